"""What a structure misses, as a random process: the error of its response beside that of noise.

The true response is taken for G (1 + Δ) + Δ_a of a fit's response G, for every pair a complex
Gaussian process in ln ω: multiplicative where the magnitude is smooth, additive across its zeros,
because its size follows the geometric mean m of abs(G)² over neighbouring frequencies,

    E|Δ|² = m ⟨(|E|² - E|ε|² - E|η|²)/m⟩,   E the fit's response less the black box's,

ε and η the errors of box and fit by noise, ⟨ ⟩ the same mean. Where noise may hide what is missed,
this difference is a poor guess, often below zero. In proportion to the evidence of all pairs
together that something is missed, it is replaced by the mean of a normal variable truncated at zero
(the difference, with its standard deviation by ε). G. C. Goodwin, M. Gevers, B. Ninness, IEEE
Transactions on Automatic Control 37(7), 1992 (stochastic embedding), with levels from a black box
of the same records.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.checks import check_asked
from casid.display import Shown, counted
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit
from casid.free import Free
from casid.response_fit import REACH, BoxResponse, gain, kernel, movable, nearness
from casid.subspace.blackbox import BlackBox
from casid.subspace.refinement import ResponseUncertainty
from casid.threads import one_thread
from casid.values import seal

POINTS = 48  # frequencies
EVIDENT = 2.0  # standard deviations of what all pairs together miss, at which one may think either
WIDE, DRAWS = 10.0, 2000  # realisations that quantiles are taken of: width in `REACH`, how many


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Undermodelling(Shown):
    """What a fit's structure misses of the response, as a random process.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s].
    std : (K, ny, nu) array
        (E|Δ|²)^½ of the complex response, in its units.
    covariance : (nf, nf) array
        What it makes of the free parameters, were they estimated from the response.
    poles : (m,) complex array
        Of the black box, imaginary parts not below zero [1/s].
    pole_std : (2, m) array
        Standard deviations of their real and imaginary parts [1/s].
    free_names, inputs, outputs : tuple of str
        Parameters and channels.
    size : (K, ny, nu) array
        abs(G) of the fit's response.
    sure : float
        Between 0 and 1: how clearly all pairs together say that the structure is not all.
    """

    omega: Array
    std: Array
    covariance: Array
    poles: ComplexArray
    pole_std: Array
    free_names: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    size: Array
    sure: float

    def __post_init__(self) -> None:
        seal(self)

    def headline(self) -> str:
        """Channels and frequencies."""
        return (
            f"{counted(len(self.outputs), 'output')} from {counted(len(self.inputs), 'input')}, "
            f"{self.omega[0]:.3g} to "
            f"{self.omega[-1]:.3g} rad/s"
        )

    def of(self, fit: AnyFit) -> "Undermodelling":
        """The same in the order of a fit's channels and parameters; ValueError: it lacks one."""
        order = {}
        for kind, wanted, known in (
            ("output", fit.model.outputs, self.outputs),
            ("input", fit.model.inputs, self.inputs),
            ("free parameter", fit.free_names, self.free_names),
        ):
            if missing := [name for name in wanted if name not in known]:
                raise ValueError(
                    f"the structure error has no {kind} {missing[0]!r}, only {', '.join(known)}: "
                    "compute that of this fit, structure_error(fit, black_box)"
                )
            order[kind] = [known.index(name) for name in wanted]
        rows, columns, free = order.values()
        return replace(
            self,
            std=self.std[:, rows][:, :, columns],
            size=self.size[:, rows][:, :, columns],
            covariance=self.covariance[np.ix_(free, free)],
            free_names=fit.free_names,
            inputs=fit.model.inputs,
            outputs=fit.model.outputs,
        )

    def at(self, omega: Array, G: ComplexArray) -> Array:
        """Its ``std`` at other frequencies (n, ny, nu), where the fit's response is G (n, ny, nu).

        Outside the band it is the share of the response that it is at its edge.
        """
        flat, size = (part.reshape(len(self.omega), -1) for part in (self.std, self.size))
        columns = [np.interp(np.log(omega), np.log(self.omega), column) for column in flat.T]
        found = np.array(columns).T
        for k, outside in ((0, omega < self.omega[0]), (-1, omega > self.omega[-1])):
            ratio = np.abs(G[outside]).reshape(-1, flat.shape[1]) / np.maximum(size[k], 1e-300)
            found[outside] *= np.where(size[k] > 0, ratio, 1.0)
        return found.reshape(len(omega), *self.std.shape[1:])

    def drawn(self, omega: Array, G: ComplexArray, count: int, *, seed: int = 0) -> ComplexArray:
        """Realisations Δ (count, n, ny, nu) at frequencies, where the fit's response is G."""
        rng, shape = np.random.default_rng(seed), (len(omega), *self.std.shape[1:])
        root = _root(omega) / np.sqrt(2)
        z = rng.standard_normal((count, *shape)) + 1j * rng.standard_normal((count, *shape))
        return np.asarray(np.einsum("kl,nlij->nkij", root, z) * self.at(omega, G))


def missed_square(difference: Array, deviation: Array, sure: float) -> Array:
    """E|Δ|² where |Δ|² less noise is found to be a difference, give or take a deviation by noise.

    The difference where there is no reason to think that anything is missed, and where there is,
    the mean of a normal number that is not below zero.
    """
    z = np.clip(difference / np.maximum(deviation, 1e-300), -1e6, 40.0)  # squares overflow beyond
    rise = np.exp(-0.5 * z**2 - scipy.special.log_ndtr(z)) / np.sqrt(2 * np.pi)
    plain, likely = np.maximum([difference, difference + deviation * rise], 0.0)
    return np.asarray((1 - sure) * plain + sure * likely)


