"""Targets of a match, brought into the model's channels on one grid, with their weights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar, cast

import numpy as np

from casid.arrays import Array
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.matching.comparison import Comparison, Source
from casid.matching.mismatch import coherence_weight
from casid.model import Model
from casid.nonlinear.conditions import by_condition
from casid.subspace.pbsid import BlackBox

Target: TypeAlias = BlackBox | FrequencyResponse | StateSpace
Weight: TypeAlias = str | Array | None

REACHABLE = "reachable"
SIZE = "size"
NAMED = (SIZE, "relative", REACHABLE)  # weights by name; the last begins as the one before

T = TypeVar("T", bound=np.ndarray)

POINTS = 40  # of the default grid over the band
MARGIN = 0.1  # of the shift from the rightmost pole, relative to pole and band
COHERENCE = 0.6  # below it a measured pair is excluded
BEYOND = 3.0  # times its slowest and fastest poles the band of a given system reaches


@dataclass(frozen=True, eq=False, kw_only=True)
class _Known:
    """A continuous system to match, where it means something, and the sizes of its channels."""

    name: str
    system: StateSpace
    band: tuple[float, float]
    bounded: bool
    input_std: Array
    output_std: Array

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.system.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.system.outputs


def comparison_of(
    model: Model,
    targets: Sequence[Target],
    *,
    omega: Array | None = None,
    shift: float | None = None,
    weight: Weight | Sequence[Weight] = None,
    source_weight: Sequence[float] | None = None,
) -> Comparison:
    """Bring targets into the model's channels, on one grid, with their weights.

    Parameters
    ----------
    model : Model
        Names the inputs and outputs, a subset of the targets' in any order.
    targets : sequence of BlackBox, FrequencyResponse or StateSpace
        What to match. A state-space model counts as a black box that means something everywhere;
        its inputs are of size one, its outputs as large as its response.
    omega : (K,) array
        Frequencies [rad/s] of black boxes and systems; 40 over their band unless given, that of a
        system three times beyond its poles. Measured responses enter with those of their own
        points that lie in its range.
    shift : float
        σ [1/s]; from the poles of black boxes and systems unless given.
    weight : "reachable", "relative", "size", array, None, or a sequence of one a target
        See `casid.matching.match.match`.
    source_weight : sequence of float
        Factor on the error of each target; one unless given.

    Raises
    ------
    ValueError
        A channel no target has, a grid outside the band of a black box, a shift left of a pole,
        weights of the wrong shape.
    """
    if not targets:
        raise ValueError("no target: pass a BlackBox, a FrequencyResponse, or several of them")
    items = [_known(target, omega) for target in targets]
    _check_channels(model, items)
    factors, weights = _factors(source_weight, len(items)), _per_target(weight, len(items))
    input_scale = _scale(model.inputs, [(t.inputs, t.input_std) for t in items])
    output_scale = _scale(model.outputs, [(t.outputs, t.output_std) for t in items])
    sigma = _shift([item for item in items if isinstance(item, _Known)], shift)
    sources = []
    for item, given, factor in zip(items, weights, factors, strict=True):
        if isinstance(item, _Known):
            source, given = _from_system(model, item, omega, sigma), _sorted(given, omega)  # noqa: PLW2901
        else:
            source = _from_measured(model, item, omega)
        if condition := ", ".join(by_condition(item.outputs)):
            source = replace(source, name=f"{source.name} @{condition}")
        sources.append(_weighted(source, given, factor, input_scale, output_scale))
    _check_used(model, np.concatenate([source.W for source in sources]).max(axis=0) > 0)
    bands = np.array([(source.omega[0], source.omega[-1]) for source in sources])
    band = float(bands[:, 0].min()), float(bands[:, 1].max())
    return Comparison(sources=tuple(sources), input_scale=input_scale, band=band, shift=sigma)


def _known(target: Target, omega: Array | None) -> _Known | FrequencyResponse:
    """A black box or a system in continuous time; a measured response is itself."""
    if isinstance(target, FrequencyResponse):
        return target
    if isinstance(target, BlackBox):
        std = {"input_std": target.input_std, "output_std": target.output_std}
        system, band = target.continuous().system, target.band
        return _Known(name="black box", system=system, band=band, bounded=True, **std)
    if not isinstance(target, StateSpace):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"target is a {type(target).__name__}, expected a BlackBox, a FrequencyResponse, a "
            "StateSpace or a sequence of them"
        )
    if target.dt is not None:
        raise ValueError("target is a discrete StateSpace; convert it to continuous time")
    low, high = _reach(target) if omega is None else (float(g) for g in _grid(omega)[[0, -1]])
    shift = max(0.0, float(target.poles().real.max(initial=-np.inf)) + MARGIN * low)
    G = target.response(np.geomspace(low, high, POINTS), shift)
    size = np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 2)))
    std = {"input_std": np.ones(target.nu), "output_std": np.where(size > 0, size, 1.0)}
    return _Known(name="state space", system=target, band=(low, high), bounded=False, **std)


def _reach(system: StateSpace) -> tuple[float, float]:
    """The band of a system's dynamics [rad/s]."""
    moduli = np.abs(system.poles())
    moduli = moduli[moduli > 1e-6 * moduli.max(initial=0.0)]
    if not len(moduli):
        raise ValueError("the StateSpace has no poles but at zero to take a band from; give omega")
    return float(moduli.min() / BEYOND), float(moduli.max() * BEYOND)


