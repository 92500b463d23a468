"""Reduce a structure: drop what the data do not determine, one parameter after the other.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., section
12.3.4: the worst insensitivity or Cramér-Rao figure goes first, and it ends when the fit suffers.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from casid.baseline.accuracy import CRAMER_RAO, INSENSITIVITY, DerividNotes
from casid.bounds.pooled_warnings import tell
from casid.bounds.trials import Data, Fits, aicc
from casid.checks import check_known, checked_fields
from casid.display import Cells, Tabled
from casid.errors import ConvergenceError, ModelError
from casid.estimator import Estimator
from casid.fit import AnyFit, ParameterEstimate
from casid.jobs.campaigns import Execution
from casid.jobs.store import Done
from casid.model import Bounds, Model
from casid.shooting.output_error import OutputError
from casid.tabulation import csv_text, markdown_table

CRITERIA = ("aicc", "cost")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One parameter held, and the fit of the rest.

    ``insensitivity`` and ``cramer_rao`` are its figures before, in % of its value; ``value`` is
    what it is held at. ``accepted`` says whether the fit stood it; ``reason`` why there is no fit.
    """

    parameter: str
    value: float
    insensitivity: float
    cramer_rao: float
    cost: float
    aicc: float
    accepted: bool
    reason: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Reduction(Tabled):
    """Parameters that were held, step by step.

    Parameters
    ----------
    full, fit : Fit
        Of the whole structure, and of what is left.
    steps : tuple of Step
        In order; rejected ones too.
    criterion : str
        "aicc" or "cost".
    """

    full: AnyFit
    fit: AnyFit
    steps: tuple[Step, ...]
    criterion: str

    @property
    def held(self) -> dict[str, float]:
        """Parameters held and at what, in the order of the steps; for ``replay``, and as a case."""
        return {step.parameter: step.value for step in self.steps if step.accepted}

    def to_csv(self) -> str:
        """One row a step."""
        columns = tuple(each.name for each in fields(Step))
        return csv_text(columns, [[getattr(step, c) for c in columns] for step in self.steps])

    def headline(self) -> str:
        """How many parameters were held, by which criterion."""
        free = len(self.full.free_names)
        return f"{len(self.held)} of {free} free parameters held by {self.criterion}"

    def cells(self) -> Cells:
        """Heading, and one row a step."""
        rows = []
        for step in self.steps:
            percent = [f"{step.insensitivity:.3g}", f"{step.cramer_rao:.3g}"]
            costs = [f"{step.cost:.8g}", f"{step.aicc:.8g}"]
            verdict = "yes" if step.accepted else step.reason or "no"
            rows.append([step.parameter, f"{step.value:.4g}", *percent, *costs, verdict])
        heading = ("held", "at", "insensitivity [%]", "Cramér-Rao [%]", "cost", "AICc", "accepted")
        return heading, rows

    def to_markdown(self) -> str:
        """One row a step."""
        return markdown_table(*self.cells())


@checked_fields
@dataclass(frozen=True, kw_only=True)
class ReductionRule:
    """What a reduction tries, and when it ends.

    Parameters
    ----------
    criterion : str
        "aicc": a step must lower the corrected Akaike criterion; "cost": it must not raise the cost
        by more than ``rise`` of the whole structure's. Unless given, the first where the cost is a
        likelihood.
    rise : float
        Share of the cost.
    protect : sequence of str
        Parameters that are never held.
    replay : mapping
        ``Reduction.held`` of another run: these steps are taken, whatever the figures say.
    candidates : int
        How many of the worst to try at each step, at once; the one that costs least is held.

    Raises
    ------
    ModelError
        Another criterion, a rise below 0, no candidate, a step to be taken again that is protected.
    """

    criterion: str | None = None
    rise: float = 0.05
    protect: Sequence[str] = ()
    replay: Mapping[str, float] | None = None
    candidates: int = 1

    def __post_init__(self) -> None:
        if self.criterion not in (None, *CRITERIA):
            raise ModelError(f"criterion={self.criterion!r}: expected one of {', '.join(CRITERIA)}")
        if not self.rise >= 0:
            raise ModelError(f"rise={self.rise!r}: expected a share of the cost, 0 or more")
        if self.candidates < 1:
            raise ModelError(f"candidates={self.candidates!r}: expected 1 or more a step")
        if both := [name for name in self.replay or {} if name in self.protect]:
            raise ModelError(
                f"{both[0]} is to be held again (replay) and never to be held (protect): leave it "
                "out of one"
            )


