"""What a structure is compared with: responses on lines of the complex plane, weighted.

A black box is compared on the line s = σ + jω (paper, (8)-(9)), measured frequency responses on
s = jω where they exist. Every entry of the error has one real weight >= 0, so that scaling, masks,
relative error and coherence are the same thing: E = W ∘ (G(λ) − Ĝ).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.frequency.estimation import FrequencyResponse
from casid.linear import StateSpace
from casid.model import Model
from casid.subspace.pbsid import BlackBox

Target: TypeAlias = BlackBox | FrequencyResponse
Weight: TypeAlias = str | Array | None

POINTS = 40  # of the default grid over the band
MARGIN = 0.1  # of the shift from the rightmost pole, relative to pole and band
COHERENCE = 0.6  # below it a measured pair is excluded


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """One target in the model's channels.

    Parameters
    ----------
    name : str
        What tables call it.
    omega : (K,) array
        Frequencies [rad/s], increasing.
    shift : float
        σ of the line s = σ + jω [1/s].
    G, W : (K, ny, nu) array
        Response, zero where there is none, and weight of every entry of the error.
    system : StateSpace or None
        The black box, which exists between the frequencies too.
    nodes, node_weights : (M,), (M, ny, nu) array
        The weight as given; in between it is linear in ω.
    """

    name: str
    omega: Array
    shift: float
    G: ComplexArray
    W: Array
    system: StateSpace | None
    nodes: Array
    node_weights: Array

    @property
    def s(self) -> ComplexArray:
        """Points of the complex plane, (K,)."""
        return np.asarray(self.shift + 1j * self.omega)

    def error(self, system: StateSpace) -> ComplexArray:
        """Weighted error E of a model at the grid, (K, ny, nu)."""
        return np.asarray(self.W * (system.response(self.omega, self.shift) - self.G))

    def at(self, omega: Array) -> "Source":
        """The black box on another grid."""
        if self.system is None:
            raise ValueError(f"{self.name} is measured at its own frequencies only")
        G = self.system.response(omega, self.shift)
        return replace(self, omega=omega, G=G, W=self.weight_at(omega))

    def weight_at(self, omega: Array) -> Array:
        """Weights at other frequencies, linear between the given ones, (K, ny, nu)."""
        index = np.clip(np.searchsorted(self.nodes, omega) - 1, 0, max(len(self.nodes) - 2, 0))
        if len(self.nodes) == 1:
            return np.asarray(np.broadcast_to(self.node_weights, (len(omega), *self.W.shape[1:])))
        left, right = self.nodes[index], self.nodes[index + 1]
        part = np.clip((omega - left) / (right - left), 0.0, 1.0)[:, None, None]
        return np.asarray(
            (1 - part) * self.node_weights[index] + part * self.node_weights[index + 1]
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """All sources of one match and the scales of the channels."""

    sources: tuple[Source, ...]
    input_scale: Array
    output_scale: Array
    band: tuple[float, float]
    shift: float

    @property
    def line(self) -> float | None:
        """σ of the line on which black boxes are compared; None without a black box."""
        return self.shift if any(source.system for source in self.sources) else None

    def shifted(self, shift: float) -> "Comparison":
        """The black boxes alone, on another line."""
        boxes = [source for source in self.sources if source.system is not None]
        moved = tuple(replace(source, shift=shift).at(source.omega) for source in boxes)
        return replace(self, shift=shift, sources=moved)

    @property
    def s(self) -> ComplexArray:
        """Points of all sources, (K,)."""
        return np.concatenate([source.s for source in self.sources])

    @property
    def G(self) -> ComplexArray:
        """Responses of all sources, (K, ny, nu)."""
        return np.concatenate([source.G for source in self.sources])

    @property
    def W(self) -> Array:
        """Weights of all sources, (K, ny, nu)."""
        return np.concatenate([source.W for source in self.sources])

    def error(self, system: StateSpace) -> ComplexArray:
        """Weighted error of a model at all points, (K, ny, nu)."""
        return np.concatenate([source.error(system) for source in self.sources])

    def norm(self, system: StateSpace) -> float:
        """Largest singular value of the weighted error over all points."""
        return float(np.linalg.norm(self.error(system), 2, axis=(1, 2)).max())


def compare(
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
    targets : sequence of BlackBox or FrequencyResponse
        What to match.
    omega : (K,) array
        Frequencies [rad/s] of the black boxes; 40 over their band unless given. Measured
        responses enter with those of their own points that lie in its range.
    shift : float
        σ [1/s]; from the poles of the black boxes unless given.
    weight : None, "relative", array, or a sequence of one a target
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
    _check_channels(model, targets)
    factors = _factors(source_weight, len(targets))
    weights = _per_target(weight, len(targets))
    input_scale = _scale(model.inputs, [dict(zip(*_inputs(t), strict=True)) for t in targets])
    output_scale = _scale(model.outputs, [dict(zip(*_outputs(t), strict=True)) for t in targets])
    sigma = _shift(targets, shift)
    sources = []
    for number, target in enumerate(targets):
        if isinstance(target, BlackBox):
            source = _from_black_box(model, target, omega, sigma)
            weights[number] = _sorted(weights[number], omega)
        else:
            source = _from_measured(model, target, omega)
        factor = factors[number]
        sources.append(_weighted(source, weights[number], factor, input_scale, output_scale))
    used = np.concatenate([source.W for source in sources]).max(axis=0) > 0
    _check_used(model, used)
    bands = np.array([(source.omega[0], source.omega[-1]) for source in sources])
    return Comparison(
        sources=tuple(sources),
        input_scale=input_scale,
        output_scale=output_scale,
        band=(float(bands[:, 0].min()), float(bands[:, 1].max())),
        shift=sigma,
    )


def _from_black_box(model: Model, target: BlackBox, omega: Array | None, sigma: float) -> Source:
    low, high = target.band
    grid = np.geomspace(low, high, POINTS) if omega is None else _grid(omega)
    slack = 1e-9 * high
    if grid[0] < low - slack or grid[-1] > high + slack:
        raise ValueError(
            f"omega reaches from {grid[0]:.4g} to {grid[-1]:.4g} rad/s, but the black box means "
            f"something in {low:.4g} to {high:.4g} rad/s only; stay inside its band, or excite "
            "more of it in the records"
        )
    system = _select(target.continuous().system, model, target)
    G = system.response(grid, sigma)
    present = np.outer(
        np.isin(model.outputs, target.system.outputs), np.isin(model.inputs, target.system.inputs)
    )
    W = np.broadcast_to(present.astype(float), G.shape)
    return Source(
        name="black box", omega=grid, shift=sigma, G=G, W=W, system=system, nodes=grid,
        node_weights=W,
    )  # fmt: skip


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
    shape = (int(keep.sum()), len(model.outputs), len(model.inputs))
    G, W = np.zeros(shape, dtype=complex), np.zeros(shape)
    for i, output in enumerate(model.outputs):
        for j, name in enumerate(model.inputs):
            if output in target.outputs and name in target.inputs:
                pair = target.outputs.index(output), target.inputs.index(name)
                values, coherence = target.G[keep, *pair], target.coherence[keep, *pair]
                good = np.isfinite(values) & (coherence >= COHERENCE)
                G[good, i, j] = values[good]
                # CIFER's W_γ weighs the square of the error (Tischler & Remple 2006, ch. 11).
                W[good, i, j] = 1.58 * (1 - np.exp(-(coherence[good] ** 2)))
    grid = target.omega[keep]
    return Source(
        name="measured", omega=grid, shift=0.0, G=G, W=W, system=None, nodes=grid, node_weights=W
    )


def _weighted(
    source: Source, weight: Weight, factor: float, input_scale: Array, output_scale: Array
) -> Source:
    """The source with scaling and the caller's weight on top of mask and coherence."""
    W = factor * source.W * input_scale
    if isinstance(weight, str):
        if weight != "relative":
            raise ValueError(f'weight={weight!r}: expected None, "relative" or an array')
        size = np.linalg.norm(source.G * (source.W > 0) * input_scale, axis=2)  # (K, ny)
        if not (size > 0).any():
            raise ValueError("the target is zero on the whole grid: relative error has no meaning")
        # A zero of the response must not make its weight infinite.
        floor = np.where(size.max(axis=0) > 0, 1e-3 * size.max(axis=0), np.inf)
        W = W / np.maximum(size, floor)[:, :, None]
    else:
        W = W / output_scale[:, None]
        W = W if weight is None else W * _checked_weight(weight, source.G.shape)
    return replace(source, W=W, node_weights=W)


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


