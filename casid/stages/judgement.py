"""The stage that judges all models on unseen records."""

from collections.abc import Iterable
from functools import partial
from typing import Any

from casid.eigenmodes import modes
from casid.report import drawings
from casid.report.content import Caution, Content, Section, template
from casid.report.evidence import differences, disagreement
from casid.report.verdicts import verdicts
from casid.stages.stage import Stage, Task
from casid.validation import Validation, validate


def _run(settings: Any, task: Task) -> Validation:  # noqa: ANN401, ARG001 - it has none
    return validate(task.models, task.records)


def _show(found: Validation, content: Content) -> Iterable[Section]:
    judged = verdicts(found, content)
    poor = [each for each in judged if each.word in ("poor", "not judged")]
    names = ", ".join(found.records)
    new = "estimations had seen" if content.repeats.seen else "no estimation had seen"
    said = [Caution(each, 3) for each in content.repeats.told()]
    said += [*disagreement(found), *differences(content)]
    said += [Caution(each.caution, 20) for each in poor]
    if found.predicted:
        said.append(Caution(f"Validation records: {found.predicted}", 21))
    yield Section(
        name="verdicts",
        title="Verdicts",
        place=5,
        template=template("verdicts"),
        values={"found": found, "verdicts": judged},
        lead=f"It was judged on records that {new} ({names}).",
        cautions=tuple(said),
    )
    yield from _compared(found, content)


def _compared(found: Validation, content: Content) -> Iterable[Section]:
    """All models side by side: modes, responses, time histories, errors, residuals."""
    yield Section(
        name="modes",
        title="Modes",
        place=40,
        template=template("modes"),
        values={"modes": {name: modes(fit.model.system()) for name, fit in content.fits.items()}},
        draw=partial(drawings.draw_poles, content),
    )
    yield Section(
        name="responses",
        title="Frequency responses",
        place=50,
        template=template("responses"),
        draw=partial(drawings.draw_responses, content),
    )
    yield Section(
        name="histories",
        title="Time histories of the validation records",
        place=60,
        template="{{ figures() }}",
        draw=partial(drawings.draw_histories, found, content.units),
    )
    for name, title, place, draw in (
        ("rms", "RMS errors", 70, drawings.draw_rms),
        ("whiteness", "Residuals", 80, drawings.draw_whiteness),
    ):
        yield Section(
            name=name,
            title=title,
            place=place,
            template=template(name),
            values={"found": found},
            draw=partial(draw, found),
        )


VALIDATION = Stage(
    name="validation",
    does="validation on unseen records",
    run=_run,
    role=("validation",),
    kept=False,
    show=_show,
)