def missed_quantile(level: float) -> float:
    """What either part of Δ is beyond with chance 1 - ``level``, in units of (E|Δ|²/2)^½.

    Less than a normal number: E|Δ|² is a mean over neighbouring frequencies of the very Δ, which
    hardly exceeds it.
    """
    omega, rng = np.geomspace(1, np.exp(WIDE * REACH), POINTS), np.random.default_rng(0)
    z = _root(omega) @ rng.standard_normal((2, POINTS, DRAWS))  # both parts
    ratio = np.abs(z) / np.sqrt(kernel(omega) @ np.mean(z**2, axis=0))
    return float(np.quantile(ratio[:, POINTS // 4 : -POINTS // 4], level))  # away from the ends


def _root(omega: Array) -> Array:
    """Square root (n, n) of the correlation of Δ."""
    values, vectors = np.linalg.eigh(nearness(omega))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _alike(F: ComplexArray) -> Array:
    """Covariance (K, K, ny, nu) of the squares of errors F z over frequency."""
    return np.asarray(np.abs(np.einsum("kijr,lijr->klij", F, F.conj(), optimize=True)) ** 2)


def _smoothed_noise(squares: Array, F: ComplexArray, omega: Array) -> Array:
    """Mean of squares over neighbouring frequencies, and how far errors F z may move it."""
    near = kernel(omega)
    variance = np.einsum("nk,nl,klij->nij", near, near, _alike(F), optimize=True)
    return np.array([np.tensordot(near, squares, 1), np.sqrt(variance)])


def _evidence(left: Array, target: BoxResponse) -> float:
    """How clearly squares beyond noise say, all pairs together, that anything is missed.

    Noise alone leaves less than nothing in the mean: estimate and black box share it.
    """
    beyond = (left - target.allowed**2) / target.variance
    alike = _alike(target.F) / (target.variance[:, None] * target.variance)
    z = beyond.sum(axis=0) / np.sqrt(np.maximum(alike.sum(axis=(0, 1)), 1e-300))
    return float(scipy.special.ndtr(z.sum() / np.sqrt(z.size) - EVIDENT))


def _own(fit: AnyFit, free: Free, dG: ComplexArray) -> Array:
    """Variance (K, ny, nu) of a fit's response by noise: bands hold it already."""
    if fit.covariance is None:
        return np.zeros(dG.shape[1:])
    at = [fit.free_names.index(name) for name in free.names]
    C = fit.covariance[np.ix_(at, at)]
    C = np.where(np.isfinite(C), C, 0.0)
    return np.asarray(np.einsum("pkij,pq,qkij->kij", dG, C, dG.conj(), optimize=True).real)


def _poles(box: BlackBox) -> tuple[ComplexArray, Array, Array]:
    """Poles with the errors of their parts; none where these are not known."""
    if isinstance(box.uncertainty, ResponseUncertainty):
        return box.uncertainty.pole_std()
    return np.empty(0, dtype=complex), np.empty(0), np.empty(0)


@one_thread
def structure_error(
    fit: AnyFit, black_box: BlackBox, *, band: tuple[float, float] | None = None
) -> Undermodelling:
    """Estimate what the structure of a fit misses of the response, by a black box of the records.

    Parameters
    ----------
    fit : Fit
        Of a linear structure.
    black_box : BlackBox
        With an uncertainty: refined to maximum likelihood.
    band : (float, float)
        Frequencies [rad/s]; those of the black box unless given.

    Raises
    ------
    ValueError
        A black box without uncertainty or without a channel of the structure.
    """
    check_asked(band, 1 / 2)
    low, high = black_box.band if band is None else band
    free = movable(fit)
    omega = np.geomspace(low, high, POINTS)
    target = BoxResponse.of(black_box, free.model, omega)
    G, dG = MatrixFunction(free)(free.guess).response_slopes(1j * omega)
    E = target.scale * G - target.G
    left = np.abs(E) ** 2 - np.sum(np.abs(target.F) ** 2, axis=-1)
    # No more than is there, so that one frequency with a large error hides nothing of the others.
    left -= np.clip(left, 0.0, _own(fit, free, target.scale * dG))
    size = np.log(np.maximum(np.abs(target.scale * G) ** 2, 1e-300))
    m = np.exp(np.tensordot(kernel(omega), size, 1))
    m /= m.max(axis=0)  # squares of what is no path at all would overflow
    square, deviation = m * _smoothed_noise(left / m, target.F / np.sqrt(m)[..., None], omega)
    sure = _evidence(left, target)
    std = np.sqrt(missed_square(square, deviation, sure))
    W = 1 / np.sqrt(target.variance + target.smoothed(E))
    inside = np.array([not fit[name].active for name in free.names], dtype=bool)
    K = np.zeros_like(dG)  # what is on a bound stays there, and others do not follow it
    K[inside] = gain(target.scale * dG[inside], W)
    root = (
        std[:, None]
        * np.linalg.cholesky(nearness(omega) + 1e-6 * np.eye(POINTS))[:, :, None, None]
        / np.sqrt(2)
    )
    moved = np.einsum("pkij,klij->plij", K, root, optimize=True).reshape(len(K), -1)
    poles, *pole_std = _poles(black_box)
    return Undermodelling(
        omega=omega,
        std=std / target.scale,
        covariance=moved.real @ moved.real.T + moved.imag @ moved.imag.T,
        poles=poles,
        pole_std=np.array(pole_std),
        free_names=free.names,
        inputs=free.model.inputs,
        outputs=free.model.outputs,
        size=np.abs(G),
        sure=sure,
    )
