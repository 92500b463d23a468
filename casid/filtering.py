"""States that a record's past tells, by Kalman filters with initial state and biases unknown.

    x[k+1] = A x[k] + f[k] + w[k],    w ~ N(0, c Q),
    y[k] = C x[k] + d[k] + b + v[k],  v ~ N(0, R)

An aircraft is disturbed and no model is true, therefore the latest samples tell most of the state.
How much more is not known beforehand: R comes from second differences of the outputs, Q is diagonal
and makes every state felt alike, and of filters with several levels c, that one is asked whose
likelihood has been the largest so far. All are linear in z = (x[0], b), of which nothing is known,
and least squares of the innovations so far give it (P. de Jong, "The diffuse Kalman filter", Annals
of Statistics 19, 1991).
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import Steps

LEVELS = 10.0 ** np.array([-6, -4, -3, -2, -1, 0, 1, 2, 3, 4])  # c
FELT = 10  # samples over which a state's noise of level 1 adds as much to an output as v does
FLOOR = 1e-6  # of an output's deviation: the least measurement noise
RANK = 1e-10  # of information: directions of z with less are left alone
SETTLED = 1e-10  # change of a covariance, relative, after which gains are kept


@dataclass(frozen=True, eq=False)
class Start:
    """What is known at one sample."""

    x: Array  # (nx,) state there
    first: Array  # (nx,) state at the first sample
    bias: Array  # (ny,)
    P: Array  # (nx, nx) covariance of x, z being known
    Q: Array  # (nx, nx) covariance of what the next steps of usual length will add each
    r: Array  # (ny,) variances of measurement noise


def noises(steps: Steps, C: Array, y: Array, scale: Array) -> tuple[Array, Array]:
    """Variances q (nx,) of process noise a step, and r (ny,) of measurement noise."""
    r = (FLOOR * scale) ** 2
    for i, column in enumerate(y.T):
        bends = np.diff(column[np.isfinite(column)], 2)
        if len(bends):
            r[i] += np.mean(bends**2) / 6
    usual = steps.maps[int(np.argmax(np.bincount(steps.which)))]
    felt, seen = np.zeros(C.shape), C
    for _ in range(FELT):
        felt += seen**2
        seen = seen @ usual
    most = (felt / r[:, None]).max(axis=0)
    return np.divide(1.0, most, out=np.zeros_like(most), where=most > 0), r


def starts(
    steps: Steps, C: Array, y: Array, t: Array, scale: Array, at: Collection[int]
) -> Iterator[Start]:
    """State at each of the samples, in order, from the outputs (N, ny) up to it; NaN is missing."""
    q, r = noises(steps, C, y, scale)
    (ny, nx), unit = C.shape, np.diff(t) / np.median(np.diff(t))
    bank = _Bank(q, r, C)
    X = np.zeros((len(LEVELS), nx, 1 + nx + ny))  # states: of inputs and outputs, and by z
    X[:, :, 1 : 1 + nx] = np.eye(nx)
    moments, sizes = np.zeros((len(LEVELS), *2 * [1 + nx + ny])), np.zeros(len(LEVELS))
    for k in range(max(at) + 1):
        seen = np.isfinite(y[k])
        K, W, size = bank.look(seen)
        E = -C @ X
        E[:, :, 0] += np.where(seen, y[k] - steps.direct[k], 0.0)
        E[:, :, 1 + nx :] -= np.eye(ny)
        X = X + K @ E
        white = W @ E
        moments += white.transpose(0, 2, 1) @ white
        sizes += size
        if k in at:
            yield _likeliest(X, moments, sizes, bank)
        if k < len(unit):
            A = steps.maps[steps.which[k]]
            X = A @ X
            X[:, :, 0] += steps.forcing[k]
            bank.move(A, float(unit[k]), int(steps.which[k]))


class _Bank:
    """Covariances of filters with all levels of process noise."""

    def __init__(self, q: Array, r: Array, C: Array) -> None:
        self.Q, self.r, self._C = LEVELS[:, None, None] * np.diag(q), r, C
        self._P = self.after = self.Q.copy()  # before and after a sample
        self._kept: tuple[Array, Array, Array] | None = None
        self._seen: BoolArray = np.zeros(0, bool)
        self._step, self._same = -1, False

    def look(self, seen: BoolArray) -> tuple[Array, Array, Array]:
        """Gains (b, nx, ny), whiteners (b, ny, ny) and log det S (b,); 0 where nothing is seen."""
        if not (self._same and self._kept is not None and np.array_equal(seen, self._seen)):
            C, r = self._C * seen[:, None], np.where(seen, self.r, 1.0)
            S = C @ self._P @ C.T + np.diag(r)
            W = np.linalg.inv(np.linalg.cholesky(S))
            K = self._P @ C.T @ W.transpose(0, 2, 1) @ W
            F = np.eye(len(self.Q[0])) - K @ C
            self.after = F @ self._P @ F.transpose(0, 2, 1) + (K * r) @ K.transpose(0, 2, 1)
            size = -2 * np.log(np.diagonal(W, axis1=1, axis2=2)).sum(axis=1)
            self._kept = K, W * seen, size
            self._seen, self._same = seen, False
        return self._kept

    def move(self, A: Array, unit: float, step: int) -> None:
        """On by a step of its class, ``unit`` times the usual one."""
        if self._same and step == self._step:
            return
        P = A @ self.after @ A.T + unit * self.Q
        change = np.abs(P - self._P).max(axis=(1, 2))
        self._same = step == self._step and bool(
            (change <= SETTLED * np.abs(P).max(axis=(1, 2))).all()
        )
        self._P, self._step = P, step


def _likeliest(X: Array, moments: Array, sizes: Array, bank: _Bank) -> Start:
    """What the level with the largest likelihood knows."""
    costs, solutions = [], []
    for M, size in zip(moments, sizes, strict=True):
        H, g = M[1:, 1:], M[1:, 0]
        unit = np.sqrt(np.diag(H))
        unit[unit == 0] = 1.0
        inverse = np.linalg.pinv(H / np.outer(unit, unit), rcond=RANK, hermitian=True)
        solutions.append(-inverse @ (g / unit) / unit)
        costs.append(size + M[0, 0] + g @ solutions[-1])
    best = int(np.argmin(costs))
    z, nx = solutions[best], X.shape[1]
    x = X[best, :, 0] + X[best, :, 1:] @ z
    return Start(x, z[:nx], z[nx:], bank.after[best], bank.Q[best], bank.r)
