"""Where inputs and innovations enter a black box of samples, by one linear regression.

PBSIDopt takes B and K from a regression between states that are themselves estimates. Given the
predictor's dynamics F = A - KC and the output matrix C, prediction errors are linear in the rest,

    x⁺ = F x + G u + K y        ŷ = C x + D u + c        G = B - KD

so that G, K, D and the initial state and constant of every stretch follow from least squares, which
short or narrow-banded records support where they do not support a refinement of everything. Source:
L. Ljung, System Identification, 2nd ed., section 10.6, there for B and D of a subspace estimate.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace.prediction import Stretch, stretches
from casid.subspace.predictor import accumulate, triangular

BLOCK = 1024  # samples whose rows are held at once
LEAST = 1e-11  # of the largest singular value: what is smaller is no direction of the data


def regress_inputs(
    system: StateSpace,
    K: Array,
    records: Sequence[Record],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    R: Array,
) -> tuple[StateSpace, Array]:
    """B, K and D of a discrete model anew, the predictor's stable dynamics A - KC and C kept.

    Records are equidistant, of one interval; missing outputs split them. Channels are scaled by
    ``su`` (nu,), ``sy`` (ny,) and errors weighed by their covariance R; the direct term is free
    where ``feedthrough`` (ny, nu) is, zero elsewhere.
    """
    n, nu, ny = system.nx, len(su), len(sy)
    F, C = system.A - K @ system.C, system.C / sy[:, None]
    whitener = np.linalg.inv(np.linalg.cholesky(R / np.outer(sy, sy)))
    total: Array = np.zeros((0, n * (nu + ny) + int(feedthrough.sum()) + 1))
    for stretch in stretches(records, su, sy, n + 2):
        own = n + ny  # initial state and constant of this stretch alone
        part, _ = accumulate(_rows(F, C, stretch, feedthrough, whitener), constant=False)
        total = triangular(np.vstack([total, part[own:, own:]]))
    size = np.maximum(np.linalg.norm(total[:, :-1], axis=0), 1e-300)
    theta = np.linalg.lstsq(total[:, :-1] / size, total[:, -1], rcond=LEAST)[0] / size
    G, gain = np.split(theta[: n * (nu + ny)].reshape(nu + ny, n).T, [nu], axis=1)
    D = np.zeros((ny, nu))
    D[feedthrough] = theta[n * (nu + ny) :]
    K = gain / sy
    A, B, D = F + K @ system.C, (G + gain @ D) / su, sy[:, None] * D / su
    return StateSpace(A, B, system.C, D, system.dt, system.inputs, system.outputs), K


def _rows(
    F: Array, C: Array, stretch: Stretch, feedthrough: BoolArray, W: Array
) -> Iterator[Array]:
    """Whitened rows of a stretch: derivatives by x(0), c, the columns of (G, K) and D, then y."""
    ny, nu = feedthrough.shape
    n, nv = len(F), nu + ny
    free = np.argwhere(feedthrough)
    states = np.hstack([np.eye(n), np.zeros((n, n * nv))])  # by x(0), and by every column of (G, K)
    row = np.arange(n)
    own = n + n * np.arange(nv)[:, None] + row  # each state by its entries in the columns
    for start in range(0, len(stretch.y), BLOCK):
        v, y = stretch.v[start : start + BLOCK], stretch.y[start : start + BLOCK]
        seen = np.empty((len(y), ny, n * (1 + nv)))
        for k, now in enumerate(v):
            seen[k] = C @ states
            states = F @ states
            states[row, own] += now[:, None]
        direct = np.zeros((len(y), ny, len(free)))
        direct[:, free[:, 0], np.arange(len(free))] = v[:, free[:, 1]]
        constant = np.broadcast_to(np.eye(ny), (len(y), ny, ny))
        rows = [seen[:, :, :n], constant, seen[:, :, n:], direct, y[:, :, None]]
        block = np.einsum("op,kpc->koc", W, np.concatenate(rows, axis=2))
        yield block.reshape(len(y) * ny, -1)
