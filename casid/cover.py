"""A stable weight that covers what a nominal model may be wrong by, for robust control.

W(s) of given order with abs(W(jω)) >= σ_max(Δ(jω)) for every model of an ensemble,

    additive:                        Δ = G - G_0
    multiplicative at the output:    Δ = (G - G_0) G_0⁺,    G = (I + Δ) G_0

(K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, chapter 9). W is the tightest in the
mean of its order: a peak of hardly any damping costs it what the peak is wide, where the least of
the largest ratio to the error would let the peak lift all of W.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.display import Shown, counted
from casid.linear import StateSpace
from casid.magnitudes import TIGHT, mean, realisation, roots, with_two_states_more
from casid.threads import one_thread
from casid.validation import AnyModel, state_space

ErrorKind = Literal["additive", "multiplicative"]
GRID = 400  # points of the certificate in a decade
MOST = 10  # states
WORTH = 2e-3  # of the mean's logarithm, that two states more must save
AXIS = 1e-8  # damping ratio below which a response at a pole is nothing but rounding
LIGHT = 0.02  # damping ratio below which the grid may step over a resonance
HIGH = 1.05  # how far below the highest a peak may be that is looked at more closely
RANK = 1e-12  # of the largest singular value: G_0 lacks rank below
SHARE = 0.1  # of a direction without effect: an input that is named
BETWEEN = 4e-6  # by how much W is lifted for what a still denser grid finds
STEP = 0.05  # of the error's logarithm from point to point, above which one is put between
NOTHING = 1e-300  # the least error: a logarithm is taken
ROUNDING = 1e-12  # of a response: an error below is none
DENSEST = 100_000  # points of a grid at most, where the error is all rounding
HALVINGS = 30  # of an interval at most


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Cover(Shown):
    """A weight that covers the errors of models, with its certificate.

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
        Geometric mean of abs(W)/error over log ω; 1 is as tight as can be.
    enough : int or None
        States with which ``excess`` is at most 1.5, if need be more than were asked for, two at a
        time; None where 10 are too few.
    margin : float
        Least of abs(W)/error over the grid; at least 1.
    models : int
        How many are covered.
    """

    weight: StateSpace
    kind: ErrorKind
    omega: Array
    error: Array
    excess: float
    enough: int | None
    margin: float
    models: int

    def headline(self) -> str:
        """Order, kind, how tight; what would be, if it is not."""
        most = f"an order of {self.enough}" if self.enough else f"no order up to {MOST}"
        return (
            f"{self.kind}, order {self.weight.nx}, {self.models} models, {self.omega[0]:.3g} to "
            f"{self.omega[-1]:.3g} rad/s, {self.excess:.3g} times the error in the mean, "
            f"{self.margin:.4g} times at least"
            + (f"; {most} makes that at most {TIGHT:g}" if self.excess > TIGHT else "")
        )


@one_thread
def cover(
    nominal: AnyModel,
    models: Sequence[AnyModel],
    *,
    band: tuple[float, float],
    order: int = 4,
    kind: ErrorKind = "additive",
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
        States of W, 1 to 10; fewer where more make it no tighter.
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
    if not 1 <= order <= MOST:
        raise ValueError(f"order={order}: expected 1 to {MOST}")
    if kind not in get_args(ErrorKind):
        raise ValueError(f"kind={kind!r}: expected one of {', '.join(get_args(ErrorKind))}")
    systems = [state_space(each) for each in (nominal, *models)]
    _check(systems, kind, band)
    points = max(GRID, int(GRID * np.log10(high / low)))
    poles = np.concatenate([each.poles() for each in systems])
    omega = np.union1d(np.geomspace(low, high, points), _resonances(poles, low, high))
    errors = partial(_largest, systems, kind, scale=scale)
    error = errors(omega)
    if (error <= _largest([systems[0]] * 2, kind, omega, scale)).all():
        raise ValueError("all models equal the nominal one: there is no error to cover")
    weight, enough = _tightest(omega, error, errors, order)
    ratio = np.abs(weight.response(omega)[:, 0, 0]) / error
    return Cover(
        weight=weight,
        kind=kind,
        omega=omega,
        error=error,
        models=len(models),
        excess=float(np.exp(mean(np.log(omega), np.log(ratio)))),
        enough=enough,
        margin=float(ratio.min()),
    )


def _check(systems: Sequence[StateSpace], kind: ErrorKind, band: tuple[float, float]) -> None:
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
    kind: ErrorKind,
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


def _resonances(roots: ComplexArray, low: float, high: float) -> Array:
    """Frequencies within a band at and beside lightly damped roots."""
    light = roots[(roots.imag > 0) & (np.abs(roots.real) < LIGHT * roots.imag)]
    beside = light.imag[:, None] + np.abs(light.real)[:, None] * np.linspace(-4, 4, 17)
    return np.asarray(beside[(beside >= low) & (beside <= high)])


def _tightest(
    omega: Array, error: Array, errors: Callable[[Array], Array], order: int
) -> tuple[StateSpace, int | None]:
    """W of up to so many states that covers the errors, and the states with which it is tight.

    Two states more begin where fewer ended: no order does worse than a lower one.
    """
    dense, m = _resolved(omega, error, errors)
    x, y = np.log(dense), 2 * np.log(m)
    v, least, enough = np.array([y.max()]), np.inf, None
    best = realisation(v)
    for states in range(order % 2, MOST + 1, 2):
        v = with_two_states_more(v, x, y, states, tries=3 if states <= order else 1)
        W = realisation(v)
        gain = _least_gain(W, roots(v), dense, m, errors) * (1 + BETWEEN)
        excess = mean(x, np.log(gain * np.abs(W.response(dense)[:, 0, 0]) / m))
        if states <= order and excess < least - WORTH:
            best, least = replace(W, C=gain * W.C, D=gain * W.D), excess
        if excess <= np.log(TIGHT):
            enough = enough or states
        if least < WORTH or (states >= order and enough is not None):
            break
    return best, enough


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
