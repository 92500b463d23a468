"""Low-order equivalent systems: a transfer function with delay fitted to one measured pair.

    G(s) = (b_0 s^m + ... + b_m)/(s^n + a_1 s^(n-1) + ... + a_n) e^(-τs)

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 11
(*T&R*; there the programme is NAVFIT); the cost J is that of `casid.matching.mismatch`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array, BoolArray, ComplexArray
from casid.display import Shown
from casid.errors import ConvergenceError, warn
from casid.frequency.response import FrequencyResponse, response_of_pair
from casid.matching.mismatch import DB, DEG, TURN, log_ratio, pair_weights, weighted_errors
from casid.records import several

STEP = 0.25  # rad of the fastest point's phase between delays to start from
BLOCK = 4  # such delays, of which the best is a start
TRIED, SIFTING = 10, 30  # starts of which so many evaluations tell
REFINED = 4  # starts that are carried to the end
SWEEPS = 8  # Sanathanan-Koerner iterations of a start
UNTOLD = 1e6  # times the error that an unknown has if all others are known: not determined
ROUNDING = 1e-8  # part in a direction without effect that is none


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TransferFunction(Shown):
    """A low-order equivalent system and how well it fits.

    Parameters
    ----------
    numerator, denominator : (nz + 1,), (np + 1,) array
        Coefficients of falling powers of s, the denominator's first is 1.
    delay : float
        τ [s], >= 0.
    J : float
        Cost, T&R: up to 100 is acceptable, up to 50 hardly distinguishable from the measurement.
    std_error : (nz + 1 + np + 1,) array
        √(H⁻¹)ᵢᵢ of the numerator's, the denominator's free coefficients and the delay, H the
        Gauss-Newton Hessian of J; infinite where the measurement does not tell coefficients apart,
        NaN for a delay that is fixed or at 0.
    omega : (K,) array
        Frequencies fitted [rad/s].
    mismatch_db, mismatch_deg : (K,) array
        Fit minus measurement, gain in dB and phase in degrees.
    output, input : str
        The pair.
    """

    numerator: Array
    denominator: Array
    delay: float
    J: float
    std_error: Array
    omega: Array
    mismatch_db: Array
    mismatch_deg: Array
    output: str
    input: str

    def headline(self) -> str:
        """Pair, degrees, delay and cost."""
        degrees = len(self.numerator) - 1, len(self.denominator) - 1
        return (
            f"{self.output}/{self.input}, degrees {degrees[0]}/{degrees[1]}, delay "
            f"{round(self.delay, 6):g} s, J {self.J:.3g}"
        )

    @property
    def poles(self) -> ComplexArray:
        """Roots of the denominator [1/s]."""
        return np.roots(self.denominator).astype(complex)

    @property
    def zeros(self) -> ComplexArray:
        """Roots of the numerator [1/s]."""
        return np.roots(self.numerator).astype(complex)

    def response(self, omega: Array) -> ComplexArray:
        """Frequency response, (K,)."""
        s = 1j * np.asarray(omega, dtype=float)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-s * self.delay))

    def to_control(self) -> Any:  # noqa: ANN401 - python-control has no types
        """The rational part as a `control.TransferFunction`; the delay is not in it."""
        import control  # noqa: PLC0415 - slow to import, and only wanted here

        return control.TransferFunction(
            self.numerator, self.denominator, inputs=[self.input], outputs=[self.output]
        )


def transfer_function(
    target: FrequencyResponse | Sequence[FrequencyResponse],
    order: tuple[int, int],
    *,
    delay: bool = True,
    pair: tuple[str, str] | None = None,
    band: tuple[float, float] | None = None,
    coherence: float = 0.6,
) -> TransferFunction:
    """The transfer function of given order that fits one pair best in dB and degrees.

    Parameters
    ----------
    target : FrequencyResponse, or several
        The measurement; the first that has the pair is fitted.
    order : (int, int)
        Degrees (nz, np) of numerator and denominator.
    delay : bool
        Whether a delay τ >= 0 is estimated too: the best of all that the phase admits, which moves
        through that of the delay less a quarter of a turn a pole or zero.
    pair : (output, input)
        Which pair; may be left out of a response that has one.
    band, coherence : (float, float), float
        Frequencies to fit [rad/s], all unless given; points of less coherence are left out.

    Raises
    ------
    ValueError, ConvergenceError
        An order that makes no sense, a pair without enough coherent points; no start led to a fit.
        A `DataWarning` tells of an order of which the measurement does not tell all coefficients,
        and of a fit that may still get better.
    """
    degrees = [float(degree) for degree in order]
    if len(degrees) != 2 or not all(each >= 0 and each.is_integer() for each in degrees):
        raise ValueError(
            f"order={order}: expected degrees (nz, np) of numerator and denominator, whole and >= 0"
        )
    nz, np_ = map(int, degrees)
    output, name = _pair(target, pair)
    frf = response_of_pair(target, (output, name))
    frf = frf if band is None else frf.between(*band)
    i, j = frf.index(output, name)
    G, gamma = frf.G[:, i, j], frf.coherence[:, i, j]
    used = np.isfinite(G) & (np.abs(G) > 0) & np.isfinite(gamma) & (gamma >= coherence)
    unknowns = nz + 1 + np_ + bool(delay)
    if 2 * used.sum() < unknowns + 1:
        raise ValueError(
            f"pair ({output!r}, {name!r}) has {used.sum()} points with coherence >= {coherence:g}, "
            f"too few for the {unknowns} unknowns of order {order}; lower the order or the "
            "threshold, or improve the measurement"
        )
    problem = _TransferFunctionFit(frf.omega[used], G[used], gamma[used], (nz, np_), delay)
    x, settled = problem.solve()
    std_error, doubt = problem.std_error(x), problem.doubt(x, settled=settled)
    if doubt:
        warn(f"transfer function of order ({nz}, {np_}) for {output}/{name}: {doubt}")
    numerator, denominator, tau = problem.unpack(x)
    found = problem.response(x)
    difference = log_ratio(found, problem.G)
    return TransferFunction(
        numerator=numerator, denominator=denominator, delay=tau,
        J=float(np.sum(problem.residual(x) ** 2)), std_error=std_error,
        omega=problem.omega, mismatch_db=DB * difference.real, mismatch_deg=DEG * difference.imag,
        output=output, input=name,
    )  # fmt: skip


def _pair(
    target: FrequencyResponse | Sequence[FrequencyResponse], pair: tuple[str, str] | None
) -> tuple[str, str]:
    if pair is not None:
        return pair
    pairs = [(y, u) for frf in several(target) for y in frf.outputs for u in frf.inputs]
    if len(pairs) != 1:
        known = ", ".join(f"{y}/{u}" for y, u in pairs)
        raise ValueError(f"the response has pairs {known}: name one pair=(output, input)")
    return pairs[0]


class _TransferFunctionFit:
    """J as a least-squares problem in numerator, denominator and delay, s in units of ω₀."""

    def __init__(
        self, omega: Array, G: ComplexArray, gamma: Array, order: tuple[int, int], delay: bool
    ) -> None:
        self.omega, self.G, self.gamma, self.order, self.delay = omega, G, gamma, order, delay
        self.weight = pair_weights(gamma, np.ones(len(omega), dtype=bool))
        self.unit = float(np.sqrt(omega[0] * omega[-1]))
        self.size = float(np.median(np.abs(G)))
        self.s = 1j * omega / self.unit

    def unpack(self, x: Array) -> tuple[Array, Array, float]:
        """Numerator, denominator and delay in physical units."""
        nz, n = self.order
        scale = self._scale()
        denominator = np.concatenate([[1.0], (x * scale)[nz + 1 : nz + 1 + n]])
        return (x * scale)[: nz + 1], denominator, float(x[-1] * scale[-1]) if self.delay else 0.0

    def _scale(self) -> Array:
        nz, n = self.order
        powers = self.unit ** np.concatenate([n - np.arange(nz, -1.0, -1), np.arange(1.0, n + 1)])
        powers[: nz + 1] *= self.size
        return np.append(powers, 1 / self.unit) if self.delay else powers

    def response(self, x: Array) -> ComplexArray:
        nz, n = self.order
        top = np.polyval(x[: nz + 1], self.s)
        bottom = np.polyval(np.append(1.0, x[nz + 1 : nz + 1 + n]), self.s)
        late = np.exp(-self.s * x[-1]) if self.delay else 1.0
        return np.asarray(self.size * top / bottom * late)

    def residual(self, x: Array) -> Array:
        return weighted_errors(self.response(x), self.G, self.weight).ravel()

    def jacobian(self, x: Array) -> Array:
        """Of the residuals: d ln G is that of numerator, denominator and delay in turn."""
        nz, n = self.order
        top = np.polyval(x[: nz + 1], self.s)
        bottom = np.polyval(np.append(1.0, x[nz + 1 : nz + 1 + n]), self.s)
        columns = [self.s**k / top for k in range(nz, -1, -1)]
        columns += [-(self.s**k) / bottom for k in range(n - 1, -1, -1)]
        columns += [-self.s] if self.delay else []
        d = np.sqrt(self.weight)[:, None] * np.column_stack(columns)
        return np.vstack([DB * d.real, TURN * d.imag])

    def solve(self) -> tuple[Array, bool]:
        """The best of all starts, and whether it has settled.

        One that has not counts all the same: coefficients that the measurement does not determine
        wander off for ever where the fit no longer gets better.
        """
        lower = np.full(sum(self.order) + 1 + self.delay, -np.inf)
        if self.delay:
            lower[-1] = 0.0
        solver = partial(scipy.optimize.least_squares, self.residual, jac=self.jacobian)
        fit = partial(
            solver, bounds=(lower, np.inf), x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12
        )
        starts = [*self._starts(), *self._nested()]
        if self.delay:
            starts = [np.append(start[:-1], max(start[-1], 1e-6)) for start in starts]
        sifted = [fit(x0=start, max_nfev=SIFTING) for start in starts]
        sifted.sort(key=lambda result: result.cost)
        found = [fit(x0=result.x, max_nfev=500) for result in sifted[:REFINED]]
        if not found:
            raise ConvergenceError(
                f"no transfer function of order {self.order} fits; try another order or band"
            )
        best = min(found, key=lambda result: result.cost)
        return np.asarray(best.x), best.status > 0

    def _starts(self) -> list[Array]:
        """The best of every radian or so that a delay adds at the fastest point.

        J has valleys over the delay, the phase being wrapped; for each delay the rest is linear.
        """
        starts = [self._start(tau) for tau in self._delays()]
        told = [(float(np.sum(self.residual(x) ** 2)), x) for x in starts if x is not None]
        blocks = [told[k : k + BLOCK] for k in range(0, len(told), BLOCK)]
        best = sorted((min(block, key=itemgetter(0)) for block in blocks), key=itemgetter(0))
        return [x for _, x in best[:TRIED]]

    def _delays(self) -> Array:
        """All delays that the phase admits, in units of 1/ω₀.

        What it moves through over the band, and what the rational part may hide of a delay: its
        phase rises by a quarter of a turn a root at most.
        """
        if not self.delay:
            return np.zeros(1)
        s = np.abs(self.s)
        moved = np.abs(np.angle(self.G[1:] / self.G[:-1])).sum()
        longest = (moved + sum(self.order) * np.pi / 2) / (s[-1] - s[0])
        return np.arange(0.0, longest + STEP / s[-1], STEP / s[-1])

    def _nested(self) -> list[Array]:
        """The fit of one degree less with a pole on a zero: no higher order fits worse than it."""
        nz, n = self.order
        if nz == 0 or n == 0:
            return []
        lower = _TransferFunctionFit(self.omega, self.G, self.gamma, (nz - 1, n - 1), self.delay)
        try:
            x = lower.solve()[0]
        except ConvergenceError:
            return []
        top, bottom = x[:nz], np.append(1.0, x[nz : nz + n - 1])
        pair = [np.convolve(each, [1.0, 1.0]) for each in (top, bottom)]
        return [np.concatenate([pair[0], pair[1][1:], x[nz + n - 1 :]])]

    def _start(self, tau: float) -> Array | None:
        """Sanathanan & Koerner (1963): linear least squares, reweighted by the last denominator."""
        nz, n = self.order
        G = self.G / self.size * np.exp(self.s * tau)
        bottom = np.ones(len(self.s), dtype=complex)
        x = np.zeros(nz + 1 + n)
        for _ in range(SWEEPS):
            w = np.sqrt(self.weight) / np.abs(G * bottom)
            columns = [self.s**k for k in range(nz, -1, -1)]
            columns += [-G * self.s**k for k in range(n - 1, -1, -1)]
            M, right = w[:, None] * np.column_stack(columns), w * G * self.s**n
            real = np.vstack([M.real, M.imag]), np.concatenate([right.real, right.imag])
            x = np.linalg.lstsq(*real, rcond=None)[0]
            bottom = np.polyval(np.append(1.0, x[nz + 1 :]), self.s)
            if not (np.isfinite(x).all() and np.abs(bottom).min() > 0):
                return None
        return np.append(x, tau) if self.delay else x

    def std_error(self, x: Array) -> Array:
        """√(H⁻¹)ᵢᵢ in physical units, H = 2 JᵀJ; NaN for a delay on its bound."""
        J, free = self._free_jacobian(x)
        std = np.full(len(x), np.nan)
        std[free] = _root_of_inverse(J)
        std *= self._scale()
        return std if self.delay else np.append(std, np.nan)

    def doubt(self, x: Array, *, settled: bool) -> str:
        """What speaks against a fit, with the remedy; nothing if nothing does."""
        (nz, n), (J, free) = self.order, self._free_jacobian(x)
        b, a = (f"b_{i}" for i in range(nz + 1)), (f"a_{i}" for i in range(1, n + 1))
        names = np.array([*b, *a, "the delay"][: len(x)])[free]
        alone = 1 / (np.sqrt(2) * np.linalg.norm(J, axis=0))
        if lost := list(names[_root_of_inverse(J) > UNTOLD * alone]):
            return f"the measurement does not determine {', '.join(lost)}; lower the order"
        return "" if settled else "J may still improve; lower the order, or choose another band"

    def _free_jacobian(self, x: Array) -> tuple[Array, BoolArray]:
        """Derivatives of the residuals by the unknowns off their bounds, and which these are."""
        free: BoolArray = np.ones(len(x), dtype=bool)
        free[-1] = not self.delay or x[-1] > 1e-6
        return self.jacobian(x)[:, free], free


def _root_of_inverse(J: Array) -> Array:
    """√((2 JᵀJ)⁻¹)ᵢᵢ from the singular values of J = U S Vᵀ, which JᵀJ would square.

    Infinite for unknowns with a part in a direction that moves no residual.
    """
    unit = np.linalg.norm(J, axis=0)
    _, S, Vt = np.linalg.svd(J / unit, full_matrices=False)
    lost = max(J.shape) * np.finfo(float).eps * S[0] >= S
    square = np.sum((Vt[~lost] / S[~lost, None]) ** 2, axis=0)
    square[(np.abs(Vt[lost]) > ROUNDING).any(axis=0)] = np.inf
    return np.asarray(np.sqrt(square / 2) / unit)
