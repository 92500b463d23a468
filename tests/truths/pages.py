"""What the stages of a study show, and the same with other results."""

import dataclasses

from matplotlib import rc_context

from casid.report import html
from casid.report.look import LOOK
from casid.stages.listing import STAGES, sections


def shown(content):
    """The sections of what the stages found."""
    return sections(STAGES, content.results, content)


def draw(content):
    """All figures."""
    with rc_context(LOOK):
        yield from (drawing for section in shown(content) for drawing in section.draw())


def cautions(content):
    return html.cautions(content, shown(content))


def changed(content, **results):
    """Content with other results of some stages."""
    labels = {stage.label: stage.name for stage in STAGES if stage.label}
    found = dict(content.results) | results
    models = {label: found[labels[label]] for label in content.models}
    return dataclasses.replace(content, results=found, models=models)
