"""The stage that estimates the frequency response of sweeps."""

from collections.abc import Sequence

from casid.errors import warn
from casid.frequency.distortion import distortion
from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.response import FrequencyResponse
from casid.record import Record
from casid.stages.stage import Stage, Task


def _run(settings: SpectralAnalysis, task: Task) -> FrequencyResponse:
    found = settings.fit(_with(task, settings.reference))
    try:
        told = distortion(task.records, omega=found.omega)
    except ValueError:  # not flown at two amplitudes: nothing to tell
        return found
    if told.nonlinear:
        warn(told.sentence())
    return found


def _with(task: Task, reference: Sequence[str]) -> Sequence[Record]:
    """The records, with references that were read as check channels."""
    if not reference:
        return task.records
    flights = task.checks.get("frequency", ())
    if missing := [name for name in reference if not flights or name not in flights[0].outputs]:
        raise ValueError(
            f"[frequency] reference: {missing[0]!r} is not read; name it in channels.check too"
        )
    names = (*task.records[0].outputs, *reference)
    return [record.select(outputs=names) for record in flights]


FREQUENCY = Stage(
    name="frequency",
    does="measured frequency response",
    run=_run,
    table="frequency",
    settings=SpectralAnalysis(),
    role=("frequency",),
    ahead=True,
)
