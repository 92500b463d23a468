"""Whether a solve ended as a solution, and what is said where it did not."""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.nlp import Solution
from casid.nonlinear.model import NonlinearModel
from casid.shooting.programme import Programme
from casid.shooting.starting import channel_size

AWAY = 100.0  # times an output's size: no bias of an instrument
DIGITS = 0.01  # of the noise, that rounding of what ran away may be
STILL, RAMP = 1e-10, 0.1  # e-folds over a record: of an integral, and of what makes a ramp


def verdict(
    solution: Solution,
    settled: bool,
    unsettled: str,
    more: Sequence[str],
    broken: str | None = None,
) -> tuple[bool, str]:
    """Whether this is a solution, and in words; ``more`` speaks against it.

    ``broken`` is what a solver that fails may have failed at: constraints that cannot hold.
    """
    failed = f"{solution.status}: {broken}" if broken else solution.status
    reasons = [unsettled] * (not settled) if solution.success else [failed]
    reasons += more
    return not reasons, "; ".join(reasons) or solution.status


def run_away(programme: Programme, x: Array, lost: int = 0) -> str:
    """What is said of biases that have left what was measured, at scaled variables x; or nothing.

    A mode at no speed with an endless initial state is a ramp, and its offset a bias: where that is
    likeliest of records that drift there is no end, and nothing that leads there is determined.
    Where the mode is an integral whatever the parameters are, its initial state and a bias are one,
    which is no matter if nothing is ``lost`` of what is to be determined, nor of the digits.
    """
    point = programme.unpack(x)
    size = np.abs(point.bias).max(axis=0)
    away = size > AWAY * channel_size(programme.evaluator)
    drowned = np.spacing(size) > DIGITS * np.sqrt(np.diag(programme.values(x).R))
    if not (lost or (away & drowned).any() or _slow(programme, point.lam)):
        return ""
    names = ", ".join(np.array(programme.free.model.outputs)[away])
    return names and (
        f"initial states and the biases of {names} diverge together, beyond {AWAY:.0f} times "
        "what was measured: a mode with an eigenvalue near zero turns the drift of the records "
        "into a ramp. Drop those biases (biases=), or state the initial states "
        "(OutputError(initial=...).fit)"
    )


def _slow(programme: Programme, lam: Array) -> bool:
    """Whether a mode hardly moves over the records, and is no integral by structure."""
    free = programme.free
    if isinstance(free.model, NonlinearModel):
        return False
    own = free.model.with_vector(free.full(lam[: len(free.index)]))
    longest = max(record.duration for record in programme.evaluator.layout.records)
    speed = np.abs(np.linalg.eigvals(own.system().A)) * longest
    return bool(((speed > STILL) & (speed < RAMP)).any())
