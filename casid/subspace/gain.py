"""Innovation gains of a model that has moved away from the one they were estimated with."""

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.linear import StateSpace


def carried_gain(system: StateSpace, K: Array, refined: StateSpace, R: Array) -> Array:
    """Innovation gain of the refined model: the old one seen in its modes, made stabilising."""
    # The old gain, carried over by the modes' order, gives the process-noise covariance K R Kᵀ; the
    # filter Riccati equation then returns the gain itself where A - KC is stable, and the stable
    # one of the same spectrum where it is not.
    lam_old, V_old = np.linalg.eig(system.A)
    lam, V = np.linalg.eig(refined.A)
    modal_gain = np.linalg.solve(V_old, K.astype(complex))
    size_old = np.linalg.norm(system.C @ V_old, axis=0)
    # Of squares: sums of distances themselves tie for real modes, and rounding would decide.
    order = scipy.optimize.linear_sum_assignment(np.abs(lam[:, None] - lam_old) ** 2)[1]
    turned = np.sum((system.C @ V_old[:, order]).conj() * (refined.C @ V), axis=0)
    scale = turned / np.abs(turned) * size_old[order] / np.linalg.norm(refined.C @ V, axis=0)
    carried = np.real(V @ (scale.conj()[:, None] * modal_gain[order]))
    return riccati_gain(refined.A, refined.C, carried, R)


def riccati_gain(A: Array, C: Array, K: Array, R: Array) -> Array:
    """Stabilising gain of process noise K R Kᵀ, correlated with residuals; ValueError if none."""
    # In standard deviations of the residuals and the model's own time: else what makes R and Q
    # definite, and the Riccati equation's rounding, depend on units.
    std, rate = np.sqrt(np.diag(R)), float(np.abs(np.linalg.eigvals(A)).max()) or 1.0
    std[std == 0] = 1.0
    A, C, K = A / rate, C / std[:, None], K * std / rate
    R = R / np.outer(std, std) + 1e-9 * np.eye(len(R))
    S = K @ R
    Q = K @ R @ K.T + 1e-9 * np.trace(K @ R @ K.T) / len(A) * np.eye(len(A))
    try:
        P = scipy.linalg.solve_continuous_are(A.T, C.T, Q, R, s=S)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"no stable predictor of order {len(A)} exists for these data ({error}); "
            "lower the order or add regularisation"
        ) from error
    return np.asarray(np.linalg.solve(R, C @ P + S.T).T * rate / std)
