"""The result of an estimation: the model with its estimates and what is known about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from casid.arrays import Array
from casid.checks import checked
from casid.display import Shown
from casid.errors import ModelError, warn
from casid.model import M, Model
from casid.textfile import read_json, stored_number, write_result
from casid.values import check_digest, decode, encode, seal, storable

M_co = TypeVar("M_co", bound=Model, covariant=True)
N_co = TypeVar("N_co", covariant=True)


@storable
@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """One row of the parameter table.

    ``multiplier`` is the price of the bound: the derivative of the estimator's optimal cost with
    respect to the position of the bound, per unit of the parameter. It is >= 0 on a lower bound,
    <= 0 on an upper one and 0 for a parameter inside its bounds. ``std_error`` is one standard
    deviation, which allows for others on bounds being within them, not on them; NaN on a bound, and
    where the estimator has no noise model. That of output error allows for residuals correlated in
    time and across outputs; ``cramer_rao`` takes them for white and the model for true, bounds that
    hold for known. That of `derivid` comes from the stated errors of the responses, ``cramer_rao``
    from the cost. ``insensitivity`` is 1/sqrt(F_ii).
    ``prior`` and ``prior_std`` are what was known before, NaN if nothing.
    """

    name: str
    value: float
    guess: float
    lower: float
    upper: float
    active: bool
    multiplier: float
    std_error: float
    insensitivity: float
    unit: str
    fixed: bool = False
    cramer_rao: float = np.nan
    prior: float = np.nan
    prior_std: float = np.nan


@storable
@dataclass(frozen=True, kw_only=True)
class ConstraintEstimate:
    """One of the model's constraints at the estimates.

    ``multiplier`` is the derivative of the optimal cost by the constraint's position, per unit of
    its value; 0 unless it is ``active``.
    """

    name: str
    value: float
    lower: float
    upper: float
    active: bool
    multiplier: float


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate:
    """How close a match is to its targets, on the grid and over the whole band.

    ``grid_norm`` is the largest singular value of the weighted error over the grid, a lower bound
    of the norm over the band; ``upper_bound`` bounds it from above on ``band`` [rad/s], between the
    points too, but of the targets ``at_points``: measured responses, of which nothing is known
    between theirs. ``peak_omega`` is where the largest value was found; ``shift`` is σ [1/s].
    """

    grid_norm: float
    upper_bound: float
    peak_omega: float
    band: tuple[float, float]
    shift: float
    at_points: tuple[str, ...] = ()


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Fit(Shown, Generic[M_co, N_co]):
    """An estimated model.

    Parameters
    ----------
    model : Model
        The structure at the estimates.
    parameters : tuple of ParameterEstimate
        One row a parameter, in the order of declaration.
    cost : float
        What the estimator minimised; of an H-infinity match the norm.
    status, success : str, bool
        Outcome in words, and whether it is a solution.
    iterations, seconds : int, float
        Effort, over all solves.
    method : str
        "match quadratic", "match hinf", "output error", ...
    notes
        What only one estimator tells: `MatchNotes`, `OutputErrorNotes`, `DerividNotes`; None of a
        fit that never began.
    constraints : tuple of ConstraintEstimate
        One row for each of the model's constraints.
    held : int
        Number of directions in which active bounds and constraints hold the free parameters.
    certificate : Certificate or None
        Of a match.
    covariance : (nf, nf) array or None
        Of the free parameters, in the order of ``free_names``; as ``std_error``.
    free_names : tuple of str
        Names of the free parameters.
    R : (ny, ny) array or None
        Residual covariance of an output-error fit.
    initial_states, biases : (records, nx), (records, ny) array or None
        What the output-error fit estimated beside λ, one row a record.
    interval : float or None
        Length of the shooting intervals [s].
    state_biases : (records, n) array or None
        Constants in the equations of the states that were to have one, one row a record.
    units : mapping
        `Record.units`, if it was estimated from records or by a study.
    """

    model: M_co
    parameters: tuple[ParameterEstimate, ...]
    cost: float
    status: str
    success: bool
    iterations: int
    seconds: float
    method: str
    notes: N_co
    constraints: tuple[ConstraintEstimate, ...] = ()
    held: int = 0
    certificate: Certificate | None = None
    covariance: Array | None = None
    free_names: tuple[str, ...] = ()
    R: Array | None = None
    initial_states: Array | None = None
    biases: Array | None = None
    interval: float | None = None
    state_biases: Array | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def headline(self) -> str:
        """Structure, method, outcome."""
        held = sum(row.active for row in self.parameters)
        bounds = f", {held} on their bounds" if held else ""
        tied = f", {self.held - held} held by constraints" if self.held > held else ""
        outcome = "solved" if self.success else f"NOT SOLVED ({self.status})"
        return (
            f"{type(self.model).__name__} by {self.method}: {outcome}, cost {self.cost:.6g}, "
            f"{len(self.free_names)} free parameters{bounds}{tied}"
        )

    def __post_init__(self) -> None:
        seal(self)

    @property
    def unbiased(self) -> tuple[str, ...]:
        """Outputs that the estimation gave no bias of a record; () of one that has none at all."""
        if self.biases is None or not len(self.biases):
            return ()
        pairs = zip(self.model.outputs, np.any(self.biases, axis=0).tolist(), strict=True)
        return tuple(name for name, has in pairs if not has)

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Row of one parameter."""
        for row in self.parameters:
            if row.name == name:
                return row
        known = ", ".join(row.name for row in self.parameters)
        raise KeyError(f"no parameter {name!r}; the model has {known}")

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, whole or not at all."""
        head = {"casid": "fit", "version": VERSION, "system": encode(self.model.numbers())}
        head["channels"] = encode(_channels(self.model))
        write_result(path, head | encode(self)["fields"])

    @classmethod
    @checked
    def load(cls, path: str | Path, *, model: type[M]) -> "Fit[M, Any]":
        """Read what `save` wrote, or what a study left in ``stages``; ``model`` is the class.

        Files of version 0.1 are read too, without their notes.

        Raises
        ------
        ValueError, ModelError
            Not a fit, the fit of another structure or of one whose equations were others, tables
            that do not agree with the model, or a file that was changed.
        """
        content = read_json(path)
        if not is_fit(content):
            raise ValueError(f"{path}: not a fit saved by casid")
        check_digest(content, path)
        content = content.get("result", {"fields": content})["fields"]
        try:
            version = content.get("version", VERSION)  # a stage's file has none
            if version not in (1, VERSION):
                raise ValueError(
                    f"{path}: a fit of version {version!r}, where 1 and {VERSION} are known; was "
                    "it saved by a later casid?"
                )
            found = (_first_version if version == 1 else _decoded)(content, model, path)
            _check_types(found)
            _check_agreement(found, path)
            if "system" in content:
                _check_numbers(found.model, decode(content["system"]), path)
            if "channels" in content:
                _check_channels(found.model, decode(content["channels"]), path)
        except (LookupError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(
                f"{path}: not as casid saves a fit ({type(error).__name__}: {error}); was the "
                "file edited?"
            ) from error
        return found


AnyFit: TypeAlias = Fit[Model, Any]


def is_fit(content: Mapping[str, Any]) -> bool:
    """Whether a file holds a fit: a saved one, or one that is the result of a study's stage."""
    kept = content.get("result")
    return content.get("casid") == "fit" or (isinstance(kept, dict) and kept.get("value") == "Fit")