def _from_system(model: Model, target: _Known, omega: Array | None, sigma: float) -> Source:
    low, high = target.band
    grid = np.geomspace(low, high, POINTS) if omega is None else _grid(omega)
    slack = 1e-9 * high
    if target.bounded and (grid[0] < low - slack or grid[-1] > high + slack):
        raise ValueError(
            f"omega reaches from {grid[0]:.4g} to {grid[-1]:.4g} rad/s, but the black box holds "
            f"in {low:.4g} to {high:.4g} rad/s only; stay inside its band, or excite more of it "
            "in the records"
        )
    system = _select(target.system, model)
    G = system.response(grid, sigma)
    known = np.isin(model.outputs, target.outputs), np.isin(model.inputs, target.inputs)
    present = np.outer(*known)
    W = np.broadcast_to(present.astype(float), G.shape)
    weights = {"W": W, "nodes": grid, "node_weights": W}
    return Source(name=target.name, omega=grid, shift=sigma, G=G, system=system, **weights)


def _from_measured(model: Model, target: FrequencyResponse, omega: Array | None) -> Source:
    keep = np.isfinite(target.omega)
    if omega is not None:
        grid = _grid(omega)
        keep &= (target.omega >= grid[0] * (1 - 1e-9)) & (target.omega <= grid[-1] * (1 + 1e-9))
    if not keep.any():
        raise ValueError(
            "no point of the measured response lies in the range of omega, "
            f"{target.omega.min():.4g} to {target.omega.max():.4g} rad/s is measured"
        )
    names = target.outputs, target.inputs
    values = in_channels(model, *names, target.G[keep])
    coherence = in_channels(model, *names, target.coherence[keep])
    good = np.isfinite(values) & (coherence >= COHERENCE)
    G = np.where(good, values, 0.0)
    W = np.where(good, np.sqrt(coherence_weight(coherence)), 0.0)
    return Source.measured(target.omega[keep], G, W)


def in_channels(model: Model, outputs: Sequence[str], inputs: Sequence[str], values: T) -> T:
    """Values (K, outputs, inputs) of pairs in the model's channels, NaN where none."""
    shape = (len(values), len(model.outputs), len(model.inputs))
    found = np.full(shape, np.nan, dtype=values.dtype)
    for i, output in enumerate(model.outputs):
        for j, name in enumerate(model.inputs):
            if output in outputs and name in inputs:
                found[:, i, j] = values[:, outputs.index(output), inputs.index(name)]
    return cast("T", found)


def check_weight_name(weight: object) -> None:
    """Refuse a text that names no weights: ValueError."""
    if isinstance(weight, str) and weight not in NAMED:
        raise ValueError(f'weight={weight!r}: expected "reachable", "relative", "size" or an array')


def _weighted(
    source: Source, weight: Weight, factor: float, input_scale: Array, output_scale: Array
) -> Source:
    """The source with scaling and the caller's weight on top of mask and coherence."""
    W = factor * source.W * input_scale
    if isinstance(weight, str) and weight != SIZE:
        check_weight_name(weight)
        W = W / row_sizes(source, input_scale)[:, :, None]
    else:
        W = W / output_scale[:, None]
        given = None if isinstance(weight, str) else weight
        W = W if given is None else W * _checked_weight(given, source.G.shape)
    return replace(source, W=W, node_weights=W)


def row_sizes(source: Source, input_scale: Array) -> Array:
    """Size of every output's response to inputs of typical size at each frequency, (K, ny)."""
    size = np.linalg.norm(source.G * (source.W > 0) * input_scale, axis=2)
    if not (size > 0).any():
        raise ValueError(
            f"the target ({source.name}) is zero or unknown on the whole grid, or has coherence "
            f"below {COHERENCE}: relative error has no meaning; mend it or leave it out"
        )
    # A zero of the response must not make its weight infinite.
    floor = np.where(size.max(axis=0) > 0, 1e-3 * size.max(axis=0), np.inf)
    return np.asarray(np.maximum(size, floor))


def _sorted(weight: Weight, omega: Array | None) -> Weight:
    """The caller's weight by increasing frequency, as the grid is."""
    if omega is None or np.ndim(weight) < 3 or len(weight) != len(omega):  # type: ignore[arg-type]
        return weight
    return np.asarray(weight)[np.argsort(omega)]


def _checked_weight(weight: Array, shape: tuple[int, ...]) -> Array:
    array = np.asarray(weight, dtype=float)
    try:
        full = np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(
            f"weight has shape {array.shape}, expected (K, ny, nu) = {shape}, the grid by the "
            "model's outputs by its inputs"
        ) from None
    if not (np.isfinite(full).all() and (full >= 0).all()):
        raise ValueError("weight holds negative or non-finite entries; 0 masks an entry")
    return full


