"""A nonlinear structure as functions that step it from sample to sample, delays exact.

Between samples by the classical Runge-Kutta method, as `casid.shooting.nonlinear` has it where
inputs break at every sample.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.intersample import delayed_input
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold
from casid.shooting.flow import cut
from casid.shooting.runge_kutta_inputs import stage_inputs

RESTLESS = 4.0  # of inputs on which a unit pulse rides: they break whatever it does
DIGITS = 14  # of weights that are known
FINE = 4.0  # steps within a radian of the fastest mode, at least


def usual_steps(
    model: NonlinearModel, dt: float, flown: Mapping[str, tuple[float, float]] | None = None
) -> int:
    """Runge-Kutta steps a sampling interval that follow the fastest mode well.

    At the reference condition and at the ends of what of states and inputs was flown.
    """
    names = (*model.states, *model.inputs)
    ends = [{n: end} for n, span in (flown or {}).items() if n in names for end in span]
    systems = [model.system(), *(model.at(end).system() for end in ends)]
    fastest = max(float(np.abs(each.poles()).max(initial=0.0)) for each in systems)
    return max(1, int(np.ceil(FINE * fastest * dt)))


def steps_of(
    model: NonlinearModel, dt: float, hold: Hold, count: int
) -> tuple[ca.Function, ca.Function]:
    """The functions ``start`` (x0, u0) -> z and ``step`` (z, u) -> (z of the next sample, y).

    The memory z is the state at the last sample, the time since then (none before the first), and
    the inputs of the past: what happens after a sample is known when the next one is.
    """
    T, V, lengths = _taps(model, dt, hold, count)
    past, nx, nu = len(V) - 1, len(model.states), len(model.inputs)
    f = ca.Function("f", *_of(model))
    z, u = ca.MX.sym("z", nx + 1 + past * nu), ca.MX.sym("u", nu)
    before = [z[nx + 1 + i * nu : nx + 1 + (i + 1) * nu] for i in range(past)]
    inputs = [u, *before]

    def held(weights: Array) -> ca.MX:
        """Inputs (past + 1, nu) weighed."""
        return sum((ca.DM(w) * each for w, each in zip(weights, inputs, strict=True)), ca.MX(nu, 1))

    x = z[:nx]
    for s, length in enumerate(lengths.tolist()):
        h = z[nx] * length
        first, middle, last = (held(T[:, s, i]) for i in range(3))
        k1 = f(x, first)[0]
        k2 = f(x + h / 2 * k1, middle)[0]
        k3 = f(x + h / 2 * k2, middle)[0]
        k4 = f(x + h * k3, last)[0]
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    y = f(x, held(V))[1]
    after = ca.vertcat(x, dt, *inputs[:past])
    step = ca.Function("step", [z, u], [after, y], ["z", "u"], ["z_next", "y"])
    step = step.expand()  # of scalars alone: whoever calls the source need lend it no memory
    x0 = ca.MX.sym("x0", nx)
    rest = ca.vertcat(x0, 0.0, *[u] * past)
    return ca.Function("start", [x0, u], [rest], ["x0", "u0"], ["z"]), step


def _of(model: NonlinearModel) -> tuple[list[ca.SX], list[ca.SX]]:
    """Arguments (x, u) and results (dx/dt, y) of the structure at its values."""
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
    found = model.equations()(x, u, model.vector())
    return [x, u], ca.cse([ca.densify(each) for each in found])


def _taps(model: NonlinearModel, dt: float, hold: Hold, count: int) -> tuple[Array, Array, Array]:
    """Weights of this sample's inputs and earlier ones, from a unit pulse on all channels.

    At the stages of the steps before this sample, (n, steps, 3, nu), and at it, (n, nu). And those
    steps' lengths (steps,), in sampling intervals. The pulse rides on inputs that break at all
    samples, so that no step is left whole for want of a break.
    """
    tau = np.asarray(model.system().delay, dtype=float)
    pulse = int(np.ceil(tau.max(initial=0.0) / dt)) + 3
    t, cuts = dt * np.arange(2 * pulse + 2), cut(model)
    restless = np.repeat(RESTLESS * (-1.0) ** np.arange(len(t))[:, None], len(tau), axis=1)

    def heard(u: Array) -> tuple[Array, Array, Array]:
        held = delayed_input(t, u, tau, hold, tau)
        stages = stage_inputs([held], [hold], np.full(len(t), dt), (count, 1), cuts)
        after = slice(pulse, 2 * pulse + 1)
        return stages.u[pulse - 1 : 2 * pulse], held.value[after], stages.eta[pulse] / dt

    both = heard(restless + (np.arange(len(t)) == pulse)[:, None]), heard(restless)
    T, V = (np.round(both[0][i] - both[1][i], DIGITS) for i in (0, 1))
    used = np.flatnonzero((T != 0).any(axis=(1, 2, 3)) | (V != 0).any(axis=1))
    last = int(used.max(initial=0)) + 1
    return T[:last], V[:last], both[0][2]
