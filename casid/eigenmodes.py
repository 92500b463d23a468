"""Modes of a system: names where the states that take part say what they are, what is seen of them.

Names as in G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., section 4.3. How much a state
takes part in a mode is measured by participation factors |v_i w_i| (right and left eigenvector;
Pérez-Arriaga, Verghese, Schweppe 1982), which do not depend on units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace

OSCILLATES = 1e-6  # imaginary part, relative to the modulus, that counts as an oscillation
SEEN = 1e-8  # smallest singular value of the Hautus matrix, relative, of a mode that is seen
NEAR = 6.0  # standard errors that two poles are apart, below which they may meet or part in truth
SAMPLES = 1000  # of what makes poles that may: a standard deviation is known to 2 %
NORMAL = 1.959964  # standard deviations of a normal number that hold 95 % of it
CLEAR = 0.6  # share of the states of one kind above which a mode is theirs

# Velocities along body axes, or airspeed with the angles of the flow: a structure has either.
ALONG, ACROSS, ASIDE = ("u", "V"), ("w", "alpha"), ("v", "beta")
LONGITUDINAL = (*ALONG, *ACROSS, "q", "theta")
LATERAL = (*ASIDE, "p", "r", "phi")


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One real pole or one complex pair (the pole with positive imaginary part).

    Parameters
    ----------
    name : str
        "-" where no name fits.
    pole, frequency : complex, float
        Eigenvalue [1/s] and its modulus, the natural frequency [rad/s].
    damping : float
        Damping ratio; ±1 for a real pole.
    time_constant, period : float
        1/|Re λ| and 2π/|Im λ| [s], inf for a real pole.
    half : float
        Time in which the amplitude halves [s]; negative: in which it doubles.
    shares : mapping
        Participation of every state, sum one.
    observable, controllable : bool
        Whether any output shows the mode and any input moves it (Hautus).
    """

    name: str
    pole: complex
    frequency: float
    damping: float
    time_constant: float
    period: float
    half: float
    shares: Mapping[str, float]
    observable: bool
    controllable: bool

    @property
    def states(self) -> tuple[str, ...]:
        """The up to three states that take most part."""
        order = sorted(self.shares, key=self.shares.__getitem__, reverse=True)
        return tuple(x for x in order if self.shares[x] >= 0.2 * self.shares[order[0]])[:3]

    @property
    def words(self) -> str:
        """Frequency and damping of an oscillation, time constant of the rest."""
        if np.isfinite(self.period):
            return f"{self.frequency:.3g} rad/s, damping {self.damping:+.2f}"
        if self.frequency < 1e-9:
            return "integrator"
        kind = "time constant" if self.pole.real < 0 else "grows e-fold in"
        return f"{kind} {self.time_constant:.3g} s"


def modes(system: StateSpace) -> tuple[Mode, ...]:
    """Modes of a continuous model, slowest first; each name is given once, to the clearest case."""
    poles, right = np.linalg.eig(system.A)
    shares = np.abs(right * np.linalg.pinv(right).T)  # state i in mode k
    shares = shares / shares.sum(axis=0)
    kept = [k for k in range(len(poles)) if poles[k].imag >= -OSCILLATES * abs(poles[k])]
    kept.sort(key=lambda k: abs(poles[k]))
    columns = [dict(zip(system.states, shares[:, k].tolist(), strict=True)) for k in kept]
    return _once([_mode(complex(poles[k]), c, system) for k, c in zip(kept, columns, strict=True)])


def pole_figures(pole: ComplexArray) -> Array:
    """Real and imaginary part, modulus and damping ratio of poles (n,), (4, n)."""
    size = np.maximum(np.abs(pole), 1e-300)
    return np.array([pole.real, pole.imag, size, -pole.real / size])


def may_meet(poles: ComplexArray, imag_std: Array, gap_std: Array) -> BoolArray:
    """Which modes' poles (n,) may be real for a pair, or a pair for two real ones.

    Closer to each other than `NEAR` standard errors: of imaginary parts (n,), and of the gaps
    between real parts (n, n).
    """
    real = np.abs(poles.imag) <= OSCILLATES * np.abs(poles)
    gap = np.abs(np.subtract.outer(poles.real, poles.real))
    pairs = (gap < NEAR * gap_std) & real & real[:, None]
    return np.asarray(np.where(real, pairs.any(axis=0), poles.imag < NEAR * imag_std))


