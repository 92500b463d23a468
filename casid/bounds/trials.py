"""One fit as a job: structure, case, data and estimator in, a fit out, in any process."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from casid.bounds.cases import Case, CaseSpec, as_user_class, constrained, feasible, read_cases
from casid.bounds.robust import weights
from casid.errors import ConvergenceError, unasked
from casid.estimator import Estimator
from casid.fit import AnyFit, Fit
from casid.jobs.campaigns import Execution, Job, UnfinishedError, run_jobs
from casid.jobs.digests import equations_digest, source_digest
from casid.jobs.store import Done
from casid.jobs.transport import Reference, can_travel, refer, refuse_while_loading, resolve
from casid.matching.targets import Target
from casid.model import Bounds, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import several
from casid.shooting.precision import OutputErrorNotes
from casid.values import decode, digest, encode

SAME = 1e-9  # share of the largest singular value below which rows say nothing more

Data: TypeAlias = Sequence[Record] | Sequence[Target] | Record | Target
Draw: TypeAlias = Callable[[tuple[Any, ...]], tuple[Any, ...]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """What all fits of a study share."""

    reference: Reference  # the structure's class
    estimator: Estimator
    data: tuple[Any, ...]  # records or targets
    fixed: tuple[str, ...]  # parameters held
    equations: str  # digest of what the structure's code builds

    @cached_property
    def key(self) -> str:
        """Digest of all of it, and of the code that computes results."""
        structure = (self.reference.name, self.reference.digest, self.equations)
        return digest(source_digest(), structure, self.estimator, self.data, self.fixed)


@dataclass(frozen=True, eq=False, kw_only=True)
class Trial:
    """What one fit needs."""

    setup: Setup  # what it shares with the others
    values: Mapping[str, Any]  # all fields: the start, unless a job gives a better, and the trim
    case: Case
    near: Any = None  # a fit nearby, encoded, for a job that starts from no other
    draw: Draw | None = None  # makes the fit's own data from the study's; picklable
    estimator: Estimator | None = None  # instead of the study's
    asked: bool = True  # what it says of the data, or a fit nearby has told that, if it succeeded


class Fits:
    """Many fits of one structure to the same data; what is the same for all is computed once.

    Settings are those of `compare_bounds`. ValueError: no estimator, or what its preparation
    refuses.
    """

    def __init__(
        self,
        model: Model,
        data: Data,
        estimator: Estimator,
        fixed: Collection[str],
        bounds: Bounds | None,
        execution: Execution,
    ) -> None:
        if isinstance(estimator, type) or not callable(getattr(estimator, "fit", None)):
            raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
                f"estimator={estimator!r}: expected an estimator with its settings, "
                'Match(norm="hinf") or OutputError()'
            )
        self.model, self.fixed, self.bounds = model, tuple(fixed), bounds
        self.data = several(data)
        prepare = getattr(estimator, "prepared", None)
        shared = (
            prepare(model, self.data, fixed=self.fixed, bounds=bounds) if prepare else estimator
        )
        self._setup = Setup(
            reference=refer(type(model)),
            estimator=shared,
            data=self.data,
            fixed=self.fixed,
            equations=equations_digest(model),
        )
        self._execution = execution

    def cases(self, specs: Mapping[str, CaseSpec]) -> tuple[Case, ...]:
        """Cases as a user wrote them."""
        return read_cases(self.model, specs, self.fixed, self.bounds)

    def job(
        self,
        case: Case,
        start: Model | AnyFit | None = None,
        *,
        after: Sequence[Job] = (),
        alone: bool = True,
        draw: Draw | None = None,
        estimator: Estimator | None = None,
        name: str | None = None,
        asked: bool = True,
    ) -> Job:
        """The fit of a case from a start, or from the nearest of the jobs it comes after.

        Near a fit that succeeded it may be not ``asked`` what the data say (`casid.errors.asked`).
        """
        values = {each.name: getattr(self.model, each.name) for each in fields(self.model)}
        guess, near = start, None
        if isinstance(start, Fit):  # how long that took makes no other result
            guess, near = start.model, encode(replace(start, seconds=0.0))
        if guess is not None:
            values |= {each: getattr(guess, each) for each in self.model.parameter_names()}
        own: Any = {"draw": draw, "estimator": estimator, "asked": asked}
        trial = Trial(setup=self._setup, values=values, case=case, near=near, **own)
        said = (dict(case.bounds), [asdict(relation) for relation in case.relations])
        before = [job.key for job in after]
        key = digest(self._setup.key, values, said, near, draw, estimator, asked, before)
        names = tuple(job.name for job in after)
        return Job(name=name or case.name, key=key, payload=trial, after=names, alone=alone)

    def run(self, jobs: Sequence[Job]) -> dict[str, Done]:
        """Do all jobs; the result of each is a `Fit`, or None where there is nothing to show."""
        return run_fits(jobs, [type(self.model)], self._execution)


def run_fits(
    jobs: Sequence[Job], structures: Sequence[type[Model]], execution: Execution
) -> dict[str, Done]:
    """Do all jobs of several `Fits`, whose models are of these structures, side by side."""
    refuse_while_loading()
    # A class that other processes cannot read keeps the fits in this one.
    here = not all(can_travel(structure) for structure in structures)
    return run_jobs(work, jobs, execution, also=tuple(structures), here=here)


def work(job: Trial, start: Any) -> AnyFit:  # noqa: ANN401 - JSON is any
    """Fit from ``start``, a fit nearby, encoded; UnfinishedError has the best iterate."""
    setup = job.setup
    cls = resolve(setup.reference)
    model = cls(**job.values)
    near: AnyFit | None = decode(job.near if start is None else start, (cls,))
    if near is not None:
        known = {name: getattr(near.model, name) for name in cls.parameter_names()}
        model = replace(model, **known)
    inside = constrained(feasible(model, job.case, near), job.case)
    data = setup.data if job.draw is None else job.draw(setup.data)
    bounds = job.case.bounds
    try:
        estimator = job.estimator or setup.estimator
        with unasked(when=not job.asked and near is not None and near.success):
            fit = estimator.fit(inside, data, fixed=setup.fixed, bounds=bounds, near=near)
    except ConvergenceError as error:
        best = error.best
        shown = _own(best, cls) if isinstance(best, Fit) else None
        raise UnfinishedError(str(error), shown) from error
    return _own(fit, cls)


def _own(fit: AnyFit, cls: type[Model]) -> AnyFit:
    """The fit with the user's class."""
    return replace(fit, model=as_user_class(fit.model, cls))


