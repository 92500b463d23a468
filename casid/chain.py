"""The whole method in one call: black box, quadratic match, H-infinity match, output error.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3: records to a black box (3.2), black box to structure (3.3), refinement on records (3.4).
"""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

from casid.consistency.kinematics import KinematicCheck, kinematic_check
from casid.fit import AnyFit, Fit, M_co
from casid.frequency.estimation import FrequencyResponse, frequency_response
from casid.matching.appraisal import MatchNotes
from casid.matching.match import Match
from casid.matching.targets import Target
from casid.model import Bounds, M
from casid.record import Record
from casid.shooting.output_error import OutputError
from casid.shooting.precision import OutputErrorNotes
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification(Generic[M_co]):
    """What each stage found, in the order of the stages.

    ``kinematics`` says whether the channels of the records agree with each other;
    ``frequency_response`` is None when no records were given for it.
    """

    kinematics: KinematicCheck
    black_box: BlackBox
    frequency_response: FrequencyResponse | None
    quadratic: Fit[M_co, MatchNotes]
    hinf: Fit[M_co, MatchNotes]
    output_error: Fit[M_co, OutputErrorNotes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Chain:
    """All stages of `identify` as an estimator, whose fit is that of the last.

    Parameters
    ----------
    pbsid, frequency : mapping
        Keyword arguments of the functions of these names.
    match, output_error
        Estimators of these stages; the norm is each stage's own.
    join : bool
        Match the measured frequency response too, where there is one.
    black_box : BlackBox
        Instead of one from the records.
    refinement, sweeps
        As in `identify`.
    """

    pbsid: Mapping[str, Any] = field(default_factory=dict)
    frequency: Mapping[str, Any] = field(default_factory=dict)
    match: Match = Match()
    output_error: OutputError = OutputError()
    join: bool = False
    black_box: BlackBox | None = None
    refinement: Sequence[Record] | None = None
    sweeps: Sequence[Record] = ()

    def fit(
        self,
        model: M,
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,  # noqa: ARG002 - the stages before lead elsewhere
    ) -> Fit[M, OutputErrorNotes]:
        """Identify a structure from records; see `identify`."""
        found = identify(
            model,
            [data] if isinstance(data, Record) else data,
            refinement=self.refinement,
            sweeps=self.sweeps,
            fixed=fixed,
            bounds=bounds,
            chain=self,
        )
        return found.output_error


def identify(
    model: M,
    records: Sequence[Record],
    *,
    refinement: Sequence[Record] | None = None,
    sweeps: Sequence[Record] = (),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    chain: Chain = Chain(),
    stage: Stage = run,
) -> Identification[M]:
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
    chain : Chain
        Settings of the stages.
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
    shared: dict[str, Any] = {"fixed": fixed, "bounds": bounds}
    kinematics = kinematic_check(records)
    for remark in kinematics.remarks:
        LOG.warning("The records do not agree with kinematics: %s", remark)
    given = chain.black_box
    black_box = stage("pbsid", lambda: pbsid(records, **chain.pbsid)) if given is None else given
    measured: FrequencyResponse | None = None
    if sweeps:
        measured = stage("frequency", lambda: frequency_response(sweeps, **chain.frequency))
    target: list[Target] = [black_box]
    if chain.join and measured is not None:
        target.append(measured)
    first, second = (replace(chain.match, norm=norm) for norm in ("quadratic", "hinf"))
    quadratic = stage("quadratic", lambda: first.fit(model, target, **shared))
    hinf = stage("hinf", lambda: second.fit(quadratic.model, target, **shared))
    refined = stage(
        "output_error",
        lambda: chain.output_error.fit(hinf.model, refinement or records, **shared),
    )
    return Identification(
        kinematics=kinematics,
        black_box=black_box,
        frequency_response=measured,
        quadratic=quadratic,
        hinf=hinf,
        output_error=refined,
    )
