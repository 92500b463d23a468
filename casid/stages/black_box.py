"""The stage that identifies a black box from records."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from casid import report
from casid.channels import FORCES
from casid.display import counted
from casid.errors import warn
from casid.excitations import Excitation, excitation_if_any
from casid.nonlinear.model import NonlinearModel
from casid.report.content import Caution, Content, Section, section
from casid.report.tables import shares
from casid.stages.stage import Stage, Task
from casid.subspace.columns import feedthrough_mask
from casid.subspace.pbsid import BlackBox, Pbsid
from casid.tables import placed


def _run(settings: Pbsid, task: Task) -> BlackBox:
    found = _fitted(settings, task)
    if found.system.dt is None or settings.transform is not None:
        return found
    # A structure is compared with the continuous equivalent, which a black box of samples, chosen
    # because it predicts these better, need not have.
    try:
        found.continuous()
    except ValueError as error:
        warn(
            f"the black box of samples predicts these records best, but {error}; that of Laguerre "
            'projections is taken ([pbsid] transform = "laguerre" says so from the start)'
        )
        return _fitted(replace(settings, transform="laguerre"), task)
    return found


def _fitted(settings: Pbsid, task: Task) -> BlackBox:
    """The black box, its excitation judged with the direct terms that the structure has."""
    found = settings.fit(task.records)
    if isinstance(task.model, NonlinearModel) or not found.feedthrough.all():
        return found
    rows = np.unique(task.model.matrices().sparsity_out(3).row()).astype(int)  # those of D
    direct = {*FORCES, *np.array(task.model.outputs)[rows].tolist()}
    if direct <= {*FORCES}:
        return found
    return replace(found, excitation=excitation_if_any(task.records, direct))


def _check(settings: Pbsid, task: Task) -> None:
    with placed("[pbsid]"):
        feedthrough_mask(settings.feedthrough, task.model.inputs, task.model.outputs)


def _show(found: BlackBox, content: Content) -> Iterable[Section]:  # noqa: ARG001
    order, names = len(found.system.A), ", ".join(found.records)
    told = (
        f"A black box of order {order} was identified from {counted(len(found.records), 'record')}"
    )
    ranks = dict.fromkeys(found.remarks, 6)  # records disagree, or stand still
    ranks |= dict.fromkeys(found.unsupported(), 5)
    said = tuple(Caution(text, ranks.get(text, 30)) for text in found.doubts())
    draw = partial(report.drawings.draw_singular_values, found)
    more: Any = {"draw": draw, "lead": f"{told} ({names}).", "cautions": said}
    yield section("black_box", "Black box", 95, found, **more)
    if found.excitation is not None:
        yield _excitation(found.excitation)


def _excitation(found: Excitation) -> Section:
    """Share of every input that comes from outside: in numbers, and over frequency."""
    draw = partial(report.drawings.draw_excitation, found)
    more: Any = {"values": {"rows": shares(found)}, "draw": draw}
    return section("excitation", "Aircraft or controller", 96, found, **more)


BLACK_BOX = Stage(
    name="pbsid",
    does="black box",
    run=_run,
    table="pbsid",
    settings=Pbsid(),
    linear=True,
    role=("identification",),
    ahead=True,
    label="black box",
    check=_check,
    show=_show,
)
