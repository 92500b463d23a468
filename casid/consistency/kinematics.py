"""Whether rates, attitudes, specific forces and velocities agree: flight path reconstruction.

Rigid-body kinematics ties channels of one flight together whatever the aircraft does; equations,
sources and the model of an instrument stand in `casid.consistency.flightpath`. Kinematics sees only
how channels stand to each other, so a scale of 5 % on p may as well be one of -5 % on φ.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import BoolArray
from casid.channels import ATTITUDES, FORCES, GRAVITY, RATES, VELOCITIES
from casid.consistency.clock_skews import Apart, known, stands_apart
from casid.consistency.comparisons import ChannelCheck, judged
from casid.consistency.drifts import Drifts, without_drifts
from casid.consistency.flightpath import LATE
from casid.consistency.lags import clocks_apart
from casid.consistency.measured import (
    Flight,
    coarse_step,
    looked_at,
    measured_parts,
    signals,
    strays,
)
from casid.consistency.recordwise import clocks_by_record
from casid.consistency.remarks import (
    ROUGH,
    against_gravity,
    dead_channels,
    misplaced,
    seen_place,
    turned,
    unexplained,
)
from casid.consistency.rigid import NEEDED, WHOLE
from casid.consistency.signs import set_upright
from casid.consistency.single_skew import one_alone
from casid.consistency.voting import mean, significant
from casid.display import Shown, counted, in_a_row, instant, listed
from casid.record import Record
from casid.records import Records, several
from casid.samples import bursts
from casid.threads import one_thread

LEVEL = 0.005  # rad


@dataclass(frozen=True, kw_only=True, repr=False)
class KinematicCheck(Shown):
    """Whether the channels of records agree with each other.

    Parameters
    ----------
    channels : tuple of ChannelCheck
        Rates and specific forces, those that could be compared.
    residuals : mapping
        Root mean square of what each equation leaves, in the unit of its attitude or velocity.
    notes : tuple of str
        What was not checked, and why.
    place, place_error : tuple of float
        From where velocities are measured to where specific forces are: forward, right, down [m];
        NaN where the records do not tell.
    further : tuple of str
        Remarks that belong to no single comparison: gravity in trim, angles that are no radians.
    apart : Apart
        Attitudes or velocities that are late against all else, and how late each rate and specific
        force is once these have moved.
    drifts : Drifts
        Clocks that run apart; ``drifts.remedy`` is what `Record.shift` takes as ``drift``.
    by_record : tuple of str
        Why no shift of all records brings them into line: clocks that differ from one to another.
    """

    channels: tuple[ChannelCheck, ...]
    residuals: Mapping[str, float]
    notes: tuple[str, ...] = ()
    further: tuple[str, ...] = ()
    place: tuple[float, ...] = (np.nan,) * 3
    place_error: tuple[float, ...] = (np.nan,) * 3
    apart: Apart = field(default_factory=Apart)
    by_record: tuple[str, ...] = ()
    drifts: Drifts = field(default_factory=Drifts)

    def headline(self) -> str:
        """What was compared and what was found."""
        compared = listed([each.channel for each in self.channels if each.determined])
        return f"{compared or 'nothing'} compared; {'; '.join(self.remarks) or 'no remark'}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Everything found wrong."""
        return (*(remark for each in self.channels for remark in each.remarks), *self.further)

    @property
    def shifts(self) -> dict[str, float]:
        """What `Record.shift` brings the channels into line: those remarked as late or early [s].

        Kinematics sees only how two channels stand to each other; here rates and forces move,
        attitudes and velocities stay, but for those that stand `apart`.
        """
        skewed = {
            name: -late for name, (late, e) in self.apart.left.items() if significant(late, e)
        }
        return skewed | self.apart.shifts

    def shifts_of(self, logger: Collection[str]) -> tuple[dict[str, float], tuple[str, ...]]:
        """Shifts [s] of the channels of one logger, which share its clock, and why in words.

        Where those in `shifts` agree, rates and forces whose skew may be the same move with them.
        Those of which nothing is told do too, unless another of the logger stands elsewhere.
        """
        alone = {name: lag for name, lag in self.apart.shifts.items() if name in logger}
        lates = {name: late for name, late in self.apart.left.items() if name in logger}
        own = {name: -lates[name][0] for name in self.shifts if name in lates}
        if not own:
            return alone, ()
        skew, _ = mean([lates[name] for name in own])
        alike = {name for name, (late, e) in lates.items() if not significant(late - skew, e)}
        untold = {*RATES, *FORCES} & {*logger} - {*lates}
        moves = dict(own)
        if {*own} <= alike:
            moving = alike if alike < {*lates} else alike | untold
            moves = {name: -skew for name in (*RATES, *FORCES) if name in moving}
        more, stay = (
            ", ".join(sorted(names))
            for names in ({*moves} - {*own}, {*lates} - {*moves} | untold - {*moves})
        )
        why = (
            f"{more}: shifted with {', '.join(own)}, as they share a logger and show no other skew"
            if more
            else ""
        )
        told = ", ".join(f"{name} {1e3 * late:+.0f} ms" for name, (late, _) in lates.items())
        rest = f"{stay} not shifted: skews of its logger's channels differ ({told})" if stay else ""
        return moves | alone, tuple(each for each in (why, rest) if each)

    @property
    def consistent(self) -> bool:
        """Whether nothing was found wrong."""
        return not self.remarks


