"""What a report begins with: is it good, where not, why, and what not to believe."""

from collections.abc import Mapping, Sequence
from itertools import combinations

from casid.bounds.robust import scattered
from casid.display import counted, listed
from casid.fit import AnyFit
from casid.report.content import BLACK_BOX, Content
from casid.report.evidence import WORSE, comparable, significant_differences
from casid.report.verdicts import GOOD, UNJUDGED, Verdict
from casid.validation import Validation

WORST = 3  # outputs named
NAMED = 6  # parameters named of a kind
SHARE = 0.5  # Theil's coefficient at the right end of the picture


def theil_place(theil: float) -> float:
    """Where a Theil coefficient stands in the picture, in percent of its width."""
    return 100 * min(theil / SHARE, 1.0)


def ranked(judged: Sequence[Verdict]) -> list[Verdict]:
    """Verdicts, the worst first; those not judged at the end."""
    return sorted(judged, key=lambda v: -v.theil if v.theil == v.theil else 1.0)


FAULTS = {
    False: "The structure is at fault: ",
    True: "The estimate is at fault, for the structure could follow the black box: ",
    None: "Structure or estimate is at fault: ",
}


def predictions_told(
    judged: Sequence[Verdict], validation: Validation, *, enough: bool | None = None
) -> str:
    """Whether the model predicts unseen records, where it does not, and why.

    ``enough`` says whether the structure is known to be enough.
    """
    if not judged:
        return ""
    words = [v.word for v in judged]
    kinds = (each for each in ("good", "fair", "poor", UNJUDGED) if each in words)
    count = ", ".join(f"{kind} on {words.count(kind)}" for kind in kinds)
    how = "predicted" if validation.predicted else "simulated in free run"
    said = [
        f"Of {counted(len(judged), 'output')} of the validation records, {how}, the model is "
        f"{count}."
    ]
    if worst := [v for v in ranked(judged) if v.theil > GOOD and v.word != UNJUDGED][:WORST]:
        named = ", ".join(f"{v.output} {v.theil:.2f}" for v in worst)
        said.append(f"It does worst on {named} (Theil's coefficient).")
    if lacking := [v for v in judged if v.structural]:
        order = sorted(lacking, key=lambda v: -v.advantage)
        times = listed([f"{v.output} {v.times}" for v in order], NAMED)
        said.append(f"{FAULTS[enough]}the black box of the same records predicts {times} better.")
    elif worst and BLACK_BOX in validation.models:
        known = [v.output for v in judged if v.advantage > WORSE]
        but = f" but {listed(known, NAMED)}, whose controller it knows" if known else ""
        said.append(f"The black box of the same records is not twice as good on any{but}.")
    return " ".join(said)


def doubted(content: Content, fit: AnyFit) -> Mapping[str, tuple[str, ...]]:
    """Why not to believe a parameter's value, by its name: all reasons, keys of ``WORDS``."""
    pairs = combinations(content.fits.values(), 2)
    differing = {name for one, other in pairs for name in significant_differences(one, other)}
    reasons, scatter = {}, scattered(fit)
    for row in fit.parameters:
        unsure = not row.fixed and row.std_error > abs(row.value)
        there = {
            "held": row.active,
            "unsure": unsure,
            "apart": row.name in differing,
            "scattered": row.name in scatter,
        }
        reasons[row.name] = tuple(reason for reason in WORDS if there[reason])
    return {name: found for name, found in reasons.items() if found}


def not_believed(content: Content, fit: AnyFit) -> str:
    """Which parameters not to believe, in a sentence."""
    reasons = doubted(content, fit)
    if not reasons:
        told = any(comparable(*pair) for pair in combinations(content.fits.values(), 2))
        agreed = ", and no other estimate disagrees" if told else ""
        return f"No parameter is on a bound or of unknown sign{agreed}."
    parts = []
    for kind, words in WORDS.items():
        if names := [name for name, found in reasons.items() if kind in found]:
            parts.append(f"{len(names)} {words} ({listed(names, NAMED)})")
    count = len(fit.free_names) or len(fit.parameters)
    said = f"Do not believe {len(reasons)} of {counted(count, 'parameter')}: {'; '.join(parts)}."
    if any("held" in found for found in reasons.values()):
        said += " Errors of all other parameters and of modes assume that these bounds are right."
    return said


WORDS = {
    "held": "held by a bound",
    "unsure": "of unknown sign",
    "apart": "on which the estimates differ by more than their errors allow",
    "scattered": "whose estimates scatter from record to record by more than their errors allow",
}
