"""The stage that identifies a black box from records."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from casid import report
from casid.display import counted
from casid.excitations import Excitation
from casid.report.content import Caution, Content, Section, section
from casid.stages.stage import Stage, Task
from casid.subspace.pbsid import BlackBox, Pbsid


def _run(settings: Pbsid, task: Task) -> BlackBox:
    return settings.fit(task.records)


def _show(found: BlackBox, content: Content) -> Iterable[Section]:  # noqa: ARG001
    order, names = len(found.system.A), ", ".join(found.records)
    told = (
        f"A black box of order {order} was identified from {counted(len(found.records), 'record')}"
    )
    said = tuple(Caution(text, 30) for text in found.doubts())
    draw = partial(report.drawings.draw_singular_values, found)
    more: Any = {"draw": draw, "lead": f"{told} ({names}).", "cautions": said}
    yield section("black_box", "Black box", 95, found, **more)
    if found.excitation is not None:
        yield _excitation(found.excitation)


def _excitation(found: Excitation) -> Section:
    """Share of every input that comes from outside: in numbers, and over frequency."""
    rows: list[dict[str, Any]] = []
    for i, name in enumerate(found.inputs):
        omega, lower, upper = (
            x[found.within[:, i]] for x in (found.omega, found.lower[:, i], found.upper[:, i])
        )
        if len(omega):
            share, most, k = float(np.median(lower)), float(np.median(upper)), int(lower.argmin())
            row = {"name": name, "low": omega[0], "high": omega[-1], "share": share, "most": most}
            rows.append({**row, "least": lower[k], "at": omega[k]})
    more: Any = {"values": {"rows": rows}, "draw": partial(report.drawings.draw_excitation, found)}
    return section("excitation", "Aircraft or controller", 96, found, **more)


BLACK_BOX = Stage(
    name="pbsid",
    does="black box",
    run=_run,
    table="pbsid",
    settings=Pbsid(),
    linear=True,
    role=("identification",),
    label="black box",
    show=_show,
)