@one_thread
def kinematic_check(records: Records, *, trim: Mapping[str, float] | None = None) -> KinematicCheck:
    """Scale, bias and skew of rates and specific forces that make records consistent.

    Scale and skew are one for all records, biases of each record's own.

    Parameters
    ----------
    records : Record or sequence of Record
        SI units and radians; outputs are known by their names: p q r, phi theta psi, ax ay az
        (specific force at the centre of gravity), u v w or V alpha beta. Equations whose channels
        are not there are left out. What `Record.detrend` subtracted is added again.
    trim : mapping
        Added to channels that were recorded as perturbations; ``theta0``, the pitch attitude [rad]
        where theta was not recorded.
    """
    flown = several(records)
    stretches = looked_at(flown)
    which, whole = [k for k, _ in stretches], [piece for _, piece in stretches]
    marks = [strays(piece) for piece in whole]
    pieces = [piece.mask(where) for piece, where in zip(whole, marks, strict=True)]
    flights = [
        signals(each, trim or {}, k, float(each.t[0] - flown[k].t[0]))
        for k, piece in zip(which, pieces, strict=True)
        for each in measured_parts(piece)
    ]
    labels = {k: flown[k].name for k in which}
    names = set.intersection(*(set(flight.values) for flight in flights)) if flights else set()
    notes = _marked(pieces, marks)
    weightless = _about_zero(flights, "az", 1e-2 * GRAVITY)
    level = _maybe_level(flights, trim or {}, weightless=weightless)
    if weightless:
        names -= {*VELOCITIES, *FORCES}
        roughly = ", and attitudes only roughly, as if about level flight" if level else ""
        notes.append(
            "az has no gravity in it, so the records are perturbations: velocities are not "
            f"checked{roughly}; give the trim, or total values"
        )
    unfit = {
        name: f"{name} is counted in steps of {step:.3g} rad, too coarse for its movement"
        for name in {*ATTITUDES} & names
        if (step := coarse_step(flights, name))
    }
    dead = dead_channels(flights, names)
    unfit |= {name: f"{name} stands still" for name in dead}
    names -= {*unfit}
    notes += _unchecked(names, pieces, unfit)
    equations = [name for name in (*ATTITUDES, *VELOCITIES) if NEEDED[name] <= names]
    why, split = turned(flights, names), False
    if equations and not why:
        why, split = clocks_apart(flights, LATE, labels)
    if why or not equations:
        further = (*dead.values(), *why)
        return KinematicCheck(
            channels=(), residuals={}, notes=tuple(notes), further=further, by_record=why * split
        )
    found = _reconstructed(flights, names, equations, notes, labels, flown[0].outputs, level)
    return replace(found, further=(*dead.values(), *found.further))


def _reconstructed(
    flights: Sequence[Flight],
    names: set[str],
    equations: Sequence[str],
    notes: Sequence[str],
    labels: Mapping[int, str],
    recorded: Collection[str],
    level: str,
) -> KinematicCheck:
    """What instruments the equations of these channels ask for, judged.

    Roughly where attitudes may be perturbations of those in trim, for what ``level`` says.
    """
    bare = [each.only(names) for each in flights]
    flights, solution, signs = set_upright(bare, equations, names, labels)
    bare, solution, drifts = without_drifts(flights, equations, solution)
    if drifts.late:  # skews are those at the start of records then, and as uncertain
        apart = stands_apart(solution, known(solution))
    else:
        solution, apart = one_alone(bare, equations, solution)
    if by_record := clocks_by_record(bare, equations, solution, labels):
        return KinematicCheck(
            channels=(), residuals={}, notes=tuple(notes), further=by_record, by_record=by_record
        )
    odd = unexplained(solution, flights, labels)
    apart = apart.without(odd)  # what does not follow at any time is not late
    spread = {
        name: float(np.sqrt(np.mean([np.var(flight.values[name]) for flight in flights])))
        for name in (*solution.channels, *equations)
    }
    rough = {name for name in equations if level or not WHOLE[name] <= names}
    checks = tuple(
        judged(solution, n, spread[n], rough, odd, labels.values(), apart, signs)
        for n in solution.channels
    )
    untold = [
        f"the records say nothing about {each.channel}: it moves too little, or too much like "
        "others"
        for each in checks
        if not (each.determined or each.remarks or each.channel in solution.limits)
    ]
    left = {n: float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for n, e in solution.left.items()}
    place, errors = seen_place(solution)
    return KinematicCheck(
        channels=checks,
        residuals=left,
        notes=(*notes, *untold, *_roughly(checks, rough, names, level)),
        further=(
            *signs.told(recorded),
            *against_gravity(flights, names),
            *odd.values(),
            *([] if _clocks_differ(apart) else misplaced(place, errors)),
            *apart.told(),
            *drifts.told(),
        ),
        place=tuple(map(float, place)),
        place_error=tuple(map(float, errors)),
        apart=apart,
        drifts=drifts,
    )


