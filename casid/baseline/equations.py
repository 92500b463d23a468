"""A starting point from a measured response: the structure's equations, one unknown at a time.

The equations of a structure, with the delays moved over to the measurement,

    jω_k X_k = A(λ) X_k + B(λ)        Ĝ_k e^(jω_k τ) = C(λ) X_k + D(λ),

are linear least squares in λ where the states' responses X_k are known. What the structure says of
the states without λ gives these: kinematics, an output that is a state, the difference of a
specific force and the row of A that shares its derivatives, that is, the combinations of rows of
[A B; C D] in which no parameter is left. Where they do not suffice, all rows at the guess help.
"""

import numpy as np
import scipy.linalg
import scipy.optimize

from casid.arrays import Array, ComplexArray
from casid.baseline.magphase import Target
from casid.evaluation import MatrixFunction
from casid.model import Free

PRIOR = 1e-3  # weight of equations that hold parameters, which are those of the guess
HUGE = 1e100  # size of an equation that was not measured
RIDGE = 1e-4  # weight of present parameters, in units of their scale


def equation_start(
    free: Free, target: Target, matrices: MatrixFunction
) -> tuple[Array, ComplexArray] | None:
    """Free parameters (nf,) and undelayed states' responses to scaled inputs (K, nx, nu).

    None where the guess has no response of its own (a pole on a frequency of the grid).
    """
    values = free.guess
    at = matrices(values)
    N, dN, tau, nx = at.N, at.slopes, at.tau, at.nx
    X = _guessed_states(N, nx, target)
    if X is None:
        return None
    late = np.exp(1j * target.omega[:, None, None] * tau)
    Y = np.where(target.weight > 0, target.G * late * target.input_scale, 0.0)
    scale = free.scale[free.index]
    trials = (values, values + scale, values - 0.7 * scale)
    T = _without_parameters([matrices(trial).slopes for trial in trials], N)
    X = _states(T, N, X, Y, target)
    return _parameters(free, N, dN, X, Y, target), X


def _guessed_states(N: Array, nx: int, target: Target) -> ComplexArray | None:
    B = np.broadcast_to(N[:nx, nx:] * target.input_scale, (len(target.omega), nx, N.shape[1] - nx))
    try:
        X = np.linalg.solve(1j * target.omega[:, None, None] * np.eye(nx) - N[:nx, :nx], B)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(X) if np.isfinite(X).all() else None


def _without_parameters(slopes: list[Array], N: Array) -> Array:
    """Combinations of the rows of [A B; C D] without a parameter, (combinations, rows)."""
    rows = np.hstack([slope.transpose(1, 0, 2).reshape(len(N), -1) for slope in slopes])
    size = np.abs(rows).max(axis=0)
    return np.asarray(scipy.linalg.null_space((rows[:, size > 0] / size[size > 0]).T).T)


def _sizes(X: ComplexArray, target: Target) -> Array:
    """Typical size of each equation's terms, (K, nx + ny, nu); infinite where not measured."""
    state = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    state = np.maximum(state, 1e-6 * state.max() or 1.0)
    rates = target.omega[:, None, None] * state[:, None] * np.ones(X.shape[2])
    with np.errstate(divide="ignore"):
        outputs = np.abs(target.G) * target.input_scale / np.sqrt(target.weight)
    return np.concatenate([rates, outputs], axis=1)


def _states(T: Array, N: Array, X: ComplexArray, Y: ComplexArray, target: Target) -> ComplexArray:
    """States from the equations without parameters; what these leave open, from the guess's."""
    K, nx, nu = X.shape
    size = _sizes(X, target)
    unit = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    unit = np.maximum(unit, 1e-6 * unit.max() or 1.0)
    below = np.broadcast_to(-N[nx:, :nx], (K, len(N) - nx, nx))
    left = 1j * target.omega[:, None, None] * np.eye(nx) - N[:nx, :nx]
    left = np.concatenate([left, below], axis=1)
    right = np.concatenate([np.zeros((K, nx, nu)), -Y], axis=1) + N[:, nx:] * target.input_scale
    found = np.empty_like(X)
    for j in range(nu):
        # A combination is as uncertain as its largest term; one not measured drops out.
        spread = np.max(np.where(np.abs(T) > 1e-9, np.abs(T) * _finite(size[:, None, :, j]), 0), 2)
        w = np.where(spread < HUGE, 1 / np.maximum(spread, 1e-300), 0.0)[:, :, None]
        M, R = w * (T @ left) * unit, w * (T @ right[:, :, j, None])
        guessed = PRIOR / np.minimum(size[:, :, j], HUGE)[:, :, None]
        M = np.concatenate([M, guessed * left * unit], axis=1)
        R = np.concatenate([R, guessed * right[:, :, j, None]], axis=1)
        MH = M.conj().transpose(0, 2, 1)
        normal = MH @ M + 1e-12 * np.eye(nx)
        found[:, :, j] = np.linalg.solve(normal, MH @ R)[:, :, 0] * unit
    return found


def _finite(size: Array) -> Array:
    return np.minimum(size, 10 * HUGE)


def _parameters(
    free: Free, N: Array, dN: Array, X: ComplexArray, Y: ComplexArray, target: Target
) -> Array:
    """Parameters within their bounds that fit all equations best with these states."""
    K, _, nu = X.shape
    scale = free.scale[free.index]
    weight = 1 / _finite(_sizes(X, target))
    inputs = np.broadcast_to(np.diag(target.input_scale), (K, nu, nu))
    V = np.concatenate([X, inputs], axis=1)
    y = np.concatenate([1j * target.omega[:, None, None] * X, Y], axis=1)
    J = np.einsum("lrc,kcj->lkrj", dN, V, optimize=True) * weight
    r = weight * (y - N @ V)
    J = J.reshape(len(scale), -1).T * scale[:, None].T
    M = np.vstack([J.real, J.imag, RIDGE * np.sqrt(K) * np.eye(len(scale))])
    right = np.concatenate([r.real.ravel(), r.imag.ravel(), np.zeros(len(scale))])
    lower = np.minimum((free.lower[free.index] - free.guess) / scale, -1e-9)
    upper = np.maximum((free.upper[free.index] - free.guess) / scale, 1e-9)
    step = scipy.optimize.lsq_linear(M, right, bounds=(lower, upper)).x
    values = free.guess + scale * step
    return np.asarray(np.clip(values, free.lower[free.index], free.upper[free.index]))
