"""What a fit takes out of its records' noise: leverages, by which residuals fall short of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.free import Free, free_parameters
from casid.model import Initial, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Evaluator, Point, whiteners

LOST = 0.01  # of white noise's variance; what is left of a direction below tells nothing


@dataclass(frozen=True, eq=False)
class Leverage:
    """What a fit takes of one record.

    Its residuals W r, whitened by their covariance sample by sample, are I - B Bᵀ times noise that
    was white: B holds the derivatives by parameters, initial state and biases, orthonormal over
    all records and what was known before.
    """

    taken: Array  # (N, ny, p) B
    whitener: Array  # (N, ny, ny) W, lower triangular; rows and columns of missing outputs zero

    def whitened(self, residuals: Array) -> Array:
        """W r (N, ny), NaN where samples are missing."""
        white = np.einsum("tij,tj->ti", self.whitener, np.nan_to_num(residuals))
        return np.where(np.isfinite(residuals), white, np.nan)

    def measured(self, white: Array) -> Array:
        """W⁻¹ times whitened values (N, ny) of any samples, NaN where they are."""
        missing = np.einsum("tii->ti", self.whitener) == 0
        full = self.whitener + np.einsum("ti,ij->tij", missing, np.eye(white.shape[1]))
        found = np.linalg.solve(full, np.nan_to_num(white)[:, :, None])[:, :, 0]
        return np.where(np.isfinite(white), found, np.nan)

    def restored(self, white: Array, samples: np.ndarray, outputs: np.ndarray) -> Array:
        """Whitened residuals of some samples and outputs (n,) with the variance of the noise.

        (I - H)^(-1/2) times what they are, H = B Bᵀ among these alone (R. M. Bell and D. F.
        McCaffrey, Survey Methodology 28(2), 2002): of white noise their covariance is the identity
        again, and correlation that the residuals have stays in them.
        """
        B, r = self.taken[samples, outputs], white[samples, outputs]
        share, V = np.linalg.eigh(B.T @ B)
        left = np.sqrt(np.maximum(1 - share, LOST))
        # (1 - s)^(-1/2) = 1 + s / (√(1 - s) (1 + √(1 - s)))
        return np.asarray(r + B @ (V @ ((V.T @ (B.T @ r)) / (left * (1 + left)))))


def leverages(
    fit: AnyFit, flying: Model, estimator: Estimator, records: Sequence[Record], x0: Array
) -> tuple[Leverage, ...]:
    """What an output-error fit took of each of its records.

    Parameters
    ----------
    flying : Model
        At the estimates, with the constants of the fit as states.
    estimator : Estimator
        Its priors and what it knows of initial states count as measurements.
    records : sequence of Record
        With the model's channels, in its order.
    x0 : (records, nx) array
        Initial states.
    """
    held = [row.name for row in fit.parameters if row.fixed]
    bounds = {row.name: (row.lower, row.upper) for row in fit.parameters if not row.fixed}
    free = free_parameters(flying, held, bounds, getattr(estimator, "priors", None))
    told: Initial = getattr(estimator, "initial", None) or {}
    known = np.array([told[name][1] if name in told else np.inf for name in flying.states])
    kind = NonlinearEvaluator if isinstance(free.model, NonlinearModel) else Evaluator
    evaluator = kind(free, lay_out(records, np.inf))
    layout, nf, nx, ny = evaluator.layout, evaluator.nf, evaluator.nx, evaluator.ny
    biases = np.asarray(fit.biases)
    point = Point(lam=free.guess, bias=biases, nodes=x0)
    W = whiteners(np.asarray(fit.R), layout)
    every = np.broadcast_to(np.eye(nf + nx + ny), (len(records), nf + nx + ny, nf + nx + ny))
    sweep = evaluator.sweep(point, evaluator.simulate(point), W)
    has = np.concatenate([np.ones(nx, dtype=bool), biases.any(axis=0)])
    before = np.hstack([np.zeros((nx, nf)), np.diag(1 / known), np.zeros((nx, ny))])
    own, shared = [], []
    for pieces in sweep.influence(every):
        J = np.concatenate([*(piece.reshape(-1, nf + nx + ny) for piece in pieces), before])
        basis = _basis(J[:, nf:][:, has])
        own.append(basis)
        shared.append(J[:, :nf] - basis @ (basis.T @ J[:, :nf]))
    pull = free.prior_residuals(free.guess)[1]
    ends = np.cumsum([0, *(len(each) for each in shared)])
    common = _basis(np.concatenate([*shared, pull]) @ _loose(fit, free))
    edges = np.cumsum([0, *(record.N for record in records)])
    found = []
    for (first, last), (a, b), basis in zip(pairwise(ends), pairwise(edges), own, strict=True):
        taken = np.hstack([basis, common[first:last]])[: (b - a) * ny]
        kinds = layout.pattern[a:b]
        found.append(Leverage(taken.reshape(b - a, ny, -1), W[kinds]))
    return tuple(found)


def _loose(fit: AnyFit, free: Free) -> Array:
    """Directions (nf, k) in which no bound and no constraint holds the free parameters."""
    at_bound: BoolArray = np.array([fit[name].active for name in free.names], dtype=bool)
    held = np.eye(len(free.names))[at_bound]
    active = [each.active for each in fit.constraints]
    if any(active):
        held = np.vstack([held, free.constraint_slopes(free.guess)[active]])
    return np.asarray(scipy.linalg.null_space(held)) if len(held) else np.eye(len(free.names))


def _basis(J: Array) -> Array:
    """Orthonormal basis of the span of columns in whatever units."""
    size = np.linalg.norm(J, axis=0)
    return np.asarray(scipy.linalg.orth(J[:, size > 0] / size[size > 0]))
