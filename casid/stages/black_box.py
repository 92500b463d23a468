"""The stage that identifies a black box from records."""

from collections.abc import Iterable
from functools import partial

from casid.report.content import Caution, Content, Section, template
from casid.report.drawings import draw_singular_values
from casid.stages.stage import Stage, Task
from casid.subspace.pbsid import BlackBox, Pbsid


def _run(settings: Pbsid, task: Task) -> BlackBox:
    return settings.fit(task.records)


def _show(found: BlackBox, content: Content) -> Iterable[Section]:  # noqa: ARG001
    order, names = len(found.system.A), ", ".join(found.records)
    yield Section(
        name="black_box",
        title="Black box",
        place=95,
        template=template("black_box"),
        values={"found": found},
        draw=partial(draw_singular_values, found),
        lead=f"A black box of order {order} was identified from {len(found.records)} records "
        f"({names}).",
        cautions=tuple(Caution(text, 30) for text in found.doubts()),
    )


BLACK_BOX = Stage(
    name="pbsid", does="black box", run=_run, table="pbsid", settings=Pbsid(),
    role=("identification",), label="black box", show=_show,
)  # fmt: skip
