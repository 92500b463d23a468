"""The whole method in one call; its stages and sources are those of `casid.stages.chain`."""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from time import perf_counter
from typing import Any, Generic, cast

from casid.consistency.kinematics import KinematicCheck
from casid.consistency.reused_flights import repeats
from casid.display import Cells, Shown, Tabled, counted
from casid.errors import DataWarning
from casid.fit import Fit, M_co
from casid.frequency.response import FrequencyResponse
from casid.matching.appraisal import MatchNotes
from casid.model import Bounds, M
from casid.nlp import Progress
from casid.record import Record
from casid.records import several
from casid.report.content import Timing
from casid.shooting.precision import OutputErrorNotes
from casid.slow_sources import repeats_known, tell_repeats
from casid.stages.choice import StepChoice
from casid.stages.listing import STAGES
from casid.stages.stage import (
    Keep,
    Role,
    Stage,
    Task,
    check_task,
    compute,
    examine_task,
    fitting,
    run_stages,
    watched,
)
from casid.subspace.pbsid import BlackBox
from casid.threads import one_thread
from casid.validation import Validation


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Identification(Tabled, Generic[M_co]):
    """What each stage found.

    Parameters
    ----------
    results : mapping
        By name of the stage, in their order; those of the usual stages are attributes too.
    """

    results: Mapping[str, Any]

    def headline(self) -> str:
        """The last of its fits."""
        fits = [each for each in self.results.values() if isinstance(each, Fit)]
        return fits[-1].headline() if fits else counted(len(self.results), "stage")

    def cells(self) -> Cells:
        """Heading, and one row a stage."""
        shown = {name: each for name, each in self.results.items() if isinstance(each, Shown)}
        return ("stage", "found"), [[name, each.headline()] for name, each in shown.items()]

    @property
    def kinematics(self) -> KinematicCheck:
        """Whether the channels of the records agree with each other."""
        return cast("KinematicCheck", self.results["kinematics"])

    @property
    def black_box(self) -> BlackBox:
        """What the structure was matched to."""
        return cast("BlackBox", self.results["pbsid"])

    @property
    def frequency_response(self) -> FrequencyResponse | None:
        """The measured one; None when no records were given for it."""
        return self.results.get("frequency")

    @property
    def quadratic(self) -> Fit[M_co, MatchNotes]:
        """The match in the quadratic norm."""
        return cast("Fit[M_co, MatchNotes]", self.results["quadratic"])

    @property
    def hinf(self) -> Fit[M_co, MatchNotes]:
        """The match in the H-infinity norm."""
        return cast("Fit[M_co, MatchNotes]", self.results["hinf"])

    @property
    def output_error(self) -> Fit[M_co, OutputErrorNotes]:
        """The refined structure."""
        return cast("Fit[M_co, OutputErrorNotes]", self.results["output_error"])

    @property
    def choice(self) -> StepChoice | None:
        """How the last step was chosen, with the fit that was; None unless it was asked for."""
        return self.results.get("choice")

    @property
    def validation(self) -> Validation | None:
        """Of all models on unseen records; None when none were given."""
        return self.results.get("validation")


def _telling(progress: Callable[[Progress | Timing], None]) -> Keep:
    """Runs a stage and tells when it begins, iterates and has ended."""

    def keep(stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401
        begun = perf_counter()
        progress(Progress(stage=stage.does, iteration=0, cost=nan, seconds=0.0))
        result = compute(stage, watched(settings, progress), task)
        steps = result.iterations if isinstance(result, Fit) else None
        progress(Timing(stage=stage.does, seconds=perf_counter() - begun, iterations=steps))
        return result

    return keep


@one_thread
def identify(
    model: M,
    records: Record | Sequence[Record],
    *,
    refinement: Record | Sequence[Record] | None = None,
    sweeps: Record | Sequence[Record] = (),
    unseen: Record | Sequence[Record] = (),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    settings: Mapping[str, Any] | None = None,
    stages: Sequence[Stage] = STAGES,
    progress: Callable[[Progress | Timing], None] | None = None,
) -> Identification[M]:
    """Identify a structure from records.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`.
    records : Record or sequence of Record
        What the black box is identified from.
    refinement : Record or sequence of Record
        What output error refines the match on; ``records`` unless given.
    sweeps, unseen : Record or sequence of Record
        Records for the frequency response and for validation; a stage without records is skipped.
    settings : mapping
        Of stages, by the name of their table in a study file: ``{"pbsid": Pbsid(order=18)}``. An
        optional stage runs if its table is there.
    stages : sequence of Stage
        What is done.
    progress : callable
        Called with a `Progress` when a stage begins and after each iteration, and with a ``Timing``
        when it has ended; `ProgressLine` writes them.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        All that the stages refuse; of one that did not converge, ``best`` is its last iterate.
    """
    roles: dict[Role, tuple[Record, ...]] = {
        "identification": several(records),
        "frequency": several(sweeps),
        "refinement": several(refinement or ()),
        "validation": several(unseen),
    }
    held: Any = {"fixed": fixed, "bounds": bounds}
    stages = fitting(model, stages, settings or {})
    task = Task(model=model, roles=roles, stages=stages, settings=settings or {}, **held)
    check_task(task)
    examine_task(task)
    for said in repeats({role: each for role, each in roles.items() if each}).told():
        warnings.warn(said, DataWarning, stacklevel=2)
    tell_repeats([record for each in roles.values() for record in each])
    with repeats_known():
        found = run_stages(task, keep=compute if progress is None else _telling(progress))
    for failure in found.failures.values():
        raise failure
    return Identification(results=found.results)
