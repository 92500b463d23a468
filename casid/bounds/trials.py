"""One fit as a job: structure, case, data and estimator in, a fit out, in any process."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from casid.arrays import Array
from casid.baseline.derivid import Derivid
from casid.bounds.cases import Case, constrained, feasible, plain
from casid.errors import ConvergenceError
from casid.estimator import Estimator
from casid.fit import AnyFit, Fit
from casid.jobs.campaigns import Advance, Done, Job, Shelf, UnfinishedError, run_jobs
from casid.jobs.store import source_digest
from casid.jobs.transport import Reference, can_travel, refer, refuse_while_loading, resolve
from casid.matching.match import Match
from casid.matching.targets import Target
from casid.model import Model
from casid.record import Record
from casid.shooting.output_error import OutputError
from casid.values import digest

Data: TypeAlias = Sequence[Record] | Sequence[Target] | Record | Target
Content: TypeAlias = Mapping[str, Any]  # of a fit
Draw: TypeAlias = Callable[[tuple[Any, ...]], tuple[Any, ...]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """What all fits of a study share.

    Parameters
    ----------
    reference : Reference
        The structure's class.
    estimator : str or Estimator
        One of `ESTIMATORS`, or the value itself.
    data : tuple
        Records or targets.
    fixed : tuple of str
        Parameters held.
    settings : mapping
        Further keyword arguments of the estimator.
    """

    reference: Reference
    estimator: str | Estimator
    data: tuple[Any, ...]
    fixed: tuple[str, ...]
    settings: Mapping[str, Any]

    @cached_property
    def key(self) -> str:
        """Digest of all of it, and of the code that computes results."""
        return digest(
            source_digest(), self.reference.name, self.reference.text, self.estimator, self.data,
            self.fixed, self.settings,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Trial:
    """What one fit needs.

    Parameters
    ----------
    setup : Setup
        What it shares with the others.
    values : mapping
        All of the structure's fields: the start, unless a job gives a better one, and the trim.
    case : Case
        Bounds and relations.
    near : mapping or None
        Content of a fit nearby, for a job that starts from no other.
    draw : callable or None
        Makes the fit's own data from the study's; it must survive pickling.
    """

    setup: Setup
    values: Mapping[str, Any]
    case: Case
    near: Content | None = None
    draw: Draw | None = None

    def job(self, name: str, after: Sequence[Job] = ()) -> Job:
        """The job of that name that starts from the nearest of ``after``."""
        case = (dict(self.case.bounds), [asdict(relation) for relation in self.case.relations])
        near = None if self.near is None else {**self.near, "seconds": 0.0}
        key = digest(
            self.setup.key, dict(self.values), case, near, self.draw, [job.key for job in after]
        )
        return Job(name=name, key=key, payload=self, after=tuple(job.name for job in after))


def setup(
    model: Model,
    data: Data,
    *,
    estimator: str | Estimator,
    fixed: Sequence[str],
    settings: Mapping[str, Any],
) -> Setup:
    """What the fits of a structure to data share; what is the same for all is computed here.

    Raises
    ------
    ValueError
        An unknown estimator.
    """
    if isinstance(estimator, str) and estimator not in ESTIMATORS:
        known = ", ".join(map(repr, ESTIMATORS))
        raise ValueError(f"estimator={estimator!r}: expected one of {known}")
    given = dict(settings)
    if "solver" in given:  # a callable does not travel
        given["solver"] = replace(given["solver"], progress=None)
    items = tuple(data) if isinstance(data, Sequence) else (data,)
    return Setup(
        reference=refer(type(model)), estimator=estimator, data=items, fixed=tuple(fixed),
        settings=given,
    )  # fmt: skip


def named(estimator: str | Estimator) -> str:
    """What tables call an estimator."""
    return estimator if isinstance(estimator, str) else type(estimator).__name__


def starting_values(
    model: Model, start: Model | AnyFit | None
) -> tuple[dict[str, Any], Content | None]:
    """All fields of a model with the parameters of a start, and the start's content if a fit."""
    values = {each.name: getattr(model, each.name) for each in fields(model)}
    guess = start.model if isinstance(start, Fit) else start
    if guess is not None:
        values |= {name: getattr(guess, name) for name in model.parameter_names()}
    return values, start.content() if isinstance(start, Fit) else None