PARTS = ("A", "B", "C", "D", "delays", "constraints", "dx/dt", "y")  # of `Model.numbers`
KINDS = ("states", "inputs", "outputs")
VERSION = 2  # of the files that `Fit.save` writes
FLAGS = ("active", "fixed")
NUMERIC = tuple(each.name for each in fields(ParameterEstimate) if each.type is float)


def _decoded(content: Any, model: type[M], place: str | Path) -> Fit[M, Any]:  # noqa: ANN401
    names = [each.name for each in fields(Fit)]
    content = {"units": {"mapping": {}}} | content  # which older files have not
    if missing := [name for name in names if name not in content]:
        raise ValueError(f"{place}: the saved fit has no {missing[0]!r}; was the file edited?")
    _check_structure(content["model"]["value"], content["model"]["fields"], model, place)
    return Fit(**{name: _field(name, content[name], model, place) for name in names})


def _field(name: str, content: Any, model: type[M], place: str | Path) -> Any:  # noqa: ANN401
    try:
        return decode(content, (model,))
    except ValueError as error:
        raise ValueError(f"{place}: {name}: {error}; was the file edited?") from error


def _check_structure(
    name: str, stored: Mapping[str, Any], model: type[Model], place: str | Path
) -> None:
    if name != model.__name__ or set(stored) != {each.name for each in fields(model)}:
        raise ModelError(
            f"{place} holds a fit of {name} with {', '.join(stored)}; it cannot be read as "
            f"{model.__name__}"
        )


