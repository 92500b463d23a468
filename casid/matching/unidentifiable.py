"""Parameters that targets do not tell apart: a match has no errors that would say so."""

import numpy as np
import scipy
import scipy.linalg

from casid.arrays import Array, BoolArray
from casid.estimates import holding
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.matching.comparison import Comparison

NOTHING = 1e-12  # of what moves the responses most, by parameters of their typical size
SINGULAR = 1e-8  # of the largest singular value, all moving the responses alike
SHARE = 1e-3  # of a direction, for a parameter to be in it


def untold(free: Free, comparison: Comparison, values: Array, active: BoolArray) -> tuple[str, ...]:
    """Free parameters in directions in which no weighted response moves, nor a prior says anything.

    At free values (nf,), of which those on a bound that holds them are ``active`` (nf,).
    """
    scale = free.scale[free.index]
    slopes = MatrixFunction(free)(values).response_slopes(comparison.s)[1]  # (nf, K, ny, nu)
    E = (comparison.W * slopes).reshape(len(scale), -1).T
    J = np.vstack([E.real, E.imag, free.prior_residuals(values)[1]]) * scale
    size = np.linalg.norm(J, axis=0)
    unit = np.where(size > NOTHING * size.max(initial=0.0), size, np.inf)
    J, span = J / unit, np.where(np.isfinite(unit), unit, 1.0)
    rows = holding(free, values, active) * scale / span
    Z = scipy.linalg.null_space(rows) if len(rows) else np.eye(len(scale))
    R = scipy.linalg.qr(J @ Z, mode="r")[0][: Z.shape[1]]
    square = np.vstack([R, np.zeros((R.shape[1] - len(R), R.shape[1]))])  # of few points
    _, found, V = np.linalg.svd(square)
    lost = Z @ V[found <= SINGULAR * found.max(initial=0.0)].T  # (nf, directions)
    shown = (np.abs(lost) > SHARE).any(axis=1)
    return tuple(name for name, one in zip(free.names, shown, strict=True) if one)
