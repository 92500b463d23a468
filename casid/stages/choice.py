"""The stages that choose the chain's last step by predicting manoeuvres left out.

None is best everywhere: what remains is the structure's error, and each step weighs it otherwise.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import numpy as np

from casid.arrays import Array
from casid.bounds.manoeuvres import FEWEST, HIDDEN, StructureComparison, compared_quietly
from casid.bounds.replaceable import FEWEST as FEWEST_GROUPS
from casid.bounds.replaceable import needed, told_unmoved, unmoved
from casid.checks import checked_fields
from casid.display import percent_above
from casid.errors import ConvergenceError, warn
from casid.fit import AnyFit, Fit
from casid.frequency.estimation import SpectralAnalysis
from casid.interpolation_error import lost_between
from casid.matching.match import Match
from casid.model import Bounds, M
from casid.record import Record
from casid.records import several
from casid.report.content import CHOSEN as LABEL
from casid.report.content import Caution, Content, Section, section
from casid.shooting.output_error import OutputError
from casid.stages.stage import Stage, Task
from casid.subspace.pbsid import Pbsid
from casid.values import seal, storable

TIE = 1.0  # standard errors by which a candidate exceeds another's errors, or is its equal
MOST = 4  # groups of manoeuvres: each is one fit more of every candidate

StepName = Literal["joint", "frequency", "time", "short", "quadratic"]
WORDS: Mapping[StepName, str] = {
    "joint": "joint: short manoeuvres in time, the others as responses",
    "frequency": "output error in the frequency domain, all manoeuvres",
    "time": "output error in the time domain, all manoeuvres",
    "short": "output error in the time domain, short manoeuvres",
    "quadratic": "quadratic match",
}

NEEDS: Mapping[StepName, str] = {
    "joint": "records of frequency that are of identification and not of refinement",
    "short": "records of refinement that are some of those of identification",
}


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class LastStep:
    """An estimator, and what of the manoeuvres it takes in which form.

    Those that do not enter as time histories become a frequency response in the same likelihood, if
    ``responses`` says how, or do not enter.
    """

    estimator: OutputError | Match  # a match is to a black box of all manoeuvres
    histories: Collection[str] | None = None  # names of time histories; all unless given
    responses: SpectralAnalysis | None = None
    decimate: int = 1  # every how many samples of a time history are taken
    black_box: Pbsid = field(default_factory=Pbsid)  # how a match's black box is identified

    def fit(
        self,
        model: M,
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, Any]:
        """The estimate from these manoeuvres, or what is there of them."""
        records, held = several(data), cast("Any", {"fixed": fixed, "bounds": bounds})
        if isinstance(self.estimator, Match):
            box = self.black_box.fit(records)
            return _within(self.estimator, *box.band).fit(model, box, **held)
        own = [each for each in records if self.histories is None or each.name in self.histories]
        others = [each for each in records if each not in own]
        estimator = self.estimator
        if self.responses is not None and others:
            measured = (*estimator.responses, self.responses.fit(others))
            estimator = replace(estimator, responses=measured)
        return estimator.fit(
            model, [each.decimate(self.decimate) for each in own], **held, near=near
        )


def _within(estimator: Match, low: float, high: float) -> Match:
    """The match at those of its frequencies that a black box of fewer manoeuvres still knows."""
    if estimator.omega is None or not isinstance(estimator.weight, str):
        return estimator
    omega = np.asarray(estimator.omega)
    return replace(estimator, omega=omega[(low <= omega) & (omega <= high)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Choosing:
    """How the last step is chosen.

    Parameters
    ----------
    candidates : tuple of str
        What is tried; of all of them, what the records allow.
    """

    candidates: tuple[StepName, ...] = tuple(WORDS)

    def __post_init__(self) -> None:
        if not self.candidates or not set(self.candidates) <= set(WORDS):
            raise ValueError(
                f"candidates = {list(self.candidates)}, expected of {', '.join(WORDS)}"
            )


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class StepChoice:
    """Which last step predicts manoeuvres left out best.

    Parameters
    ----------
    names, manoeuvres : tuple of str
        Candidates, and what each predicted without having seen it.
    excess, error : (candidates,) array
        By how much the logarithm of the prediction error exceeds the chosen one's, mean over
        outputs, and its standard error; infinite for a candidate that failed.
    chosen : str
        The first of those that are equal to the best within a standard error.
    fit : Fit
        Its estimate from all manoeuvres.
    reasons : mapping
        Why fits failed, by candidate and manoeuvre.
    hidden : bool
        Whether errors are so far below the noise that candidates differ by more than ``excess``.
    """

    names: tuple[str, ...]
    manoeuvres: tuple[str, ...]
    excess: Array
    error: Array
    chosen: str
    fit: AnyFit
    reasons: Mapping[str, str]
    hidden: bool = False

    def __post_init__(self) -> None:
        seal(self)

    def headline(self) -> str:
        """What was chosen, and by how much."""
        others = [
            f"{name} {_beyond(more, error)}"
            for name, more, error in zip(self.names, self.excess, self.error, strict=True)
            if name != self.chosen
        ]
        return (
            f"Last step: {self.chosen}, chosen by errors of predicting "
            f"{', '.join(self.manoeuvres)}, each without itself; errors of the others, relative "
            f"to its own: {', '.join(others) or 'no other was tried'}"
            f"{HIDDEN if self.hidden and others else ''}"
        )


def _beyond(excess: float, error: float) -> str:
    """By how much a candidate's errors exceed the chosen one's, in words if that is not known."""
    if not np.isfinite(excess):
        return "failed"
    more, scatter = percent_above(excess, error)
    digits = 0 if error >= 0.01 else 1
    said = f"{more:+.{digits}f} ± {scatter:.{digits}f} %"
    return said if abs(excess) > TIE * error else f"equal within errors ({said})"


def last_steps(settings: Choosing, task: Task) -> dict[str, LastStep]:
    """The candidates that the records allow."""
    table = task.settings.get
    _, short = _records(task)
    own: OutputError = table("output_error", OutputError())
    lined = OutputError(priors=own.priors, responses=own.responses, domain="frequency")
    match: Match = table("match", Match())
    found: dict[str, LastStep] = {}
    step, names = _decimation(task), possible(task)
    if "joint" in names:
        analysis = table("frequency", SpectralAnalysis())
        found["joint"] = LastStep(estimator=own, histories=short, responses=analysis, decimate=step)
    found["frequency"] = LastStep(estimator=lined, decimate=step)
    found["time"] = LastStep(estimator=own, decimate=step)
    if "short" in names:
        found["short"] = LastStep(estimator=own, histories=short, decimate=step)
    quadratic = replace(match, norm="quadratic")
    box: Pbsid = table("pbsid", Pbsid())
    if "pbsid" in task.results:  # whose order and windows those of fewer manoeuvres share
        box = box.like(task.results["pbsid"])
    found["quadratic"] = LastStep(estimator=quadratic, black_box=box)
    return {name: found[name] for name in settings.candidates if name in found}


def possible(task: Task) -> list[StepName]:
    """Names of the candidates that the records, or their files, allow."""
    records, short = _records(task)
    sweeps = {each.name for each in task.roles.get("frequency", ())} - set(short)
    joint = bool(sweeps & {each.name for each in records})
    lacking = {"joint": not joint, "short": len(short) == len(records)}
    return [name for name in WORDS if not lacking.get(name)]


def _check(settings: Choosing, task: Task) -> None:
    if (count := len(task.roles.get("identification", ()))) < FEWEST:
        raise ValueError(
            f"[choice]: each manoeuvre is left out in turn, which takes {FEWEST} records of "
            f"identification or more, here are {count}; add some, or leave the table out"
        )
    allowed = possible(task)
    if settings.candidates != Choosing().candidates:  # which are all that there may be
        for name in settings.candidates:
            if name not in allowed:
                raise ValueError(
                    f"[choice] candidates: {name!r} takes {NEEDS[name]}, which these roles do not "
                    f"have; there are {', '.join(allowed)}"
                )


def _records(task: Task) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Manoeuvres of the identification, and the names of those that are short: of refinement."""
    records = tuple(task.roles["identification"])
    wanted = {each.name for each in task.roles.get("refinement", ())}
    short = tuple(each.name for each in records if each.name in wanted)
    return records, short or tuple(each.name for each in records)