def _first_version(content: Any, model: type[M], place: str | Path) -> Fit[M, Any]:  # noqa: ANN401
    """A fit as version 0.1 saved it: plain lists, notes as a mapping."""
    old = {each.name: content[each.name] for each in fields(Fit) if each.name in content}
    stored, notes = old["model"], old["notes"]
    _check_structure(stored["class"], stored["values"], model, place)
    texts = {"name", "unit", "active", "fixed"}

    def row(values: Mapping[str, Any]) -> dict[str, Any]:
        return {k: v if k in texts else stored_number(v) for k, v in values.items()}

    old["model"], old["notes"] = model(**stored["values"]), None
    old["parameters"] = tuple(
        ParameterEstimate(cramer_rao=stored_number(each["std_error"]), **row(each))
        for each in old["parameters"]
    )
    old["constraints"] = tuple(ConstraintEstimate(**row(c)) for c in notes.get("constraints", ()))
    old["held"] = sum(each.active for each in (*old["parameters"], *old["constraints"]))
    if old["certificate"] is not None:
        band = tuple(map(float, old["certificate"].pop("band")))
        old["certificate"] = Certificate(band=band, **row(old["certificate"]))  # type: ignore[arg-type]
    for name in ("covariance", "R", "initial_states", "biases"):
        if old[name] is not None:
            old[name] = np.array(old[name], dtype=float)
    old |= {"cost": stored_number(old["cost"]), "free_names": tuple(old["free_names"])}
    warn(
        f"{place} was saved by casid 0.1: its notes are left out, and its standard errors "
        "take residuals for white; estimate again to have both"
    )
    return Fit(**old)


def _check_types(fit: AnyFit) -> None:
    """What a file says of names and values must be text and numbers, its tables of their kind."""
    rows, held = list(fit.parameters), list(fit.constraints)
    optional = [each for each in (fit.certificate,) if each is not None]
    arrays = (fit.covariance, fit.R, fit.initial_states, fit.biases)
    values: list[Any] = [getattr(fit.model, name) for name in fit.model.parameter_names()]
    values += [fit.cost, fit.iterations, fit.seconds, fit.held]
    values += [getattr(row, name) for row in rows for name in NUMERIC]
    texts: list[Any] = [fit.status, fit.method, *fit.free_names, *fit.units.values()]
    texts += [text for row in rows for text in (row.name, row.unit)]
    flags = {f"{row.name}.{name}": getattr(row, name) for row in rows for name in FLAGS}
    flags |= {f"{row.name}.active": row.active for row in held} | {"success": fit.success}
    if odd := [name for name, value in flags.items() if not isinstance(value, bool)]:
        raise TypeError(f"{odd[0]} = {flags[odd[0]]!r} is neither true nor false")
    for kind, found in (
        (ParameterEstimate, rows),
        (ConstraintEstimate, held),
        (Certificate, optional),
        (np.ndarray, [each for each in arrays if each is not None]),
        (int | float, values),
        (str, texts),
    ):
        if wrong := [each for each in found if not isinstance(each, kind)]:
            raise TypeError(f"{wrong[0]!r} is no {getattr(kind, '__name__', 'number')}")


def _check_agreement(fit: AnyFit, place: str | Path) -> None:
    """Refuse a fit whose tables are not those of its model and of each other."""
    names, free = fit.model.parameter_names(), fit.free_names
    wrong = ""
    if tuple(row.name for row in fit.parameters) != names:
        wrong = f"the table has {', '.join(row.name for row in fit.parameters)}, not {names}"
    elif apart := [
        row.name
        for row in fit.parameters
        if not np.array_equal(getattr(fit.model, row.name), row.value, equal_nan=True)
    ]:
        wrong = f"{apart[0]} is {fit[apart[0]].value} in the table and not in the model"
    elif not set(free) <= set(names):
        wrong = f"{', '.join(free)} are not all parameters"
    elif fit.covariance is not None and fit.covariance.shape != (len(free), len(free)):
        wrong = f"covariance of shape {fit.covariance.shape} for {len(free)} free parameters"
    elif negative := [row.name for row in fit.parameters if row.std_error < 0]:
        wrong = f"the standard error of {negative[0]} is {fit[negative[0]].std_error}"
    elif fit.covariance is not None and (np.diag(fit.covariance) < 0).any():
        wrong = "the covariance has a negative variance"
    if wrong:
        raise ValueError(f"{place}: {wrong}; was the file edited?")


def _channels(model: Model) -> tuple[tuple[str, ...], ...]:
    return model.states, model.inputs, model.outputs


def _check_channels(model: Model, saved: tuple[tuple[str, ...], ...], place: str | Path) -> None:
    """Refuse a structure whose channels have other names or another order than when fitted."""
    for kind, now, then in zip(KINDS, _channels(model), saved, strict=True):
        if tuple(now) != tuple(then):
            raise ModelError(
                f"{place}: {type(model).__name__} has the {kind} {', '.join(now)}; when it was "
                f"fitted they were {', '.join(then)}: load it with the file of then, or fit again"
            )


def _check_numbers(model: Model, saved: list[Array], place: str | Path) -> None:
    """Refuse a structure whose equations are not those that were fitted."""
    # Of nonlinear structures older files hold fewer.
    for name, now, then in zip(PARTS, model.numbers(), saved, strict=False):
        same = now.shape == then.shape
        if not same or not np.allclose(now, then, rtol=1e-6, atol=1e-9, equal_nan=True):
            raise ModelError(
                f"{place}: {type(model).__name__} has other {name} than when it was fitted; the "
                "values belong to the equations of then: load it with that file, or fit again"
            )
