"""A flight as output error of its nonlinear structure will see it: what it tells.

F = Σ (∂y/∂λ)ᵀ R⁻¹ (∂y/∂λ) as in `casid.design.loop`, but with the sensitivities along the nonlinear
motion, for the sticks as they were flown; initial states and biases are projected out.
"""

import numpy as np

from casid.arrays import Array
from casid.design.loop import spanned
from casid.free import Free
from casid.record import Record
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Point, whiteners


class Flown:
    """Total sticks (N, nu), outputs (N, ny) and states (N, nx) of a flight at instants t (N,).

    ``free`` are the parameters of the nonlinear structure. The motion is taken from sample to
    sample: one that only feedback holds would leave these states otherwise.
    """

    def __init__(self, free: Free, t: Array, u: Array, y: Array, x: Array) -> None:
        record = Record(t, u, y, free.model.inputs, free.model.outputs)
        self._evaluator = NonlinearEvaluator(free, lay_out([record], np.inf))
        self._point = Point(lam=free.guess, bias=np.zeros((1, y.shape[1])), nodes=x[:1])
        self._motion = self._evaluator.along(self._point, x)

    def information(self, R: Array) -> Array:
        """F (nf, nf) under noise of covariance R a sample.

        ValueError: an equation without a derivative on the way.
        """
        e = self._evaluator
        sweep = e.sweep(self._point, self._motion, whiteners(R, e.layout))
        n = e.nf + e.nx + e.ny
        every = np.concatenate(list(next(sweep.influence(np.eye(n)[None])))).reshape(-1, n)
        if not np.isfinite(every).all():
            raise ValueError(
                f"{type(e.model).__name__} has an equation without a derivative somewhere in the "
                "flight, as a square root has at zero, so its information cannot be computed: "
                "write it differentiably, or design for model.at(trim)"
            )
        J, unknown = np.split(every, [e.nf], axis=1)
        basis = spanned(unknown)
        J = J - basis @ (basis.T @ J)
        return np.asarray(J.T @ J)

    def jumps(self) -> str:
        """What is said of jumps of equations that the flight passes; "" of none."""
        return self._evaluator.jumps(self._point, self._motion)
