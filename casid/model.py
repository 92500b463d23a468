"""Model structures: classes of named, bounded parameters.

    dx/dt = A(λ) x + B(λ) u(t - τ(λ))        y = C(λ) x + D(λ) u(t - τ(λ))

A subclass names its states, inputs and outputs, declares each parameter with `parameter`, holds
trim values as plain fields and writes the matrices as methods. The same methods run on numbers
(an instance is one parameter set) and on CasADi symbols (`Model.matrices`).
"""

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, Literal, Self, TypeAlias, TypeVar, cast, dataclass_transform

import casadi as ca
import numpy as np

from casid import declaration, sensors
from casid.arrays import Array
from casid.checks import check_known
from casid.code_dependencies import Surroundings, surroundings
from casid.errors import ModelError
from casid.linear import StateSpace
from casid.sensors import Scalar, Sensor

Rows: TypeAlias = Sequence[Sequence[Scalar]]

NO_DELAY = 1e-6  # s, rounding of a delay on its bound
RESTORING = ContextVar("restoring", default=False)  # classes that were checked where they came from

Bounds: TypeAlias = Mapping[str, tuple[float, float]]
Priors: TypeAlias = Mapping[str, tuple[float, float]]  # λ ~ N(value, deviation²)
Initial: TypeAlias = Mapping[str, tuple[float | Literal["trim"], float]]  # or the record's trim


@dataclass(frozen=True)
class ParameterInfo:
    """What a model file says of one parameter besides its guess."""

    lower: float
    upper: float
    unit: str
    scale: float | None


@dataclass(frozen=True)
class Constraint:
    """lower <= value <= upper for an expression of parameters; equal bounds make a tie."""

    name: str
    value: Scalar
    lower: float = 0.0
    upper: float = 0.0

    def __post_init__(self) -> None:
        declaration.check_pair(str(self.name), (self.lower, self.upper))


def parameter(
    *,
    default: float,
    lower: float = -np.inf,
    upper: float = np.inf,
    unit: str = "",
    scale: float | None = None,
) -> Any:  # noqa: ANN401 - a field specifier, typed by the annotation beside it
    """Declare one parameter of a `Model`; the class checks it, since it knows the name.

    Parameters
    ----------
    default : float
        The guess.
    lower, upper : float
        Bounds; a value may lie on them.
    unit : str
        Its unit, SI and radians, "-" if it has none; must be given.
    scale : float
        Typical magnitude, for the solver; taken from guess and bounds unless given.

    Raises
    ------
    ModelError
        When the class is made: lower > upper, a guess outside the bounds, no unit, a scale that is
        not positive, any of them that is no real number.
    """
    lower, upper, scale = map(declaration.number, (lower, upper, scale))
    info = ParameterInfo(lower, upper, unit, scale)
    return field(default=declaration.number(default), metadata={"parameter": info})


