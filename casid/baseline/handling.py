"""Handling-qualities reading of a frequency response: bandwidth, phase delay, stability margins.

Attitude response to a stick, ADS-33E-PRF, Aeronautical Design Standard, Handling Qualities
Requirements for Military Rotorcraft (2000), section 3.3.2.1 and figure 5:

- ω_180 is where the phase of attitude to stick passes -180°;
- the phase bandwidth is where it passes -135° (45° of phase margin), the last time before ω_180;
- the gain bandwidth is where the gain is 6 dB above that at ω_180, the last time before it;
- the bandwidth is the lesser of the two, of an attitude-command response the phase bandwidth;
- the phase delay is τ_p = ΔΦ/(57.3 · 2ω_180), ΔΦ the phase lost from ω_180 to 2ω_180; where the
  phase is no straight line there, from a least-squares line (both are given).

Passing means downwards and up to whole turns: the first such frequency sets the turn.

Open loop, MIL-DTL-9490E: the phase margin is 180° plus the phase where the gain passes 0 dB, the
gain margin minus the gain where the phase passes -180°; 45° and 6 dB are wanted. With several
crossings the least in magnitude counts; a negative gain margin is that against a loss of gain, a
negative phase margin where the gain rises that against a phase lead. The closed loop is unstable if
the response encircles -1 clockwise (`casid.baseline.encirclements`), as that of a loop of the wrong
sign does from its lowest frequencies; the phase margin is then the negative one where the gain
falls for the last time, if there is one. Encirclements the other way round are those that a loop
with unstable poles needs: how many there are a response alone does not tell, and margins are called
satisfactory if the open loop has as many as these say, none without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from casid.arrays import Array
from casid.baseline.encirclements import Encirclements, encirclements
from casid.display import Shown
from casid.frequency.response import FrequencyResponse, response_of_pair

Kind = Literal["attitude", "rate", "loop"]

PHASE_MARGIN, GAIN_MARGIN = 45.0, 6.0  # degrees, dB
COHERENT = 0.6
COARSE = 45.0  # degrees from point to point; a resonance between them is up to 0.7 dB above both
ALIKE = 0.5  # part of the larger that two readings of a phase delay may differ by


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class HandlingQualities(Shown):
    """What is read off one response; NaN where it does not apply or lies outside the band.

    Parameters
    ----------
    output, input, kind : str
        The pair and what it was read as.
    omega, gain_db, phase_deg : (K,) array
        The curve that was read: frequencies [rad/s], gain, phase unwrapped.
    omega_180 : float
        Where the phase passes -180° [rad/s].
    bandwidth, bandwidth_phase, bandwidth_gain : float
        [rad/s], ADS-33.
    phase_delay, phase_delay_line : float
        τ_p [s], from the end points and from a least-squares line.
    crossover : float
        Gain crossing of the phase margin [rad/s]: that of the least in magnitude, or the last if
        the closed loop is unstable by it.
    phase_margin, gain_margin : float
        [degrees], [dB].
    satisfactory : bool or None
        Whether an open loop has both margins, if it has as many ``unstable_poles``; None where the
        band does not tell, and for an attitude response, whose limits depend on the aircraft's
        mission (ADS-33 figures 6 and 9).
    unstable_poles : int
        How many unstable poles of the open loop its encirclements of -1 presume; 0 of a stable one.
    remarks : tuple of str
        What to know before believing the numbers.
    """

    output: str
    input: str
    kind: Kind
    omega: Array
    gain_db: Array
    phase_deg: Array
    omega_180: float = np.nan
    bandwidth: float = np.nan
    bandwidth_phase: float = np.nan
    bandwidth_gain: float = np.nan
    phase_delay: float = np.nan
    phase_delay_line: float = np.nan
    crossover: float = np.nan
    phase_margin: float = np.nan
    gain_margin: float = np.nan
    satisfactory: bool | None = None
    unstable_poles: int = 0
    remarks: tuple[str, ...] = ()

    def headline(self) -> str:
        """What was read off."""
        if self.kind == "loop":
            verdict = {True: "satisfactory", False: "not satisfactory", None: "not all in the band"}
            said = f"{self.output}/{self.input}, open loop, margins {verdict[self.satisfactory]}"
            return said + self._presumed() * (self.satisfactory is True)
        delay = "" if np.isnan(self.phase_delay) else f", phase delay {self.phase_delay:.3f} s"
        return f"{self.output}/{self.input}, bandwidth {self.bandwidth:.2f} rad/s{delay} (ADS-33)"

    def _presumed(self) -> str:
        """What a favourable verdict presumes."""
        if not self.unstable_poles:
            return ", if it is stable"
        return f", if it has {self.unstable_poles} unstable pole{'s' * (self.unstable_poles > 1)}"


def handling_qualities(
    target: FrequencyResponse | Sequence[FrequencyResponse],
    pair: tuple[str, str],
    *,
    kind: Kind = "attitude",
    sign: int = 1,
    attitude_command: bool = False,
) -> HandlingQualities:
    """Bandwidth and phase delay of an attitude response, or the margins of an open loop.

    Parameters
    ----------
    target : FrequencyResponse, or several
        The first that has the pair is read, on a grid fine enough to interpolate in log ω.
    pair : (output, input)
        Which response.
    kind : {"attitude", "rate", "loop"}
        ``"attitude"``: read as it is; ``"rate"``: an angular rate, integrated first; ``"loop"``: a
        loop broken at one point, negative feedback, whose characteristic equation is 1 + L = 0.
        Whether it is stable when closed is told from frequencies within a decade or so below its
        gain crossings: give what was measured there.
    sign : {1, -1}
        -1 for a stick whose positive deflection lowers the attitude.
    attitude_command : bool
        Whether the stick commands attitude, so that the gain bandwidth does not count.

    Raises
    ------
    ValueError
        A pair that was not measured, a phase that never passes -180° in the band.
    """
    if kind not in get_args(Kind) or sign not in {1, -1}:
        raise ValueError(
            f'kind={kind!r}, sign={sign}: expected "attitude", "rate" or "loop", and 1 or -1'
        )
    frf = response_of_pair(target, pair)
    i, j = frf.index(*pair)
    G, gamma = frf.G[:, i, j], frf.coherence[:, i, j]
    known = np.isfinite(G) & (np.abs(G) > 0)
    if known.sum() < 3:
        raise ValueError(f"pair {pair} was measured at {known.sum()} frequencies, too few to read")
    omega, G, gamma = frf.omega[known], sign * G[known], gamma[known]
    if kind == "rate":
        G = G / (1j * omega)
    gain = 20 * np.log10(np.abs(G))
    phase = np.degrees(np.unwrap(np.angle(G)))
    found = HandlingQualities(
        output=pair[0], input=pair[1], kind=kind, omega=omega, gain_db=gain, phase_deg=phase
    )
    if kind == "loop":
        return _margins(found, gamma)
    return _bandwidth(found, gamma, attitude_command=attitude_command)


def _bandwidth(
    found: HandlingQualities, gamma: Array, *, attitude_command: bool
) -> HandlingQualities:
    x, gain = np.log(found.omega), found.gain_db
    crossings = _passing(x, found.phase_deg, -180.0, downwards=True)
    if not len(crossings):
        raise ValueError(
            f"the phase of {found.output}/{found.input} does not pass -180° between "
            f"{found.omega[0]:.3g} and {found.omega[-1]:.3g} rad/s: extend the grid to higher "
            'frequencies, or check kind= (an angular rate is read with "rate") and sign='
        )
    x180 = crossings[0]
    phase = found.phase_deg - 360 * np.round((np.interp(x180, x, found.phase_deg) + 180) / 360)
    at_phase = _passing(x, phase, -135.0, downwards=True, turns=False)
    at_gain = _passing(x, gain, np.interp(x180, x, gain) + 6, turns=False)
    before = [at[at <= x180] for at in (at_phase, at_gain)]
    by_phase, by_gain = (np.exp(at[-1]) if len(at) else np.nan for at in before)
    both = [by_phase] if attitude_command else [by_phase, by_gain]
    delay, line, remarks = _phase_delay(x, phase, x180)
    remarks += _several("the phase", "-135°", _passing(x, phase, -135.0, turns=False), x180)
    if not attitude_command:
        remarks += _several("the gain", "6 dB above that at ω_180", before[1], x180)
    again = _passing(x, phase, -180.0, turns=False)
    again = again[again > x180 + 1e-9]  # growing modes may have raised it through that before
    if len(again):
        remarks.append(
            f"the phase crosses -180° again, at {', '.join(f'{at:.3g}' for at in np.exp(again))} "
            "rad/s: ω_180 is the first crossing, and phase lost between the crossings is no "
            "phase delay"
        )
    if np.isnan(by_phase):
        remarks.append("the phase is below -135° in the whole band: no phase bandwidth can be read")
    if np.isnan(by_gain) and not attitude_command:
        remarks.append(
            "the gain is below 6 dB above that at ω_180 in the whole band: no gain bandwidth"
        )
    top = min(2 * np.exp(x180), found.omega[-1])
    read = (found.omega >= np.nanmin([*both, np.exp(x180)])) & (found.omega <= top)
    remarks += _doubts(gamma[read])
    found = replace(found, phase_deg=phase)
    remarks += _coarse(found, np.array([x180, *np.log([each for each in both if each > 0])]))
    found = replace(found, omega_180=float(np.exp(x180)), remarks=tuple(remarks))
    found = replace(found, phase_delay=delay, phase_delay_line=line, bandwidth=float(np.min(both)))
    return replace(found, bandwidth_phase=float(by_phase), bandwidth_gain=float(by_gain))


def _several(what: str, level: str, at: Array, x180: float) -> list[str]:
    """A remark if a level is met, at places in log ω, several times below ω_180."""
    places = [f"{each:.3g}" for each in np.exp(at[at <= x180])]
    if len(places) < 2:
        return []
    return [
        f"{what} is {level} at {', '.join(places)} rad/s; the last of these is used, although "
        "the margin is too small below it as well"
    ]


def _phase_delay(x: Array, phase: Array, x180: float) -> tuple[float, float, list[str]]:
    """τ_p from the end points and from a line through ω_180 and the points up to 2ω_180."""
    omega_180 = np.exp(x180)
    if x180 + np.log(2) > x[-1] + 1e-9:
        beyond = (
            f"2ω_180 = {2 * omega_180:.3g} rad/s lies beyond the grid: no phase delay can be read"
        )
        return np.nan, np.nan, [beyond]
    fine = np.linspace(omega_180, 2 * omega_180, 41)
    curve = np.interp(np.log(fine), x, phase)
    delay = -(curve[-1] + 180) / (np.degrees(1) * 2 * omega_180)
    slope = np.polyfit(fine, curve, 1)[0]
    line = -slope / np.degrees(1) / 2
    remarks = []
    if abs(delay - line) > ALIKE * max(abs(delay), abs(line)):
        remarks.append(
            f"the phase delay is {delay:.3g} s from the end points and {line:.3g} s from a "
            "fitted line: the phase is not a straight line from ω_180 to 2ω_180, for instance "
            "because of a lightly damped mode there; judge by the curve"
        )
    return float(delay), float(line), remarks


def _margins(found: HandlingQualities, gamma: Array) -> HandlingQualities:
    x, remarks = np.log(found.omega), []
    at_gain = _passing(x, found.gain_db, 0.0, turns=False)
    at_phase = _passing(x, found.phase_deg, -180.0)
    margins = _phase_margin(at_gain, x, found.phase_deg)
    spare = -np.interp(at_phase, x, found.gain_db)
    phase_margin, gain_margin, crossover, omega_180 = (np.nan,) * 4
    around = encirclements(x, found.gain_db, found.phase_deg)
    if len(at_gain):
        last = around.unstable and margins[-1] < 0 and found.gain_db[-1] < 0
        k = -1 if last else int(np.argmin(np.abs(margins)))
        phase_margin, crossover = float(margins[k]), float(np.exp(at_gain[k]))
    else:
        remarks.append("the gain does not cross 0 dB in the band: no phase margin can be read")
    if len(at_phase):
        k = int(np.argmin(np.abs(spare)))
        gain_margin, omega_180 = float(spare[k]), float(np.exp(at_phase[k]))
    else:
        remarks.append("the phase does not cross -180° in the band: no gain margin can be read")
    remarks += _instability(found, around)
    wide = abs(phase_margin) >= PHASE_MARGIN and abs(gain_margin) >= GAIN_MARGIN
    places = np.concatenate([at_gain, at_phase])
    near = [int(np.argmin(np.abs(x - place))) for place in places]
    remarks += _doubts(gamma[near]) + _coarse(found, places)
    known = np.isfinite(phase_margin) and np.isfinite(gain_margin)
    told = known and (around.unstable or around.beginning != "untold" or not wide)
    satisfactory = wide and not around.unstable if told else None
    found = replace(found, omega_180=omega_180, crossover=crossover, satisfactory=satisfactory)
    found = replace(found, unstable_poles=around.poles)
    found = replace(found, phase_margin=phase_margin, gain_margin=gain_margin)
    return replace(found, remarks=tuple(remarks))


def _instability(found: HandlingQualities, around: Encirclements) -> list[str]:
    """Why the closed loop is unstable, or may be; empty where nothing says so."""
    x, way = np.log(found.omega), "falling" if around.slope <= 0 else "rising"
    begins = (
        f"at the lowest frequency, {found.omega[0]:.3g} rad/s, the gain is {found.gain_db[0]:.0f} "
        f"dB, {way} by {abs(around.slope):.0f} dB a decade, the phase {around.phase:.0f}°"
    )
    if not around.unstable:
        if around.beginning != "untold":
            return []
        return [
            f"{begins}: a loop of the wrong sign begins like this, and so does one whose lower "
            "frequencies are missing; check the sign, or extend the grid to lower frequencies"
        ]
    if around.beginning == "reversed":
        return [
            f"{begins}: a loop of the wrong sign begins like this, so the closed loop is "
            "unstable, unless the response changes its sign below the band; check the sign "
            "(sign=-1)"
        ]
    falling = _passing(x, found.gain_db, 0.0, downwards=True, turns=False)
    lost = falling[_phase_margin(falling, x, found.phase_deg) < 0]
    if len(lost):
        return [
            "the phase is below -180° where the gain falls through 0 dB, at "
            f"{np.exp(lost[-1]):.3g} rad/s: the closed loop is unstable; if it flies, check the "
            "sign of the loop"
        ]
    return [
        f"above 0 dB the phase passes -180° downwards {around.number:.0f} time(s) more than "
        "upwards: the closed loop is unstable, unless the phase rises through it below the band; "
        "if it flies, check the sign of the loop"
    ]


def _phase_margin(at: Array, x: Array, phase: Array) -> Array:
    """Phase above -180°, in [-180°, 180°), at places in log ω."""
    return np.asarray((np.interp(at, x, phase) + 360) % 360 - 180)


def _passing(
    x: Array, y: Array, level: float, *, downwards: bool = False, turns: bool = True
) -> Array:
    """Where y passes a level (up to whole turns of 360), linear between points."""
    found = []
    for k in range(len(x) - 1):
        low, high = sorted((y[k], y[k + 1]))
        if downwards and y[k + 1] >= y[k]:
            continue
        first = level + 360 * np.ceil((low - level) / 360) if turns else level
        # A level met at a point belongs to the step that reaches it.
        if low <= first < high or (first == high and k + 2 == len(x)):
            found.append(x[k] + (first - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k]))
    return np.array(found)


def _coarse(found: HandlingQualities, places: Array) -> list[str]:
    """A remark on each step of the grid too wide to read what lies in it, at places in log ω."""
    after = np.clip(np.searchsorted(np.log(found.omega), places), 1, len(found.omega) - 1)
    wide = {int(k) for k in after if abs(np.diff(found.phase_deg)[k - 1]) > COARSE}
    return [
        f"the phase changes by {abs(found.phase_deg[k] - found.phase_deg[k - 1]):.0f}° between "
        f"{found.omega[k - 1]:.3g} and {found.omega[k]:.3g} rad/s, where numbers are read, "
        "without a point between them: give the response on a finer grid there"
        for k in sorted(wide)
    ]


def _doubts(gamma: Array) -> list[str]:
    worst = np.nanmin(gamma) if np.isfinite(gamma).any() else np.nan
    if worst < COHERENT:
        return [f"coherence falls to {worst:.2f} where the numbers are read"]
    return []
