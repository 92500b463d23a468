"""Whether one source of an estimate agrees with all others together, and with its own errors.

Where several sources add their parts to one cost, their gradients are nothing in all at the
estimate; that of one, g, tells by how much it pulls against the rest. With P the inverse
information of all, V the covariance of the estimates, F the information of the one source and S the
covariance of its gradient at the truth,

    cov g = (I - F P) S (I - P F) + F (V - P S P) F,

F - F P F where all is as stated: the test of specification of J. A. Hausman, Econometrica 46(6),
1978, by the gradient instead of another estimate.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri

from casid.arrays import Array
from casid.display import listed

SELDOM = 1e-3  # chance by which sources that agree are said not to
SAID = 1e-3  # of the information in a direction, that the source and the rest each have at least
GONE = 1e-12  # of the largest variance in units of the parameters' own: held
APART = 2.0  # standard errors from which a parameter is named
MOST = 3  # parameters named
SMALLER, LARGER = 0.25, 1.2  # of what is stated: residuals that say something of their errors


class Source(NamedTuple):
    """One source of an estimate, at the estimate of all, by the free parameters."""

    g: Array  # (nf,) gradient of its part of the cost
    F: Array  # (nf, nf) its information
    S: Array  # (nf, nf) covariance of its gradient at the truth


class Disagreement(NamedTuple):
    """How far one source is from the others."""

    square: float  # χ² of as many degrees of freedom, if they agree
    freedom: int
    apart: Array  # (m,) the others' estimate less that of all, in standard errors of that
    step: Array  # (m,) the same, in units of the parameters

    @property
    def chance(self) -> float:
        """By which sources that agree are as far apart."""
        return float(chdtrc(self.freedom, self.square)) if self.freedom else 1.0

    @property
    def significant(self) -> bool:
        """Whether chance makes it so large seldom enough."""
        return self.chance < SELDOM

    def told(self, names: tuple[str, ...]) -> str:
        """How far, in words."""
        worst = np.argsort(-np.abs(self.apart))[:MOST]
        far = [f"{names[i]} {abs(self.apart[i]):.1f}" for i in worst if abs(self.apart[i]) > APART]
        limit = chdtri(self.freedom, SELDOM)
        return (
            f"by a chi-square of {self.square:.0f} in {self.freedom} combinations of parameters, "
            f"where chance exceeds {limit:.0f} once in {1 / SELDOM:.0f}"
            + f" (standard errors between the estimate and that of the others: {listed(far)})"
            * bool(far)
        )


def disagreement(source: Source, P: Array, V: Array, told_of: Array | None = None) -> Disagreement:
    """How far a source is from all others; P, V (nf, nf) as above, zero of what is held.

    ``told_of`` (m, nf) are combinations of which is told how far; the parameters unless given.
    """
    size = np.sqrt(np.diag(P))
    unit = np.where(size > 0, size, 1.0)
    values, axes = np.linalg.eigh(P / np.outer(unit, unit))
    known = values > GONE * values.max(initial=0.0)
    root = unit[:, None] * axes[:, known] * np.sqrt(values[known])  # P = root rootᵀ
    share, axes = np.linalg.eigh(root.T @ source.F @ root)
    root = root @ axes
    B, FU = root.T @ source.S @ root, source.F @ root
    rest = 1 - share
    cov = rest[:, None] * B * rest + FU.T @ V @ FU - share[:, None] * B * share
    told = (share > SAID) & (rest > SAID)
    plain = np.sqrt(share[told] * rest[told])  # standard deviations if all is as stated
    # Never surer than stated: V is of few data, and its factors may not be those of S.
    factor, axes = np.linalg.eigh(cov[np.ix_(told, told)] / np.outer(plain, plain))
    factor = np.maximum(factor, 1.0)
    u = root[:, told].T @ source.g
    square = float(np.sum((axes.T @ (u / plain)) ** 2 / factor))
    way = root[:, told] / rest[told]  # the others' estimate less that of all is way @ u
    way = way if told_of is None else told_of @ way
    std = np.linalg.norm((way * plain) @ axes * np.sqrt(factor), axis=1)
    step = way @ u
    apart = np.divide(step, std, out=np.zeros_like(std), where=std > 0)
    return Disagreement(square, int(told.sum()), apart, step)


def misstated(power: Array, independent: float, decided: float) -> float:
    """By what factor residuals are smaller or larger than stated, 1 where chance may be why.

    Parameters
    ----------
    power : (n,) array
        Of complex residuals, 1 on average where errors are as stated.
    independent : float
        So many independent ones have a mean that scatters as theirs.
    decided : float
        So many parameters they decide.
    """
    freedom = 2 * independent - decided
    if freedom < 1:
        return 1.0
    square = 2 * independent * float(np.mean(power))
    factor = np.sqrt(square / freedom)
    if factor < SMALLER and chdtr(freedom, square) < SELDOM:
        return float(factor)
    # Of most points: what a structure misses at some is no error of all.
    usual = min(factor, np.sqrt(np.median(power) / np.log(2)))
    return float(usual) if usual > LARGER and chdtrc(freedom, square) < SELDOM else 1.0
