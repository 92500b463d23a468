"""How good an information matrix is: Kiefer's means of the scaled covariance, and their slopes.

V = S⁻¹ (F⁻¹)_PP S⁻¹ is the covariance of the parameters P that matter over the standard errors S of
a reference. The criterion is ½ ln Φ_p, Φ_p = (tr Vᵖ / n)^(1/p) (J. Kiefer, Annals of Statistics 2,
1974): p → 0 is the determinant (D), p = 1 the trace (A), p → ∞ the largest eigenvalue (E, here by
p = 8, whose slope is smooth). What E makes small is the error of a combination of parameters; MV
weighs the largest of the parameters' own: the same mean, p = 2, of the diagonal of V (a larger p,
up to minimax variance, costs the others more than the largest gains). All are the logarithm of a
typical ratio of standard errors, so halving all of them lowers it by ln 2, whatever p is.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from casid.arrays import Array

Criterion = Literal["A", "D", "E", "MV"]
POWER = {"D": 0, "A": 1, "MV": 2, "E": 8}
LONGEST = 12.0  # logarithm of the longest time that is looked at, in times of one flight
LOST = 1e4  # times the error of a parameter alone beyond which it is not told apart from others
NOTHING = 1e-9  # effect of a parameter over the largest, each moved by its scale, that is rounding
KEPT = 0.9  # share of the plausible aircraft that are held with which limits are kept
FAINT = 1e-12  # share of its own information that is added to every parameter, against singularity


@dataclass(frozen=True, eq=False)
class Goal:
    """What is to be small."""

    criterion: Criterion
    rows: np.ndarray  # (n,) parameters that matter
    reference: Array  # (n,) their standard errors in the reference
    known: Array  # (nf, nf) information from before

    def __call__(self, F: Array) -> tuple[float, Array]:
        """½ ln Φ of what F (nf, nf) adds to what is known, and its derivatives by F."""
        inverse = covariance(F + self.known)
        columns = inverse[:, self.rows] / self.reference
        V = columns[self.rows] / self.reference[:, None]
        n, p = len(self.rows), POWER[self.criterion]
        values, vectors = (np.diag(V), np.eye(n)) if self.criterion == "MV" else np.linalg.eigh(V)
        values = np.maximum(values, 1e-300)
        if p == 0:
            value, weights = np.log(values).mean(), 1.0 / values / n
        else:
            top = values.max()
            powers = (values / top) ** p
            value = np.log(top) + np.log(powers.mean()) / p
            weights = powers / values / powers.sum()
        half = columns @ vectors
        return 0.5 * float(value), -0.5 * (half * weights) @ half.T


def covariance(F: Array) -> Array:
    """F⁻¹ (nf, nf), scaled for its inversion; what F does not feel comes out very large."""
    size = np.sqrt(np.maximum(np.diag(F), 1e-200))
    N = F / np.outer(size, size)
    return np.asarray(np.linalg.inv(N + FAINT * np.eye(len(F))) / np.outer(size, size))


def told(F: Array, scale: Array) -> np.ndarray:
    """Which parameters (nf,) of typical sizes F (nf, nf) tells, and not only with others."""
    alone = np.sqrt(np.maximum(np.diag(F), 0.0))
    inflation = alone * np.sqrt(np.diag(covariance(F)))
    return np.asarray((alone * scale > NOTHING * (alone * scale).max()) & (inflation < LOST))


def as_long(F: Array, known: Array, errors: Array, rows: np.ndarray) -> float:
    """How many times F beside what is known gives these standard errors, in the geometric mean.

    Those of the parameters in these rows count; infinite if F never does.
    """

    def excess(log_times: float) -> float:
        now = np.diag(covariance(known + np.exp(log_times) * F))
        return float(np.mean(np.log(now[rows])) / 2 - np.mean(np.log(errors[rows])))

    ends = (-LONGEST, LONGEST)
    if excess(ends[0]) * excess(ends[1]) > 0:  # already known, or never told
        return 0.0 if excess(ends[0]) < 0 else np.inf
    return float(np.exp(scipy.optimize.brentq(excess, *ends, xtol=1e-3)))
