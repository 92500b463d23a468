"""Motion of a nonlinear structure in its loop, from one sample to the next.

As in `casid.design.loop` the sticks are u = u₀ + r - K (y - y₀) at samples and straight lines in
between, delayed by τ. States follow by the classical method of Runge and Kutta. Where a delay is
shorter than a sample, what feedback adds at the next sample is not known yet and goes on as a
straight line, an error of second order in the interval.
"""

from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.nonlinear.model import NonlinearModel

PASSES = 3  # of what a stick does to its own sample, by a direct term and feedback


class Motion:
    """Flights of a structure at any parameters λ from any trim, N samples, h apart.

    K (nu, ny) are the gains; integration takes so many ``parts`` an interval, and no delay is
    longer than ``longest``. At a point that is no balance the rest of dx/dt there is taken off.
    """

    def __init__(
        self, model: NonlinearModel, K: Array, *, h: float, N: int, parts: int, longest: float
    ) -> None:
        self.h, self.N, self._equations = h, N, model.equations()
        self._sizes = nx, nu, ny = len(model.states), len(model.inputs), len(model.outputs)
        depth, count = int(longest / h) + 1, len(model.parameter_names())
        own = [
            ca.SX.sym(name, n)
            for name, n in zip("uxyrdl", (nu, nx, ny, nx, nu, count), strict=True)
        ]
        step = _step(self._equations, own, K, h, parts, depth)
        self._fly = step.mapaccum("fly", N)
        self._before = np.zeros(nx + nu * (depth + 1))

    def place(self, z: Array, lam: Array, tau: Array) -> Array:
        """What one aircraft flies by: total states and inputs z in trim, λ, delays (nu,) [s]."""
        x0, u0 = np.split(z, [self._sizes[0]])
        rate, y0 = (np.ravel(part.full()) for part in self._equations(x0, u0, lam))
        return np.concatenate([u0, x0, y0, rate, tau / self.h, lam])

    def fly(self, place: Array, r: Array) -> Array:
        """Sticks, outputs and states (N, nu + ny + nx), in deviations, after a designed input r."""
        both = np.hstack([r, np.append(r[1:], r[-1:], axis=0)]).T
        return np.asarray(self._fly(np.concatenate([self._before, place]), both)[1].full().T)


def _step(
    f: ca.Function, own: list[Any], K: Array, h: float, parts: int, depth: int
) -> ca.Function:
    """From one sample to the next: (s, (r now, r then)) -> (s, (u, y, x)), in deviations.

    s holds the states, what feedback added last, the sticks of the samples before, the last one
    first, and ``own``, what an aircraft flies by, delays in samples.
    """
    u0, x0, y0, rate0, lag, lam = own
    nx, nu, h = x0.numel(), u0.numel(), h / parts
    before, r = ca.SX.sym("s", nx + nu * (depth + 1)), ca.SX.sym("r", 2 * nu)
    x, last, past = ca.vertsplit(before, [0, nx, nx + nu, before.numel()])
    past = ca.reshape(past, nu, depth)

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
    kept = ca.vertcat(*own)
    after = ca.vertcat(z, back, ca.vec(sticks[:, 1 : depth + 1]), kept)
    return ca.Function("step", [ca.vertcat(before, kept), r], [after, ca.vertcat(u, y, x)])


def _acting(sticks: Any, lag: Any, w: float) -> Any:  # noqa: ANN401 - expressions
    """Of sticks (nu, n), that at the next sample first, what acts w of a sample from now.

    Between samples they are lines: each sample counts by how near it is, within one.
    """
    ago = 1.0 + lag - w  # samples before the next one
    near = [ca.fmax(0.0, 1.0 - ca.fabs(ago - k)) for k in range(sticks.shape[1])]
    return ca.sum2(sticks * ca.horzcat(*near))
