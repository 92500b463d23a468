"""Nonlinear structures: dx/dt = f(x, u(t - τ); λ), y = h(x, u(t - τ); λ), in total values.

A subclass of `NonlinearModel` declares parameters, delays and constraints as a `Model` does, and
writes f and h as methods of named states and inputs. As a `Model` it is its own linearisation at
its reference condition; `NonlinearModel.at` linearises elsewhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar, Self, cast

import casadi as ca
import numpy as np

from casid import declaration
from casid.arrays import Array
from casid.code_dependencies import Surroundings, surroundings
from casid.errors import ModelError, warn
from casid.model import Model, Rows, constants
from casid.nonlinear.conditions import Trim, check_named, linearisation
from casid.nonlinear.coverage import joined_spans, reached, warn_beyond
from casid.nonlinear.expressions import evaluated, jumping, linearised, reference_point
from casid.nonlinear.kinks import kinks
from casid.sensors import Scalar

SCATTERED = 6  # conditions at which equations are told from others


class NonlinearModel(Model, base=True):
    """Base of every nonlinear structure; subclasses become frozen dataclasses like a `Model`'s.

    ``units`` may say the units of states, inputs and outputs, for tables. `Model.sensors` are those
    of a linear structure but for delays: outputs of ``measurements`` are at the centre of gravity.
    """

    units: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, *, base: bool = False) -> None:
        if cls.late_outputs:
            raise ModelError(
                f"{cls.__name__}.late_outputs: sensors of nonlinear structures have no delay; "
                "shift the channels of the records instead (Record.shift)"
            )
        super().__init_subclass__(base=base)
        if both := [name for name in cls.states if name in cls.inputs]:
            raise ModelError(
                f"{cls.__name__}: {both[0]!r} is a state and an input, which a flight condition "
                "could not tell apart; rename one"
            )

    # ---- what a structure writes ----------------------------------------------------------------

    def derivatives(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401, ARG002
        """dx/dt, one expression a state, of named states ``x.p`` and inputs ``u.lat``."""
        raise ModelError(f"{type(self).__name__} has no method derivatives")

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401, ARG002
        """Outputs, one expression each; unless written, the states of the outputs' names."""
        if missing := [name for name in self.outputs if name not in self.states]:
            raise ModelError(
                f"{type(self).__name__} has no method measurements, and output {missing[0]!r} is "
                "no state"
            )
        return [getattr(x, name) for name in self.outputs]

    def reference(self) -> Mapping[str, Scalar]:
        """States and inputs of a typical flight condition; zero where not named."""
        return {}

    # ---- what every structure can do ------------------------------------------------------------

    def equations(self) -> ca.Function:
        """CasADi function (x, u, λ) -> (dx/dt, y) of total values.

        Raises
        ------
        ModelError
            Methods that raise or do not give one expression a state and an output, operations that
            no estimator can differentiate, values not finite at the reference condition.
        """
        return _equations(cast(Any, cls := type(self)), constants(self), surroundings(cls))

    def operating_point(self) -> tuple[Array, Array]:
        """States (nx,) and inputs (nu,) of the reference condition."""
        x0, u0 = reference_point(self)
        return np.array([float(v) for v in x0]), np.array([float(v) for v in u0])

    def at(self, *conditions: Trim | Mapping[str, float]) -> Model:
        """The linear structure about one flight condition, in deviations from it.

        Parameters
        ----------
        conditions : Trim or mapping
            Total values of states and inputs, such as those in a record's ``trim``. Several,
            named, stand side by side in one linear structure with channels like ``p@60 kn``.

        Returns
        -------
        Model
            With the same parameters, and one more for each unknown of the trims, which the balance
            dx/dt = 0 then ties. Its matrices are the Jacobians' expressions. A `DataWarning` tells
            of conditions beyond the structure's tables, and of such on a jump or a kink.

        Raises
        ------
        ValueError, ModelError
            What is no condition, such as a record; a name that is no channel; an
            unknown that is no state or input, a balance that nothing unknown can bring about,
            several conditions without names of their own.
        """
        for each in conditions:
            if not isinstance(each, Trim | Mapping):
                raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
                    f"at: a {type(each).__name__} is no flight condition; give total values of "
                    "states and inputs, model.at(Trim(values={...})), as a detrended record has "
                    "them: model.at(Trim(values=record.trim))"
                )
            check_named(self, each.values if isinstance(each, Trim) else each)
        given = [each if isinstance(each, Trim) else Trim(values=each) for each in conditions]
        linear = linearisation(self, given)
        for each in given:
            if not each.unknown:
                said = ", ".join(f"{name} = {value:.4g}" for name, value in each.values.items())
                _check_finite(self, self.equations(), *self._placed(each), f"at {said}")
                if found := kinks(self, *self._placed(each)):
                    warn(
                        f"linearised where {'; '.join(found)}: the slope there belongs to "
                        "neither side, and motions about it show another. Take a condition "
                        "beside it, or write something smooth (casadi.tanh, casid.spline)"
                    )
        known = [self.reached_at(each) for each in given if not each.unknown]
        warn_beyond(self, "linearised at a condition", joined_spans(known))
        return linear

    def reached_at(self, condition: Trim) -> dict[str, tuple[float, float]]:
        """Airspeed and the variables of tables at a condition, as spans of one value."""
        x, u = self._placed(condition)
        return reached(self, x[None], u[None])

    def _placed(self, condition: Trim) -> tuple[Array, Array]:
        """States (nx,) and inputs (nu,) of a condition, the reference's where it has none."""
        usual = zip((*self.states, *self.inputs), np.concatenate(self.operating_point()),
                    strict=True)  # fmt: skip
        own = np.array([condition.values.get(name, value) for name, value in usual], dtype=float)
        return own[: len(self.states)], own[len(self.states) :]

    def with_values_of(self, model: Model) -> Self:
        """The same structure with the values of another one's parameters of the same names."""
        own = self.parameter_names()
        return replace(self, **{n: getattr(model, n) for n in model.parameter_names() if n in own})

    def numbers(self) -> list[Array]:
        """Those of the linear model at the reference condition, then dx/dt and y scattered wide."""
        here = np.concatenate(self.operating_point())
        far = np.sin(np.arange(1.0, 1 + SCATTERED * len(here))).reshape(SCATTERED, -1)
        points = (here + (1 + np.abs(here)) * far).T
        x, u = np.split(points, [len(self.states)])
        return [*super().numbers(), *(y.full() for y in self.equations()(x, u, self.vector()))]

    def A(self) -> Rows:
        """df/dx at the reference condition."""
        return linearised(self, *reference_point(self))[0]

    def B(self) -> Rows:
        """df/du at the reference condition."""
        return linearised(self, *reference_point(self))[1]

    def C(self) -> Rows:
        """dh/dx at the reference condition."""
        return linearised(self, *reference_point(self))[2]

    def D(self) -> Rows:
        """dh/du at the reference condition."""
        return linearised(self, *reference_point(self))[3]


