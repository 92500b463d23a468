"""Compare what a structure's bounds cost: one fit a case, every bound with its price.

The multipliers of a constrained fit are the derivatives of its optimal cost by the positions of its
bounds (Boyd & Vandenberghe, Convex Optimization, section 5.6), so they say which bounds are worth
relaxing, and predict by how much the cost would fall.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from casid.bounds.cases import Case, CaseSpec
from casid.bounds.pooled_warnings import returned, sentences, tell
from casid.bounds.prices import CaseResult, price_case
from casid.bounds.trials import Data, Fits, spelt_out
from casid.display import Shown, listed
from casid.envelope import balance_of, flight_condition
from casid.errors import warn
from casid.estimator import Estimator
from casid.fit import AnyFit, Fit
from casid.jobs.campaigns import Execution, Job
from casid.jobs.store import Done
from casid.model import Bounds, Model
from casid.nonlinear.balance import unbalanced
from casid.nonlinear.conditions import Trim
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import several
from casid.shooting.homogeneity import OPPOSED
from casid.shooting.output_error import OutputError
from casid.shooting.whiteness import FED
from casid.tabulation import csv_text, markdown_table
from casid.textfile import write_texts
from casid.validation import Validation, validate

OF_RECORDS = OPPOSED, FED  # how what residuals say of them begins
WORSE = 1e-6  # of the cost: a wider case that fits worse than this has found another minimum


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BoundsComparison(Shown):
    """What each case of a comparison costs, in the order the cases were given.

    Parameters
    ----------
    cases : tuple of CaseResult
        One a case.
    freest : str
        The case the others are measured against: the one within which most others lie.
    estimator : str
        The estimator's name in words.
    structure : str
        Name of the structure's class.
    validation : Validation or None
        Of the cases on unseen records.
    linearised_at : str
        Of a nonlinear structure: where eigenvalues are those of its linearisation, the trim of the
        first unseen record, else of the first, in balance; else the reference condition.
    """

    cases: tuple[CaseResult, ...]
    freest: str
    estimator: str
    structure: str
    validation: Validation | None = None
    linearised_at: str = ""

    def headline(self) -> str:
        """Structure, estimator, cases with their increase of the cost."""
        each = (
            f"{case.name} {'failed' if case.reason else f'+{case.increase:.4g}'}"
            for case in self.cases
        )
        return f"{self.structure} by {self.estimator}, increase of the cost: {', '.join(each)}"

    def __getitem__(self, name: str) -> CaseResult:
        """Result of one case."""
        for case in self.cases:
            if case.name == name:
                return case
        raise KeyError(f"no case {name!r}; there are {', '.join(c.name for c in self.cases)}")

    def ranked(self) -> tuple[str, ...]:
        """Parameters by their price: the largest share of a case's predicted increase first.

        Those without any follow in the order of declaration.
        """
        rows = next((case.parameters for case in self.cases if case.parameters), ())
        names = [row.name for row in rows]
        first = [label for label in self.priced() if label in names]
        return tuple(dict.fromkeys([*first, *names]))

    def priced(self) -> tuple[str, ...]:
        """Parameters and relations that cost some case something, largest price first."""
        shares: dict[str, float] = {}
        for case in self.cases:
            for label, share in case.shares.items():
                shares[label] = max(share, shares.get(label, -np.inf))
        return tuple(sorted(shares, key=lambda label: -shares[label]))

    def to_csv(self, path: str | Path) -> None:
        """Write one row a case and parameter, and beside it PATH_cases.csv with one row a case."""
        write_texts(self.csv_files(path))

    def csv_files(self, path: str | Path) -> dict[Path, str]:
        """What `to_csv` writes, by file."""
        path = Path(path)
        cases = path.with_name(f"{path.stem}_cases.csv")
        parameters = csv_text(PARAMETERS, list(_parameter_rows(self)))
        return {path: parameters, cases: csv_text(CASES, list(_case_rows(self)))}

    def to_markdown(self) -> str:
        """The cases, then parameters and relations by price; * marks those held, ± one sigma.

        Below stands what the cases' fits warned of.
        """
        figures = ("cost", "increase", "predicted", "held", "AICc", "LR", "p", "validation")
        heading = ("case", *figures, "eigenvalues [1/s]")
        cases = [_case_cells(case) for case in self.cases]
        names = [case.name for case in self.cases]
        prices = [f"price in {name}" for name in names if name != self.freest]
        body = [[name, *_cells(self, name)] for name in self.ranked()]
        relations = [row for case in self.cases for row in _relation_cells(case)]
        at = f"Eigenvalues are of the structure linearised at {self.linearised_at}."
        parts = [
            markdown_table(heading, cases),
            *([at] if self.linearised_at else []),
            markdown_table(["parameter", *names, *prices], body),
        ]
        if relations:
            parts.append(markdown_table(["case", "relation", "value", "price"], relations))
        if said := sentences({case.name: case.warnings for case in self.cases}):
            parts.append("\n".join(f"- {each}" for each in said))
        return "\n\n".join(parts)


def compare_bounds(
    model: Model,
    data: Data,
    *,
    cases: Mapping[str, CaseSpec],
    estimator: Estimator = OutputError(),
    validation: Record | Sequence[Record] = (),
    start: Model | AnyFit | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> BoundsComparison:
    """Estimate a structure under several sets of bounds and price every bound.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`, in all cases; the guess is what cases like "±20 %" refer to.
    data
        Records or targets, as the estimator takes them; not those of several flight conditions.
    cases : mapping
        Name and content of each case (`casid.bounds.cases`): ``{"free": {}, "signs": {"Lp": "<
        0"}}``.
    estimator : Estimator
        `OutputError`, `Match`, `Derivid`, `Chain` or another, with its settings.
    validation : Record or sequence of Record
        Unseen records to judge every case by.
    start : Model or Fit
        Where the freest case starts, e.g. ``match(...)``; the guess unless given. Every other case
        starts from the fit of a case that contains it, and one that a case within it beats starts
        from there once more: it had ended in another minimum.
    execution : Execution
        Where cases run and are kept.

    Returns
    -------
    BoundsComparison
        A case that fails is a row with its reason. What the cases' fits warned of is told, once
        each.

    Raises
    ------
    ValueError, ModelError
        A case that is not understood, no estimator.
    """
    fits = Fits(model, data, estimator, fixed, bounds, execution)
    read = fits.cases(cases)
    jobs = _jobs(read, fits, start)
    done = _from_each_other(read, fits, fits.run(jobs))
    said = returned({case.name: done[case.name] for case in read})
    tell(_of_records(said, next(job.name for job in jobs if job.name in said)))
    good = {case.name: done[case.name].result for case in read if not done[case.name].reason}
    freest, judged = jobs[0].name, None
    if good and (unseen := several(validation)):
        judged = validate(good, unseen)
    base = next(case for case in read if case.name == freest), good.get(freest)
    trim, where = _flown(good, judged, fits.data)
    results = tuple(
        _from_guess(price_case(case, done[case.name], base, fits.data, judged, trim), model)
        for case in read
    )
    _warn_of_minima(results, read, base[0])
    _warn_of_narrowness(base, fits.cases({freest: {}})[0], read)
    return BoundsComparison(
        cases=results,
        freest=freest,
        estimator=spelt_out(type(estimator).__name__),
        structure=type(model).__name__,
        validation=judged,
        linearised_at=where,
    )


def _of_records(said: Mapping[str, Sequence[str]], freest: str) -> dict[str, tuple[str, ...]]:
    """Warnings of cases; what the freest says of records is told of all, others are not asked.

    Under bounds that the truth breaks, records contradict each other by the bounds' doing.
    """
    of_all = [text for text in said[freest] if text.startswith(OF_RECORDS)]
    own = {
        name: [text for text in texts if not text.startswith(OF_RECORDS)]
        for name, texts in said.items()
    }
    return {name: (*texts, *of_all) for name, texts in own.items()}


def _from_guess(case: CaseResult, guess: Model) -> CaseResult:
    """The case with the guess that its bounds refer to, not the start that its fit had."""
    rows = (replace(row, guess=float(getattr(guess, row.name))) for row in case.parameters)
    return replace(case, parameters=tuple(rows))


def _flown(
    fits: Mapping[str, AnyFit], judged: Validation | None, data: Sequence[Any]
) -> tuple[Trim | None, str]:
    """The trim at which cases of a nonlinear structure are linearised, if records tell one."""
    curved: list[Fit[Any, Any]]
    curved = [fit for fit in fits.values() if isinstance(fit.model, NonlinearModel)]
    if not curved:
        return None, ""
    flown = (*(judged.measured if judged else ()), *data)
    if not isinstance(flown[0], Record):
        return None, "its reference condition"
    trim = flight_condition(curved[0].model, flown[0])
    if doubts := [doubt for fit in curved if (doubt := balance_of(fit, trim).doubt)]:
        warn(unbalanced(curved[0].model, doubts))
    return trim, f"the trim of record {flown[0].name}, in balance"


def _jobs(cases: Sequence[Case], fits: Fits, start: Model | AnyFit | None) -> list[Job]:
    """One job a case, the freest first; each after a wider one, or the freest if that failed."""
    # The wider one is that halfway down the ladder of cases that contain it: near, and a ladder of
    # n cases takes log n rounds on many processors.
    order = sorted(cases, key=lambda case: -sum(other.within(case) for other in cases))
    guess = start.model if isinstance(start, Fit) else start
    jobs: list[Job] = []
    for case in order:
        wider = [job for job, other in zip(jobs, order, strict=False) if case.within(other)]
        halfway = wider[(len(wider) - 1) // 2 :][:1]
        after = [*halfway, *jobs[:1]]
        jobs.append(fits.job(case, guess if jobs else start, after=after, asked=not jobs))
    return jobs


def _from_each_other(
    cases: Sequence[Case], fits: Fits, done: Mapping[str, Done]
) -> dict[str, Done]:
    """Fits of cases, anew from one that lies within and costs less; then all within what is found.

    Of each case that which costs least remains.
    """
    best, tried, found = dict(done), set[tuple[str, str]](), set[str]()
    while True:
        cost = {name: np.inf if each.reason else each.result.cost for name, each in best.items()}
        starts: dict[str, str] = {}
        jobs: list[Job] = []
        for case in cases:
            others = [o for o in cases if o is not case and (case.name, o.name) not in tried]
            inside = (o.name for o in others if o.within(case))
            near = [name for name in inside if _less(cost[name], cost[case.name])]
            near = near or [o.name for o in others if o.name in found and case.within(o)]
            if near:
                start = starts[case.name] = min(near, key=cost.__getitem__)
                name = f"{case.name}, from {start}"
                jobs.append(fits.job(case, best[start].result, name=name, asked=False))
        if not jobs:
            return best
        tried |= starts.items()
        again, found = list(fits.run(jobs).values()), set()
        for (name, start), new in zip(starts.items(), again, strict=True):
            if not new.reason and _less(new.result.cost, cost[name]):
                best[name] = replace(new, source=start)
                found.add(name)


def _less(cost: float, other: float) -> bool:
    """Whether a cost is lower by more than two ways to one minimum differ by."""
    return cost < other and (not np.isfinite(other) or other - cost > WORSE * (1 + abs(other)))


def _warn_of_minima(results: Sequence[CaseResult], cases: Sequence[Case], freest: Case) -> None:
    """A case within the freest cannot fit better, unless the freest found another minimum."""
    for case, allowed in zip(results, cases, strict=True):
        if allowed.within(freest) and case.increase < -WORSE * (1 + abs(case.cost)):
            warn(
                f"case {case.name!r} lies within {freest.name!r}, yet its cost is lower by "
                f"{-case.increase:.3g}, and {freest.name!r} came no lower when started from "
                f"there: increases are relative to a local minimum; start {freest.name!r} "
                "elsewhere"
            )


def _warn_of_narrowness(
    freest: tuple[Case, AnyFit | None], own: Case, cases: Sequence[Case]
) -> None:
    """What all cases hold has no price in any of them: nothing is said of what it costs.

    Nor is it a price by how much a case differs that does not lie within the freest.
    """
    case, fit = freest
    held = () if fit is None else [row.name for row in fit.parameters if row.active]
    if common := [name for name in held if case.bounds[name] != own.bounds[name]]:
        apart = [repr(other.name) for other in cases if not other.within(case)]
        more = (
            f"; increases of {listed(apart)}, which {'does' if len(apart) == 1 else 'do'} not lie "
            "within it, may be negative and are no prices of bounds"
        ) * bool(apart)
        warn(
            f"increases and prices count from {case.name!r}, the freest case, in which "
            f"{listed(common)} {'is' if len(common) == 1 else 'are'} on bounds narrower than the "
            f"structure's own: add a case without any, free = {{}}, to see what those cost{more}"
        )


ERRORS = ("std_error", "cramer_rao")
ROW = ("name", "unit", "guess", "value", *ERRORS, "lower", "upper", "active", "multiplier")
FIGURES = ("reason", "cost", "increase", "predicted", "held", "aicc", "statistic", "freedom")
PARAMETERS = ("case", "kind", *ROW, "share", "p_value")
CASES = ("case", *FIGURES, "p_value", "validation_rms", "start", "eigenvalues", "linearised_at")
ABSENT = {"unit": "", "guess": np.nan} | dict.fromkeys(ERRORS, np.nan)  # of a relation


def _parameter_rows(comparison: BoundsComparison) -> Iterator[list[Any]]:
    for case in comparison.cases:
        for kind, rows in (("parameter", case.parameters), ("relation", case.relations)):
            for row in rows:
                values = [getattr(row, name, ABSENT.get(name)) for name in ROW]
                p_value = case.price_p_values.get(row.name, np.nan)
                yield [case.name, kind, *values, case.shares.get(row.name, 0.0), p_value]


def _case_rows(comparison: BoundsComparison) -> Iterator[list[Any]]:
    for case in comparison.cases:
        poles = " ".join(f"{pole:.6g}" for pole in case.eigenvalues)
        figures = [getattr(case, name) for name in FIGURES]
        where = comparison.linearised_at
        yield [case.name, *figures, case.p_value, case.rms, case.start, poles, where]


def _case_cells(case: CaseResult) -> list[str]:
    if case.reason:
        return [case.name, f"failed: {case.reason}", *[""] * 8]
    poles = [pole for pole in case.eigenvalues if pole.imag >= 0]
    shown = ", ".join(f"{p.real:.3g} ± {p.imag:.3g}j" if p.imag else f"{p.real:.3g}" for p in poles)
    test = f"{case.statistic:.4g} ({case.freedom})" if np.isfinite(case.statistic) else ""
    figures = map(_short, (case.increase, case.predicted, case.held, case.aicc))
    after = map(_short, (case.p_value, case.rms))
    return [case.name, f"{case.cost:.8g}", *figures, test, *after, shown]


def _cells(comparison: BoundsComparison, name: str) -> list[str]:
    """Value of a parameter in every case, and its price in all but the freest."""
    values, prices = [], []
    for case in comparison.cases:
        row = next((row for row in case.parameters if row.name == name), None)
        if row is None:
            values.append("")
        else:
            error = f" ± {row.std_error:.2g}" if np.isfinite(row.std_error) else ""
            values.append(f"{row.value:.4g}{error}{'*' if row.active else ''}")
        if case.name != comparison.freest:
            prices.append(_price(case, name))
    return [*values, *prices]


def _price(case: CaseResult, label: str) -> str:
    """A share and how surprising it is, "12.3 (p 0.04)"; nothing for what costs nothing."""
    p = case.price_p_values.get(label, np.nan)
    return _short(case.shares.get(label, np.nan)) + (f" (p {p:.2g})" if np.isfinite(p) else "")


def _relation_cells(case: CaseResult) -> Iterator[list[str]]:
    for row in case.relations:
        mark = "*" if row.active else ""
        yield [case.name, f"{row.name}{mark}", f"{row.value:.4g}", _price(case, row.name)]


def _short(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}"
