"""What the standard errors of a fit make of its response and its modes.

First order: the covariance J C Jᵀ of a function of the parameters, J its derivatives by central
differences of a thousandth of each standard error, C the covariance that `Fit.std_error` is read
from. It holds the noise and the colour of the residuals; what the structure lacks is added where a
`Undermodelling` says how much that is.

Two poles that may be a pair or both real have no derivatives where they meet: theirs come from
models drawn from C, wide enough for their longer tail: twice a pole is seldom estimated as one.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.checks import check_level
from casid.display import Shown, counted
from casid.eigenmodes import SAMPLES, Mode, deviations, may_meet, modes, pole_figures
from casid.fit import AnyFit
from casid.model import Model
from casid.propagation import drawn_models, first_order, known_errors, spread
from casid.threads import one_thread
from casid.undermodelling import Undermodelling, missed_quantile, missed_square

EQUAL = 1e-4  # distance of poles, relative to them, that is that of rounding in a multiple one
SAME = np.e - 1  # share of a pole within which a black box's is the same mode


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ResponseBand(Shown):
    """A fit's frequency response with its band.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s].
    G : (K, ny, nu) complex array
        The response.
    magnitude_std, phase_std : (K, ny, nu) array
        Standard deviations of ln abs(G), a share of the magnitude, and of the phase [rad], from the
        covariance of the fit alone: ``missed`` is not in them, only in `magnitude` and `phase`.
    level : float
        Share of the bands that hold the true value, frequency by frequency.
    inputs, outputs : tuple of str
        Channels.
    missed : (K, ny, nu) array
        Of what the structure misses, in both parts together and relative to abs(G), the standard
        deviation of a normal number that is as seldom beyond the band; zero unless given.
    """

    omega: Array
    G: ComplexArray
    magnitude_std: Array
    phase_std: Array
    level: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    missed: Array | float = 0.0

    def headline(self) -> str:
        """Frequencies and typical width."""
        wide = 100 * float(np.median(self._half(self.magnitude_std)))
        return (
            f"{counted(len(self.outputs), 'output')} from {counted(len(self.inputs), 'input')}, "
            f"{self.omega[0]:.3g} to {self.omega[-1]:.3g} rad/s; magnitude ± {wide:.2g} % in the "
            f"median at {100 * self.level:.3g} %"
        )

    def magnitude(self) -> Array:
        """Lower and upper edge of abs(G), (2, K, ny, nu)."""
        half = self._half(self.magnitude_std)
        if not np.any(self.missed):
            return np.asarray(np.abs(self.G) * np.exp(np.array([-half, half])))
        return np.asarray(np.abs(self.G) * np.array([np.maximum(1 - half, 0.0), 1 + half]))

    def phase(self) -> Array:
        """Lower and upper edge of the phase [rad], (2, K, ny, nu), unwrapped over frequency."""
        half = self._half(self.phase_std)
        if np.any(self.missed):  # where the origin may be inside, the phase may be any
            half = np.where(half < 1, np.arcsin(np.minimum(half, 1.0)), np.pi)
        return np.asarray(np.unwrap(np.angle(self.G), axis=0) + np.array([-half, half]))

    def _half(self, std: Array) -> Array:
        """Half the width of a part's band, relative to the magnitude."""
        return np.asarray(
            scipy.special.ndtri(0.5 + self.level / 2)
            * np.hypot(std, np.asarray(self.missed) / np.sqrt(2))
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class ModeBand(Shown):
    """One mode of a fit with standard deviations.

    Parameters
    ----------
    mode : Mode
        Pole, name, frequency, damping.
    real_std, imag_std : float
        Of the pole [1/s]; ``imag_std`` above 0 of a real pole: in truth it may be one of a pair.
    frequency_std, damping_std : float
        Of its modulus [rad/s] and damping ratio.

    Of poles that may be a pair or both real, whose errors are lopsided, ± 1.96 of them hold 95 % of
    models drawn from the fit's covariance on the wider side.
    """

    mode: Mode
    real_std: float
    imag_std: float
    frequency_std: float
    damping_std: float

    def headline(self) -> str:
        """Name and pole with its standard deviations."""
        pole = self.mode.pole
        turn = f", ±({pole.imag:.3g} ± {self.imag_std:.2g})j" if pole.imag or self.imag_std else ""
        return f"{self.mode.name}: pole {pole.real:.3g} ± {self.real_std:.2g}{turn} 1/s (1σ)"


@one_thread
def response_band(
    fit: AnyFit, omega: Array, *, level: float = 0.95, error: Undermodelling | None = None
) -> ResponseBand:
    """Frequency response of a fit with the band that its standard errors give it.

    Of a nonlinear structure's fit it is that of the linearisation at its reference condition.

    Parameters
    ----------
    fit : Fit
        With a covariance: of `output_error` or `derivid`.
    omega : (K,) array
        Frequencies [rad/s].
    level : float
        Share of the bands that hold the true value, between 0 and 1.
    error : Undermodelling
        What the structure misses, from `structure_error`; added to the bands. Zero where the noise
        of the records hides it whole: there the band is that of the standard errors.

    Raises
    ------
    ValueError
        A fit without covariance; a level or a frequency that makes no sense.
    """
    omega = checked_frequencies(omega)
    check_level(level, "share")
    center = fit.model.system().response(omega)
    unit = np.where(center == 0, 1.0, center)

    def of(model: Model) -> Array:
        ratio = np.log(np.where(center == 0, 1.0, model.system().response(omega) / unit))
        return np.stack([ratio.real, ratio.imag])

    std = np.where(center == 0, 0.0, spread(fit, of))  # what is no path at all stays none
    size = np.where(center == 0, np.inf, np.abs(center))
    return ResponseBand(
        omega=omega,
        G=center,
        magnitude_std=std[0],
        phase_std=std[1],
        level=level,
        inputs=fit.model.inputs,
        outputs=fit.model.outputs,
        missed=0.0 if error is None else _as_normal(level) * error.of(fit).at(omega, center) / size,
    )


def checked_frequencies(omega: Array) -> Array:
    """Frequencies (K,); ValueError for what is none."""
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    if not len(omega) or not ((omega > 0) & np.isfinite(omega)).all():
        raise ValueError("omega: expected finite frequencies above 0 rad/s")
    return omega


def _as_normal(level: float) -> float:
    """Quantile of a structure's error over that of normal numbers."""
    return missed_quantile(level) / float(scipy.special.ndtri(0.5 + level / 2))


@one_thread
def mode_bands(fit: AnyFit, *, error: Undermodelling | None = None) -> tuple[ModeBand, ...]:
    """Modes of a fit with the standard deviations of pole, frequency and damping.

    Of a nonlinear structure's fit they are those of the linearisation at its reference condition.
    With ``error``, from `structure_error`, they hold what the estimates make of what it misses, and
    how far the black box's own mode near each is from it beyond that mode's noise: a pole takes up
    what a structure misses, a lag above all, and the response hardly shows it.

    Raises
    ------
    ValueError
        A fit without covariance.
    """
    found = modes(fit.model.system())
    poles = np.array([mode.pole for mode in found])
    names, C = known_errors(fit, error)

    def of(model: Model) -> Array:
        moved = np.linalg.eigvals(model.system().A).astype(complex)
        near = np.abs(poles[:, None] - moved)
        near += np.where((poles.imag > 0)[:, None] & (moved.imag < 0), np.inf, 0.0)
        pole = moved[scipy.optimize.linear_sum_assignment(np.minimum(near, 1e300))[1]]
        return np.vstack([*pole_figures(pole), np.subtract.outer(pole.real, pole.real)])

    std = first_order(fit, of, names, C)
    if (near := may_meet(poles, std[1], std[4:])).any():
        drawn = drawn_models(fit, names, C, SAMPLES, 0)
        off = deviations([model.system().A for model in drawn], poles)
        # Real ones of which no draw made a pair only pass each other.
        std[:4] = np.where(near & (off[1] > 0), off, std[:4])
    if error is not None:
        std[:4] = np.hypot(std[:4], _beside(poles, error))
    stated = ("real_std", "imag_std", "frequency_std", "damping_std")
    return tuple(
        ModeBand(mode=mode, **dict(zip(stated, row, strict=True)))
        for mode, row in zip(found, std[:4].T.tolist(), strict=True)
    )


def _beside(poles: ComplexArray, error: Undermodelling) -> Array:
    """How far modes of the black box are from poles (n,), beyond their noise, (4, n).

    In `pole_figures`; zero where none is near. A square of noise varies by √2 of its mean. Of equal
    poles the box's are those of one that any noise splits far: their mean stands for each.
    """
    apart = np.abs(poles[:, None] - error.poles) / np.maximum(np.abs(poles), 1e-150)[:, None]
    mine, its = scipy.optimize.linear_sum_assignment(np.minimum(apart, SAME))
    near = apart[mine, its] < SAME
    equal = np.abs(poles[:, None] - poles) <= EQUAL * np.abs(poles)
    share = equal[:, mine[near]].astype(float)
    there = share.any(axis=1)
    share = share[there] / share[there].sum(axis=1, keepdims=True)
    boxes, steps = share @ error.poles[its[near]], error.pole_std[:, its[near]] @ share.T
    paired = (equal.sum(axis=1) > 1) & (poles.imag == 0)  # two real ones, told as one of a pair
    boxes = np.where(paired[there], boxes.real, boxes)
    own, theirs = pole_figures(boxes), pole_figures(poles[there])
    noise = sum((pole_figures(boxes + step) - own) ** 2 for step in (steps[0], 1j * steps[1]))
    off = np.zeros((4, len(poles)))
    off[:, there] = np.sqrt(
        missed_square((theirs - own) ** 2 - noise, np.sqrt(2) * noise, error.sure)
    )
    return off
