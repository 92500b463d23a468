"""What `casid check` says of settings that do nothing, or that no record is long enough for."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from casid.display import listed
from casid.prediction import PAST
from casid.record import Record
from casid.shooting.output_error import OutputError
from casid.stages.judgement import Judgement
from casid.stages.qualification import Bands
from casid.studies.study import Study


def idle(study: Study, flights: Mapping[Any, Sequence[Record]]) -> tuple[str, ...]:
    """What of the study does nothing: noise no record gets, tolerances of no output, figures."""
    said = []
    if study.noise is not None and not any(each.noise for each in study.roles.values()):
        said.append(
            "[noise] is added to no record, and only casid design reads it: write noise = true "
            "in the [records.ROLE] of simulated records that need it."
        )
    tolerances = study.settings.get("qualification", Bands()).tolerances
    if none := [name for name in tolerances if name not in study.channels.outputs]:
        said.append(
            f"[qualification.tolerances] {listed(none)} judge{'s' * (len(none) == 1)} nothing: "
            f"outputs are {', '.join(study.channels.outputs)}."
        )
    return (*said, *_beyond(study, flights))


def _beyond(study: Study, flights: Mapping[Any, Sequence[Record]]) -> tuple[str, ...]:
    """That no record is as long as intervals of it, which is no fault."""
    flown = flights.get("refinement", flights["identification"])
    interval = study.settings.get("output_error", OutputError()).interval
    longest = max(record.duration for record in flown)
    if interval is None or interval <= longest:
        return ()
    return (
        f"[output_error] interval = {interval:g} s is longer than any record ({longest:g} s at "
        "most): each is simulated as a whole from its beginning, which a poor guess and modes that "
        "grow do not stand; leave it out to have it chosen.",
    )


def unpredicted(study: Study, flown: Sequence[Record]) -> tuple[str, ...]:
    """That a horizon leaves no prediction in a validation record, which ends a study late."""
    horizon = study.settings.get("validation", Judgement()).horizon
    if horizon is None or np.isinf(horizon):
        return ()
    return tuple(
        f"[validation] horizon = {horizon:g} s, expected {each.dt:.3g} s to less than "
        f"{each.duration / PAST:.3g} s for record {each.name!r}, a third of it, as predictions "
        "start from a past of three horizons: write one between, or leave it out."
        for each in flown
        if not each.dt <= horizon * (1 + 1e-9) or round(PAST * horizon / each.dt) >= each.N - 1
    )
