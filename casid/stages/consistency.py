"""The stage that asks whether the channels of the records agree with each other."""

import logging
from collections.abc import Iterable
from typing import Any

from casid.consistency.kinematics import KinematicCheck, kinematic_check
from casid.report.content import Caution, Content, Section, section
from casid.stages.stage import Stage, Task

LOG = logging.getLogger("casid")


def _run(settings: Any, task: Task) -> KinematicCheck:  # noqa: ANN401, ARG001 - it has none
    flights = task.checks.get("identification", task.records)  # velocities may be check channels
    found = kinematic_check(flights, trim={"theta0": float(getattr(task.model, "theta0", 0.0))})
    for remark in found.remarks:
        LOG.warning("The records do not agree with kinematics: %s", remark)
    return found


def _show(found: KinematicCheck, content: Content) -> Iterable[Section]:  # noqa: ARG001
    said = tuple(Caution(f"Kinematics: {remark}.", 25) for remark in found.remarks)
    yield section("kinematics", "Kinematic consistency of the data", 97, found, cautions=said)


KINEMATICS = Stage(
    name="kinematics",
    does="kinematic check of the records",
    run=_run,
    role=("identification",),
    kept=False,
    show=_show,
)
