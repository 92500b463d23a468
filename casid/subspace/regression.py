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
from casid.linear import StateSpace, recursion
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
    # The derivatives by entries i of (G, K) and of x(0) are Σ C F^(k-1-l) e_i v(l) and C F^k e_i:
    # rows that take one more F a sample, for all i at once.
    ny, nu = feedthrough.shape
    n, nv = len(F), nu + ny
    free = np.argwhere(feedthrough)
    state: Array = np.hstack([C.T, np.zeros((n, nv * ny))])  # (n, x(0) and every channel, ny)
    for start in range(0, len(stretch.y), BLOCK):
        v, y = stretch.v[start : start + BLOCK], stretch.y[start : start + BLOCK]
        driven = np.hstack([np.zeros((len(v), 1)), v])
        forcing = np.einsum("kc,oi->kico", driven, C).reshape(len(v), n, -1)
        states = recursion(F.T, forcing, state)
        state = states[-1]
        by = states[:-1].reshape(len(v), n, 1 + nv, ny).transpose(0, 3, 2, 1)
        seen = by.reshape(len(v), ny, -1)
        direct = np.zeros((len(y), ny, len(free)))
        direct[:, free[:, 0], np.arange(len(free))] = v[:, free[:, 1]]
        constant = np.broadcast_to(np.eye(ny), (len(y), ny, ny))
        rows = [seen[:, :, :n], constant, seen[:, :, n:], direct, y[:, :, None]]
        block = np.einsum("op,kpc->koc", W, np.concatenate(rows, axis=2))
        yield block.reshape(len(y) * ny, -1)
