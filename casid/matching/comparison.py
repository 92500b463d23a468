"""What a structure is compared with: responses on lines of the complex plane, weighted.

A black box is compared on the line s = σ + jω (paper, (8)-(9)), measured frequency responses on
s = jω where they exist. Every entry of the error has one real weight >= 0, so that scaling, masks,
relative error and coherence are the same thing: E = W ∘ (G(λ) − Ĝ).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.linear import StateSpace
from casid.matching.mismatch import DB

SURPRISE = 0.01  # of the response: its mean square error, and one deviation from a prior value


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """One target in the model's channels."""

    name: str  # what tables call it
    omega: Array  # (K,) frequencies [rad/s], increasing
    shift: float  # σ of the line s = σ + jω [1/s]
    G: ComplexArray  # (K, ny, nu) response, zero where there is none
    W: Array  # (K, ny, nu) weight of every entry of the error
    system: StateSpace | None  # the black box, which exists between the frequencies too
    nodes: Array  # (M,) frequencies of the weight as given; in between it is linear in ω
    node_weights: Array  # (M, ny, nu) that weight

    @classmethod
    def measured(cls, omega: Array, G: ComplexArray, W: Array) -> "Source":
        """A measured response, at its own points of the imaginary axis."""
        weights = {"W": W, "nodes": omega, "node_weights": W}
        return cls(name="measured", omega=omega, shift=0.0, G=G, system=None, **weights)

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
    """All sources of one match, the size of each input, and where black boxes are compared."""

    sources: tuple[Source, ...]
    input_scale: Array
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

    @cached_property
    def s(self) -> ComplexArray:
        """Points of all sources, (K,)."""
        return np.concatenate([source.s for source in self.sources])

    @cached_property
    def G(self) -> ComplexArray:
        """Responses of all sources, (K, ny, nu)."""
        return np.concatenate([source.G for source in self.sources])

    @cached_property
    def W(self) -> Array:
        """Weights of all sources, (K, ny, nu)."""
        return np.concatenate([source.W for source in self.sources])

    @cached_property
    def decibel_weight(self) -> Array:
        """Weights of squared decibels whose mean is, to first order, the mean square error."""
        return np.asarray((self.W * np.abs(self.G) / DB) ** 2 / len(self.s))

    def error(self, system: StateSpace) -> ComplexArray:
        """Weighted error of a model at all points, (K, ny, nu)."""
        return np.concatenate([source.error(system) for source in self.sources])

    def prior_weight(self, norm: str) -> float:
        """Square root of what a parameter one standard deviation off its prior value costs."""
        # J in decibels and degrees counts as a negative log-likelihood, as its Hessian does (T&R,
        # chapter 12); the other norms know no noise: an error of a share of the response counts.
        if norm == "decibel":
            return float(np.sqrt(0.5))
        return float(SURPRISE * np.linalg.norm(self.W * self.G) / np.sqrt(len(self.s)))

    def norm(self, system: StateSpace) -> float:
        """Largest singular value of the weighted error over all points."""
        return float(np.linalg.norm(self.error(system), 2, axis=(1, 2)).max())