def spelt_out(name: str) -> str:
    """``OutputError`` as "output error"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def aicc(fit: AnyFit, records: Sequence[Record]) -> float:
    """Corrected Akaike criterion of a fit to records; NaN unless its cost is a likelihood.

        AICc = 2 J + 2 k n / (n - k - 1)

    n counts the measurements; k the directions in which parameters are free, each by the variance
    its estimate has over that by the information (K. Takeuchi, Suri-Kagaku 153, 1976), and all that
    was estimated beside them (N. Sugiura, Commun. Stat. A7, 1978), what two of these say once. That
    records contradict each other, which is told of some fits and not of others, does not count.
    """
    if not isinstance(fit.notes, OutputErrorNotes):
        return np.nan
    outputs = type(fit.model).outputs
    n = sum(int(np.isfinite(record.channel(name)).sum()) for record in records for name in outputs)
    alike = None if fit.covariance is None else fit.notes.alike(fit.covariance)
    w = weights(replace(fit, covariance=alike), np.eye(len(fit.free_names)))
    k = (w.sum() if len(w) else len(fit.free_names) - fit.held) + fit.notes.nuisances
    k -= _told_twice(fit) * len(records)
    return 2 * fit.cost + 2 * k * n / (n - k - 1) if n > k + 1 else np.inf


def _told_twice(fit: AnyFit) -> int:
    """Directions of a record's initial state that its outputs do not feel, or as biases alone.

    An integral's, beside a bias of it: C x(0) is constant where C Aⁿ x(0) = 0 for all n > 0.
    """
    if isinstance(fit.model, NonlinearModel):
        return 0
    system = fit.model.system()
    exact = np.ones(system.ny, dtype=bool) if fit.biases is None else ~fit.biases.any(axis=0)
    size = max(float(np.linalg.norm(system.A, 2)), 1e-300)
    rows, power = [system.C[exact]], system.C
    for _ in range(system.nx):
        power = power @ system.A / size
        rows.append(power)
    return int(system.nx - np.linalg.matrix_rank(np.vstack(rows), rtol=SAME))