def _decimation(task: Task) -> int:
    """Of the identification's records, to the rate of the refinement; 1 if inputs lose by it."""
    fine, coarse = (
        min((each.dt for each in task.roles.get(role, ())), default=np.inf)
        for role in ("identification", "refinement")
    )
    step = max(1, round(coarse / fine)) if np.isfinite(coarse) else 1
    records = task.roles.get("identification", ())
    loses = any(lost_between(each.take(slice(None, None, step)), each) for each in records)
    return 1 if loses else step


def _examine(settings: Choosing, task: Task) -> None:  # noqa: ARG001 - of any settings
    """Refuse what leaves too little to leave out: manoeuvres that alone move an input."""
    (records, short), inputs = _records(task), needed(task.model, **task.held)
    if len(groups(short, records, inputs)) >= FEWEST_GROUPS:
        return
    told = told_unmoved(records, inputs)
    raise ValueError(
        f"[choice] leaves manoeuvres out in turn, at least {FEWEST_GROUPS} of those of refinement "
        f"that are of identification ({', '.join(short)}): {told or 'there are fewer'}; fly each "
        "axis twice, or drop [choice]"
    )


def groups(
    names: tuple[str, ...], records: Sequence[Record] = (), inputs: Sequence[str] = ()
) -> list[tuple[str, ...]]:
    """Names dealt out to at most four groups, without each of which the records move all inputs.

    Those that nothing replaces are in none.
    """
    dealt: list[tuple[str, ...]] = [()] * min(MOST, len(names))
    for name in names:
        for k in sorted(range(len(dealt)), key=lambda k: len(dealt[k])):
            if not unmoved(records, (*dealt[k], name), inputs):
                dealt[k] += (name,)
                break
    return [each for each in dealt if each]


