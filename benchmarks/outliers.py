"""Outliers of 20 deviations in flights with lost samples: how many are found, how many invented.

Records of the examples (UH-60, AH-1S, AW109) with noise, of which samples are lost in several ways,
and five outliers in each; then shares of all samples, or of those of one channel.

Run: python -m benchmarks.outliers [every n-th record]       (a minute or two for all of them)
"""

import argparse
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
SHARES = (0.01, 0.03, 0.05, 0.1)


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


def many(record, rng, share, alone):
    """The record with a share of its samples, or of one channel's, off, and which (N, ny)."""
    there = (rng.random(record.y.shape) < share) & np.isfinite(record.y)
    if alone:
        there &= np.arange(record.ny) == rng.integers(record.ny)
    size = FAR * np.array([NOISE[name] for name in record.outputs])
    return replace(record, y=record.y + there * size * rng.choice([-1, 1], there.shape)), there


def shares(files):
    """Rows of the second table."""
    for share in SHARES:
        row = [f"{share:.1%}"]
        for how, alone in ((whole, False), (whole, True), (quarters, False)):
            found = innocent = count = samples = 0
            for number, file in enumerate(files):
                rng = np.random.default_rng([number, 9])
                record, there = many(how(flown(file, rng), rng), rng, share, alone)
                marks = outliers(record)
                found, count = found + (marks & there).sum(), count + there.sum()
                innocent += (marks & ~there).sum()
                samples += np.isfinite(record.y).sum()
            row.append(f"{found / count:.1%} of {count}, {1e5 * innocent / samples:.1f}")
        yield row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("step", nargs="?", type=int, default=1, help="every n-th record")
    step = parser.parse_args().step
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
    print("\nFound, and innocent samples called, of 1e5")
    heads = ["share", "of all samples", "of one channel's", "the first, with channels at rates"]
    print(table(heads, list(shares(files))))


if __name__ == "__main__":
    main()