@dataclass(frozen=True, kw_only=True)
@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(parameter,))
class Model:
    """Base of every structure; subclasses become frozen dataclasses with keyword arguments."""

    states: ClassVar[tuple[str, ...]]
    inputs: ClassVar[tuple[str, ...]]
    outputs: ClassVar[tuple[str, ...]]
    late_outputs: ClassVar[tuple[str, ...]] = ()  # outputs whose sensors have a delay
    constant_states: ClassVar[tuple[str, ...]] = ()  # states that may have no dynamics

    def __init_subclass__(cls, *, base: bool = False) -> None:
        if RESTORING.get():
            return
        if base:  # one more base of structures, with nothing declared
            dataclass(frozen=True, kw_only=True, eq=True)(cls)
            return
        for attribute in ("states", "inputs", "outputs"):
            declaration.check_names(cls, attribute, getattr(cls, attribute, None))
        cls.states = sensors.all_states(cls)
        bases = [each for each in cls.__mro__ if each.__module__.startswith("casid.")]
        reserved = {*(n for each in bases for n in vars(each)), "states", "inputs", "outputs"}
        for name, declared in vars(cls).items():
            if "parameter" in getattr(declared, "metadata", {}):
                declaration.check_parameter(cls, name, declared, reserved)
        declaration.check_overridden(cls)
        dataclass(frozen=True, kw_only=True, eq=True)(cls)

    def A(self) -> Rows:
        """State matrix, (nx, nx)."""
        raise ModelError(f"{type(self).__name__} has no method A")

    def B(self) -> Rows:
        """Input matrix, (nx, nu)."""
        raise ModelError(f"{type(self).__name__} has no method B")

    def C(self) -> Rows:
        """Output matrix, (ny, nx); unless written, the states of the outputs' names."""
        states = sensors.own_states(self.states, self.outputs)
        if missing := [name for name in self.outputs if name not in states]:
            raise ModelError(
                f"{type(self).__name__} has no method C, and output {missing[0]!r} is no state"
            )
        return [[float(state == name) for state in states] for name in self.outputs]

    def D(self) -> Rows:
        """Direct matrix, (ny, nu); zero unless written."""
        return [[0.0 for _ in self.inputs] for _ in self.outputs]

    def delays(self) -> Mapping[str, Scalar]:
        """Pure delay of each input named [s]; none unless written."""
        return {}

    def sensors(self) -> Mapping[str, Sensor]:
        """Place, delay and scale of what measures each output named; ideal unless written."""
        return {}

    def constraints(self) -> Sequence[Constraint]:
        """Ties and inequalities between parameters; none unless written."""
        return ()

    @classmethod
    def infos(cls) -> dict[str, ParameterInfo]:
        """What the file says of each parameter, in the order of declaration."""
        declared = [f for f in fields(cls) if "parameter" in f.metadata]
        return {f.name: f.metadata["parameter"] for f in declared}

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        """Names of λ, in the order of declaration."""
        return tuple(cls.infos())

    def vector(self) -> Array:
        """Parameter values λ, (n_λ,); ModelError for one that is no number."""
        named = {f"{type(self).__name__}.{name}": name for name in self.parameter_names()}
        values = [declaration.check_number(n, getattr(self, name)) for n, name in named.items()]
        return np.array(values)

    def with_vector(self, values: Any) -> Self:  # noqa: ANN401 - SX or array
        """The same structure and trim with other parameter values: an (n_λ,) array or SX."""
        names = self.parameter_names()
        if isinstance(values, ca.SX):
            return replace(self, **{name: values[i] for i, name in enumerate(names)})
        if len(values) != len(names):
            raise ModelError(f"{len(values)} values for {len(names)} parameters")
        numbers = zip(names, np.asarray(values), strict=True)
        return replace(self, **{name: float(value) for name, value in numbers})

    def matrices(self) -> ca.Function:
        """CasADi function λ -> (A, B, C, D, τ, c), with c the values of `constraints`.

        Entries that are literally 0 are structural zeros.

        Raises
        ------
        ModelError
            A method that raises, matrices whose shapes disagree, a delay for no input.
        """
        cls, trim = cast(Any, type(self)), constants(self)
        try:
            hash(trim)
        except TypeError:  # a field that its owner may change
            return _function.__wrapped__(cls, trim, frozenset())
        return _function(cls, trim, surroundings(cls))

    def numbers(self) -> list[Array]:
        """A, B, C, D, delays and constraints at the present values: what tells equations apart."""
        return [matrix.full() for matrix in self.matrices()(self.vector())]

    def system(self) -> StateSpace:
        """The state-space model at the present parameter values."""
        A, B, C, D, tau, _ = (matrix.full() for matrix in self.matrices()(self.vector()))
        for letter, values in zip("ABCD", (A, B, C, D), strict=True):
            if not np.isfinite(values).all():
                i, j = np.argwhere(~np.isfinite(values))[0]
                raise ModelError(
                    f"{type(self).__name__}.{letter}[{i}][{j}] is {values[i, j]} at these "
                    "parameter values; check the guess and the formula of that entry (functions "
                    "of parameters: casadi.sin, not math.sin)"
                )
        for name, delay in zip(self.inputs, tau.ravel(), strict=True):
            if not delay >= -NO_DELAY:
                raise ModelError(
                    f"{type(self).__name__}.delays: that of {name!r} is {delay} s, expected 0 "
                    "or more"
                )
        names = self.inputs, self.outputs, self.states
        return StateSpace(A, B, C, D, None, *names, np.maximum(tau.ravel(), 0.0))