@lru_cache(maxsize=64)
def _equations(
    cls: type[NonlinearModel],
    rest: tuple[tuple[str, Any], ...],
    read: Surroundings,  # noqa: ARG001 - it is remembered by
) -> ca.Function:
    """`NonlinearModel.equations` of a structure with its constants and what its methods read."""
    _check_units(cls)
    lam = ca.SX.sym("lam", len(cls.parameter_names()))
    x, u = ca.SX.sym("x", len(cls.states)), ca.SX.sym("u", len(cls.inputs))
    model = cls(**dict(rest))
    f, h = evaluated(model.with_vector(lam), ca.vertsplit(x), ca.vertsplit(u))
    for method, part in (("derivatives", f), ("measurements", h)):
        declaration.check_closed(f"{cls.__name__}.{method}", part, ca.vertcat(x, u, lam))
    function = ca.Function("equations", [x, u, lam], [f, h], ["x", "u", "lam"], ["f", "h"])
    named = zip((*cls.states, *cls.outputs), ca.vertsplit(ca.vertcat(f, h)), strict=True)
    for name, expression in named:
        if found := jumping(expression):
            raise ModelError(
                f"{cls.__name__}: {name!r} uses {found[0]}, which jumps and has no derivative; "
                "write something smooth (casid.spline, casadi.tanh)"
            )
    where = "at the guess in the reference condition (method reference)"
    _check_finite(model, function, *model.operating_point(), where)
    return function


def _check_units(cls: type[NonlinearModel]) -> None:
    if unknown := sorted(set(cls.units) - {*cls.states, *cls.inputs, *cls.outputs}):
        raise ModelError(
            f"{cls.__name__}.units names {unknown[0]!r}, which is no state, input or output"
        )


def _check_finite(
    model: NonlinearModel, function: ca.Function, x: Array, u: Array, where: str
) -> None:
    values = function(x, u, model.vector())
    for said, names, part in zip(("d/dt of", "output"), (model.states, model.outputs), values,
                                 strict=True):  # fmt: skip
        for name, value in zip(names, part.full().ravel(), strict=True):
            if not np.isfinite(value):
                raise ModelError(
                    f"{type(model).__name__}: {said} {name!r} is {value} {where}; check its "
                    "formula (casadi.sin, not math.sin), or give a condition in which it holds"
                )