def deviations(matrices: Sequence[Array], poles: ComplexArray) -> Array:
    """How far poles of matrices A are off those (n,) of modes, as standard deviations (4, n).

    In `pole_figures`. Roots part by the square root of what is normal, far to one side: root mean
    squares, or where that is more what `NORMAL` of it must be for 97.5 % of them to be nearer, on
    either side. A pair counts both members, where these have become real too.
    """
    paired = np.flatnonzero(poles.imag > OSCILLATES * np.abs(poles))
    every = np.concatenate([poles, poles[paired].conj()])
    off, center = [], pole_figures(poles.real + 1j * np.abs(poles.imag))
    center = np.hstack([center, center[:, paired]])
    for drawn in np.linalg.eigvals(np.array(matrices)):
        apart = np.abs(every[:, None] - drawn) ** 2  # by squares real ones keep their order
        moved = drawn[scipy.optimize.linear_sum_assignment(apart)[1]]
        off.append(pole_figures(moved.real + 1j * np.abs(moved.imag)) - center)
    both = np.array(off)
    each = np.concatenate([both[:, :, : len(poles)]] * 2)
    each[len(off) :, :, paired] = both[:, :, len(poles) :]
    wide = np.abs(np.quantile(each, [0.025, 0.975], axis=0)).max(axis=0) / NORMAL
    return np.asarray(np.maximum(np.sqrt(np.mean(each**2, axis=0)), wide))


def _mode(pole: complex, shares: Mapping[str, float], system: StateSpace) -> Mode:
    real, modulus = pole.real, abs(pole)
    oscillates = abs(pole.imag) > OSCILLATES * modulus
    shifted = pole * np.eye(system.nx) - system.A
    return Mode(
        name=_name(oscillates, shares)[0],
        pole=pole,
        frequency=modulus,
        damping=-real / modulus if modulus else np.nan,
        time_constant=1 / abs(real) if real else np.inf,
        period=2 * np.pi / abs(pole.imag) if oscillates else np.inf,
        half=-np.log(2) / real if real else np.inf,
        shares=shares,
        observable=_full_rank(np.vstack([shifted, _scaled(system.C)])),
        controllable=_full_rank(np.vstack([shifted.T, _scaled(system.B.T)])),
    )


def _scaled(rows: Array) -> Array:
    """Rows of length one, so that units do not decide what counts as seen."""
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(size > 0, size, 1.0))


def _full_rank(matrix: ComplexArray) -> bool:
    values = np.linalg.svd(matrix, compute_uv=False)
    return bool(values[-1] > SEEN * max(values[0], 1e-300))


def _name(oscillates: bool, shares: Mapping[str, float]) -> tuple[str, float]:
    """Name of a mode and how clearly it is the one."""
    long, lat = (sum(shares.get(x, 0.0) for x in group) for group in (LONGITUDINAL, LATERAL))
    if max(long, lat) < CLEAR:
        return "-", 0.0

    def part(*states: str) -> float:
        return sum(shares.get(x, 0.0) for x in states)

    if long > lat:
        slow, fast = part(*ALONG, "theta"), part(*ACROSS, "q")
        if oscillates:
            # Of q and theta alone each has half of it: without a speed there is no phugoid.
            flown = not shares.keys().isdisjoint(ALONG)
            return ("phugoid", slow) if flown and slow > fast else ("short period", fast)
        heave, pitch = part(*ACROSS), part("q", "theta")
        return ("heave subsidence", heave) if heave > pitch else ("pitch subsidence", pitch)
    if oscillates:
        return "Dutch roll", lat
    roll, spiral = part("p"), part("phi", "r")
    return ("roll subsidence", roll) if roll > spiral else ("spiral", spiral)


def _once(found: Sequence[Mode]) -> tuple[Mode, ...]:
    claims = [_name(np.isfinite(mode.period), mode.shares)[1] for mode in found]
    best: dict[str, float] = {}
    for mode, claim in zip(found, claims, strict=True):
        best[mode.name] = max(best.get(mode.name, 0.0), claim)
    return tuple(
        mode if claim == best[mode.name] else replace(mode, name="-")
        for mode, claim in zip(found, claims, strict=True)
    )
