"""Records recognised again, decimated, cut or detrended, by a few of their samples.

A fingerprint is the least of the digests of a record's samples, all channels together, trim
included and time left out: any large part of the record has a share of the same ones (A. Z. Broder,
On the resemblance and containment of documents, 1997).
"""

from collections.abc import Sequence
from hashlib import blake2b

import numpy as np

from casid.record import Record

KEPT = 64  # digests of a fingerprint
SHARED = 0.125  # of them in another record: they are one flight


def fingerprint(record: Record) -> tuple[str, ...]:
    """The least digests of a record's different samples."""
    return tuple(sorted(_digests(record, record.inputs, record.outputs))[:KEPT])


def same_flight(
    prints: Sequence[str], inputs: Sequence[str], outputs: Sequence[str], record: Record
) -> bool:
    """Whether a record has samples of a fingerprint of these channels; False if it lacks some."""
    if not prints or not {*inputs, *outputs} <= {*record.inputs, *record.outputs}:
        return False
    shared = len(_digests(record, inputs, outputs).intersection(prints))
    return shared > max(1.0, SHARED * len(prints))


def _digests(record: Record, inputs: Sequence[str], outputs: Sequence[str]) -> set[str]:
    names = (*inputs, *outputs)
    columns = [record.channel(name) + record.trim.get(name, 0.0) for name in names]
    table = np.ascontiguousarray(np.nan_to_num(np.column_stack(columns), nan=-1e30))
    rounded = (table.astype(np.float32) + np.float32(0)).view(np.uint8).reshape(len(table), -1)
    return {blake2b(row.tobytes(), digest_size=6).hexdigest() for row in rounded}
