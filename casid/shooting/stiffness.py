"""How fast a nonlinear structure is, and how many steps of integration follow it."""

from typing import Any, Protocol

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.nonlinear.model import NonlinearModel
from casid.shooting.flow import Flow
from casid.shooting.intervals import Layout

REACH = 1.0  # of the fastest eigenvalue times a step, at most: then the method follows it
STABLE = 2.5  # the same, beyond which the method diverges (2.78)
MOST = 64  # steps a sampling interval
PLACES, TYPICAL = 200, 0.95  # samples at which modes are looked at; the share that steps follow


class Flown(Protocol):
    """As much of an evaluator as tells how fast its structure is."""

    model: NonlinearModel
    flow: Flow
    layout: Layout

    def matrices(self, lam: Array) -> Any:  # noqa: ANN401 - of a layer above
        """Those at the reference condition."""

    def inputs(self, m: Any) -> Array:  # noqa: ANN401
        """Delayed inputs (N, nu) at the samples."""

    def flown(self, rows: np.ndarray) -> Array:
        """States (n, nx) at samples, as measured."""


def first_steps(evaluator: Flown, lam: Array) -> int:
    """Steps a sampling interval that follow the fastest mode, at the reference and as flown.

    ModelError where none do at the reference.
    """
    longest, model = float(evaluator.layout.classes.max()), evaluator.model
    A = evaluator.matrices(lam).A
    pole, place = _fastest(A) if np.isfinite(A).all() else (0j, 0)  # no slope at the reference
    if abs(pole) * longest > STABLE * MOST and pole.real < 0:
        raise ModelError(
            f"{type(model).__name__} is stiff at the start: its mode at {pole:.3g} 1/s, mostly "
            f"of {model.states[place]}, is too fast for {MOST} steps within {longest:.3g} s; "
            f"write {model.states[place]} in its steady state, or make its lag longer"
        )
    fastest = max(abs(pole), fastest_flown(evaluator, lam)[0]) * longest
    return int(np.clip(np.ceil(fastest / REACH), 1, MOST))


def fastest_flown(evaluator: Flown, lam: Array) -> tuple[float, str]:
    """The fastest mode's modulus [rad/s] where the records are, and the state it is mostly of.

    But for single wild samples; zero and no state where no sample has a value.
    """
    rows = np.unique(np.linspace(0, len(evaluator.layout.y) - 1, PLACES).astype(int))
    u = evaluator.inputs(evaluator.matrices(lam))[rows]
    with np.errstate(all="ignore"):
        A = evaluator.flow.f(evaluator.flown(rows), u, lam)[1]
    A = A[np.isfinite(A).all(axis=(1, 2))]
    if not len(A):
        return 0.0, ""
    rates = np.abs(np.linalg.eigvals(A)).max(axis=1)
    typical = float(np.quantile(rates, TYPICAL))
    _, place = _fastest(A[int(np.argmin(np.abs(rates - typical)))])
    return typical, evaluator.model.states[place]


def _fastest(A: Array) -> tuple[complex, int]:
    """The fastest pole of a linearisation, and which state moves most in its mode."""
    poles, vectors = np.linalg.eig(A)
    worst = int(np.argmax(np.abs(poles)))
    return poles[worst], int(np.argmax(np.abs(vectors[:, worst])))
