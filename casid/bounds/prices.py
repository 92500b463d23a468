"""What one case of a comparison costs, and which of its bounds and relations cost it."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.bounds.cases import Case
from casid.bounds.robust import price_p_values, ratio_p_value, weights
from casid.bounds.trials import aicc
from casid.envelope import linear_fit
from casid.fit import AnyFit, ConstraintEstimate, ParameterEstimate
from casid.free import free_parameters
from casid.jobs.store import Done
from casid.nonlinear.conditions import Trim
from casid.records import standard_deviations
from casid.validation import Validation

ROUNDING = 1e-8  # of the cost: what two solves may leave


@dataclass(frozen=True, eq=False, kw_only=True)
class CaseResult:
    """What one case costs.

    Parameters
    ----------
    name, reason : str
        ``reason`` says why the case failed; it is empty otherwise.
    fit : Fit or None
        Of a failed case the best iterate, if there is one.
    parameters : tuple of ParameterEstimate
        One row a parameter; a fixed value has equal bounds and a multiplier as a bound has. Of a
        comparison ``guess`` is the structure's, which "±20 %" refers to; the fit started elsewhere.
    relations : tuple of ConstraintEstimate
        Ties and inequalities between parameters.
    held : int
        Number of directions in which bounds and relations hold the parameters.
    cost, increase : float
        Minimum, and by how much it lies above that of the freest case; of a case that does not lie
        within that one it may be negative.
    predicted : float
        The increase that the multipliers predict: ½ Σ (μ + μ₀)(λ - λ₀) over bounds and relations,
        index 0 being the freest case. It is exact where the cost is quadratic.
    shares : mapping
        What each parameter's bounds, or each relation, contribute to ``predicted``.
    price_p_values : mapping
        Of each of them, how probable so large a multiplier is if the data do not mind it.
    aicc : float
        Corrected Akaike criterion; NaN unless the cost is a likelihood.
    statistic, freedom, p_value : float, int, float
        Likelihood ratio of the case within the freest: twice the increase, a sum of as many χ² of
        one degree of freedom as directions are held beside those of the freest case, each weighed
        by what the estimates' variance is of that by the information; of one direction that enough
        records tell of, Student's t by how these scatter (`casid.bounds.robust`). Of
        inequalities this is the test on condition of which are active (P. C. Wollan, R. L. Dykstra,
        Conditional tests with an order restriction as a null hypothesis, Springer LNS 37, 1986).
    rms : float
        Of the validation residuals, each output divided by its standard deviation.
    eigenvalues : (nx,) complex array
        [1/s], the fastest growing first; of a nonlinear structure in balance where
        `BoundsComparison.linearised_at` says.
    start : str
        Case whose fit it started from.
    warnings : tuple of str
        What its fit warned of.
    """

    name: str
    reason: str = ""
    fit: AnyFit | None = None
    parameters: tuple[ParameterEstimate, ...] = ()
    relations: tuple[ConstraintEstimate, ...] = ()
    held: int = 0
    cost: float = np.nan
    increase: float = np.nan
    predicted: float = np.nan
    shares: Mapping[str, float] = field(default_factory=dict)
    price_p_values: Mapping[str, float] = field(default_factory=dict)
    aicc: float = np.nan
    statistic: float = np.nan
    freedom: int = 0
    p_value: float = np.nan
    rms: float = np.nan
    eigenvalues: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    start: str = ""
    warnings: tuple[str, ...] = ()


def price_case(
    case: Case,
    done: Done,
    base: tuple[Case, AnyFit | None],
    data: Sequence[Any],
    validation: Validation | None,
    trim: Trim | None = None,
) -> CaseResult:
    """The result of a case, measured against the freest and its fit; eigenvalues at a trim."""
    fit: AnyFit | None = done.result
    if fit is None or done.reason:
        said: Any = {"start": done.source, "warnings": done.warnings}
        return CaseResult(name=case.name, reason=done.reason, fit=fit, **said)
    rows = zip(_own(fit, case)[1], case.relations, strict=True)
    linear = linear_fit(fit, trim).model if trim else fit.model
    found = CaseResult(
        name=case.name, fit=fit, parameters=_parameters(fit, case),
        relations=tuple(row for row, relation in rows if len(relation.names) > 1), held=fit.held,
        cost=fit.cost, aicc=aicc(fit, data), rms=relative_rms(validation, case.name),
        eigenvalues=linear.system().poles(), start=done.source, warnings=done.warnings,
    )  # fmt: skip
    freest, free = base
    if free is None:
        return found
    shares = _shares((case, fit), (freest, free))
    increase = 0.0 if fit is free else fit.cost - free.cost
    if case.within(freest) and abs(increase) < ROUNDING * (1 + abs(fit.cost)):
        increase = max(increase, 0.0)  # narrower bounds gain nothing but what tolerances leave
    found = replace(found, increase=increase, predicted=sum(shares.values()), shares=shares)
    if fit.R is None or not case.within(freest):  # no likelihood, or no test
        return found
    labels, A, prices = _held(fit, case)
    w, statistic = weights(free, A), max(2 * increase, 0.0)
    surprises = dict(zip(labels, price_p_values(free, A, prices).tolist(), strict=True))
    found = replace(found, statistic=statistic, freedom=len(w), price_p_values=surprises)
    return replace(found, p_value=ratio_p_value(free, A, statistic))


def relative_rms(validation: Validation | None, name: str) -> float:
    """Root mean square of a model's residuals, each divided by its output's standard deviation."""
    if validation is None:
        return np.nan
    scale = standard_deviations(validation.measured)[1]
    return float(np.sqrt(np.nanmean((validation.rms[name] / scale) ** 2)))


def _own(fit: AnyFit, case: Case) -> tuple[list[ConstraintEstimate], list[ConstraintEstimate]]:
    """Rows of the structure's own constraints, and of the case's relations."""
    rows = list(fit.constraints)
    first = len(rows) - len(case.relations)
    return rows[:first], rows[first:]


def _held(fit: AnyFit, case: Case) -> tuple[list[str], Array, Array]:
    """What holds the fit: names, gradients by its free parameters (m, nf), multipliers (m,)."""
    outside = set(type(fit.model).parameter_names()) - set(fit.free_names)
    free, (own, relations) = free_parameters(fit.model, outside, case.bounds), _own(fit, case)
    bounds = [fit[name] for name in fit.free_names]
    slopes = free.constraint_slopes(free.guess) if own else np.zeros((0, len(bounds)))
    rows = np.array([relation.row(free.names) for relation in case.relations])
    gradients = np.vstack([np.eye(len(bounds)), slopes, rows.reshape(-1, len(bounds))])
    held: list[ParameterEstimate | ConstraintEstimate] = [*bounds, *own, *relations]
    active = np.array([row.active for row in held])
    single = {r.text: r.names[0] for r in case.relations if len(r.names) == 1}
    names = [single.get(row.name, row.name) for row in held if row.active]
    return names, gradients[active], np.array([row.multiplier for row in held if row.active])


def _parameters(fit: AnyFit, case: Case) -> tuple[ParameterEstimate, ...]:
    """Rows of the parameters; a fixed value has equal bounds and the price of its tie."""
    relations = zip(_own(fit, case)[1], case.relations, strict=True)
    ties = {tie.names[0]: row for row, tie in relations if len(tie.names) == 1}
    rows = {row.name: row for row in fit.parameters}
    for name, tie in ties.items():
        fixed: Any = dict.fromkeys(("value", "lower", "upper"), tie.lower)
        fixed |= {"multiplier": tie.multiplier} | dict.fromkeys(("std_error", "cramer_rao"), np.nan)
        rows[name] = replace(rows[name], active=True, **fixed)
    return tuple(rows.values())


def _shares(here: tuple[Case, AnyFit], there: tuple[Case, AnyFit]) -> dict[str, float]:
    """½ Σ (μ + μ₀)(λ - λ₀), by parameter or relation."""
    at, base = ({row.name: row.value for row in fit.parameters} for _, fit in (here, there))
    shares: dict[str, float] = defaultdict(float)
    for case, fit in (here, there):
        for name, row in ((row.name, row) for row in fit.parameters if row.active):
            shares[name] += 0.5 * row.multiplier * (at[name] - base[name])
        own, rows = _own(fit, case)
        for k, tie in enumerate(own):
            change = here[1].constraints[k].value
            change -= there[1].constraints[k].value
            shares[tie.name] += 0.5 * tie.multiplier * change
        for priced, relation in zip(rows, case.relations, strict=True):
            change = relation.value(at) - relation.value(base)
            label = relation.names[0] if len(relation.names) == 1 else relation.text
            shares[label] += 0.5 * priced.multiplier * change
    return {label: float(share) for label, share in shares.items() if share}
