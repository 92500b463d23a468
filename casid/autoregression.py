"""A short autoregression of a record, and what it makes of lost samples.

The outputs are predicted one sample ahead from their own and the inputs' last few samples,

    y(k) = Σ A_i y(k−i) + Σ B_i u(k−i) + c + e(k),        i = 1 … p, and B_0 u(k),

by least squares. Lost samples are then those values that make the innovations e of all samples
around them smallest, weighed by their covariance: what a smoother with this model gives, from both
ends of a loss and from the other channels; near the record's start, which nothing predicts, by an
autoregression that runs back in time. Those between the samples of a slower channel are read
off a cubic spline instead, which is no worse there and adds no model.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.record import Record
from casid.samples import at_instants

REACH = 0.25  # time [s] that the lags reach back, within these limits
LAGS = (2, 10)
PER_UNKNOWN = (12, 5)  # samples, and at least for the fewest lags
TRUST = 9.0  # times the variance of what is interpolated, as the regression takes it
ROWS = 20_000  # samples that it is fitted to
ROUNDS = 2  # of fitting and filling
SPAN = 9  # times the lags: samples whose covariance is looked at together
BLOCK = 64  # lost samples whose variances are held at once


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Coefficients by lag and the innovations' covariance."""

    A: Array  # (p, ny, ny) on past outputs
    B: Array  # (p + 1, ny, nu) on inputs, the present one first
    c: Array  # (ny,) constant
    R: Array  # (ny, ny)

    def innovations(self, u: Array, y: Array) -> Array:
        """What the prediction misses from sample p on, (N - p, ny)."""
        p = len(self.A)
        e = y[p:] - self.c
        for i in range(p + 1):
            rows = slice(p - i, len(y) - i)
            e = e - u[rows] @ self.B[i].T
            if i:
                e = e - y[rows] @ self.A[i - 1].T
        return np.asarray(e)


