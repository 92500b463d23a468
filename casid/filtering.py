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
from functools import cached_property

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import Steps

LEVELS = 10.0 ** np.array([-6, -4, -3, -2, -1, 0, 1, 2, 3, 4])  # c
FELT = 10  # samples over which a state's noise of level 1 adds as much to an output as v does
FLOOR = 1e-2  # of an output's deviation: the least noise; with less, model errors move biases
RANK = 1e-10  # of information: directions of z with less are left alone
SETTLED = 1e-10  # change of a covariance, relative, after which gains are kept


@dataclass(frozen=True, eq=False)
class FilterState:
    """Filtered states at one sample; the first axis (levels) is that of the filters."""

    X: Array  # (levels, nx, 1 + nx + ny) states there: what inputs and outputs make, and by z
    P: Array  # (levels, nx, nx) covariances of these states, z known
    Q: Array  # (levels, nx, nx) of what the next steps of usual length will add each
    r: Array  # (ny,) variances of measurement noise
    moments: Array  # (levels, *2 * [1 + nx + ny]) of the whitened innovations so far, and by z
    sizes: Array  # (levels,) sums of log det S

    @cached_property
    def _covariances(self) -> Array:
        """Of z (levels, *2 * [nx + ny]); directions of which nothing is told have none."""
        H = self.moments[:, 1:, 1:]
        unit = np.sqrt(np.diagonal(H, axis1=1, axis2=2))
        unit = np.where(unit == 0, 1.0, unit)
        both = unit[:, :, None] * unit[:, None]
        return np.asarray(np.linalg.pinv(H / both, rcond=RANK, hermitian=True) / both)

    @cached_property
    def likeliest(self) -> tuple[int, Array]:
        """The level with the largest likelihood, and 1 beside what it knows of z."""
        g = self.moments[:, 1:, 0]
        z = -(self._covariances @ g[:, :, None])[:, :, 0]
        best = int(np.argmin(self.sizes + self.moments[:, 0, 0] + np.sum(g * z, axis=1)))
        return best, np.r_[1.0, z[best]]

    @property
    def unsettled(self) -> Array:
        """Covariance of state and biases, *2 * [nx + ny], that comes of z, by noise alone."""
        by_z = np.eye(self.X.shape[2] - 1)  # the first level has next to no disturbances
        by_z[: self.X.shape[1]] = self.X[0, :, 1:]
        return np.asarray(by_z @ self._covariances[0] @ by_z.T)

    def known_by(self, later: "FilterState") -> Array:
        """State (nx,), z and the level being those of a later sample."""
        best, z = later.likeliest
        return np.asarray(self.X[best] @ z)

    @property
    def x(self) -> Array:
        """State (nx,)."""
        return self.known_by(self)

    @property
    def bias(self) -> Array:
        """Biases (ny,)."""
        return self.likeliest[1][1 + self.X.shape[1] :]


def noises(steps: Steps, C: Array, y: Array, scale: Array) -> tuple[Array, Array]:
    """Variances q (nx,) of process noise a step, and r (ny,) of measurement noise."""
    r = (FLOOR * scale) ** 2
    for i, column in enumerate(y.T):
        bends = np.diff(column[np.isfinite(column)], 2)
        if len(bends):
            r[i] = max(r[i], np.mean(bends**2) / 6)
    usual = steps.maps[int(np.argmax(np.bincount(steps.which)))]
    felt, seen = np.zeros(C.shape), C
    for _ in range(FELT):
        felt += seen**2
        seen = seen @ usual
    most = (felt / r[:, None]).max(axis=0)
    return np.divide(1.0, most, out=np.zeros_like(most), where=most > 0), r


def filter_states(
    steps: Steps,
    C: Array,
    y: Array,
    t: Array,
    scale: Array,
    at: Collection[int],
    biased: BoolArray | None = None,
) -> Iterator[FilterState]:
    """What is known at each of the samples, in order, from the outputs (N, ny) up to it.

    NaN is missing; C is (ny, nx) or (N, ny, nx). All outputs have a bias, unless it is said which
    (ny,) are ``biased``. What comes after a sample is read when the next is asked for: whoever
    linearises may set it on the way.
    """
    C = np.broadcast_to(C, (len(t), *C.shape[-2:]))
    q, r = noises(steps, C[0], y[: max(at) + 1], scale)
    (ny, nx), unit = C.shape[1:], np.diff(t) / np.median(np.diff(t))
    constant = np.eye(ny) if biased is None else np.diag(biased.astype(float))
    bank = _Bank(q, r)
    X = np.zeros((len(LEVELS), nx, 1 + nx + ny))  # states: of inputs and outputs, and by z
    X[:, :, 1 : 1 + nx] = np.eye(nx)
    moments, sizes = np.zeros((len(LEVELS), *2 * [1 + nx + ny])), np.zeros(len(LEVELS))
    for k in range(max(at) + 1):
        seen = np.isfinite(y[k])
        K, W, size = bank.update(C[k], seen)
        E = -C[k] @ X
        E[:, :, 0] += np.where(seen, y[k] - steps.direct[k], 0.0)
        E[:, :, 1 + nx :] -= constant
        X = X + K @ E
        white = W @ E
        moments = moments + white.transpose(0, 2, 1) @ white
        sizes = sizes + size
        if k in at:
            yield FilterState(X, bank.P, bank.Q, r, moments, sizes)
        if k < len(unit):
            A = steps.maps[steps.which[k]]
            X = A @ X
            X[:, :, 0] += steps.forcing[k]
            bank.propagate(A, float(unit[k]), int(steps.which[k]))


class _Bank:
    """Covariances of filters with all levels of process noise."""

    def __init__(self, q: Array, r: Array) -> None:
        self.Q, self.r = LEVELS[:, None, None] * np.diag(q), r
        self._P = self.P = self.Q.copy()  # before and after a sample
        self._kept: tuple[Array, Array, Array] | None = None
        self._seen: BoolArray = np.zeros(0, bool)
        self._step, self._same = -1, False

    def update(self, C: Array, seen: BoolArray) -> tuple[Array, Array, Array]:
        """Gains (b, nx, ny), whiteners (b, ny, ny), log det S (b,) of a measurement update."""
        if not (self._same and self._kept is not None and np.array_equal(seen, self._seen)):
            C, r = C * seen[:, None], np.where(seen, self.r, 1.0)
            S = C @ self._P @ C.T + np.diag(r)
            W = np.linalg.inv(np.linalg.cholesky(S))
            K = self._P @ C.T @ W.transpose(0, 2, 1) @ W
            F = np.eye(len(self.Q[0])) - K @ C
            self.P = F @ self._P @ F.transpose(0, 2, 1) + (K * r) @ K.transpose(0, 2, 1)
            size = -2 * np.log(np.diagonal(W, axis1=1, axis2=2)).sum(axis=1)
            self._kept = K, W * seen, size
            self._seen, self._same = seen, False
        return self._kept

    def propagate(self, A: Array, unit: float, step: int) -> None:
        """Time update over a step of its class, ``unit`` times as long as the usual one."""
        if self._same and step == self._step:
            return
        P = A @ self.P @ A.T + unit * self.Q
        change = np.abs(P - self._P).max(axis=(1, 2))
        self._same = step == self._step and bool(
            (change <= SETTLED * np.abs(P).max(axis=(1, 2))).all()
        )
        self._P, self._step = P, step
