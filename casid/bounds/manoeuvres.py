"""Structures, or ways to estimate one, side by side: how well each predicts manoeuvres left out.

Each is estimated from all manoeuvres but one and judged on that one. Which structure is enough is
then told by the simplest whose errors are not significantly larger than the best one's (L. Breiman
and others, Classification and Regression Trees, 1984, section 3.4): not more than by chance, at
90 % of Student's t, as few manoeuvres do not tell how they scatter. One standard error, as in that
rule, is exceeded by chance in a fifth of the comparisons of four, and the best is one of several.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from casid.arrays import Array
from casid.bounds.pooled_warnings import heard, returned, tell
from casid.bounds.replaceable import needed, parts_of
from casid.bounds.trials import Fits, aicc, run_fits
from casid.checks import check_known
from casid.display import Cells, Tabled, percent_above
from casid.errors import ConvergenceError
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.jobs.campaigns import Execution, Job
from casid.model import Bounds, Model
from casid.nonlinear.model import NonlinearModel
from casid.prediction import PredictionPlan, predict, which_biased
from casid.record import Record
from casid.records import standard_deviations, stretches
from casid.shooting.output_error import OutputError
from casid.tabulation import markdown_table
from casid.validation import validate

SURE = 0.9  # one-sided, that a candidate is worse than the best
FEWEST = 3  # manoeuvres, for an error of the mean over them
NOISE = 0.9  # of the noise's power, which is not known exactly, is taken from errors' squares
HIDDEN = ", at least: errors are below the noise"
TOP = 0.75  # of the highest frequency, from where residuals are noise


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StructureComparison(Tabled):
    """How well candidates predict manoeuvres that they were not estimated from.

    Parameters
    ----------
    names, manoeuvres, outputs : tuple of str
        Candidates, the records left out in turn, what was predicted.
    errors : (candidates, manoeuvres, ny) array
        Root mean square errors on the record left out, all candidates simulated or all predicted,
        with the biases of the estimator, and with what these and initial states take of the noise
        given back; infinite where a fit has nothing to show, NaN of an output that the record has
        no sample of, which counts for none.
    noise : (ny,) array
        Standard deviation of the white noise among these, by the residuals' highest frequencies.
    parameters : tuple of int
        Free parameters of every candidate.
    aicc : (candidates,) array
        Corrected Akaike criterion of the fits to all records; NaN unless all are by one likelihood.
    fits : tuple of Fit or None
        To all records.
    reasons : mapping
        Why fits failed, by candidate and manoeuvre.
    warnings : mapping
        What the fits to all records warned of, by candidate.
    """

    names: tuple[str, ...]
    manoeuvres: tuple[str, ...]
    outputs: tuple[str, ...]
    errors: Array
    noise: Array
    parameters: tuple[int, ...]
    aicc: Array
    fits: tuple[AnyFit | None, ...]
    reasons: Mapping[str, str]
    warnings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def best(self) -> str:
        """The candidate that failed least, of these with the smallest errors where none failed."""
        failed = np.asarray(np.isinf(self.errors).any(axis=2))
        often = failed.sum(axis=1)
        size = self._size(self.errors[:, ~failed[often == often.min()].any(axis=0)])
        return self.names[int(np.lexsort((size, often))[0])]

    @property
    def excess(self) -> tuple[Array, Array]:
        """By how much the logarithm of the error exceeds the best one's, and its standard error."""
        return self.over(self.best)

    def over(self, name: str) -> tuple[Array, Array]:
        """By how much the logarithm of the error exceeds that of a candidate, and its error.

        Of root mean square errors over the manoeuvres, without the noise that nothing predicts,
        mean over outputs; a candidate that failed on one is infinitely worse. Standard errors are
        those of the jackknife over manoeuvres.
        """
        k, n = self.names.index(name), self.errors.shape[1]
        parts = [self._size(np.delete(self.errors, i, axis=1)) for i in range(n)]
        with np.errstate(invalid="ignore"):
            apart = np.array([part - part[k] for part in parts])
            error = np.sqrt(n - 1) * np.std(apart, axis=0)
            mean = self._size(self.errors) - self._size(self.errors)[k]
        return np.where(np.isnan(mean), np.inf, mean), np.where(np.isfinite(error), error, 0.0)

    def _size(self, errors: Array) -> Array:
        """Logarithm (candidates,) of errors (candidates, manoeuvres, ny), infinite of failures."""
        own, some = self._own(errors), ~np.isnan(errors).all(axis=1)
        logarithm, count = np.log(np.maximum(own, 1e-300)) / 2, some.sum(axis=1)
        size = np.sum(logarithm, axis=1, where=some) / np.maximum(count, 1)
        return np.asarray(np.where(np.isfinite(size) & (count > 0), size, np.inf))

    def _own(self, errors: Array) -> Array:
        """Mean squares (candidates, ny) over the manoeuvres, most of the noise taken off."""
        told = ~np.isnan(errors)
        square = np.sum(errors**2, axis=1, where=told) / np.maximum(told.sum(axis=1), 1)
        return np.asarray(np.maximum(square - NOISE * self.noise**2, (1 - NOISE) * square))

    @property
    def hidden(self) -> bool:
        """Whether the noise that is left, which makes errors alike, is most of the best one's."""
        own = self._own(self.errors)[self.names.index(self.best)]
        return bool(np.median((1 - NOISE) * self.noise**2 / np.maximum(own, 1e-300)) > 1 / 2)

    @property
    def simplest(self) -> str:
        """The candidate with the fewest parameters among those that are not worse than the best.

        Worse is one by more standard errors than 90 % of Student's t for these manoeuvres.
        ConvergenceError: none was estimated without each of the manoeuvres.
        """
        mean, error = self.excess
        chance = error * scipy.special.stdtrit(max(self.errors.shape[1] - 1, 1), SURE)
        equal = np.flatnonzero(mean <= chance)
        if not len(equal):
            raise ConvergenceError(f"every candidate failed:{self.failures()}")
        order = sorted(equal, key=lambda k: (self.parameters[k], mean[k]))
        return self.names[order[0]]

    def failures(self) -> str:
        """One line a candidate that failed: on what first, on how many more, and why."""
        lines = []
        for name in self.names:
            own = {job: why for job, why in self.reasons.items() if job.startswith(f"{name}, ")}
            if own:
                job, why = next(iter(own.items()))
                more = f" (and {len(own) - 1} more)" if len(own) > 1 else ""
                lines.append(f"\n{job}{more}: {why}")
        return "".join(lines)

    def headline(self) -> str:
        """Which candidate predicts best, and the simplest that is not worse, with what it loses."""
        of = f"{len(self.names)} candidates, {len(self.manoeuvres)} manoeuvres left out in turn"
        if np.isinf(self.excess[0]).all():
            return f"{of}; every candidate failed"
        told = f"{of}; best {self.best}, the simplest that is not worse {self.simplest}"
        best, k = (self.names.index(name) for name in (self.best, self.simplest))
        if k == best:
            return told
        mean, error = self.excess
        likelier = self.aicc[k] - self.aicc[best]
        beside = f", AICc {likelier:+.0f}" if np.isfinite(likelier) else ""
        least = HIDDEN if self.hidden else ""
        return f"{told} ({_above(mean[k], error[k])}{beside}{least})"

    def cells(self) -> Cells:
        """Heading, and one row a candidate: "failed" of one that did on some manoeuvre."""
        each = zip(self.names, self.parameters, *self.excess, self.aicc, strict=True)
        rows = []
        for name, count, mean, error, criterion in each:
            told = "" if np.isnan(criterion) else f"{criterion:.0f}"
            above = "failed" if np.isinf(mean) else _above(mean, error)
            rows.append([name, str(count), above, told])
        return ("candidate", "parameters", "error above the best", "AICc"), rows

    def to_markdown(self) -> str:
        """One row a candidate; then why fits failed."""
        heading, rows = self.cells()
        said = [f"- {job}: {reason}" for job, reason in self.reasons.items()]
        return "\n\n".join(filter(None, [markdown_table(heading, rows), "\n".join(said)]))


