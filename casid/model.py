"""Model structures: classes of named, bounded parameters.

    dx/dt = A(λ) x + B(λ) u(t - τ(λ))        y = C(λ) x + D(λ) u(t - τ(λ))

A subclass names its states, inputs and outputs, declares each parameter with `parameter`, holds
trim values as plain fields and writes the matrices as methods. The same methods run on numbers
(an instance is one parameter set) and on CasADi symbols (`Model.matrices`).
"""

from collections.abc import Collection, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, Protocol, Self, TypeAlias, TypeVar, cast, dataclass_transform

import casadi as ca
import numpy as np

from casid import declaration, sensors
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear import StateSpace
from casid.sensors import Scalar, Sensor

Rows: TypeAlias = Sequence[Sequence[Scalar]]

NO_DELAY = 1e-6  # s, rounding of a delay on its bound
RESTORING = ContextVar("restoring", default=False)  # classes that were checked where they came from

Bounds: TypeAlias = Mapping[str, tuple[float, float]]
Priors: TypeAlias = Mapping[str, tuple[float, float]]  # λ ~ N(value, deviation²)


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
        declaration.check_order(str(self.name), self.lower, self.upper)


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
        not positive.
    """
    info = ParameterInfo(float(lower), float(upper), unit, scale)
    return field(default=float(default), metadata={"parameter": info})


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
        """Parameter values λ, (n_λ,)."""
        return np.array([float(getattr(self, name)) for name in self.parameter_names()])

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
        infos, cls = self.infos(), cast(Any, type(self))
        trim = tuple((f.name, getattr(self, f.name)) for f in fields(self) if f.name not in infos)
        try:
            hash(trim)
        except TypeError:  # a field that its owner may change
            return _function.__wrapped__(cls, trim)
        return _function(cls, trim)

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


@lru_cache(maxsize=64)
def _function(cls: type[Model], trim: tuple[tuple[str, Any], ...]) -> ca.Function:
    """`Model.matrices` of a structure at a trim; its methods run once, not at every value."""
    lam = ca.SX.sym("lam", len(cls.parameter_names()))
    expressions = _expressions(cls(**dict(trim)).with_vector(lam))
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


class Evidence(Protocol):
    """Measurements of the parameters beside an estimator's own data."""

    def residuals(self, values: Array) -> tuple[Array, Array]:
        """Independent residuals (m,) of unit variance at free values, and derivatives (m, nf)."""
        ...

    def scatter(self, values: Array) -> Array:
        """Covariance (nf, nf) of the gradient of half the sum of their squares."""
        ...


@dataclass(frozen=True, eq=False)
class Free:
    """The free parameters of one estimation; fixed ones are numbers and no variables."""

    model: Model  # the guess; fixed parameters keep its values
    index: np.ndarray  # (nf,) positions of the free parameters in λ
    lower: Array  # (n_λ,) bounds of all parameters
    upper: Array  # (n_λ,)
    scale: Array  # (n_λ,) typical magnitudes
    priors: Priors = field(default_factory=dict)  # of free parameters
    initial: Priors = field(default_factory=dict)  # of every record's initial states
    unbiased: tuple[str, ...] = ()  # outputs without a bias, where the others have one
    evidence: Evidence | None = None  # other measurements of the free parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        names = self.model.parameter_names()
        return tuple(names[i] for i in self.index)

    @property
    def guess(self) -> Array:
        """Guess of the free parameters, (nf,), moved onto its bounds where it violates them."""
        return np.asarray(np.clip(self.model.vector(), self.lower, self.upper)[self.index])

    def surprise(self, values: Array) -> tuple[Array, Array]:
        """(λ − λ₀)/σ of all priors at free values (nf,), and the derivatives (priors, nf).

        Behind them the residuals of other evidence, in standard deviations too.
        """
        rows = np.array([self.names.index(name) for name in self.priors], dtype=int)
        mean, std = np.array(list(self.priors.values())).reshape(-1, 2).T
        off, pull = (values[rows] - mean) / std, np.eye(len(self.index))[rows] / std[:, None]
        if self.evidence is None:
            return off, pull
        more, slopes = self.evidence.residuals(values)
        return np.concatenate([off, more]), np.vstack([pull, slopes])

    def scatter_of_surprise(self, values: Array) -> Array:
        """Covariance (nf, nf) of the gradient of ½ Σ of the squares of `surprise`."""
        pull = replace(self, evidence=None).surprise(values)[1]
        own = pull.T @ pull
        return own if self.evidence is None else own + self.evidence.scatter(values)

    def constraint_slopes(self, values: Array) -> Array:
        """Derivatives of the model's constraints by the free parameters at free values, (m, nf)."""
        lam = ca.SX.sym("lam", len(self.index))
        c = self.model.matrices()(self.full(lam))[5]
        slopes = ca.Function("slopes", [lam], [ca.jacobian(c, lam)])
        return np.asarray(slopes(values).full())

    def full(self, free: Any) -> Any:  # noqa: ANN401 - MX, SX or array in, the same out
        """λ (n_λ,) from the free values (nf,), numbers or symbols."""
        fixed = self.model.vector()
        if isinstance(free, np.ndarray):
            fixed[self.index] = free
            return fixed
        entries = list(map(ca.DM, fixed))
        for position, i in enumerate(self.index):
            entries[i] = free[position]
        return ca.vertcat(*entries)


