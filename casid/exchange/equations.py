"""A model as dx/dt and y of states and inputs, without delays: what simulators ask for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casid.arrays import Array, BoolArray
from casid.channels import UNITS
from casid.exchange.delays import (
    approximated,
    delays_as_states,
    steps_told,
    warn_steps,
    without_delay,
)
from casid.linear import StateSpace
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_unbalanced

DEVIATIONS = (
    "x, u and y are deviations from the trim the model was identified at, which is not in this "
    "file: subtract it from the inputs, add it to the outputs"
)
TOTAL = "x, u and y are total values"


@dataclass(frozen=True, eq=False, kw_only=True)
class Equations:
    """dx/dt = f(x, u), y = h(x, u), for SciPy's `solve_ivp` and other integrators.

    Total values of a nonlinear structure, deviations from trim of a linear system.

    Parameters
    ----------
    states, inputs, outputs : tuple of str
        Names; states of the Padé approximation of delays behind the model's.
    units : mapping
        By name, where they are known.
    x0, u0 : (nx,) and (nu,) array
        The reference condition, zero of a linear system; states of delays at rest under u0.
    function : casadi.Function
        (x, u) -> (dx/dt, y).
    remarks : tuple of str
        What the values are, and which states stand for which delays, a sentence each.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    x0: Array
    u0: Array
    function: ca.Function
    remarks: tuple[str, ...] = ()

    def derivatives(self, t: float, x: Array, u: Array | Callable[[float], Array]) -> Array:
        """dx/dt (nx,) for inputs u (nu,), or a function of time that has them.

        ``scipy.integrate.solve_ivp(found.derivatives, (0, 10), found.x0, args=(u,))``
        """
        return self._values(0, t, x, u)

    def measurements(self, t: float, x: Array, u: Array | Callable[[float], Array]) -> Array:
        """Outputs (ny,)."""
        return self._values(1, t, x, u)

    def _values(self, which: int, t: float, x: Array, u: Array | Callable[[float], Array]) -> Array:
        at = u(t) if callable(u) else u
        return np.asarray(self.function(x, at)[which], dtype=float).ravel()


def equations_of(
    model: StateSpace | NonlinearModel,
    pade: int | None = None,
    units: Mapping[str, str] | None = None,
) -> Equations:
    """The equations of a continuous model.

    Parameters
    ----------
    model : StateSpace or NonlinearModel
        The model.
    pade : int
        As in `without_delay`.
    units : mapping
        Of channels in others than their names or the structure say: ``fit.units``.

    Raises
    ------
    ValueError
        A discrete model, delays without ``pade``. A `DataWarning` tells of a reference condition
        that is no trim.
    """
    if isinstance(model, NonlinearModel):
        return _nonlinear(model, pade, units or {})
    if model.dt is not None:
        raise ValueError(
            f"the model is discrete with an interval of {model.dt:g} s; convert it to continuous "
            "time first (BlackBox.continuous)"
        )
    plain = without_delay(model, pade)
    x, u = ca.SX.sym("x", plain.nx), ca.SX.sym("u", plain.nu)
    A, B, C, D = (ca.sparsify(ca.DM(getattr(plain, letter))) for letter in "ABCD")
    return Equations(
        states=plain.states,
        inputs=plain.inputs,
        outputs=plain.outputs,
        units={**UNITS, **(units or {})},
        x0=np.zeros(plain.nx),
        u0=np.zeros(plain.nu),
        function=_function(x, u, A @ x + B @ u, C @ x + D @ u),
        remarks=(DEVIATIONS, *_on_delays(model, plain.states, model.D != 0, pade)),
    )


def _on_delays(
    late: StateSpace, states: Sequence[str], direct: BoolArray, pade: int | None
) -> list[str]:
    """What is to be said of approximated delays."""
    told = approximated(late, states, pade)
    steps = steps_told(late, direct)
    return [*told, steps[0].upper() + steps[1:]] if told and steps else told


def _nonlinear(model: NonlinearModel, pade: int | None, units: Mapping[str, str]) -> Equations:
    """The structure's equations with its delays as a linear system before its inputs."""
    warn_unbalanced(model, "what is exported starts there")
    (x0, u0), names = model.operating_point(), model.inputs
    nu, empty = len(names), np.zeros((0, 0))
    through = np.zeros((0, nu)), np.zeros((nu, 0)), np.eye(nu)
    linear, equations = model.system(), model.equations()
    direct = np.array(ca.DM(equations.jac_sparsity(1, 1)), dtype=bool)  # y by u, wherever
    warn_steps(linear, direct, pade)
    line = delays_as_states(StateSpace(empty, *through, None, names, names, (), linear.delay), pade)
    x, u = ca.SX.sym("x", len(x0) + line.nx), ca.SX.sym("u", nu)
    own, late = x[: len(x0), 0], x[len(x0) :, 0]  # of one index a 1 x 1 makes a row
    rates, outputs = equations(own, line.C @ late + line.D @ u, model.vector())
    rest = np.linalg.solve(line.A, -line.B @ u0) if line.nx else np.zeros(0)
    return Equations(
        states=(*model.states, *line.states),
        inputs=names,
        outputs=model.outputs,
        units={**UNITS, **model.units, **units},
        x0=np.concatenate([x0, rest]),
        u0=u0,
        function=_function(x, u, ca.vertcat(rates, line.A @ late + line.B @ u), outputs),
        remarks=(TOTAL, *_on_delays(linear, line.states, direct, pade)),
    )


def _function(x: ca.SX, u: ca.SX, rates: ca.SX, outputs: ca.SX) -> ca.Function:
    dense = [ca.densify(rates), ca.densify(outputs)]
    return ca.Function("equations", [x, u], ca.cse(dense), ["x", "u"], ["dx", "y"])
