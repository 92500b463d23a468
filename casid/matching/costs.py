"""What matching minimises, as functions of the structure's response, with their derivatives.

An error E is analytic in the response G, dE = factor ∘ dG; derivatives of a cost by E are numbers
P, ``pull``, with d cost = Re Σ conj(P) ∘ dE, and V (nf, ...), ``curved``, with the cost's second
derivatives Re Σ conj(dE_i) ∘ V_j, G being linear.
"""

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.matching.comparison import Comparison
from casid.matching.mismatch import DB, TINY, TURN, log_ratio


class MeanSquare:
    """A share of the mean square of the weighted error, in units of ``unit``."""

    def __init__(self, comparison: Comparison, unit: float, share: float) -> None:
        self._W, self._G = comparison.W / unit, comparison.G
        self._share = share / len(comparison.s)

    def errors(self, G: ComplexArray) -> ComplexArray:
        """W ∘ (G − Ĝ)."""
        return np.asarray(self._W * (G - self._G))

    def factor(self, _: ComplexArray) -> Array:
        """W."""
        return self._W

    def value(self, E: ComplexArray) -> float:
        """Mean of ‖E‖²_F."""
        return self._share * float(np.linalg.norm(E) ** 2)

    def pull(self, E: ComplexArray) -> ComplexArray:
        """P, the derivative by E."""
        return 2 * self._share * E

    def curved(self, _: ComplexArray, dE: ComplexArray) -> ComplexArray:
        """V, from the derivatives of E."""
        return 2 * self._share * dE


class Decibels:
    """Squared decibels and degrees, E = ln(G/Ĝ), in units whose square ``unit``² is."""

    def __init__(self, comparison: Comparison, unit: float) -> None:
        weight = comparison.decibel_weight / unit**2
        self._used = weight > 0
        self._G = np.where(self._used, comparison.G, 1.0)
        self._gain, self._phase = weight * DB**2, weight * TURN**2

    def errors(self, G: ComplexArray) -> ComplexArray:
        """ln(G/Ĝ), zero where nothing is compared."""
        return log_ratio(np.where(self._used, G, self._G), self._G)

    def factor(self, G: ComplexArray) -> ComplexArray:
        """1/G."""
        floor = TINY * np.abs(self._G) ** 2
        return np.where(self._used, G.conj() / (np.abs(G) ** 2 + floor), 0)

    def value(self, E: ComplexArray) -> float:
        """Sum of squared decibels and weighted degrees."""
        return float(np.sum(self._gain * E.real**2 + self._phase * E.imag**2))

    def pull(self, E: ComplexArray) -> ComplexArray:
        """P, the derivative by E."""
        return np.asarray(2 * (self._gain * E.real + 1j * self._phase * E.imag))

    def curved(self, E: ComplexArray, dE: ComplexArray) -> ComplexArray:
        """V; d² ln G holds −(dG/G)²."""
        return np.asarray(self.pull(dE) - self.pull(E) * dE.conj())
