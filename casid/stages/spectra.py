"""The stage that estimates the frequency response of sweeps."""

from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.response import FrequencyResponse
from casid.stages.stage import Stage, Task


def _run(settings: SpectralAnalysis, task: Task) -> FrequencyResponse:
    return settings.fit(task.records)


FREQUENCY = Stage(
    name="frequency",
    does="measured frequency response",
    run=_run,
    table="frequency",
    settings=SpectralAnalysis(),
    given=("reference",),  # records of a study have the structure's channels only
    role=("frequency",),
)
