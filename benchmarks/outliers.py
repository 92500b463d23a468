"""Outliers of 20 deviations in flights with lost samples: how many are found, how many invented.

Records of the examples (UH-60, AH-1S, AW109) with noise, of which samples are lost in several ways,
and five outliers in each.

Run: python -m benchmarks.outliers [every n-th record]       (a minute or two for all of them)
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.flights import FAR, scattered
from benchmarks.tables import against, table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS
from casid import outliers, read_csv

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
COUNT = 5
LIMIT = 1.0  # innocent samples in 1e5


def whole(record, rng):  # noqa: ARG001 - as the others
    """Nothing lost."""
    return record


def bursts(record, rng):
    """Four samples of all outputs lost every 2 s."""
    k = (np.arange(record.N) + rng.integers(100)) % round(2 / record.dt)
    return record.mask(np.broadcast_to((k < 4)[:, None], record.y.shape))


def halves(record, rng):
    """Half of the channels at half the rate."""
    return slower(record, rng, [1, 2])


def quarters(record, rng):
    """Channels at the whole, half and a quarter of the rate."""
    return slower(record, rng, [1, 2, 4])


def both(record, rng):
    """Channels at these rates, a tenth of their samples lost at random."""
    return quarters(record, rng).mask(rng.random(record.y.shape) < 0.1)


def slower(record, rng, among):
    """Channels with every n-th sample, n one of these."""
    every = rng.choice(among, record.ny)
    k = np.arange(record.N)[:, None] + rng.integers(max(among), size=record.ny)
    return record.mask(k % every != 0)


def flown(file, rng):
    """A record with noise on its outputs."""
    columns = file.read_text().partition("\n")[0].strip().split(",")
    inputs, outputs = ([n for n in names if n in columns] for names in (INPUTS, OUTPUTS))
    record = read_csv(file, inputs=inputs, outputs=outputs)
    return record.with_noise({name: NOISE[name] for name in outputs}, rng)


def spiked(record, rng):
    """The record with outliers, and where they are."""
    seen = np.argwhere(np.isfinite(record.y))
    places = seen[rng.choice(len(seen), COUNT, replace=False)]
    y = record.y.copy()
    for k, i in places:
        y[k, i] += FAR * NOISE[record.outputs[i]] * rng.choice([-1, 1])
    return replace(record, y=y), {(int(k), int(i)) for k, i in places}


def main():
    step = int(sys.argv[1]) if sys.argv[1:] else 1
    files = sorted(EXAMPLES.glob("[a-u]*/data/*.csv"))
    files = [file for file in files if file.parts[-3] in ("ah1s", "aw109", "uh60")][::step]
    lines = []
    for how in (whole, bursts, scattered, halves, quarters, both):
        samples = innocent = found = 0
        for number, file in enumerate(files):
            rng = np.random.default_rng([number, 7])
            record, there = spiked(how(flown(file, rng), rng), rng)
            marks = {(int(k), int(i)) for k, i in np.argwhere(outliers(record))}
            samples += int(np.isfinite(record.y).sum())
            innocent, found = innocent + len(marks - there), found + len(marks & there)
        share = against(1e5 * innocent / samples, LIMIT)
        lines.append([how.__doc__.rstrip("."), share, f"{found} of {COUNT * len(files)}"])
    print(table([f"{len(files)} records", "innocent samples called, of 1e5", "found"], lines))


if __name__ == "__main__":
    main()