def _select(system: StateSpace, model: Model, target: BlackBox) -> StateSpace:
    """The system in the model's channels; those it does not have are zero."""
    B, C = np.zeros((system.nx, len(model.inputs))), np.zeros((len(model.outputs), system.nx))
    D, delay = np.zeros((len(model.outputs), len(model.inputs))), np.zeros(len(model.inputs))
    inputs, outputs = target.system.inputs, target.system.outputs
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


def _inputs(target: Target) -> tuple[tuple[str, ...], Array]:
    names = target.system.inputs if isinstance(target, BlackBox) else target.inputs
    return names, target.input_std


def _outputs(target: Target) -> tuple[tuple[str, ...], Array]:
    names = target.system.outputs if isinstance(target, BlackBox) else target.outputs
    return names, target.output_std


def _check_channels(model: Model, targets: Sequence[Target]) -> None:
    for target in targets:
        if not isinstance(target, BlackBox | FrequencyResponse):
            raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
                f"target is a {type(target).__name__}, expected a BlackBox, a FrequencyResponse "
                "or a sequence of them"
            )
    for kind, wanted, pick in (
        ("input", model.inputs, _inputs),
        ("output", model.outputs, _outputs),
    ):
        known = [name for target in targets for name in pick(target)[0]]
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


def _scale(names: Sequence[str], known: Sequence[dict[str, float]]) -> Array:
    """Standard deviation of every channel, from the first target that has it."""
    found = []
    for name in names:
        value = next((float(table[name]) for table in known if name in table), np.nan)
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
        return list(weight)
    return [weight] * count  # type: ignore[list-item]


def _shift(targets: Sequence[Target], shift: float | None) -> float:
    """σ of the line on which black boxes are compared.

    As small as possible, since frequencies below about σ are blurred: zero when all poles lie
    left of the imaginary axis by a margin, else the margin right of the rightmost pole. The margin
    keeps the pole's own uncertainty from crossing the line and the resolvent well conditioned.
    """
    boxes = [target for target in targets if isinstance(target, BlackBox)]
    if not boxes:
        if shift:
            raise ValueError("shift moves the line of a black box; measured points cannot move")
        return 0.0
    systems = [box.continuous().system for box in boxes]
    poles = np.concatenate([system.poles() for system in systems])
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
    margin = max(MARGIN * abs(rightmost), MARGIN * min(box.band[0] for box in boxes))
    return float(max(0.0, rightmost.real + margin))
