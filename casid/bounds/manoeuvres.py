"""Structures, or ways to estimate one, side by side: how well each predicts manoeuvres left out.

Each is estimated from all manoeuvres but one and judged on that one. Which structure is enough is
then told by the simplest whose errors are not significantly larger than the best one's (the rule of
one standard error: L. Breiman and others, Classification and Regression Trees, 1984, section 3.4).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.bounds.trials import Fits, aicc
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.jobs.campaigns import Execution
from casid.jobs.store import Done
from casid.model import Model
from casid.record import Record
from casid.records import stretches
from casid.shooting.output_error import OutputError
from casid.tabulation import markdown_table
from casid.validation import validate

FEWEST = 3  # manoeuvres, for an error of the mean over them


@dataclass(frozen=True, eq=False, kw_only=True)
class StructureComparison:
    """How well candidates predict manoeuvres that they were not estimated from.

    Parameters
    ----------
    names, manoeuvres, outputs : tuple of str
        Candidates, the records left out in turn, what was predicted.
    errors : (candidates, manoeuvres, ny) array
        Root mean square errors on the record left out; NaN where a fit has nothing to show.
    parameters : tuple of int
        Free parameters of every candidate.
    aicc : (candidates,) array
        Corrected Akaike criterion of the fits to all records; NaN unless they are by likelihood.
    fits : tuple of Fit or None
        To all records.
    reasons : mapping
        Why fits failed, by candidate and manoeuvre.
    """

    names: tuple[str, ...]
    manoeuvres: tuple[str, ...]
    outputs: tuple[str, ...]
    errors: Array
    parameters: tuple[int, ...]
    aicc: Array
    fits: tuple[AnyFit | None, ...]
    reasons: Mapping[str, str]

    @property
    def excess(self) -> tuple[Array, Array]:
        """By how much the logarithm of the error exceeds the best one's, and its standard error.

        Mean over outputs, then over manoeuvres; a candidate that failed on one is infinitely worse.
        """
        size = np.log(np.maximum(self.errors, 1e-300)).mean(axis=2)
        size = np.where(np.isfinite(size), size, np.inf)
        best = int(np.argmin(size.mean(axis=1)))
        apart = size - np.where(np.isfinite(size[best]), size[best], 0.0)
        with np.errstate(invalid="ignore"):
            spread = np.std(apart, axis=1, ddof=1) / np.sqrt(apart.shape[1])
        return apart.mean(axis=1), np.where(np.isfinite(spread), spread, 0.0)

    @property
    def best(self) -> str:
        """The candidate with the smallest errors."""
        return self.names[int(np.argmin(self.excess[0]))]

    @property
    def simplest(self) -> str:
        """The candidate with the fewest parameters among those that are not worse than the best."""
        mean, error = self.excess
        equal = np.flatnonzero(mean <= error)
        order = sorted(equal, key=lambda k: (self.parameters[k], mean[k]))
        return self.names[order[0]]

    def to_markdown(self) -> str:
        """One row a candidate."""
        mean, error = self.excess
        rows = [
            [name, str(count), f"{100 * np.expm1(m):+.0f} % ± {100 * e:.0f} %", f"{a:.0f}"]
            for name, count, m, e, a in zip(
                self.names, self.parameters, mean, error, self.aicc, strict=True
            )
        ]
        return markdown_table(["candidate", "parameters", "error above the best", "AICc"], rows)


@dataclass(frozen=True, eq=False)
class WithoutOne:
    """All records but one."""

    number: int

    def __call__(self, records: tuple[Record, ...]) -> tuple[Record, ...]:
        """The others."""
        return (*records[: self.number], *records[self.number + 1 :])


def compare_structures(
    candidates: Mapping[str, Model],
    records: Sequence[Record],
    *,
    estimator: Estimator | Mapping[str, Estimator] = OutputError(),
    execution: Execution = Execution(),
) -> StructureComparison:
    """Estimate candidates from all manoeuvres but one, in turn, and predict that one.

    Parameters
    ----------
    candidates : mapping
        A name for each structure at its start; one structure may stand there several times, to be
        estimated in several ways. All have the same outputs.
    records : sequence of Record
        The manoeuvres, three or more.
    estimator : Estimator, or mapping of them by candidate
        How to estimate, from records.
    execution : Execution
        As in `compare_bounds`.

    Raises
    ------
    ValueError, ModelError
        Too few records, other outputs, a candidate without an estimator; what the estimator
        refuses.
    """
    flown = stretches(records)
    outputs = _checked(candidates, flown)
    ways = estimator if isinstance(estimator, Mapping) else dict.fromkeys(candidates, estimator)
    for name in candidates:
        if name not in ways:
            raise ValueError(f"no estimator for {name!r}; there are {', '.join(ways)}")
    errors = np.full((len(candidates), len(flown), len(outputs)), np.nan)
    fits: list[AnyFit | None] = []
    reasons: dict[str, str] = {}
    for k, (name, model) in enumerate(candidates.items()):
        many = Fits(model, flown, ways[name], (), None, execution)
        (case,) = many.cases({name: {}})
        every = many.run([many.job(case, name=f"{name}, all")])[f"{name}, all"]
        fits.append(every.result)
        start = None if every.result is None else every.result.model
        jobs = [
            many.job(case, start, draw=WithoutOne(i), name=f"{name}, without {i + 1}")
            for i in range(len(flown))
        ]
        done = many.run(jobs)
        for i, each in enumerate(done.values()):
            errors[k, i] = _error(each, flown[i], outputs)
        failed = {job: each.reason for job, each in done.items() if each.reason}
        reasons |= failed | ({f"{name}, all": every.reason} if every.reason else {})
    return StructureComparison(
        names=tuple(candidates), manoeuvres=tuple(each.name for each in flown), outputs=outputs,
        errors=errors, parameters=tuple(0 if f is None else len(f.free_names) for f in fits),
        aicc=np.array([np.nan if f is None else aicc(f, flown) for f in fits]),
        fits=tuple(fits), reasons=reasons,
    )  # fmt: skip


def _checked(candidates: Mapping[str, Model], records: Sequence[Record]) -> tuple[str, ...]:
    """Outputs that all candidates have; ValueError if there are none, or too few records."""
    if not candidates:
        raise ValueError('no candidates; expected {"name": model, ...}')
    if len(records) < FEWEST:
        raise ValueError(
            f"{len(records)} manoeuvres: each is left out in turn, which takes {FEWEST} or more"
        )
    first = next(iter(candidates.values())).outputs
    for name, model in candidates.items():
        if set(model.outputs) != set(first):
            raise ValueError(
                f"candidate {name!r} predicts {', '.join(model.outputs)}, the first "
                f"{', '.join(first)}: compare structures of the same outputs"
            )
    return first


def _error(done: Done, record: Record, outputs: tuple[str, ...]) -> Array:
    """Root mean square errors (ny,) of a fit on a record; NaN where it has nothing to show."""
    if done.result is None or done.reason:
        return np.full(len(outputs), np.nan)
    own = record.select(done.result.model.inputs, outputs)
    return np.asarray(validate({"fit": done.result}, own).rms["fit"][0])