def _grid(omega: Array) -> Array:
    grid = np.unique(np.atleast_1d(np.asarray(omega, dtype=float)))
    if np.ndim(omega) > 1 or not len(grid) or not np.isfinite(grid).all() or grid[0] <= 0:
        raise ValueError("omega: expected finite frequencies above 0 rad/s in one dimension")
    return grid


def _select(system: StateSpace, model: Model) -> StateSpace:
    """The system in the model's channels; those it does not have are zero."""
    B, C = np.zeros((system.nx, len(model.inputs))), np.zeros((len(model.outputs), system.nx))
    D, delay = np.zeros((len(model.outputs), len(model.inputs))), np.zeros(len(model.inputs))
    inputs, outputs = system.inputs, system.outputs
    rows = [(i, outputs.index(name)) for i, name in enumerate(model.outputs) if name in outputs]
    columns = [(j, inputs.index(name)) for j, name in enumerate(model.inputs) if name in inputs]
    for j, source in columns:
        B[:, j], delay[j] = system.B[:, source], system.delay[source]
    for i, source in rows:
        C[i] = system.C[source]
        for j, other in columns:
            D[i, j] = system.D[source, other]
    names = model.inputs, model.outputs
    return StateSpace(system.A, B, C, D, None, *names, (), delay)


def _check_channels(model: Model, items: Sequence[_Known | FrequencyResponse]) -> None:
    for kind, wanted in (("input", model.inputs), ("output", model.outputs)):
        known = [name for item in items for name in getattr(item, f"{kind}s")]
        if missing := [name for name in wanted if name not in known]:
            raise ValueError(
                f"the model's {kind} {missing[0]!r} is no {kind} of the target, which has "
                f"{', '.join(dict.fromkeys(known))}; rename it, or leave it out of the model"
            )


def _check_used(model: Model, used: np.ndarray) -> None:
    for kind, names, axis in (("output", model.outputs, 1), ("input", model.inputs, 0)):
        seen = np.atleast_1d(used.any(axis=axis))
        idle = [name for name, some in zip(names, seen, strict=True) if not some]
        if idle:
            raise ValueError(
                f"no point of the target weighs on {kind} {idle[0]!r}: coherence is below "
                f"{COHERENCE} or the weights mask it; leave it out of the model or unmask it"
            )


def _scale(names: Sequence[str], known: Sequence[tuple[Sequence[str], Array]]) -> Array:
    """Standard deviation of every channel, from the first target that has it."""
    tables = [dict(zip(*pair, strict=True)) for pair in known]
    found = []
    for name in names:
        value = next((float(table[name]) for table in tables if name in table), np.nan)
        if not (np.isfinite(value) and value > 0):
            raise ValueError(
                f"the standard deviation of channel {name!r} is {value}; a match needs it as "
                "scale: give the target a positive one"
            )
        found.append(value)
    return np.array(found)


def _factors(source_weight: Sequence[float] | None, count: int) -> list[float]:
    factors = [1.0] * count if source_weight is None else [float(f) for f in source_weight]
    if len(factors) != count or not all(np.isfinite(f) and f > 0 for f in factors):
        raise ValueError(
            f"source_weight={source_weight}: expected {count} positive numbers, one a target"
        )
    return factors


def _per_target(weight: Weight | Sequence[Weight], count: int) -> list[Weight]:
    if isinstance(weight, list | tuple):
        if len(weight) != count:
            raise ValueError(f"{len(weight)} weights for {count} targets")
        if any(isinstance(each, str) and each == REACHABLE for each in weight):
            raise ValueError(
                f'weight="{REACHABLE}" is for all targets at once, not for one of them'
            )
        return list(weight)
    return [weight] * count  # type: ignore[list-item]


def _shift(systems: Sequence[_Known], shift: float | None) -> float:
    """σ of the line on which black boxes and systems are compared.

    As small as possible, since frequencies below about σ are blurred: zero when all poles lie
    left of the imaginary axis by a margin, else the margin right of the rightmost pole. The margin
    keeps the pole's own uncertainty from crossing the line and the resolvent well conditioned.
    """
    if not systems:
        if shift:
            raise ValueError("shift moves the line of a black box; measured points cannot move")
        return 0.0
    poles = np.concatenate([item.system.poles() for item in systems])
    if not len(poles):
        return float(shift or 0.0)
    rightmost = poles[np.argmax(poles.real)]
    if shift is not None:
        if not np.isfinite(shift) or shift < 0 or shift <= rightmost.real:
            raise ValueError(
                f"shift={shift} 1/s lies left of the black box's pole at {rightmost:.4g}; take "
                f"it >= 0 and above {max(rightmost.real, 0.0):.4g}, or leave it out"
            )
        return float(shift)
    margin = max(MARGIN * abs(rightmost), MARGIN * min(item.band[0] for item in systems))
    return float(max(0.0, rightmost.real + margin))