def reduce_structure(
    model: Model,
    data: Data,
    *,
    estimator: Estimator = OutputError(),
    rule: ReductionRule = ReductionRule(),
    start: Model | AnyFit | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Reduction:
    """Hold the worst determined parameter, fit the rest, and go on until the fit suffers.

    A parameter is held at zero if its bounds allow that, else at its value. It ends when all
    figures are within their guidelines (insensitivity 10 %, Cramér-Rao 20 %) or a step is rejected;
    a fit that fails is a step too, and its parameter is left alone from then on.

    Standard errors are those of a structure chosen beforehand, which this one was not: of
    parameters that are zero those survive that chance has made large, two errors from zero or more.
    Judge what stays by records that were not fitted.

    Parameters
    ----------
    model, data, estimator, start, fixed, bounds, execution
        As in `compare_bounds`; not `Match`, which gives no standard errors. Each fit starts from
        the one before.
    rule : ReductionRule
        What is tried, and when the fit suffers.

    Raises
    ------
    ModelError, ConvergenceError
        An unknown parameter, an estimator without standard errors; no fit of the whole structure.
    """
    replay, said = rule.replay, f"{type(model).__name__} has no parameter"
    check_known(said, (*rule.protect, *(replay or {})), model.parameter_names(), ModelError)
    many = Fits(model, data, estimator, fixed, bounds, execution)

    def fits(holds: Sequence[Mapping[str, float]], near: Model | AnyFit | None) -> list[Done]:
        specs = {f"{len(each)} {list(each)[-1]}" if each else "0": dict(each) for each in holds}
        jobs = [many.job(case, near) for case in many.cases(specs)]
        return list(many.run(jobs).values())

    (whole,) = fits([{}], start)
    full, told = _whole(whole), {"whole": whole.warnings}
    criterion = rule.criterion or ("cost" if full.R is None else "aicc")
    limit = full.cost + rule.rise * abs(full.cost)
    fit, held, passed, steps = full, dict[str, float](), set(rule.protect), list[Step]()
    while rows := _worst(fit, {*held, *passed}, replay, rule.candidates):
        trials = [held | {row.name: _value(row, replay)} for row in rows]
        done, row, trial = min(
            zip(fits(trials, fit), rows, trials, strict=True),
            key=lambda each: np.inf if each[0].reason else float(each[0].result.cost),
        )
        stands = replay is not None or _stands(criterion, done.result, fit, limit, many.data)
        accepted = stands and not done.reason
        steps.append(_step(fit, row, trial[row.name], done, many.data, accepted=accepted))
        if accepted:
            fit, held = done.result, trial
            told["reduced"] = done.warnings
        elif done.reason:
            passed.add(row.name)
        else:
            break
    tell(told, of="structure")
    return Reduction(full=full, fit=fit, steps=tuple(steps), criterion=criterion)


def accuracy_figures(fit: AnyFit, row: ParameterEstimate) -> tuple[float, float]:
    """Insensitivity and Cramér-Rao figure of a parameter, % of its value.

    The guidelines are T&R's, for √(H⁻¹) of a cost in decibels and degrees.
    """
    size = abs(row.value) / 100
    std = row.cramer_rao if isinstance(fit.notes, DerividNotes) else row.std_error
    if size == 0:
        return np.inf, np.inf
    return row.insensitivity / size, 2 * std / size


def _whole(done: Done) -> AnyFit:
    """The fit of the whole structure, if it can be reduced."""
    if done.reason:
        tell({"whole": done.warnings})
        raise ConvergenceError(f"reduce_structure: nothing held: {done.reason}", done.result)
    fit: AnyFit = done.result
    if all(np.isnan(row.std_error) for row in fit.parameters if not row.fixed):
        raise ModelError(
            f"{fit.method} gives no standard errors to reduce by; take another estimator"
        )
    return fit


def _worst(
    fit: AnyFit, out: set[str], replay: Mapping[str, float] | None, count: int
) -> list[ParameterEstimate]:
    """Parameters to try next: those furthest beyond their guidelines, or the next to replay."""
    if replay is not None:
        return [fit[name] for name in replay if name not in out][:1]
    guide = np.array([INSENSITIVITY, CRAMER_RAO])
    poor = {
        row.name: worst
        for row in fit.parameters
        if not (row.fixed or row.active or row.name in out)
        and (worst := float(np.nanmax(np.array(accuracy_figures(fit, row)) / guide))) > 1
    }
    return [fit[name] for name in sorted(poor, key=lambda name: -poor[name])[:count]]


def _value(row: ParameterEstimate, replay: Mapping[str, float] | None) -> float:
    if replay is not None:
        return float(replay[row.name])
    return 0.0 if row.lower <= 0 <= row.upper else row.value


def _stands(
    criterion: str, found: AnyFit | None, before: AnyFit, limit: float, data: Sequence[Any]
) -> bool:
    """Whether the fit is as good as before, by the criterion."""
    if found is None:
        return False
    if criterion == "cost":
        return found.cost <= limit
    return aicc(found, data) < aicc(before, data)


def _step(
    before: AnyFit,
    row: ParameterEstimate,
    value: float,
    done: Done,
    data: Sequence[Any],
    *,
    accepted: bool,
) -> Step:
    insensitivity, cramer_rao = accuracy_figures(before, row)
    return Step(
        parameter=row.name,
        value=value,
        insensitivity=insensitivity,
        cramer_rao=cramer_rao,
        cost=np.nan if done.reason else done.result.cost,
        aicc=np.nan if done.reason else aicc(done.result, data),
        accepted=accepted,
        reason=done.reason,
    )
