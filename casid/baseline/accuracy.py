"""Accuracy of parameters fitted to frequency responses, as T&R define and judge it.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*),
chapter 12: Cramér-Rao figures 2 √(H⁻¹)ᵢᵢ up to 20 % of the value and insensitivities 1/√Hᵢᵢ up to
10 % are satisfactory, H the Hessian of the cost J.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray
from casid.matching.mismatch import GOOD
from casid.values import storable

CRAMER_RAO, INSENSITIVITY = 20.0, 10.0  # guidelines, % of the value


@storable
@dataclass(frozen=True, kw_only=True)
class PairCost:
    """Cost J of one pair."""

    output: str
    input: str
    J: float
    points: int
    band: tuple[float, float]  # of the points [rad/s]
    misses: tuple[str, ...]  # guidelines it does not meet


@storable
@dataclass(frozen=True, kw_only=True)
class ParameterAccuracy:
    """Accuracy of one parameter: figures in % of the value, as T&R define them."""

    name: str
    value: float
    cramer_rao_percent: float  # 2 √(H⁻¹)ᵢᵢ
    insensitivity_percent: float  # 1/√Hᵢᵢ
    scatter: float  # standard deviation that the response's random errors cause, NaN if not stated
    misses: tuple[str, ...]  # guidelines it does not meet: CR, I


@storable
@dataclass(frozen=True, kw_only=True)
class StartCost:
    """Where one starting point led."""

    start: str
    J: float
    success: bool
    status: str
    iterations: int
    seconds: float


@storable
@dataclass(frozen=True, kw_only=True)
class Guidelines:
    """Up to which figures a fit is satisfactory."""

    J: float = GOOD
    cramer_rao_percent: float = CRAMER_RAO
    insensitivity_percent: float = INSENSITIVITY


@storable
@dataclass(frozen=True, kw_only=True)
class DerividNotes:
    """What a fit in dB and degrees reports beside its estimates.

    Parameters
    ----------
    pairs : tuple of PairCost
        One row a pair fitted; ``average`` is their mean J.
    table : tuple of ParameterAccuracy
        One row a free parameter.
    starts : tuple of StartCost
        One row a starting point.
    guidelines : Guidelines
        What the rows are judged by.
    covered : mapping
        Spans of airspeed and tables of flight conditions, where there are any.
    """

    pairs: tuple[PairCost, ...]
    average: float
    table: tuple[ParameterAccuracy, ...]
    starts: tuple[StartCost, ...]
    guidelines: Guidelines = Guidelines()
    covered: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def accuracy(J: Array, active: BoolArray, ties: Array | None = None) -> tuple[Array, Array, Array]:
    """√(H⁻¹)ᵢᵢ, 1/√Hᵢᵢ (nf,) and H⁻¹ of the cost Σ r², H = 2 JᵀJ, T&R chapter 12.

    ``J`` is dr/dλ (residuals, nf), ``active`` (nf,) the parameters on a bound: known,
    without uncertainty (NaN). ``ties`` (m, nf) are gradients of relations that hold. Infinite where
    the data do not tell parameters apart.
    """
    H = 2 * J.T @ J
    size = np.sqrt(np.diag(H))
    with np.errstate(divide="ignore"):
        insensitivity = np.where(size > 0, 1 / size, np.inf)
    inside = np.flatnonzero(~active)
    covariance = np.full(H.shape, np.nan)
    if len(inside):
        unit, Z = size[inside], np.eye(len(inside))
        # What acts on no residual can still be moved by what is tied to it, and takes the relation.
        idle = unit == 0
        unit[idle] = 1.0
        if ties is not None and len(ties):
            bound = ties[:, inside] / unit
            unit[idle] = np.linalg.norm(bound[:, idle], axis=0) / max(np.abs(bound).max(), 1e-300)
            unit[unit == 0] = 1.0
            bound = ties[:, inside] / unit
            norms = np.linalg.norm(bound, axis=1, keepdims=True)
            Z = scipy.linalg.null_space(bound / np.where(norms > 0, norms, 1.0))
        scaled = H[np.ix_(inside, inside)] / np.outer(unit, unit)
        eigenvalues, V = np.linalg.eigh(Z.T @ scaled @ Z)
        lost = eigenvalues <= len(inside) * np.finfo(float).eps * eigenvalues.max(initial=0.0)
        V = Z @ V
        inverse = (V[:, ~lost] / eigenvalues[~lost]) @ V[:, ~lost].T
        blind = (np.abs(V[:, lost]) > 1e-6).any(axis=1)
        inverse[np.ix_(blind, blind)] += np.diag(np.full(int(blind.sum()), np.inf))
        covariance[np.ix_(inside, inside)] = inverse / np.outer(unit, unit)
    return np.sqrt(np.diag(covariance)), insensitivity, covariance


def accuracy_row(
    name: str, value: float, std: float, insensitivity: float, scatter: float
) -> ParameterAccuracy:
    """One row of the accuracy table: percentages of the value, and the guidelines it misses."""
    size = abs(value)
    cr = 200 * std / size if size > 0 else np.inf
    i = 100 * insensitivity / size if size > 0 else np.inf
    misses = tuple(word for word, bad in (("CR", cr > CRAMER_RAO), ("I", i > INSENSITIVITY)) if bad)
    return ParameterAccuracy(
        name=name,
        value=float(value),
        cramer_rao_percent=float(cr),
        insensitivity_percent=float(i),
        scatter=float(scatter),
        misses=misses,
    )