def compared(settings: Choosing, task: Task) -> StructureComparison:
    """The candidates' predictions of short manoeuvres left out, and their estimates from all."""
    (records, short), steps = _records(task), last_steps(settings, task)
    start = task.results["quadratic"].model
    inputs = needed(task.model, **task.held)
    parts = groups(short, records, inputs)
    if sum(map(len, parts)) < len(short):
        warn(
            f"[choice]: {told_unmoved(records, inputs)}; manoeuvres that nothing "
            "replaces are not left out, and no candidate is judged by them; fly each axis twice"
        )
    return compared_quietly(
        dict.fromkeys(steps, start),
        records,
        estimator=steps,
        groups=parts,
        fixed=tuple(task.fixed),
        bounds=task.bounds,
        execution=task.execution,
    )


def _run(settings: Choosing, task: Task) -> StepChoice:
    compared_all = compared(settings, task)
    found = chosen(compared_all)
    for said in compared_all.warnings.get(found.chosen, ()):  # others are no concern of the user's
        warn(said)
    return found


def chosen(found: StructureComparison) -> StepChoice:
    """The choice that a comparison leads to.

    The candidates stand in the order of what they take from the manoeuvres: of equals, the first.
    """
    above, error = found.excess
    if not np.isfinite(above).any():
        raise ConvergenceError(f"no last step could be estimated:{found.failures()}")
    k = int(np.argmax(above <= TIE * error))
    excess, error = found.over(found.names[k])
    return StepChoice(
        names=found.names,
        manoeuvres=found.manoeuvres,
        excess=excess,
        error=error,
        chosen=found.names[k],
        fit=cast("AnyFit", found.fits[k]),
        reasons=found.reasons,
        hidden=found.hidden,
    )


def _show(found: StepChoice, content: Content) -> Iterable[Section]:  # noqa: ARG001
    said = [Caution(f"Last step {name} failed: {why}", 45) for name, why in found.reasons.items()]
    lead = f"Of {len(found.names)} last steps {found.chosen} was chosen."
    above = {
        name: percent_above(float(excess), float(error))
        for name, excess, error in zip(found.names, found.excess, found.error, strict=True)
    }
    more: Any = {"values": {"words": WORDS, "above": above}, "lead": lead, "cautions": tuple(said)}
    yield section("choice", "Choice of the last step", 12, found, **more)


def _chosen(_: object, task: Task) -> Fit[Any, Any]:
    fit: Fit[Any, Any] = task.results["choice"].fit
    return fit


CHOICE = Stage(
    name="choice",
    does="choice of the last step",
    run=_run,
    table="choice",
    settings=Choosing(),
    role=("identification",),
    needs=("quadratic",),
    uses=("frequency", "output_error"),
    linear=True,
    structured=True,
    optional=True,
    check=_check,
    examine=_examine,
    show=_show,
)
CHOSEN = Stage(
    name="chosen", does="chosen step", run=_chosen, needs=("choice",), kept=False, label=LABEL
)
