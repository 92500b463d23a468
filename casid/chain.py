"""The whole method in one call: black box, quadratic match, H-infinity match, output error.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3: records to a black box (3.2), black box to structure (3.3), refinement on records (3.4).
"""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from casid.consistency.kinematics import KinematicCheck, kinematic_check
from casid.fit import Fit
from casid.frequency.estimation import FrequencyResponse, frequency_response
from casid.matching.comparison import Target
from casid.matching.match import match
from casid.model import Bounds, Model
from casid.nlp import SolverOptions
from casid.record import Record
from casid.shooting.output_error import output_error
from casid.subspace.pbsid import BlackBox, pbsid

T = TypeVar("T")

LOG = logging.getLogger("casid")


class Stage(Protocol):
    """Runs one stage of a chain, or returns what an earlier run of it left."""

    def __call__(self, name: str, compute: Callable[[], T]) -> T:
        """Return the result of the named stage."""
        ...


def run(name: str, compute: Callable[[], T]) -> T:  # noqa: ARG001 - the plain Stage
    """Compute a stage, no more."""
    return compute()


@dataclass(frozen=True, kw_only=True)
class Options:
    """Keyword arguments of each stage's function, and how hard each tries.

    Parameters
    ----------
    pbsid, frequency, match, output_error : mapping
        Passed to the function of that name as they are.
    solver : mapping
        `SolverOptions` by stage, ``{"match": SolverOptions(tolerance=1e-6)}``.
    join : bool
        Match the measured frequency response too, where there is one.
    """

    pbsid: Mapping[str, Any] = field(default_factory=dict)
    frequency: Mapping[str, Any] = field(default_factory=dict)
    match: Mapping[str, Any] = field(default_factory=dict)
    output_error: Mapping[str, Any] = field(default_factory=dict)
    solver: Mapping[str, SolverOptions] = field(default_factory=dict)
    join: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """What each stage found, in the order of the stages.

    ``kinematics`` says whether the channels of the records agree with each other;
    ``frequency_response`` is None when no records were given for it.
    """

    kinematics: KinematicCheck
    black_box: BlackBox
    frequency_response: FrequencyResponse | None
    quadratic: Fit
    hinf: Fit
    output_error: Fit


def identify(
    model: Model,
    records: Sequence[Record],
    *,
    refinement: Sequence[Record] | None = None,
    sweeps: Sequence[Record] = (),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    options: Options | None = None,
    stage: Stage = run,
) -> Identification:
    """Identify a structure from records.

    Parameters
    ----------
    model : Model
        Structure and trim.
    records : sequence of Record
        What the black box is identified from.
    refinement : sequence of Record
        What output error refines the match on; ``records`` unless given.
    sweeps : sequence of Record
        What the frequency response is estimated from; none, no frequency response.
    fixed, bounds
        As in `match`.
    options : Options
        Of the stages.
    stage : callable
        Called as ``stage(name, compute)`` for "pbsid", "frequency", "quadratic", "hinf" and
        "output_error" in turn; it may store results, show progress, or return a stored result.

    Returns
    -------
    Identification

    Raises
    ------
    ConvergenceError
        From the stage that did not converge; ``best`` is its last iterate.
    ValueError, ModelError
        All that the stages refuse.
    """
    options = Options() if options is None else options
    shared: dict[str, Any] = {"fixed": fixed, "bounds": bounds}
    matching = shared | {"options": options.solver.get("match", SolverOptions())}
    refining = shared | {"options": options.solver.get("output_error", SolverOptions())}
    kinematics = kinematic_check(records)
    for remark in kinematics.remarks:
        LOG.warning("The records do not agree with kinematics: %s", remark)
    black_box = stage("pbsid", lambda: pbsid(records, **options.pbsid))
    measured: FrequencyResponse | None = None
    if sweeps:
        measured = stage("frequency", lambda: frequency_response(sweeps, **options.frequency))
    target: list[Target] = [black_box]
    if options.join and measured is not None:
        target.append(measured)
    quadratic = stage(
        "quadratic", lambda: match(model, target, norm="quadratic", **options.match, **matching)
    )
    hinf = stage(
        "hinf", lambda: match(quadratic.model, target, norm="hinf", **options.match, **matching)
    )
    refined = stage(
        "output_error",
        lambda: output_error(hinf.model, refinement or records, **options.output_error, **refining),
    )
    return Identification(
        kinematics=kinematics,
        black_box=black_box,
        frequency_response=measured,
        quadratic=quadratic,
        hinf=hinf,
        output_error=refined,
    )
