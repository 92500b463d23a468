"""Fisher information and Cramér-Rao bounds of an output-error fit."""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from casid.arrays import Array

RIDGE = 1e-12  # on nuisance blocks, relative; an unobservable nuisance must not stop the rest


def eliminate(
    H: Array, H_nuisance: scipy.sparse.csc_array, H_cross: Array, G: scipy.sparse.csc_array,
    G_cross: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Fisher information of λ with nuisance variables ν eliminated, and dν/dλ.

    The log-likelihood is quadratic with Hessian [H, crossᵀ; cross, H_nuisance] under the linear
    constraints G ν + G_cross λ = 0 (continuity); its Schur complement by the KKT system is the
    information an optimal estimator of λ alone has. Works for unstable dynamics, since no
    sensitivity is carried over a whole record.

    Parameters
    ----------
    H : (nf, nf) array
    H_nuisance : (nn, nn) sparse
    H_cross : (nn, nf) array
    G, G_cross : (m, nn) sparse, (m, nf) array
    """
    nn, m = H_nuisance.shape[0], G.shape[0]
    ridge = RIDGE * max(float(H_nuisance.diagonal().max()), 1e-300)
    top = scipy.sparse.hstack([H_nuisance + ridge * scipy.sparse.eye_array(nn), G.T])
    bottom = scipy.sparse.hstack([G, scipy.sparse.csc_array((m, m))])
    K = scipy.sparse.csc_array(scipy.sparse.vstack([top, bottom]))
    cross = np.vstack([H_cross, G_cross])
    solved = scipy.sparse.linalg.splu(K).solve(np.ascontiguousarray(cross))
    F = H - cross.T @ solved
    return (F + F.T) / 2, -solved[:nn]
