"""Records recognised again, decimated, cut, detrended or without their means, by a few samples.

A fingerprint is the least of the digests of a record's samples, all channels together, trim
included and time left out: any large part of the record has a share of the same ones (A. Z. Broder,
On the resemblance and containment of documents, 1997). So it is for the steps from sample to
sample, which a constant that was subtracted leaves as they are.
"""

from collections.abc import Collection, Sequence
from hashlib import blake2b

import numpy as np

from casid.arrays import Array
from casid.record import Record

KEPT = 64  # digests of samples in a fingerprint, and of steps
SHARED = 0.125  # of them in another record: they are one flight
STEP = "+"  # before the digest of a step
DIFFERENT = 0.5  # of a record's steps: else sensors are too coarse for steps to tell flights apart


def fingerprint(record: Record) -> tuple[str, ...]:
    """The least digests of a record's different samples, and of its steps."""
    parts = digests(record, record.inputs, record.outputs)
    return tuple(each for part in parts for each in sorted(part)[:KEPT])


def same_flight(
    prints: Sequence[str], inputs: Sequence[str], outputs: Sequence[str], record: Record
) -> bool:
    """Whether a record has samples of a fingerprint of these channels; False if it lacks some."""
    if not prints or not {*inputs, *outputs} <= {*record.inputs, *record.outputs}:
        return False
    own = frozenset().union(*digests(record, inputs, outputs))
    return any(many_shared(part, own) for part in _parts(prints))


def same_prints(prints: Sequence[str], others: Sequence[str]) -> bool:
    """Whether two fingerprints are of one flight."""
    return any(many_shared(part, others) for part in _parts(prints))


def many_shared(prints: Collection[str], others: Collection[str], share: float = SHARED) -> bool:
    """Whether more than a share of some digests, and more than one, are among others."""
    return len(frozenset(prints).intersection(others)) > max(1.0, share * len(prints))


def digests(
    record: Record, inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[frozenset[str], frozenset[str]]:
    """All digests of a record's samples in these channels, and of its steps."""
    names = (*inputs, *outputs)
    columns = [record.channel(name) + record.trim.get(name, 0.0) for name in names]
    table = np.column_stack(columns)
    steps = np.diff(table, axis=0)
    known = steps[~np.isnan(steps).any(axis=1) & (np.nan_to_num(steps) != 0).any(axis=1)]
    marks = _of_rows(known, STEP)
    samples = _of_rows(np.nan_to_num(table, nan=-1e30))
    return samples, marks if len(marks) > DIFFERENT * len(known) else frozenset()


def _parts(prints: Sequence[str]) -> tuple[list[str], list[str]]:
    steps = [each for each in prints if each.startswith(STEP)]
    return [each for each in prints if not each.startswith(STEP)], steps


def _of_rows(table: Array, mark: str = "") -> frozenset[str]:
    """Digests of a table's rows in single precision."""
    size = 4 * table.shape[1]
    rows = (table.astype(np.float32, order="C") + np.float32(0)).view(np.uint8).reshape(-1, size)
    return frozenset(mark + blake2b(row.tobytes(), digest_size=6).hexdigest() for row in rows)
