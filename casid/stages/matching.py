"""The stages that match the structure to the black box: quadratic norm, then H-infinity norm."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

from casid import report
from casid.declaration import check_priors
from casid.fit import Fit
from casid.free import free_parameters
from casid.matching.appraisal import MatchNotes
from casid.matching.match import Match
from casid.matching.targets import Target
from casid.report.content import MATCH, Content, Section, section
from casid.report.words import number
from casid.stages.stage import Stage, Task
from casid.tables import placed

SOURCES = {"black box": "pbsid", "frequency response": "frequency"}  # stages by name of target


MEANING = {  # of the certified number
    "reachable": ", which says by how many times the misfit at its worst exceeds what the "
    "structure typically misses of a pair there",
    "relative": ", which says what share of an output's response is missed at worst",
    "size": ", which says what share of an output's standard deviation is missed at worst",
    "given": ", in the units of the weights given",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Matching(Match):
    """A match, and what it is to.

    Parameters
    ----------
    targets : tuple of str
        "black box", and perhaps "frequency response".
    """

    targets: tuple[Literal["black box", "frequency response"], ...] = ("black box",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if "black box" not in self.targets or not set(self.targets) <= set(SOURCES):
            known = " and perhaps ".join(map(repr, SOURCES))
            raise ValueError(f"targets = {list(self.targets)}, expected {known}")


def targets(settings: Matching, task: Task) -> list[Target]:
    """What the structure is matched to."""
    return [task.results[SOURCES[name]] for name in settings.targets]


def _check(settings: Matching, task: Task) -> None:
    if len(settings.targets) > 1 and not task.roles.get("frequency"):
        raise ValueError(
            "[match] targets: 'frequency response' needs records: write [records.frequency]"
        )
    with placed("[match]"):
        free_parameters(task.model, **task.held, priors=settings.priors)
        check_priors(task.model, settings.priors, **task.held)


def _quadratic(settings: Matching, task: Task) -> Fit[Any, MatchNotes]:
    estimator = replace(settings, norm="quadratic")
    return estimator.fit(task.model, targets(settings, task), **task.held)


def _hinf(settings: Matching, task: Task) -> Fit[Any, MatchNotes]:
    estimator, start = replace(settings, norm="hinf"), task.results["quadratic"].model
    return estimator.fit(start, targets(settings, task), **task.held)


def _show(found: Fit[Any, MatchNotes], content: Content) -> Iterable[Section]:  # noqa: ARG001
    certificate, band = found.certificate, ""
    if certificate is not None:
        low, high = (number(edge, 3) for edge in certificate.band)
        band = f" between {low} and {high} rad/s"
    draw = partial(report.drawings.draw_match_error, found)
    lead = f"The structure was matched to it in the H∞ norm{band}{MEANING[found.notes.weight]}."
    title = "Match and certificate"
    yield section("certificate", title, 90, found, draw=draw, lead=lead)


QUADRATIC = Stage(
    name="quadratic",
    does="quadratic match",
    run=_quadratic,
    table="match",
    settings=Matching(),
    given=("norm",),
    needs=("pbsid",),
    uses=("frequency",),
    linear=True,
    structured=True,
    check=_check,
)
HINF = Stage(
    name="hinf",
    does="H-infinity match",
    run=_hinf,
    table="match",
    settings=Matching(),
    given=("norm",),
    needs=("pbsid", "quadratic"),
    uses=("frequency",),
    linear=True,
    structured=True,
    label=MATCH,
    start="quadratic",
    data=targets,
    show=_show,
)