def _clocks_differ(apart: Apart) -> bool:
    """Whether attitudes and rates are of different clocks: velocities they turned read as places.

    At a speed U those that an attitude late by τ turned into body axes as of a place U τ away.
    """
    rates = [each for name, each in apart.left.items() if name in RATES]
    return bool({*ATTITUDES} & {*apart.late}) or any(significant(*each) for each in rates)


def _marked(pieces: Sequence[Record], marks: Sequence[BoolArray]) -> list[str]:
    """Notes on outliers, which are left out here and nowhere else."""
    notes = []
    for i, name in enumerate(pieces[0].outputs if pieces else ()):
        at = [piece.t[where[:, i]] for piece, where in zip(pieces, marks, strict=True)]
        if count := sum(map(len, at)):
            first = next(each[0] for each in at if len(each))
            rows = [row for t, piece in zip(at, pieces, strict=True) for row in bursts(t, piece.dt)]
            notes.append(
                f"{name} has {counted(count, 'outlier')}, left out here; the first at "
                f"{instant(first)} s{in_a_row(rows)}"
            )
    return notes


def _unchecked(names: set[str], pieces: Sequence[Record], unfit: Mapping[str, str]) -> list[str]:
    """Notes on what was not checked, and why: not there, or ``unfit`` for it."""

    def absence(name: str) -> str:
        if name in unfit:
            return unfit[name]
        shares = [np.isnan(p.channel(name)).mean() for p in pieces if name in p.outputs]
        return f"{max(shares):.0%} of {name} is missing" if shares else f"there is no {name}"

    there = {name for piece in pieces for name in piece.outputs}
    notes = [
        f"{rate} was not checked: {', '.join(map(absence, lacking))}"
        for rate, attitude in (("p", "phi"), ("q", "theta"))
        if rate in there and (lacking := [name for name in (rate, attitude) if name not in names])
    ]
    lacking = sorted(WHOLE["theta"] - {"r"} - names)
    if "r" in names and lacking:  # it would take the place of what turns with it
        notes.append(f"r was not checked: {', '.join(map(absence, lacking))}")
    lacking = sorted(NEEDED["u"] - names)
    if lacking and {*FORCES} & names:
        why = ", ".join(map(absence, lacking))
        notes.append(f"specific forces were checked against gravity in trim only: {why}")
    return notes


def _maybe_level(flights: Sequence[Flight], trim: Mapping[str, float], *, weightless: bool) -> str:
    """Why attitudes may be perturbations, of a trim that nobody knows; empty if they are not."""
    if "theta" in trim:
        return ""
    if weightless:
        return "az has no gravity in it"
    weighed = all("az" in flight.values for flight in flights) and "az" not in trim
    if weighed or not _about_zero(flights, "theta", LEVEL):
        return ""
    return (
        "theta is about zero, and no az with gravity tells whether attitudes are total values: "
        "give the trim of theta, 0 where it is total"
    )


def _roughly(
    checks: Sequence[ChannelCheck], rough: set[str], names: set[str], level: str
) -> list[str]:
    """Notes on scales that are told only if they are large, and why."""
    found: dict[str, list[str]] = {}
    for each in checks:
        if each.determined and rough & {*each.against}:
            lacking = set[str]().union(*(WHOLE[name] for name in each.against)) - names
            absent = f"there is no {listed(sorted(lacking))}" if lacking else ""
            found.setdefault(level or absent, []).append(each.channel)
    return [
        f"a scale of {listed(channels)} is reported only if it is off by {ROUGH:.0%} or more: {why}"
        for why, channels in found.items()
    ]


def _about_zero(flights: Sequence[Flight], name: str, size: float) -> bool:
    """Whether a channel of all flights is about zero: its trim may have been removed before."""
    seen = [flight.values[name] for flight in flights if name in flight.values]
    whole = bool(seen) and len(seen) == len(flights)
    return whole and bool(abs(np.median(np.concatenate(seen))) < size)