M = TypeVar("M", bound=Model)  # a user's structure


def constants(model: Model) -> tuple[tuple[str, Any], ...]:
    """Names and values of fields that are no parameters."""
    own = model.infos()
    return tuple((f.name, getattr(model, f.name)) for f in fields(model) if f.name not in own)


@lru_cache(maxsize=64)
def _function(
    cls: type[Model],
    trim: tuple[tuple[str, Any], ...],
    read: Surroundings,  # noqa: ARG001 - it is remembered by
) -> ca.Function:
    """`Model.matrices` of a structure at a trim; methods run once for what they read."""
    lam = ca.SX.sym("lam", len(cls.parameter_names()))
    expressions = _expressions(cls(**dict(trim)).with_vector(lam))
    for method, part in zip([*"ABCD", "delays", "constraints"], expressions, strict=True):
        declaration.check_closed(f"{cls.__name__}.{method}", part, lam)
    names = ["A", "B", "C", "D", "tau", "c"]
    return ca.Function("matrices", [lam], list(expressions), ["lam"], names)


def matrix(rows: Rows) -> ca.SX:
    """Turn rows of numbers and symbols into an SX matrix; literal zeros become structural.

    Raises
    ------
    ModelError
        No rows, or rows of different length.
    """
    declaration.check_lengths(rows)
    entries = [
        [declaration.scalar(value, f"entry [{i}][{j}]") for j, value in enumerate(row)]
        for i, row in enumerate(rows)
    ]
    return ca.sparsify(ca.vertcat(*[ca.horzcat(*row) for row in entries]))


def _expressions(symbolic: Model) -> tuple[ca.SX, ...]:
    cls = type(symbolic)
    built = {letter: declaration.written(symbolic, letter, matrix) for letter in "ABCD"}
    nx = len(sensors.own_states(cls.states, cls.outputs))
    nu, ny = len(cls.inputs), len(cls.outputs)
    wanted = {"A": (nx, nx), "B": (nx, nu), "C": (ny, nx), "D": (ny, nu)}
    for letter, shape in wanted.items():
        if built[letter].shape != shape:
            raise ModelError(
                f"{cls.__name__}.{letter} has shape {built[letter].shape}, expected {shape}: "
                f"{nx} states, {nu} inputs, {ny} outputs"
            )
    built = declaration.written(
        symbolic, "sensors", lambda found: sensors.measured(symbolic, built, found)
    )
    declaration.check_rows(symbolic, built)
    delays = declaration.written(symbolic, "delays", declaration.check_delays)
    check_known(f"{cls.__name__}.delays: no input is called", delays, cls.inputs, ModelError)
    where = f"{cls.__name__}.delays: that of"
    tau = [declaration.scalar(delays.get(name, 0.0), f"{where} {name!r}") for name in cls.inputs]
    return (
        *built.values(),
        ca.vertcat(*tau),
        declaration.written(symbolic, "constraints", _values),
    )


def _values(constraints: Sequence[Constraint]) -> ca.SX:
    """Values of constraints, (m, 1)."""
    for item in constraints:
        if not isinstance(item, Constraint):
            raise ModelError(f"it holds {item!r}, expected Constraint(name, value, lower, upper)")
    values = [declaration.scalar(item.value, f"the value of {item.name!r}") for item in constraints]
    return ca.vertcat(ca.SX(0, 1), *values)