def free_parameters(
    model: Model,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    priors: Priors | None = None,
) -> Free:
    """Which parameters are free in which bounds, equal ones fixing; ModelError if none can be."""
    bounds, priors = dict(bounds or {}), dict(priors or {})
    _check_choice(model, fixed, {**bounds, **priors})
    for name, pair in priors.items():
        declaration.check_prior(name, pair)
    infos = model.infos()
    limits = {name: bounds.get(name, (info.lower, info.upper)) for name, info in infos.items()}
    for name, pair in limits.items():
        declaration.check_pair(name, pair)
    lower, upper = (np.array([pair[i] for pair in limits.values()], dtype=float) for i in (0, 1))
    held = np.array([name in fixed for name in infos], dtype=bool)
    guess = model.vector()
    for i, name in enumerate(infos):  # equal bounds fix the value, whatever the guess says
        if lower[i] == upper[i] and name not in fixed:
            guess[i], held[i] = lower[i], True
    index = np.flatnonzero(~held)
    if not infos:
        raise ModelError(f"{type(model).__name__} has no parameters: there is nothing to estimate")
    if not len(index):
        raise ModelError("every parameter is fixed: nothing is left to estimate; free one")
    model = model.with_vector(guess)
    _check_delays(model, np.where(held, guess, lower), np.where(held, guess, upper))
    given = [info.scale for info in infos.values()]
    widths = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    typical = np.maximum(np.abs(guess), 0.1 * widths)
    scale = np.array(
        [s or (value if value > 0 else 1.0) for s, value in zip(given, typical, strict=True)]
    )
    names = list(infos)
    known = {names[i]: priors[names[i]] for i in index if names[i] in priors}
    return Free(model, index, lower, upper, scale, known)


def _check_delays(model: Model, lower: Array, upper: Array) -> None:
    """Refuse bounds (n_λ,) between which a delay may be negative."""
    # Where a delay is not linear in the parameters, or constraints between them may keep it
    # positive, it is looked at in the guess alone.
    lam, at = ca.SX.sym("lam", len(lower)), model.vector()
    tau, c = model.matrices()(lam)[4:]
    slopes = ca.jacobian(tau, lam)
    values, J = (part.full() for part in ca.Function("delays", [lam], [tau, slopes])(at))
    tied = ca.jacobian(c, lam).sparsity().get_triplet()[1]
    names = model.parameter_names()
    for j, (delay, row) in enumerate(zip(values.ravel(), J, strict=True)):
        moved, least = np.flatnonzero(row), float(delay)
        kept = len(moved) > 1 and not set(tied).isdisjoint(moved)
        if not kept and not ca.depends_on(slopes[j, :], lam):
            lowest = np.where(row > 0, lower, upper)[moved]
            least += float(row[moved] @ (lowest - at[moved]))
        if least < -NO_DELAY:
            raise ModelError(
                f"{type(model).__name__}.delays: that of {model.inputs[j]!r} may be {least:g} s "
                f"between the bounds of {', '.join(names[i] for i in moved)}; a delay is 0 s or "
                "more: bound it there"
            )


def _check_choice(model: Model, fixed: Collection[str], bounds: Bounds) -> None:
    if isinstance(model, type):
        raise ModelError(
            f"{model.__name__} is a class, expected a model: call it, {model.__name__}()"
        )
    if isinstance(fixed, str):
        raise ModelError(f"fixed={fixed!r}: expected a collection of names, ({fixed!r},)")
    for name in (*fixed, *bounds):
        if name not in (known := model.parameter_names()):
            raise ModelError(
                f"{type(model).__name__} has no parameter {name!r}; it has {', '.join(known)}"
            )


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
    declaration.check_rows(cls, built)
    delays = declaration.written(symbolic, "delays", declaration.check_delays)
    if unknown := [name for name in delays if name not in cls.inputs]:
        raise ModelError(
            f"{cls.__name__}.delays names {unknown[0]!r}, which is no input; "
            f"inputs are {', '.join(cls.inputs)}"
        )
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
