"""A card flown in the nonlinear structure that it was designed for, in its loop.

As in `casid.design.loop` the sticks are u = u₀ + r - K (y - y₀) at samples and straight lines in
between, delayed by τ. States follow by the classical method of Runge and Kutta. Where a delay is
shorter than a sample, what feedback adds at the next sample is not known yet and goes on as a
straight line, an error of second order in the interval.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.design.loop import Feedback, gains
from casid.design.nonlinear_information import Flown
from casid.design.optimise import Task
from casid.design.prior import condition
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.nonlinear.conditions import Trim
from casid.nonlinear.model import NonlinearModel

REACH = 0.5  # of the fastest mode times a step of the integration, at most
LEAST, MOST = 4, 100  # steps of it a sample: lines break within one, where delays have them do so
PASSES = 3  # of what a stick does to its own sample, by a direct term and feedback
ROUNDS = 40  # of making a card smaller
SAFE = 1e-3  # by which it is made smaller than it needs to be, so that rounds end
HALF = 2.0  # a card that is further beyond its limits, or runs away, is halved first


class Flight:
    """A nonlinear structure in its loop from a trim, sampled N times every h seconds.

    ``free`` are the parameters of its linearisation there, whose modes and delays count.
    """

    def __init__(
        self,
        model: NonlinearModel,
        trim: Trim | Mapping[str, float] | None,
        free: Free,
        feedback: Feedback,
        task: Task,
    ) -> None:
        at, (h, N) = MatrixFunction(free)(free.guess), (task.loops[0].h, task.loops[0].N)
        values = condition(model, trim).values
        x0, u0 = (np.array([values[n] for n in names]) for names in (model.states, model.inputs))
        y0 = model.equations()(x0, u0, model.vector())[1].full().ravel()
        self._free, self._values = replace(free, model=model), np.concatenate([u0, y0, x0])
        self._t = h * np.arange(N)
        K = gains(feedback, model.inputs, model.outputs)
        fastest = float(np.abs(np.linalg.eigvals(at.blocks[0])).max())
        parts = int(np.clip(np.ceil(fastest * h / REACH), LEAST, MOST))
        step = _step(model, (x0, u0), K, at.tau / h, h / parts, parts)
        self._fly, self._start = step.mapaccum("fly", N), np.zeros(step.size1_in(0))
        self._task = task

    def fly(self, r: Array) -> Array:
        """Sticks, outputs and states (N, nu + ny + nx), in deviations, after a designed input r."""
        after = np.append(r[1:], r[-1:], axis=0)
        return np.asarray(self._fly(self._start, np.hstack([r, after]).T)[1].full().T)

    def shares(self, r: Array) -> Array:
        """Largest shares of the limits (2 nu + ny + nx,); infinite where the flight runs away."""
        most = np.abs(self._task.shares(self.fly(r))).max(axis=0)
        return np.where(np.isfinite(most), most, np.inf)

    @property
    def trim(self) -> dict[str, float]:
        """Total values of states, inputs and outputs."""
        model, (nu, ny) = self._free.model, (len(self._free.model.inputs), self._task.loops[0].ny)
        u, y, x = np.split(self._values, [nu, nu + ny])
        pairs = (model.states, x), (model.inputs, u), (model.outputs, y)
        return {n: v for names, own in pairs for n, v in zip(names, own.tolist(), strict=True)}

    def flown(self, r: Array) -> Flown:
        """The flight after r as output error sees it."""
        nu, ny = len(self._free.model.inputs), self._task.loops[0].ny
        parts = np.split(self._values + self.fly(r), [nu, nu + ny], axis=1)
        return Flown(self._free, self._t, *parts)

    def within(self, r: Array) -> Array:
        """An input that keeps the limits in the linearisation, as small as it takes here."""
        for _ in range(ROUNDS):
            if (most := float(self.shares(r).max())) <= 1.0:
                return r
            r = r / min(HALF, most + SAFE)
        raise ValueError(
            "the nonlinear structure diverges after inputs of any size, though its linearisation "
            "at the trim does not: check its equations there, or design for model.at(trim)"
        )


def _step(
    model: NonlinearModel, trim: tuple[Array, Array], K: Array, lag: Array, h: float, parts: int
) -> ca.Function:
    """From one sample to the next: (s, (r now, r then)) -> (s, (u, y, x)), in deviations.

    s holds the states, what feedback added last, and the sticks of the samples before, the last
    one first. Delays are in samples, h is one of so many parts of the interval.
    """
    (x0, u0), (f, lam) = trim, (model.equations(), model.vector())
    rate0, y0 = f(x0, u0, lam)
    nx, nu, depth = len(x0), len(u0), int(lag.max()) + 1
    s, r = ca.SX.sym("s", nx + nu * (depth + 1)), ca.SX.sym("r", 2 * nu)
    x, last, past = s[:nx], s[nx : nx + nu], ca.reshape(s[nx + nu :], nu, depth)

    def rate(x: Any, d: Any) -> Any:  # noqa: ANN401 - expressions
        return f(x0 + x, u0 + d, lam)[0] - rate0

    y: Any = y0
    back: Any = last
    for _ in range(PASSES):
        sticks = ca.horzcat(r[nu:], r[:nu] + back, past)
        y = f(x0 + x, u0 + _acting(sticks, lag, 0.0), lam)[1] - y0
        back = -ca.mtimes(K, y)
    u = r[:nu] + back
    sticks = ca.horzcat(r[nu:] + 2 * back - last, u, past)
    z = x
    for k in range(parts):
        now, mid, then = (_acting(sticks, lag, (k + w) / parts) for w in (0.0, 0.5, 1.0))
        k1 = rate(z, now)
        k2 = rate(z + h / 2 * k1, mid)
        k3 = rate(z + h / 2 * k2, mid)
        k4 = rate(z + h * k3, then)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    after = ca.vertcat(z, back, ca.vec(sticks[:, 1 : depth + 1]))
    return ca.Function("step", [s, r], [after, ca.vertcat(u, y, x)])


def _acting(sticks: Any, lag: Array, w: float) -> Any:  # noqa: ANN401 - expressions
    """Of sticks (nu, n), that at the next sample first, what acts w of a sample from now."""
    ago = 1.0 + lag - w  # samples before the next one
    k = np.minimum(ago.astype(int), sticks.shape[1] - 2)
    pairs = [(sticks[j, int(i)], sticks[j, int(i) + 1]) for j, i in enumerate(k)]
    new, old = (ca.vertcat(*each) for each in zip(*pairs, strict=True))
    return new + (ago - k) * (old - new)
