"""From gathered columns to models of the channels in their own units."""

from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.subspace.laguerre import from_laguerre
from casid.subspace.predictor import Future, Stack, realise


@dataclass(frozen=True, eq=False, kw_only=True)
class Subspace:
    """A subspace estimate: model and gain, continuous from projections, discrete from samples."""

    system: StateSpace
    K: Array
    singular_values: Array
    residual_covariance: Array


@dataclass(frozen=True, eq=False)
class Regressed:
    """The predictor of gathered columns, from which models of any order follow."""

    stack: Stack  # columns of the channels divided by su and sy
    su: Array  # (nu,)
    sy: Array  # (ny,)
    a: float  # Laguerre pole of the projections [rad/s]; NaN for samples
    mask: BoolArray  # (ny, nu) where a direct term is free
    dt: float  # between samples [s]
    predicted: Future  # what the predictor says of the future

    def model(self, order: int) -> Subspace:
        """Subspace estimate of that order."""
        projected, su, sy = not np.isnan(self.a), self.su, self.sy
        direct = np.ones_like(self.mask) if projected else self.mask
        found = realise(self.stack, self.predicted, order=order, feedthrough=direct)
        C, D = sy[:, None] * found.C, sy[:, None] * found.D / su
        system = StateSpace(found.A, found.B / su, C, D, 1.0 if projected else self.dt)
        K: Array = found.K / sy
        if projected:
            system, K = from_laguerre(system, K, self.a)
        return Subspace(
            system=system,
            K=K,
            singular_values=found.singular_values,
            residual_covariance=found.residual_covariance * np.outer(sy, sy),
        )
