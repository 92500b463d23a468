"""From gathered columns to a model of the channels in their own units."""

from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.subspace.laguerre import from_laguerre
from casid.subspace.predictor import Stack, predictor_coefficients, realise


@dataclass(frozen=True, eq=False, kw_only=True)
class Subspace:
    """A subspace estimate: model and gain, continuous from projections, discrete from samples."""

    system: StateSpace
    K: Array
    singular_values: Array
    residual_covariance: Array


def subspace_model(
    stack: Stack,
    su: Array,
    sy: Array,
    a: float,
    *,
    order: int,
    future: int,
    feedthrough: BoolArray,
    regularisation: float,
    dt: float,
) -> Subspace:
    """Identify one order from gathered columns.

    Parameters
    ----------
    stack : Stack
        Columns of the channels divided by ``su`` (nu,) and ``sy`` (ny,).
    a : float
        Laguerre pole of the projections [rad/s]; NaN for samples ``dt`` [s] apart.
    order, future, feedthrough, regularisation
        As in `casid.subspace.pbsid`.
    """
    projected = not np.isnan(a)
    Xi, _ = predictor_coefficients(stack, feedthrough, regularisation, at_one=projected)
    direct = np.ones_like(feedthrough) if projected else feedthrough
    found = realise(stack, Xi, order=order, future=future, feedthrough=direct)
    C, D = sy[:, None] * found.C, sy[:, None] * found.D / su
    system = StateSpace(found.A, found.B / su, C, D, 1.0 if projected else dt)
    K: Array = found.K / sy
    if projected:
        system, K = from_laguerre(system, K, a)
    R = found.residual_covariance * np.outer(sy, sy)
    return Subspace(
        system=system, K=K, singular_values=found.singular_values, residual_covariance=R
    )
