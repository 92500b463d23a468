"""What output error takes: records that tell enough, and what R may be."""

from typing import get_args

import numpy as np

from casid.arrays import Array
from casid.display import counted
from casid.free import Free
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import Records, check_alive, stretches
from casid.shooting.likelihood import CovarianceKind
from casid.shooting.priors import in_totals
from casid.slow_sources import tell_repeats

MANY = 2.0  # measurements for every unknown, at least


def select_records(free: Free, records: Records, biases: bool) -> list[Record]:
    """Records with the model's channels, in its order.

    ValueError: no records, a channel missing, a record too short for its own initial state and
    biases, fewer measurements in all than unknowns.
    """
    model = free.model
    totals = isinstance(model, NonlinearModel)
    given = [in_totals(r, free.initial) if totals else r for r in stretches(records)]
    chosen = [record.select(model.inputs, model.outputs) for record in given]
    if not chosen:
        raise ValueError("no records: output error needs at least one")
    needed = len(model.states) + biases * len(model.outputs)
    counts = [int(np.isfinite(record.y).sum()) for record in chosen]
    for record, count in zip(chosen, counts, strict=True):
        if count < needed:
            raise ValueError(
                f"record {record.name!r} has {counted(count, 'measurement')}; its initial state "
                f"and biases alone need {needed}: leave it out"
            )
    unknowns = len(free.index) + needed * len(chosen)
    if sum(counts) < MANY * unknowns:
        raise ValueError(
            f"the records have {sum(counts)} measurements for {unknowns} unknowns (parameters, "
            "initial states, biases), too few to estimate from: add records, or fix parameters"
        )
    check_alive(chosen)
    tell_repeats(chosen)
    return chosen


def checked_covariance(R: Array | CovarianceKind | None, ny: int) -> Array | CovarianceKind:
    """R as an array, or the structure in which to estimate it."""
    if R is None:
        return "diagonal"
    if isinstance(R, str):
        if R not in get_args(CovarianceKind):
            raise ValueError(f'R={R!r}: expected "diagonal", "full" or an (ny, ny) array')
        return R
    R = np.asarray(R, dtype=float)
    if R.shape != (ny, ny):
        raise ValueError(f"R has shape {R.shape}, expected (ny, ny) = ({ny}, {ny})")
    if not np.allclose(R, R.T) or np.linalg.eigvalsh(R).min() <= 0:
        raise ValueError("R is not symmetric positive definite: it is a covariance, squared units")
    return R