def run_trials(
    jobs: Sequence[Job],
    structure: type[Model],
    *,
    folder: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[Advance], None] | None = None,
) -> dict[str, Done]:
    """Do all jobs; the result of each is a `Fit`, or None where there is nothing to show.

    A class that other processes cannot read keeps the fits in this one.
    """
    refuse_while_loading()
    done = run_jobs(
        work, jobs, shelf=Shelf(folder), executor=executor, progress=progress,
        here=not can_travel(structure),
    )  # fmt: skip
    return {
        name: each
        if each.result is None
        else replace(each, result=Fit.from_content(each.result, model=structure))
        for name, each in done.items()
    }


def work(job: Trial, start: Content | None) -> Content:
    """Fit; ``start`` is the content of a fit nearby.

    Raises
    ------
    UnfinishedError
        No convergence; with the content of the best iterate.
    """
    setup = job.setup
    cls = resolve(setup.reference)
    model = cls(**job.values)
    start = job.near if start is None else start
    near = None if start is None else Fit.from_content(start, model=cls)
    if near is not None:
        known = {name: getattr(near.model, name) for name in cls.parameter_names()}
        model = replace(model, **known)
    inside, sizes = constrained(feasible(model, job.case, near), job.case)
    data = setup.data if job.draw is None else job.draw(setup.data)
    chosen = setup.estimator
    estimator = ESTIMATORS[chosen](**setup.settings) if isinstance(chosen, str) else chosen
    try:
        fit = estimator.fit(inside, data, fixed=setup.fixed, bounds=job.case.bounds, near=near)
    except ConvergenceError as error:
        best = error.best
        content = _own(best, cls, sizes).content() if isinstance(best, Fit) else None
        raise UnfinishedError(str(error), content) from error
    return _own(fit, cls, sizes).content()


def _own(fit: AnyFit, cls: type[Model], sizes: Array) -> AnyFit:
    """The fit with the user's class, and the case's relations in their own units."""
    own = len(fit.constraints) - len(sizes)
    relations = tuple(
        replace(
            row,
            value=row.value * size,
            lower=row.lower * size,
            upper=row.upper * size,
            multiplier=row.multiplier / size,
        )
        for row, size in zip(fit.constraints[own:], sizes.tolist(), strict=True)
    )
    constraints = fit.constraints[:own] + relations
    return replace(fit, model=plain(fit.model, cls), constraints=constraints)


ESTIMATORS: Mapping[str, Callable[..., Estimator]] = {
    "match": Match,
    "output_error": OutputError,
    "derivid": Derivid,
}


# ---- what a fit says about its likelihood --------------------------------------------------------


def aicc(fit: AnyFit, records: Sequence[Record]) -> float:
    """Corrected Akaike criterion of a fit to records; NaN unless its cost is a likelihood.

        AICc = 2 J + 2 k n / (n - k - 1)

    n counts the measurements; k the directions in which parameters are free, the initial states and
    biases of every record and the noise variances (N. Sugiura, Commun. Stat. A7, 1978).
    """
    if fit.R is None or fit.initial_states is None or fit.biases is None:
        return np.nan
    outputs = type(fit.model).outputs
    n = sum(int(np.isfinite(record.channel(name)).sum()) for record in records for name in outputs)
    k = len(fit.free_names) - fit.held
    k += fit.initial_states.size + fit.biases.size + len(fit.R)
    return 2 * fit.cost + 2 * k * n / (n - k - 1) if n > k + 1 else np.inf