def autoregression(record: Record, y: Array, lost: BoolArray) -> Autoregression:
    """The autoregression of a record with these outputs, not fitted to the lost ones (N, ny)."""
    p = _order(record)
    rows = p + np.arange(record.N - p)[:: -(-(record.N - p) // ROWS)]
    ny, nu = record.ny, record.nu
    columns = [y[rows - i] for i in range(1, p + 1)]
    columns += [record.u[rows - i] for i in range(p + 1)]
    X = np.hstack([*columns, np.ones((len(rows), 1))])
    size = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-100)
    seen = ~lost[rows]
    seen[:, seen.sum(axis=0) < 2 * X.shape[1]] = True
    gone = np.concatenate([lost[rows - i].sum(axis=0) for i in range(1, p + 1)])
    gone = gone / np.maximum(size[: p * ny], 1e-100) ** 2
    theta = _regressed(X / size, y[rows], seen, gone, _doubts(y, lost)[rows]) / size[:, None]
    e = y[rows] - X @ theta
    # What is filled in fits better than what was measured.
    level = np.sqrt((e**2).mean(axis=0, where=seen) / np.maximum((e**2).mean(axis=0), 1e-300))
    e = e * level
    R = e.T @ e / len(rows)
    floor = 1e-10 * np.maximum(np.var(y, axis=0), 1e-300)
    A = theta[: p * ny].T.reshape(ny, p, ny).swapaxes(0, 1)
    B = theta[p * ny : -1].T.reshape(ny, p + 1, nu).swapaxes(0, 1)
    return Autoregression(A, B, theta[-1], R + np.diag(floor))


def _order(record: Record) -> int:
    """Number of lags p."""
    p = int(np.clip(round(REACH / record.dt), *LAGS))
    # In short records fewer, lest it adapts to single samples.
    few, most = (
        (record.N // rows - 1 - record.nu) // (record.nu + record.ny) for rows in PER_UNKNOWN
    )
    return max(1, min(p, most, max(few, LAGS[0])))


def _regressed(X: Array, y: Array, seen: BoolArray, gone: Array, doubts: Array) -> Array:
    """Least squares of every output (N, ny) on X (N, n), over the rows where it was seen.

    ``gone`` says how many samples of each past output were filled in, in squared units of X. As
    each is uncertain by about an innovation, it counts less: what is filled in follows the model,
    which would else follow what was filled in. Rows that were not seen count by the variance of
    what stands there, ``doubts`` (N, ny): where losses keep step with the inputs, they alone hold
    what an input does at once.
    """
    if seen.all() and not gone.any():
        return np.linalg.lstsq(X, y, rcond=1e-10)[0]
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    kept = s > 1e-10 * s[0]
    U, V = U[:, kept], Vt[kept].T / s[kept]
    theta, unsure = np.zeros((X.shape[1], y.shape[1])), np.zeros(X.shape[1])
    count = np.asarray(seen, dtype=float)
    for _ in range(2):
        more = V.T @ (unsure[:, None] * V) + 1e-9 * np.eye(V.shape[1])
        theta = V @ np.column_stack(
            [_weighed(U, more, x, w) for x, w in zip(y.T, count.T, strict=True)]
        )
        power = ((y - X @ theta) ** 2).mean(axis=0, where=seen)
        unsure[: len(gone)] = gone * np.tile(power, len(gone) // len(power))
        count = np.where(seen, 1.0, power / np.maximum(doubts, np.maximum(power, 1e-300)))
    return np.asarray(theta)


def _weighed(U: Array, more: Array, x: Array, count: Array) -> Array:
    """Least squares of x (N,) on orthonormal columns U (N, n), rows weighed by ``count`` (N,)."""
    less = count < 1
    H = np.eye(U.shape[1]) - U[less].T @ ((1 - count[less])[:, None] * U[less])
    return np.asarray(np.linalg.solve(H + more, U.T @ (count * x)))


def _doubts(y: Array, lost: BoolArray) -> Array:
    """Variance (N, ny) of lost samples as interpolated between neighbours, infinite of others.

    By how far samples seen are from the mean of those as far away on both sides: of splines less.
    It is taken for larger by `TRUST`, as nothing is measured there.
    """
    doubts = np.full(y.shape, np.inf)
    for i in np.flatnonzero(lost.any(axis=0) & ~lost.all(axis=0)):
        seen, at = np.flatnonzero(~lost[:, i]), np.flatnonzero(lost[:, i])
        at = at[(at > seen[0]) & (at < seen[-1])]
        after = np.searchsorted(seen, at)
        far = np.maximum(at - seen[after - 1], seen[after] - at)
        known = np.where(lost[:, i], np.nan, y[:, i])
        for m in np.unique(far[far <= LAGS[1]]):
            off = known[m:-m] - (known[: -2 * m] + known[2 * m :]) / 2
            off = off[np.isfinite(off)]
            if len(off):
                doubts[at[far == m], i] = TRUST * np.mean(off**2)
    return doubts


def filled(record: Record) -> tuple[Record, BoolArray]:
    """An equidistant record with its lost outputs filled in, and where they were (N, ny)."""
    # A channel without any sample stays lost.
    lost = np.isnan(record.y)
    if not lost.any():
        return record, lost
    known = np.column_stack([at_instants(record.t, x, record.t, "smooth") for x in record.y.T])
    known = np.where(lost, known, record.y)
    unread = np.isnan(known)
    gone = np.where(slow(lost), unread, lost)
    there = ~unread.all(axis=0)
    if not gone[:, there].any():
        return replace(record, y=known), lost
    k = np.arange(record.N)
    for i in np.flatnonzero(there):
        rows = ~unread[:, i]
        known[:, i] = np.interp(k, k[rows], known[rows, i])
    part = record.select(outputs=[record.outputs[i] for i in np.flatnonzero(there)])
    for _ in range(ROUNDS):
        smooth = _refilled(part, known[:, there], gone[:, there])
        known[:, there] = np.where(np.isfinite(smooth), smooth, known[:, there])
    return replace(record, y=known), lost


def slow(lost: BoolArray) -> BoolArray:
    """Which channels are sampled at twice the record's interval or more, (ny,)."""
    spacing = [np.diff(np.flatnonzero(~column)) for column in lost.T]
    return np.array([len(each) > 0 and np.median(each) >= 2 for each in spacing])


def _refilled(record: Record, y: Array, lost: BoolArray) -> Array:
    """Outputs (N, ny), lost ones as autoregressions fitted to them smooth them.

    Up to the turn one that runs back in time. Forward the first p samples are not predicted: one
    that is lost is then what later innovations make of it, by coefficients that may be small.
    """
    turn = _turn(lost, _order(record))
    ahead, behind = slice(turn, None), slice(len(y) - turn, None)
    out = y.copy()
    if lost[ahead].any():
        out[ahead] = _smoothed(autoregression(record, y, lost), record.u, y, lost)[ahead]
    if lost[:turn].any():
        y, lost = y[::-1], lost[::-1]
        back = replace(record, u=record.u[::-1], y=y)
        smooth = _smoothed(autoregression(back, y, lost), back.u, y, lost)
        out[:turn] = smooth[behind][::-1]
    return out


def _turn(lost: BoolArray, p: int) -> int:
    """The first of p rows without a loss: as these are known, neither side needs the other.

    Without such rows a known one near the middle, far from where either way begins.
    """
    known = ~lost.any(axis=1)
    clear = np.flatnonzero(np.convolve(known, np.ones(p), "valid") > p - 0.5)
    if len(clear):
        return int(clear[0])
    rows, middle = np.flatnonzero(known), len(lost) // 2
    return int(rows[np.argmin(np.abs(rows - middle))]) if len(rows) else middle


def _smoothed(model: Autoregression, u: Array, y: Array, lost: BoolArray) -> Array:
    """Outputs (N, ny), lost ones estimated by least squares of the whitened innovations."""
    normal, slope = _normal(model, u, y, lost)
    with warnings.catch_warnings():  # what a singular system gives is not taken
        warnings.simplefilter("ignore", scipy.sparse.linalg.MatrixRankWarning)
        step = scipy.sparse.linalg.spsolve(normal, slope)
    out = y.copy()
    out[lost] -= step
    return out


def apart(
    model: Autoregression, whole: Record, lost: BoolArray, rows: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Smoothing residual of each sample, given all others, and its standard deviation, (N, ny).

    Of successive ``rows`` (N,) of a record, forward or back in time. With Q the inverse of the
    outputs' covariance, these are (Q (y − mean))_k/Q_kk and 1/√Q_kk, lost ones eliminated from Q.
    """
    u, lost = whole.u[rows], lost[rows]
    y = _smoothed(model, u, whole.y[rows], lost)
    p, N, ny = len(model.A), *y.shape
    W, size = _whitening(model)
    S = np.array([W, *(-W @ A for A in model.A)])  # slopes of the innovation i samples later
    none = np.zeros((p, ny))
    e = np.vstack([none, model.innovations(u, y) @ W.T, none])
    slope = sum((e[i : i + N] @ S[i] for i in range(p + 1)), np.zeros((N, ny)))
    span = min(N, SPAN * p)  # Q is a band matrix, of which parts are enough
    each = np.hstack([*S[::-1]])  # of one sample's innovations by the outputs up to it
    Q = np.zeros((span * ny, span * ny))
    for n in range(0, (span - p) * ny, ny):
        Q[n : n + len(each.T), n : n + len(each.T)] += each.T @ each
    Q += 1e-9 * np.diag(np.tile(np.diag(W.T @ W), span))
    sharp = np.zeros((N, ny))
    for k in range(0, N, max(span - 4 * p, 1)):
        first = min(max(k - 2 * p, 0), N - span)
        end = min(k + max(span - 4 * p, 1), N)
        own = np.arange((k - first) * ny, (end - first) * ny)
        gone = np.flatnonzero(lost[first : first + span])
        between = Q[np.ix_(gone, own)]
        drop = np.sum(between * np.linalg.solve(Q[np.ix_(gone, gone)], between), axis=0)
        sharp[k:end] = (np.diag(Q)[own] - drop).reshape(-1, ny)
    sharp = np.maximum(sharp, 1e-9 * np.diag(W.T @ W))
    return slope / sharp, 1 / (size * np.sqrt(sharp))


def unsure(whole: Record, lost: BoolArray, marks: BoolArray) -> Array:
    """Standard deviations (N, ny) of what `filled` makes of these lost samples, 0 elsewhere."""
    late = marks & (np.arange(whole.N) >= _turn(lost, _order(whole)))[:, None]
    early, std = marks & ~late, np.zeros(lost.shape)
    if late.any():
        std += _spread(autoregression(whole, whole.y, lost), whole, lost, late)
    if early.any():
        back, gone = replace(whole, u=whole.u[::-1], y=whole.y[::-1]), lost[::-1]
        std += _spread(autoregression(back, back.y, gone), back, gone, early[::-1])[::-1]
    return std


def _spread(model: Autoregression, whole: Record, lost: BoolArray, marks: BoolArray) -> Array:
    """Standard deviations (N, ny) of what `_smoothed` makes of these lost samples, 0 elsewhere."""
    normal, _ = _normal(model, whole.u, whole.y, lost)
    own = np.flatnonzero(marks[lost])
    solve, variance = scipy.sparse.linalg.splu(normal).solve, np.zeros(len(own))
    for k in range(0, len(own), BLOCK):
        part = own[k : k + BLOCK]
        unit = np.zeros((normal.shape[0], len(part)))
        unit[part, np.arange(len(part))] = 1.0
        variance[k : k + BLOCK] = solve(unit)[part, np.arange(len(part))]
    std = np.zeros(lost.shape)
    std[marks & lost] = np.sqrt(np.maximum(variance, 0.0)) / _whitening(model)[1]
    return std


def _normal(
    model: Autoregression, u: Array, y: Array, lost: BoolArray
) -> tuple[scipy.sparse.csc_matrix, Array]:
    """Normal equations (n, n), (n,) of the n lost samples, scaled as `_whitening` is."""
    p, ny = len(model.A), y.shape[1]
    W, _ = _whitening(model)
    e = model.innovations(u, y) @ W.T
    at, of = np.nonzero(lost)
    rows, columns, values = [], [], []
    for i in range(p + 1):
        slope = W if i == 0 else -W @ model.A[i - 1]  # of the innovation i samples later
        inside = (at + i >= p) & (at + i < len(y))
        n = np.flatnonzero(inside)
        rows.append((((at[n] + i - p) * ny)[:, None] + np.arange(ny)).ravel())
        columns.append(np.repeat(n, ny))
        values.append(slope[:, of[n]].T.ravel())
    shape = (e.size, len(at))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    J = scipy.sparse.csc_matrix(entries, shape=shape)
    normal = J.T @ J + 1e-12 * scipy.sparse.diags(np.diag(W.T @ W)[of])
    return normal.tocsc(), np.asarray(J.T @ e.ravel())


def _whitening(model: Autoregression) -> tuple[Array, float]:
    """What whitens innovations but for a size: squares of it all may be too large."""
    W = np.linalg.inv(np.linalg.cholesky(model.R))
    size = float(np.abs(W).max())
    return W / size, size
