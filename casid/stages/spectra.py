"""The stage that estimates the frequency response of sweeps."""

from casid.errors import warn
from casid.frequency.distortion import distortion
from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.response import FrequencyResponse
from casid.stages.stage import Stage, Task


def _run(settings: SpectralAnalysis, task: Task) -> FrequencyResponse:
    found = settings.fit(task.records)
    try:
        told = distortion(task.records, omega=found.omega)
    except ValueError:  # not flown at two amplitudes: nothing to tell
        return found
    if told.nonlinear:
        warn(told.sentence())
    return found


FREQUENCY = Stage(
    name="frequency",
    does="measured frequency response",
    run=_run,
    table="frequency",
    settings=SpectralAnalysis(),
    given=("reference",),  # records of a study have the structure's channels only
    role=("frequency",),
)
