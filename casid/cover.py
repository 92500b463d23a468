"""A stable weight that covers what a nominal model may be wrong by, for robust control.

W(s) of given order with abs(W(jω)) >= σ_max(Δ(jω)) for every model of an ensemble,

    additive:                        Δ = G - G_0
    multiplicative at the output:    Δ = (G - G_0) G_0⁺,    G = (I + Δ) G_0

(K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, chapter 9). abs(W)² = P(ω²)/Q(ω²): for
a ratio γ, P and Q with m² Q <= P <= γ² m² Q over the grid is a linear programme in their
coefficients, so the least γ is found by bisection; the roots in the left half-plane are W. Where
P or Q falls below zero between the points that keep it above, its least values join them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.polynomial import Chebyshev

from casid.arrays import Array, ComplexArray
from casid.display import Shown, counted
from casid.linear import StateSpace
from casid.threads import one_thread
from casid.validation import AnyModel, state_space

Kind = Literal["additive", "multiplicative"]
GRID = 400  # points of the certificate in a decade
POINTS = 100  # of the linear programme
EVERYWHERE = 150  # points from zero to infinity where P and Q must stay above zero
CLEAR = 1e-5  # how far, relative to their size
ROUNDS = 12  # of points added to those
AXIS = 1e-8  # damping ratio below which a response at a pole is nothing but rounding
TIGHT = 3e-3  # relative width of the last interval of γ
LIGHT = 0.02  # damping ratio below which the grid may step over a resonance
HIGH = 1.05  # how far below the highest a peak may be that is looked at more closely
RANK = 1e-12  # of the largest singular value: G_0 lacks rank below
SHARE = 0.1  # of a direction without effect: an input that is named
BETWEEN = 4e-6  # by how much W is lifted for what a still denser grid finds
LIFT = 1.01  # how far W may be lifted for what lies between the points of the fit
STEP = 0.05  # of the error's logarithm from point to point, above which one is put between
NOTHING = 1e-300  # the least error: a logarithm is taken
ROUNDING = 1e-12  # of a response: an error below is none
DENSEST = 100_000  # points of a grid at most, where the error is all rounding
HALVINGS = 30  # of an interval at most


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Cover(Shown):
    """A weight with its certificate.

    Parameters
    ----------
    weight : StateSpace
        W(s), one input and one output, stable and of minimum phase.
    kind : {"additive", "multiplicative"}
        What it multiplies.
    omega : (K,) array
        Dense grid of the certificate [rad/s].
    error : (K,) array
        Largest σ_max(Δ) of all models.
    excess : float
        Geometric mean of abs(W)/error over the grid, in log ω; 1 is as tight as can be.
    margin : float
        Least of abs(W)/error over the grid; at least 1.
    models : int
        How many are covered.
    """

    weight: StateSpace
    kind: Kind
    omega: Array
    error: Array
    excess: float
    margin: float
    models: int

    def headline(self) -> str:
        """Order, kind, how tight."""
        return (
            f"{self.kind}, order {self.weight.nx}, {self.models} models, {self.omega[0]:.3g} to "
            f"{self.omega[-1]:.3g} rad/s, {self.excess:.3g} times the error in the mean, "
            f"{self.margin:.4g} times at least"
        )


@one_thread
def cover(
    nominal: AnyModel,
    models: Sequence[AnyModel],
    *,
    band: tuple[float, float],
    order: int = 4,
    kind: Kind = "additive",
    scale: tuple[Sequence[float], Sequence[float]] | None = None,
) -> Cover:
    """Find a stable weight of given order that covers the differences of models to a nominal one.

    A nonlinear structure, or its fit, counts as its linearisation at its reference condition; give
    ``model.at(trim)`` of each for another.

    Parameters
    ----------
    nominal : Fit, Model, BlackBox or StateSpace
        G_0, continuous.
    models : sequence of the same
        The ensemble: `sample_models` of a fit, models at other speeds, fits of other flights.
    band : (float, float)
        Frequencies [rad/s] to cover.
    order : int
        States of W, 1 to 10; fewer where more make it no tighter, or where poles or zeros would lie
        too close to the imaginary axis to be told from it.
    kind : {"additive", "multiplicative"}
        Additive, or multiplicative at the output: for that G_0 needs as many outputs as inputs at
        least.
    scale : (sequence, sequence)
        Sizes of the inputs and of the outputs that one unit of Δ stands for; one each unless given.

    Raises
    ------
    ValueError
        No model, discrete ones, other channels; numbers of unstable poles that differ (robust
        stability cannot be concluded from a weight then); fewer outputs than inputs of a
        multiplicative one, or a nominal model that lacks column rank in the band; poles on the
        imaginary axis in the band, where the error is infinite; an order or a band out of range;
        sizes that are not positive.
    """
    low, high = band
    if not 0 < low < high < np.inf:
        raise ValueError(f"band={band}: expected two increasing finite frequencies above 0 rad/s")
    if not 1 <= order <= 10:
        raise ValueError(f"order={order}: expected 1 to 10")
    if kind not in get_args(Kind):
        raise ValueError(f"kind={kind!r}: expected one of {', '.join(get_args(Kind))}")
    systems = [state_space(each) for each in (nominal, *models)]
    _check(systems, kind, band)
    points = max(GRID, int(GRID * np.log10(high / low)))
    poles = np.concatenate([each.poles() for each in systems])
    omega = np.union1d(np.geomspace(low, high, points), _resonances(poles, low, high))
    errors = partial(_largest, systems, kind, scale=scale)
    error = errors(omega)
    if (error <= _largest([systems[0]] * 2, kind, omega, scale)).all():
        raise ValueError("all models equal the nominal one: there is no error to cover")
    weight = _tightest(omega, error, errors, order)
    ratio = np.abs(weight.response(omega)[:, 0, 0]) / error
    return Cover(
        weight=weight,
        kind=kind,
        omega=omega,
        error=error,
        models=len(models),
        excess=float(np.exp(np.mean(np.log(ratio)))),
        margin=float(ratio.min()),
    )


def _check(systems: Sequence[StateSpace], kind: Kind, band: tuple[float, float]) -> None:
    """Refuse what no weight can cover."""
    first, *others = systems
    if not others:
        raise ValueError("no models given to cover; sample_models(fit, 100) draws some")
    unstable = _unstable(first)
    for number, system in enumerate(systems):
        name = f"model {number}" if number else "the nominal model"
        if system.dt is not None:
            raise ValueError(f"{name} is discrete; convert it first (BlackBox.continuous)")
        if (system.inputs, system.outputs) != (first.inputs, first.outputs):
            raise ValueError(f"{name} has other inputs or outputs than the nominal one")
        poles = system.poles()
        bare = np.abs(poles.imag[np.abs(poles.real) <= AXIS * np.abs(poles)])
        if (at := bare[(bare >= band[0]) & (bare <= band[1])]).size:
            raise ValueError(
                f"{name} has poles on the imaginary axis at {at[0]:.4g} rad/s, in the band of "
                f"{band[0]:g} to {band[1]:g} rad/s: its response is infinite there and no weight "
                "covers it; take a band without them, or a model that has damping"
            )
        if _unstable(system) != unstable:
            raise ValueError(
                f"{name} has {_unstable(system)} unstable poles, the nominal one {unstable}: a "
                "weight says nothing about stability then; take another nominal model, or fewer"
            )
    if kind == "multiplicative" and first.ny < first.nu:
        raise ValueError(
            f"{first.ny} outputs from {first.nu} inputs: an error at the output needs as many "
            'outputs as inputs at least; take kind="additive" or fewer inputs'
        )


def _unstable(system: StateSpace) -> int:
    return int(np.sum(system.poles().real > 0))


def _largest(
    systems: Sequence[StateSpace],
    kind: Kind,
    omega: Array,
    scale: tuple[Sequence[float], Sequence[float]] | None,
) -> Array:
    """Largest singular value of Δ of any model at every frequency, (K,)."""
    first, *others = systems
    inputs, outputs = scale or (np.ones(first.nu), np.ones(first.ny))
    right, sizes = np.asarray(inputs, float), np.asarray(outputs, float)
    if right.shape != (first.nu,) or sizes.shape != (first.ny,):
        raise ValueError(
            f"scale={scale}: expected sizes of {counted(first.nu, 'input')} and of "
            f"{counted(first.ny, 'output')}"
        )
    if not all((each > 0).all() and np.isfinite(each).all() for each in (right, sizes)):
        raise ValueError(f"scale={scale}: expected finite sizes above 0")
    left = np.reciprocal(sizes)
    G0 = left[:, None] * first.response(omega) * right
    inverse = _inverse(G0, omega, first.inputs) if kind == "multiplicative" else None
    largest = np.zeros(len(omega))
    for system in others:
        delta = left[:, None] * system.response(omega) * right - G0
        delta = delta if inverse is None else delta @ inverse
        largest = np.maximum(largest, np.linalg.norm(delta, ord=2, axis=(1, 2)))
    size = np.linalg.norm(G0, ord=2, axis=(1, 2))
    size = size if inverse is None else size * np.linalg.norm(inverse, ord=2, axis=(1, 2))
    floor = 1e-6 * largest.max(initial=NOTHING)  # a weight has no exact zero
    return np.asarray(np.fmax.reduce([largest, np.full(len(omega), floor), ROUNDING * size]))


def _inverse(G0: ComplexArray, omega: Array, inputs: Sequence[str]) -> ComplexArray:
    """G_0⁺ (K, nu, ny); ValueError where inputs do nothing, which an error at the output misses."""
    U, sizes, V = np.linalg.svd(G0, full_matrices=False)
    if (short := sizes[:, -1] <= RANK * sizes[:, 0]).any():
        without = np.abs(V[short, -1]).max(axis=0)  # what moves no output, by input
        names = [name for name, share in zip(inputs, without, strict=True) if share > SHARE]
        raise ValueError(
            f"the nominal model does not answer to {' and '.join(names)} on their own at "
            f"{omega[short].min():.4g} to {omega[short].max():.4g} rad/s: no error at its output "
            'stands for models that do; take kind="additive", another nominal model or fewer inputs'
        )
    return np.asarray(((U / sizes[:, None]) @ V).conj().swapaxes(1, 2))


def _fitted(omega: Array, error: Array, order: int) -> tuple[Chebyshev, Chebyshev, float]:
    """P, Q as polynomials of x = (ω² - c)/(ω² + c), and c, with the least γ."""
    center, size = float(omega[0] * omega[-1]), float(np.exp(np.mean(np.log(error))))
    some = np.linspace(0, len(omega) - 1, POINTS).astype(int)
    x = ((omega**2 - center) / (omega**2 + center))[some]
    m2 = (error[some] / size) ** 2
    low, high = 0.0, float(np.log(m2.max() / m2.min())) + 0.1
    best = Chebyshev([m2.max()]), Chebyshev([1.0])  # a constant, if nothing is better
    while high - low > TIGHT:
        middle = 0.5 * (low + high)
        found = _between(x, m2, np.exp(middle), order)
        low, high, best = (low, middle, found) if found is not None else (middle, high, best)
    return size**2 * best[0], best[1], center


def _between(x: Array, m2: Array, gamma2: float, order: int) -> tuple[Chebyshev, Chebyshev] | None:
    """P and Q of degree ``order`` with m² Q <= P <= γ² m² Q, both above zero from -1 to 1."""
    points = np.cos(np.linspace(0, np.pi, EVERYWHERE))
    for _ in range(ROUNDS):
        if (found := _programme(x, m2, gamma2, order, points)) is None:
            return None
        P, Q = found
        added = np.concatenate([_dips(P, 0.5 * CLEAR * m2.min()), _dips(Q, 0.5 * CLEAR)])
        if not added.size:
            return found
        points = np.concatenate([points, added])
    return None


def _dips(of_x: Chebyshev, floor: float) -> Array:
    """Where from -1 to 1 a polynomial has extremes below a floor."""
    extremes = np.clip(of_x.deriv().roots().real, -1.0, 1.0)
    return np.asarray(extremes[of_x(extremes) < floor])


def _programme(
    x: Array, m2: Array, gamma2: float, order: int, points: Array
) -> tuple[Chebyshev, Chebyshev] | None:
    """P and Q with m² Q <= P <= γ² m² Q, if there are any, both above zero at the points."""
    # Of all that will do those furthest above zero on the whole axis, 0 to infinity: roots on it
    # would be poles or zeros on the imaginary axis. The unknowns are P, Q and that distance.
    T = np.polynomial.chebyshev.chebvander(x, order) / m2[:, None]
    E = np.polynomial.chebyshev.chebvander(points, order)
    none, one = np.zeros((len(x), 1)), np.ones((len(E), 1))
    Q = T * m2[:, None]
    rows = np.block(
        [
            [-T, Q, none],
            [T / gamma2, -Q, none],
            [np.zeros_like(E), -E, one],
            [-E / m2.min(), np.zeros_like(E), one],
        ]
    )
    n = 2 * order + 3
    answer = scipy.optimize.linprog(
        -np.eye(n)[-1],
        A_ub=rows,
        b_ub=np.zeros(len(rows)),
        A_eq=np.eye(n)[order + 1 : order + 2],
        b_eq=[1.0],
        bounds=(None, None),
        method="highs",
    )
    if answer.x is None or answer.status != 0 or answer.x[-1] < CLEAR:
        return None
    return Chebyshev(answer.x[: order + 1]), Chebyshev(answer.x[order + 1 : -1])


def _resonances(roots: ComplexArray, low: float, high: float) -> Array:
    """Frequencies within a band at and beside lightly damped roots."""
    light = roots[(roots.imag > 0) & (np.abs(roots.real) < LIGHT * roots.imag)]
    beside = light.imag[:, None] + np.abs(light.real)[:, None] * np.linspace(-4, 4, 17)
    return np.asarray(beside[(beside >= low) & (beside <= high)])


def _tightest(
    omega: Array, error: Array, errors: Callable[[Array], Array], order: int
) -> StateSpace:
    """W of up to so many states that covers the errors on a denser grid and at its own resonances.

    A high order may set a notch between the points of its fit, which lifts all of it: a lower one
    is tried then, and where rounding takes a pole or zero out of the left half-plane; a constant
    always does.
    """
    none = np.zeros(0, dtype=complex)
    best, least = _system(none, none), np.inf
    dense, m = _resolved(omega, error, errors)
    for states in range(order, -1, -1):
        P, Q, center = _fitted(omega, error, states)
        degree = max(P.degree(), Q.degree(), 1)  # of a constant one that cancels
        W = _system(*(_stable_roots(each, center, degree) for each in (P, Q)))
        roots = np.concatenate([W.poles(), np.linalg.eigvals(W.A - W.B @ W.C / W.D)])
        if not (roots.real < -AXIS * np.abs(roots)).all():
            continue
        size = np.abs(W.response(omega)[:, 0, 0])
        fitted, needed = float(np.max(error / size)), _least_gain(W, roots, dense, m, errors)
        gain = max(fitted, needed) * (1 + BETWEEN)
        excess = float(np.mean(np.log(gain * size / error)))
        if excess < least:
            best, least = replace(W, C=gain * W.C, D=gain * W.D), excess
        if needed <= LIFT * fitted:
            break
    return best


def _resolved(omega: Array, error: Array, errors: Callable[[Array], Array]) -> tuple[Array, Array]:
    """A grid with points between wherever the error leaps, and the errors: resonances whole."""
    for _ in range(HALVINGS):
        leaps = np.flatnonzero(np.abs(np.diff(np.log(error))) > STEP)
        leaps = leaps[omega[leaps + 1] > omega[leaps] * (1 + AXIS)]
        if not leaps.size or len(omega) > DENSEST:
            break
        between = 0.5 * (omega[leaps] + omega[leaps + 1])
        omega = np.insert(omega, leaps + 1, between)
        error = np.insert(error, leaps + 1, errors(between))
    return omega, error


def _least_gain(
    W: StateSpace, roots: ComplexArray, omega: Array, error: Array, errors: Callable[[Array], Array]
) -> float:
    """Largest error/abs(W) on a grid, at the roots of W, and between the points by closer looks."""
    ratio = error / np.abs(W.response(omega)[:, 0, 0])
    at = np.concatenate([_resonances(roots, omega[0], omega[-1]), _peaks(omega, ratio)])
    for _ in range(2):
        own = errors(at) / np.abs(W.response(at)[:, 0, 0])
        omega, first = np.unique(np.concatenate([omega, at]), return_index=True)
        ratio = np.concatenate([ratio, own])[first]
        at = _peaks(omega, ratio)
    return float(ratio.max())


def _peaks(omega: Array, ratio: Array) -> Array:
    """Frequencies around the highest peaks of a ratio on a grid, within its neighbouring points."""
    inner = ratio[1:-1]
    high = (inner >= ratio[:-2]) & (inner >= ratio[2:]) & (inner > ratio.max() / HIGH)
    at = 1 + np.flatnonzero(high)
    share = np.linspace(0, 1, 21)
    return np.asarray(
        (omega[at - 1, None] + (omega[at + 1] - omega[at - 1])[:, None] * share).ravel()
    )


def _system(zeros: ComplexArray, poles: ComplexArray) -> StateSpace:
    A, B, C, D = (part.real for part in scipy.signal.zpk2ss(zeros, poles, 1.0))
    return StateSpace(A, B, C, D, None, ("w",), ("z",))


def _stable_roots(of_x: Chebyshev, center: float, degree: int) -> ComplexArray:
    """Roots s in the left half-plane of a polynomial of x, s² = -ω² = -c (1 + x)/(1 - x)."""
    x = of_x.trim(1e-12 * np.abs(of_x.coef).max()).roots().astype(complex)
    roots = -np.sqrt(-center * (1 + x) / (1 - x))
    # A degree that is missing in x is a factor ω² + c.
    return np.concatenate([roots, np.full(degree - len(x), -np.sqrt(center))])