def _above(mean: float, error: float) -> str:
    excess, error = percent_above(mean, error)
    return f"{excess:+.0f} % ± {error:.0f} %"


@dataclass(frozen=True, eq=False)
class Without:
    """All records but some."""

    numbers: tuple[int, ...]

    def __call__(self, records: tuple[Record, ...]) -> tuple[Record, ...]:
        """The others."""
        return tuple(each for k, each in enumerate(records) if k not in self.numbers)


def compare_structures(
    candidates: Mapping[str, Model],
    records: Sequence[Record],
    *,
    estimator: Estimator | Mapping[str, Estimator] = OutputError(),
    groups: Sequence[Collection[str]] | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
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
    groups : sequence of collections of str
        Names of the manoeuvres that are left out and predicted together; every one by itself unless
        given, but those without which the others hardly move an input: a `DataWarning` names them.
        Those in no group are never left out.
    fixed, bounds, execution
        As in `compare_bounds`.

    Raises
    ------
    ValueError, ModelError
        Too few records, or groups of them without which the others move an input; other outputs, a
        candidate without an estimator; what the estimator refuses.
    """
    with heard() as known:
        found = compared_quietly(candidates, records, estimator, groups, fixed, bounds, execution)
    tell(found.warnings, "candidate", known)
    return found


def compared_quietly(
    candidates: Mapping[str, Model],
    records: Sequence[Record],
    estimator: Estimator | Mapping[str, Estimator],
    groups: Sequence[Collection[str]] | None,
    fixed: Collection[str],
    bounds: Bounds | None,
    execution: Execution,
) -> StructureComparison:
    """`compare_structures` without a word of what the candidates' fits warned of."""
    flown = stretches(records)
    outputs = _checked(candidates, flown)
    inputs = {name for each in candidates.values() for name in needed(each, fixed, bounds)}
    parts = parts_of(groups, flown, sorted(inputs))
    left = [i for part in parts for i in part]
    ways = estimator if isinstance(estimator, Mapping) else dict.fromkeys(candidates, estimator)
    check_known("no estimator for", candidates, ways)
    biased = {name for each in candidates for name in _biased(ways[each], outputs)}
    noise = np.full((len(candidates), len(flown), len(outputs)), np.nan)
    errors = np.full(noise.shape, np.inf)
    fits: list[AnyFit | None] = []
    reasons: dict[str, str] = {}
    many = {
        name: Fits(model, flown, ways[name], fixed, bounds, execution)
        for name, model in candidates.items()
    }
    jobs = {name: _jobs(each, name, parts) for name, each in many.items()}
    done = run_fits(_in_turn(jobs), [type(model) for model in candidates.values()], execution)
    ends = {name: [done[job.name] for job in each] for name, each in jobs.items()}
    for name, (every, *without) in ends.items():
        fits.append(every.result)
        told = {f"{name}, all": every.reason}
        for part, each in zip(parts, without, strict=True):
            left_out = ", ".join(flown[i].name for i in part)
            told[f"{name}, without {left_out}"] = "" if every.reason else each.reason
        reasons |= {job: reason for job, reason in told.items() if reason}
    for number, part in enumerate(parts, 1):
        shown = {
            k: fit
            for k, each in enumerate(ends.values())
            if (fit := each[number].result) is not None and not each[number].reason
        }
        rows, judged = list(shown), list(shown.values())
        for i in part if shown else ():
            errors[rows, i], noise[rows, i] = _judged(judged, flown[i], outputs, biased)
    return StructureComparison(
        names=tuple(candidates),
        manoeuvres=tuple(flown[i].name for i in left),
        outputs=outputs,
        parameters=tuple(0 if f is None else len(f.free_names) for f in fits),
        errors=errors[:, left],
        noise=_least(noise[:, left]),
        aicc=_criteria([None if e[0].reason else e[0].result for e in ends.values()], flown),
        fits=tuple(fits),
        reasons=reasons,
        warnings=returned({name: every for name, (every, *_) in ends.items()}),
    )


def _criteria(fits: Sequence[AnyFit | None], records: Sequence[Record]) -> Array:
    """AICc of each fit; NaN of all where these have several likelihoods, which do not compare."""
    if len({fit.method for fit in fits if fit is not None}) > 1:
        return np.full(len(fits), np.nan)
    return np.array([np.nan if fit is None else aicc(fit, records) for fit in fits])


def _jobs(many: Fits, name: str, parts: Sequence[tuple[int, ...]]) -> list[Job]:
    """A candidate's fit to all manoeuvres and, from there, those without each group."""
    (case,) = many.cases({name: {}})
    whole = many.job(case, name=f"{name}, all")
    without = [
        many.job(
            case,
            after=[whole],
            alone=False,
            asked=False,
            draw=Without(part),
            name=f"{name}, without {', '.join(str(i + 1) for i in part)}",
        )
        for part in parts
    ]
    return [whole, *without]


def _in_turn(jobs: Mapping[str, Sequence[Job]]) -> list[Job]:
    """Those of all manoeuvres first, which the others wait for."""
    return [job for each in zip(*jobs.values(), strict=True) for job in each]


def _checked(candidates: Mapping[str, Model], records: Sequence[Record]) -> tuple[str, ...]:
    """Outputs that all candidates have; ValueError if there are none, or too few records."""
    if not candidates:
        raise ValueError('no candidates; expected {"name": model, ...}')
    if len(records) < FEWEST:
        raise ValueError(
            f"{len(records)} manoeuvres: each is left out in turn, which needs {FEWEST} or more"
        )
    first = next(iter(candidates.values())).outputs
    for name, model in candidates.items():
        if set(model.outputs) != set(first):
            raise ValueError(
                f"candidate {name!r} predicts {', '.join(model.outputs)}, the first "
                f"{', '.join(first)}: compare structures of the same outputs"
            )
    return first


def _biased(estimator: Estimator, outputs: Sequence[str]) -> Collection[str]:
    """Outputs of which an estimator takes a constant of every record for a bias."""
    biases: bool | Collection[str] = getattr(estimator, "biases", True)
    if isinstance(biases, bool):
        return outputs if biases else ()
    return biases


def _judged(
    fits: Sequence[AnyFit], record: Record, outputs: tuple[str, ...], biased: Collection[str]
) -> tuple[Array, Array]:
    """Root mean square errors (fits, ny) on a record, all in one way, and noise.

    Initial state and biases that follow the record take degrees of freedom of its noise: a
    structure with a state more would be better by that on every record. Outputs that no estimator
    gives a bias have none here: with one, a slow mode is a line for whatever drifts.
    """
    own = record.select(outputs=outputs)
    found = validate({str(k): fit for k, fit in enumerate(fits)}, own, biases=biased)
    errors, noise, scale = [], [], standard_deviations([own])[1]
    nothing: Array = np.zeros(len(outputs))
    for k, fit in enumerate(fits):
        y, taken = found.simulated[str(k)][0], nothing
        seen = np.isfinite(own.y) & (np.arange(own.N) >= found.begins[0])[:, None]
        if np.isinf(found.horizon[0]) and isinstance(fit.model, NonlinearModel):
            taken = which_biased(outputs, biased) + len(fit.model.states) / len(outputs)
        elif np.isinf(found.horizon[0]):
            whole = predict(fit.model.system(), own, scale, PredictionPlan(np.inf), biased)
            y, taken = whole.y, nothing if whole.taken is None else whole.taken
        square = np.sum((own.y - y) ** 2, axis=0, where=seen)
        with np.errstate(invalid="ignore", divide="ignore"):
            errors.append(np.sqrt(square / (seen.sum(axis=0) - taken)))
        noise.append([_white(e[np.isfinite(e)]) for e in (own.y - y).T])  # nor need they share any
    return np.array(errors), np.array(noise)


def _white(e: Array) -> float:
    """Standard deviation of the white noise in residuals (n,); NaN of none.

    White noise of power σ² has lines of median σ² ln 2: lines of a vibration do not count.
    """
    if not len(e):
        return np.nan
    lines = np.abs(np.fft.rfft(e)) ** 2 / len(e)
    return float(np.sqrt(np.median(lines[int(TOP * len(lines)) :]) / np.log(2)))


def _least(noise: Array) -> Array:
    """Noise (ny,) by the median manoeuvre of the candidate that has least; zero if none tells."""
    told = np.where(np.isfinite(noise), noise, np.inf)
    least = np.median(told.min(axis=0), axis=0)
    return np.where(np.isfinite(least), least, 0.0)
