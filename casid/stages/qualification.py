"""The stage that judges the delivered model by a simulator's qualification test."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from casid import report
from casid.display import listed
from casid.qualification import (
    EVEN,
    TOLERANCES,
    Qualification,
    check_tolerances,
    qualify,
    read_tolerance,
)
from casid.report.content import Caution, Content, Section, delivered, section
from casid.report.evidence import noise_levels, residual_levels
from casid.report.words import fitted
from casid.stages.stage import Stage, Task


@dataclass(frozen=True, eq=False, kw_only=True)
class Bands:
    """What the table [qualification] holds.

    Parameters
    ----------
    tolerances : mapping
        Output and band in words, ``{p = "10 % or 3 deg/s"}``; those of the usual test unless given.
    source : str
        Where they come from, for the report.
    """

    tolerances: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        for output, text in self.tolerances.items():
            read_tolerance(output, text)


def _run(settings: Bands, task: Task) -> Qualification:
    judged = task.results["validation"]
    usual = settings.tolerances or TOLERANCES
    found = qualify(judged, delivered(judged.models), usual, _noise(task))
    return replace(found, source=settings.source) if settings.source else found


def _noise(task: Task) -> dict[str, float]:
    """Standard deviations of the outputs' noise, no more than the fit left of its own records."""
    judged, fit = task.results["validation"], task.results["output_error"]
    fast = dict(zip(judged.outputs, noise_levels(judged.measured).tolist(), strict=True))
    return {
        name: min(fast[name], left)
        for name, left in residual_levels(fit).items()
        if np.isfinite([left, fast.get(name, np.nan)]).all()
    }


def _check(settings: Bands, task: Task) -> None:
    check_tolerances(settings.tolerances, type(task.model).outputs)


def _show(found: Qualification, content: Content) -> Iterable[Section]:
    failed, none = found.named(found.largest > 1), found.named(np.isnan(found.largest))
    said = [Caution(f"Out of the tolerance band: {', '.join(failed)}.", 15)] if failed else []
    if noisy := found.named(found.chance < EVEN):
        said.append(Caution(f"Noise alone may leave the tolerance band: {', '.join(noisy)}.", 16))
    if excused := found.named(found.excused):
        said.append(
            Caution(
                "Passed the tolerance bands only with a fitted constant larger than the "
                f"tolerance, which no figure counts: {', '.join(excused)}.",
                15,
            )
        )
    if found.still:
        named = listed(found.still)
        said.append(
            Caution(
                f"The measurement never leaves the tolerance band around trim in {named}: "
                "passing there says nothing about the model.",
                16,
            )
        )
    if none:
        said.append(Caution(f"Not judged by the tolerance bands: {', '.join(none)}.", 15))
    draw = partial(report.drawings.draw_qualification, found, content.units)
    values = {"fitted": fitted(found.validation.outputs, found.validation.unbiased)}
    more: Any = {"values": values, "draw": draw, "cautions": tuple(said)}
    yield section("qualification", "Qualification", 75, found, **more)


QUALIFICATION = Stage(
    name="qualification",
    does="tolerance bands of a simulator's qualification test",
    run=_run,
    table="qualification",
    settings=Bands(),
    needs=("validation", "output_error"),
    optional=True,
    kept=False,
    check=_check,
    show=_show,
)
