"""The result of an estimation: the model with its estimates and what is known about them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray
from casid.errors import ModelError
from casid.files import number, read_json, write_json
from casid.model import Free, Model

ACTIVE = 1e-6  # distance to a bound, relative to the parameter's scale, that counts as on it


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """One row of the parameter table.

    ``multiplier`` is the price of the bound: the derivative of the estimator's optimal cost with
    respect to the position of the bound, per unit of the parameter. It is >= 0 on a lower bound,
    <= 0 on an upper one and 0 for a parameter inside its bounds. ``std_error`` is one standard
    deviation, others on their bounds held there; NaN on a bound, and where the estimator has no
    noise model. ``insensitivity`` is 1/sqrt(F_ii).
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate:
    """How close a match is to the black box, on the grid and over the whole band.

    ``grid_norm`` is the largest singular value of the weighted error over the grid, a lower bound
    of the norm over the band; ``upper_bound`` bounds it from above on ``band`` [rad/s];
    ``peak_omega`` is where the largest value was found; ``shift`` is σ [1/s].
    """

    grid_norm: float
    upper_bound: float
    peak_omega: float
    band: tuple[float, float]
    shift: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
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
    certificate : Certificate or None
        Of a match.
    covariance : (nf, nf) array or None
        Of the free parameters, in the order of ``free_names``.
    free_names : tuple of str
        Names of the free parameters.
    R : (ny, ny) array or None
        Residual covariance of an output-error fit.
    initial_states, biases : (records, nx), (records, ny) array or None
        What the output-error fit estimated beside λ, one row a record.
    interval : float or None
        Length of the shooting intervals [s].
    notes : mapping
        Further numbers and tables of one estimator, plain lists and numbers.
    """

    model: Model
    parameters: tuple[ParameterEstimate, ...]
    cost: float
    status: str
    success: bool
    iterations: int
    seconds: float
    method: str
    certificate: Certificate | None = None
    covariance: Array | None = None
    free_names: tuple[str, ...] = ()
    R: Array | None = None
    initial_states: Array | None = None
    biases: Array | None = None
    interval: float | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Row of one parameter."""
        for row in self.parameters:
            if row.name == name:
                return row
        known = ", ".join(row.name for row in self.parameters)
        raise KeyError(f"no parameter {name!r}; the model has {known}")

    def content(self) -> dict[str, Any]:
        """All of it as plain values and arrays, without the structure's class."""
        model = {f.name: getattr(self.model, f.name) for f in fields(self.model)}
        content = {f.name: getattr(self, f.name) for f in fields(self)}
        content["model"] = {"class": type(self.model).__name__, "values": model}
        content["parameters"] = [asdict(row) for row in self.parameters]
        content["certificate"] = None if self.certificate is None else asdict(self.certificate)
        return content

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, whole or not at all."""
        write_json(path, {"casid": "fit", "version": 1} | self.content())

    @classmethod
    def load(cls, path: str | Path, *, model: type[Model]) -> "Fit":
        """Read what `save` wrote; ``model`` is the structure's class.

        Raises
        ------
        ValueError, ModelError
            Not a fit, or the fit of another structure.
        """
        content = read_json(path)
        if content.pop("casid", None) != "fit":
            raise ValueError(f"{path}: not a fit saved by casid")
        return cls.from_content(content, model=model, place=path)

    @classmethod
    def from_content(
        cls, content: Mapping[str, Any], *, model: type[Model], place: str | Path = "content"
    ) -> "Fit":
        """The fit whose `content` this is, or the JSON of it; ``place`` is named in messages."""
        try:
            return cls._from_content(content, model, place)
        except (LookupError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(
                f"{place}: not as casid saves a fit ({type(error).__name__}: {error}); was the "
                "file edited?"
            ) from error

    @classmethod
    def _from_content(
        cls, content: Mapping[str, Any], model: type[Model], place: str | Path
    ) -> "Fit":
        names = [f.name for f in fields(cls)]
        if missing := [name for name in names if name not in content]:
            raise ValueError(f"{place}: the saved fit has no {missing[0]!r}; was the file edited?")
        content = {name: content[name] for name in names}
        stored = content["model"]
        expected = {f.name for f in fields(model)}
        if stored["class"] != model.__name__ or set(stored["values"]) != expected:
            raise ModelError(
                f"{place} holds a fit of {stored['class']} with {', '.join(stored['values'])}; "
                f"it cannot be read as {model.__name__}"
            )
        content["model"] = model(**stored["values"])
        content["parameters"] = tuple(_row(row) for row in content["parameters"])
        if content["certificate"] is not None:
            certificate = dict(content["certificate"])
            certificate["band"] = tuple(certificate["band"])
            numbers: dict[str, Any] = {
                k: v if k == "band" else number(v) for k, v in certificate.items()
            }
            content["certificate"] = Certificate(**numbers)
        for name in ("covariance", "R", "initial_states", "biases"):
            if content[name] is not None:
                content[name] = np.array(content[name], dtype=float)
        content["cost"] = number(content["cost"])
        content["free_names"] = tuple(content["free_names"])
        found = cls(**content)
        _check_types(found)
        return found


def _check_types(fit: Fit) -> None:
    """What a file says of names and values must be text and numbers."""
    texts: list[Any] = [fit.status, fit.method, *fit.free_names]
    texts += [text for row in fit.parameters for text in (row.name, row.unit)]
    values: list[Any] = [getattr(fit.model, name) for name in fit.model.parameter_names()]
    for wanted, kind, found in (("text", str, texts), ("number", int | float, values)):
        if wrong := [each for each in found if not isinstance(each, kind)]:
            raise TypeError(f"{wrong[0]!r} is no {wanted}")


def parameter_table(
    free: Free,
    values: Array,
    multipliers: Array,
    std_error: Array | None = None,
    insensitivity: Array | None = None,
    guess: Model | None = None,
) -> tuple[ParameterEstimate, ...]:
    """Rows of the parameter table from the free values.

    Parameters
    ----------
    free : Free
        Which parameters were free, and their bounds.
    values, multipliers, std_error, insensitivity : (nf,) array
        Of the free parameters, in physical units; a missing one is NaN.
    guess : Model
        What the estimator started from; the model of ``free`` unless given.
    """
    model = free.model
    full = free.full(np.asarray(values, dtype=float))
    start = (guess or model).vector()
    position = {int(i): k for k, i in enumerate(free.index)}

    def pick(column: Array | None, i: int, fixed: float) -> float:
        if i not in position:
            return fixed
        return np.nan if column is None else float(column[position[i]])

    rows = []
    for i, (name, info) in enumerate(model.infos().items()):
        near = ACTIVE * free.scale[i]
        gap = min(full[i] - free.lower[i], free.upper[i] - full[i])
        active = i in position and bool(gap <= near)
        rows.append(
            ParameterEstimate(
                name=name,
                value=float(full[i]),
                guess=float(start[i]),
                lower=float(free.lower[i]),
                upper=float(free.upper[i]),
                active=active,
                multiplier=pick(multipliers, i, 0.0) if active else 0.0,
                std_error=np.nan if active else pick(std_error, i, 0.0),
                insensitivity=pick(insensitivity, i, np.nan),
                unit=info.unit,
                fixed=i not in position,
            )
        )
    return tuple(rows)


def constraint_table(model: Model, prices: Array) -> list[dict[str, Any]]:
    """What became of the model's constraints, for ``Fit.notes["constraints"]``.

    Parameters
    ----------
    model : Model
        At the estimates.
    prices : (m,) array
        Derivative of the optimal cost by the position of each constraint, per unit of its value.
    """
    rows = []
    for item, price in zip(model.constraints(), prices, strict=True):
        value = float(item.value)
        gap = min(value - item.lower, item.upper - value)
        active = bool(item.lower == item.upper or gap <= ACTIVE)
        rows.append({
            "name": item.name, "value": value, "lower": float(item.lower),
            "upper": float(item.upper), "active": active,
            "multiplier": float(price) if active else 0.0,
        })  # fmt: skip
    return rows


def holding(free: Free, values: Array, active: BoolArray) -> Array:
    """Gradients by the free parameters of all that holds them at these values, (m, nf).

    First the bounds of those ``active`` (nf,), then ties and inequalities with no room left.
    """
    bounds = np.eye(len(free.index))[active]
    if not free.model.constraints():
        return bounds
    model = free.model.with_vector(free.full(values))
    rows = constraint_table(model, np.zeros(len(model.constraints())))
    held = np.array([row["active"] for row in rows])
    return np.vstack([bounds, free.constraint_slopes(values)[held]])


def _row(stored: Mapping[str, Any]) -> ParameterEstimate:
    kept = {"name", "unit", "active", "fixed"}
    values: dict[str, Any] = {k: v if k in kept else number(v) for k, v in stored.items()}
    return ParameterEstimate(**values)
