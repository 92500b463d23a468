"""A short autoregression of a record: what it makes of lost samples, and which it calls outliers.

The outputs are predicted one sample ahead from their own and the inputs' last few samples,

    y(k) = Σ A_i y(k−i) + Σ B_i u(k−i) + c + e(k),        i = 1 … p, and B_0 u(k),

by least squares. Lost samples are then those values that make the innovations e of all samples
around them smallest, weighed by their covariance: what a smoother with this model gives, from both
ends of a loss and from the other channels. Those between the samples of a slower channel are read
off a cubic spline instead, which is no worse there and adds no model.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg

from casid.arrays import Array, BoolArray
from casid.record import Record
from casid.samples import at_instants

REACH = 0.25  # time [s] that the lags reach back, within these limits
LAGS = (2, 10)
ROWS = 20_000  # samples that it is fitted to
ROUNDS = 2  # of fitting and filling
PASSES = 8  # at most, in which outliers are looked for
FEWEST = 50  # samples of a channel in which outliers are looked for
LATE = 1.5  # intervals after which a sample is not judged
FAR = 6.0  # deviations of a normal distribution that make an outlier
SLIGHT = 0.05  # of a channel's deviation: what is less does no harm
MAD = 1.482602218505602  # standard deviation of a normal distribution over its median deviation


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


def autoregression(record: Record, y: Array, trusted: BoolArray) -> Autoregression:
    """The autoregression of a record with these outputs, fitted where samples are trusted (N,)."""
    p = int(np.clip(round(REACH / record.dt), *LAGS))
    p = max(1, min(p, (record.N // 5 - 1 - record.nu) // (record.nu + record.ny)))
    rows = np.flatnonzero(trusted[p:])
    unknowns = p * (record.ny + record.nu) + record.nu + 1
    rows = p + (rows if len(rows) >= 2 * unknowns else np.arange(record.N - p))
    rows = rows[:: -(-len(rows) // ROWS)]
    columns = [y[rows - i] for i in range(1, p + 1)]
    columns += [record.u[rows - i] for i in range(p + 1)]
    X = np.hstack([*columns, np.ones((len(rows), 1))])
    size = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300)
    theta = np.linalg.lstsq(X / size, y[rows], rcond=1e-10)[0] / size[:, None]
    e = y[rows] - X @ theta
    R = e.T @ e / len(rows)
    floor = 1e-10 * np.maximum(np.var(y, axis=0), 1e-300)
    ny, nu = record.ny, record.nu
    A = theta[: p * ny].T.reshape(ny, p, ny).swapaxes(0, 1)
    B = theta[p * ny : -1].T.reshape(ny, p + 1, nu).swapaxes(0, 1)
    return Autoregression(A, B, theta[-1], R + np.diag(floor))


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
        model = autoregression(part, known[:, there], np.asarray(~gone[:, there].any(axis=1)))
        smooth = _smoothed(model, part.u, known[:, there], gone[:, there])
        known[:, there] = np.where(np.isfinite(smooth), smooth, known[:, there])
    return replace(record, y=known), lost


def slow(lost: BoolArray) -> BoolArray:
    """Which channels are sampled at twice the record's interval or more, (ny,)."""
    spacing = [np.diff(np.flatnonzero(~column)) for column in lost.T]
    return np.array([len(each) > 0 and np.median(each) >= 2 for each in spacing])


def outliers(record: Record) -> BoolArray:
    """Samples of outputs that neither those before and after nor the other channels bear out.

    Six robust deviations (median of absolute deviations) of the innovations away from what fills
    them in from both sides, (N, ny). What lasts, as a gust or a step does, is none.
    """
    found = np.zeros(record.y.shape, dtype=bool)
    # Channels sampled less often are no help to the others: between their samples predictions
    # are worse, and their outliers would spread. They are judged at their own samples.
    often = np.flatnonzero(~slow(np.isnan(record.y)))
    found[:, often] = _far(record.select(outputs=[record.outputs[i] for i in often]))
    sound = record.mask(found)
    for i in set(range(record.ny)) - set(often.tolist()):
        rows = np.isfinite(record.y[:, i])
        names = [record.outputs[j] for j in (*often, i)]
        if rows.sum() > FEWEST:
            found[rows, i] = _far(sound.select(outputs=names).take(rows))[:, -1]
    return found


def _far(record: Record) -> BoolArray:
    """Outliers of channels that are sampled alike, (N, ny)."""
    there = np.flatnonzero(np.isfinite(record.y).sum(axis=0) > FEWEST)
    part = record.select(outputs=[record.outputs[i] for i in there])
    found = np.zeros(record.y.shape, dtype=bool)
    if not len(there) or record.N < FEWEST:
        return found
    late = np.diff(record.t, prepend=record.t[0]) > LATE * record.dt  # not foreseen as well
    for _ in range(PASSES):
        y = np.where(found[:, there], np.nan, part.y)
        whole, lost = filled(replace(part, y=y))
        model = autoregression(part, whole.y, np.asarray(~lost.any(axis=1)))
        e = model.innovations(part.u, whole.y)
        unjudged = lost | late[:, None]
        e, p = np.where(unjudged[-len(e) :], np.nan, e), part.N - len(e)
        limit = FAR * MAD * np.nanmedian(np.abs(e), axis=0)
        limit = np.maximum(limit, SLIGHT * np.std(whole.y, axis=0))
        far = np.vstack([np.zeros((p, len(there)), dtype=bool), np.abs(e) > limit])
        if not far.any():
            break
        again = _smoothed(model, part.u, whole.y, far)
        size = np.where(far, np.abs(whole.y - again) / limit, 0.0)
        # An outlier spoils the predictions of all channels after it: the largest one first.
        around = scipy.ndimage.maximum_filter1d(size.max(axis=1), 2 * p + 1)
        found[:, there] |= (size > 1) & (size == around[:, None])
    return found


def _smoothed(model: Autoregression, u: Array, y: Array, lost: BoolArray) -> Array:
    """The outputs with the lost ones such that the weighed innovations are smallest."""
    p, ny = len(model.A), y.shape[1]
    W = np.linalg.inv(np.linalg.cholesky(model.R))  # whitens
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
    normal = J.T @ J + 1e-12 * scipy.sparse.eye(len(at))
    with warnings.catch_warnings():  # what a singular system gives is not taken
        warnings.simplefilter("ignore", scipy.sparse.linalg.MatrixRankWarning)
        step = scipy.sparse.linalg.spsolve(normal.tocsc(), J.T @ e.ravel())
    out = y.copy()
    out[at, of] -= step
    return out
