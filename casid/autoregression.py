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
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.record import Record
from casid.repetition import least_step
from casid.samples import MAD, at_instants, runs

REACH = 0.25  # time [s] that the lags reach back, within these limits
LAGS = (2, 10)
PER_UNKNOWN = (12, 5)  # samples, and at least for the fewest lags
ROWS = 20_000  # samples that it is fitted to
ROUNDS = 2  # of fitting and filling
PASSES = 8  # at most, in which outliers are looked for
FEWEST = 50  # samples of a channel in which outliers are looked for
PULSE = 0.2  # of an input's range
GAP = 10  # samples in a row that are lost, of all outputs: nothing after follows from before
SPAN = 9  # times the lags: samples whose covariance is looked at together
FAR = 6.0  # deviations of a normal distribution that make an outlier
GROSS = 10.0  # of one that no fit may see, as it would follow what all channels do at once
BRIEF, FEW = 0.08, 4  # s and samples that such a jump lasts at most
LONG, LEAP = 80, 0.5  # samples between jumps of a run; these, in the channel's deviations
SLIGHT = 0.05  # of a channel's deviation: what is less does no harm


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
    p = int(np.clip(round(REACH / record.dt), *LAGS))
    # In short records fewer, lest it adapts to single samples.
    few, most = (
        (record.N // rows - 1 - record.nu) // (record.nu + record.ny) for rows in PER_UNKNOWN
    )
    p = max(1, min(p, most, max(few, LAGS[0])))
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
    theta = _regressed(X / size, y[rows], seen, gone) / size[:, None]
    e = y[rows] - X @ theta
    # What is filled in fits better than what was measured.
    level = np.sqrt((e**2).mean(axis=0, where=seen) / np.maximum((e**2).mean(axis=0), 1e-300))
    e = e * level
    R = e.T @ e / len(rows)
    floor = 1e-10 * np.maximum(np.var(y, axis=0), 1e-300)
    A = theta[: p * ny].T.reshape(ny, p, ny).swapaxes(0, 1)
    B = theta[p * ny : -1].T.reshape(ny, p + 1, nu).swapaxes(0, 1)
    return Autoregression(A, B, theta[-1], R + np.diag(floor))


def _regressed(X: Array, y: Array, seen: BoolArray, gone: Array) -> Array:
    """Least squares of every output (N, ny) on X (N, n), over the rows where it was seen.

    ``gone`` says how many samples of each past output were filled in, in squared units of X. As
    each is uncertain by about an innovation, it counts less: what is filled in follows the model,
    which would else follow what was filled in.
    """
    if seen.all() and not gone.any():
        return np.linalg.lstsq(X, y, rcond=1e-10)[0]
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    kept = s > 1e-10 * s[0]
    U, V = U[:, kept], Vt[kept].T / s[kept]
    rows = [U[there] for there in seen.T]
    normal = [(Q.T @ Q, Q.T @ x[there]) for Q, x, there in zip(rows, y.T, seen.T, strict=True)]
    theta, unsure = np.zeros((X.shape[1], y.shape[1])), np.zeros(X.shape[1])
    for _ in range(2):
        more = V.T @ (unsure[:, None] * V) + 1e-9 * np.eye(V.shape[1])
        theta = V @ np.column_stack([np.linalg.solve(H + more, g) for H, g in normal])
        power = ((y - X @ theta) ** 2).mean(axis=0, where=seen)
        unsure[: len(gone)] = gone * np.tile(power, len(gone) // len(power))
    return np.asarray(theta)


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
        model = autoregression(part, known[:, there], gone[:, there])
        smooth = _smoothed(model, part.u, known[:, there], gone[:, there])
        known[:, there] = np.where(np.isfinite(smooth), smooth, known[:, there])
    return replace(record, y=known), lost


def slow(lost: BoolArray) -> BoolArray:
    """Which channels are sampled at twice the record's interval or more, (ny,)."""
    spacing = [np.diff(np.flatnonzero(~column)) for column in lost.T]
    return np.array([len(each) > 0 and np.median(each) >= 2 for each in spacing])


def outliers(record: Record) -> BoolArray:
    """Samples of outputs that neither those before and after nor the other channels bear out.

    A sample is compared with what an autoregression makes of all others, lost ones left out: six
    robust deviations (median of absolute deviations) of the innovations away, and of this
    difference, which is the larger the fewer samples there are around, (N, ny). What lasts, as a
    gust or a step does, is none.
    """
    found = np.zeros(record.y.shape, dtype=bool)
    # Channels sampled less often are no help to the others: an autoregression would have to be
    # fitted to what lies between their samples. They are judged at their own samples.
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
    seen = [x[np.isfinite(x)] for x in record.y.T]
    there = np.flatnonzero([len(x) > FEWEST and np.ptp(x) > 0 for x in seen])
    found = np.zeros(record.y.shape, dtype=bool)
    if not len(there) or record.N < FEWEST:
        return found
    part, own = _regular(record.select(outputs=[record.outputs[i] for i in there]))
    marks = _jumps(part) | _runs(part)
    for _ in range(PASSES):
        whole, lost = filled(part.mask(marks))
        off, limit, p = _judged(whole, lost)
        size = np.where(lost, 0.0, np.abs(off) / limit)
        # An outlier spoils what is expected of all channels around it: the largest one first.
        around = scipy.ndimage.maximum_filter1d(size.max(axis=1), 2 * p + 1)
        far = (size > 1) & (size == around[:, None])
        if not far.any():
            break
        marks |= far
    found[:, there] = marks[own]
    return found


def _jumps(record: Record) -> BoolArray:
    """Samples of several channels at once off what was around them and is expected there, (N, ny).

    Channels that jump together bear each other out, and least squares follow: so these are looked
    for in each channel alone, by its running median, and called if a fit without them says so too.
    """
    width = 2 * int(np.clip(round(BRIEF / record.dt), 1, FEW)) + 1
    marks = np.column_stack([_brief(x, width) for x in record.y.T])
    # A pulse of an input moves them all, and without its rows nobody would know.
    off = np.abs(record.u - scipy.ndimage.median_filter(record.u, (width, 1), mode="nearest"))
    pulses = np.any(off > PULSE * np.ptp(record.u, axis=0), axis=1)
    marks &= ~scipy.ndimage.maximum_filter1d(pulses, 2 * width + 1)[:, None]
    marks &= marks.sum(axis=1, keepdims=True) > 1
    if marks.any():
        whole, lost = filled(record.mask(marks))
        limit = np.where(lost, np.nan, _judged(whole, lost)[1])
        marks &= np.abs(record.y - whole.y) > GROSS / FAR * np.nanmedian(limit, axis=0)
    return np.asarray(marks & (marks.sum(axis=1, keepdims=True) > 1))


def _runs(record: Record) -> BoolArray:
    """Samples of runs, between jumps of a channel there and back, far off what is expected there.

    A fit that sees a long run follows it. So all that lies between jumps is expected without it,
    and called where it is far off at both ends: what the aircraft flies begins within a sample's
    noise of what it did before. The longer the run, the less is known of what is expected.
    """
    marks = np.column_stack([_between(x, _stepped(record.u)) for x in record.y.T])
    if not marks.any():
        return marks
    whole, lost = filled(record.mask(marks))
    limit = np.nanmedian(np.where(lost, np.nan, _judged(whole, lost)[1]), axis=0)
    unsure = _unsure(autoregression(whole, whole.y, lost), whole, lost, marks)
    far = np.abs(record.y - whole.y) > GROSS / FAR * np.hypot(limit, FAR * unsure)
    rest = np.where(marks, np.nan, record.y)  # no model is believed that diverges from it
    far &= (whole.y > np.nanmin(rest, axis=0) - limit) & (whole.y < np.nanmax(rest, axis=0) + limit)
    for i, column in enumerate(marks.T):
        for a, b in runs(column):
            column[a:b] &= far[a:b, i] & bool(far[a, i] and far[b - 1, i])
    return marks


def _stepped(u: Array) -> BoolArray:
    """Samples (N,) about which an input jumps, as what follows from it may."""
    jumps = np.abs(np.diff(u, axis=0, prepend=u[:1])) > PULSE * np.ptp(u, axis=0)
    return np.asarray(scipy.ndimage.maximum_filter1d(jumps.any(axis=1), 2 * FEW + 1))


def _between(x: Array, stepped: BoolArray) -> BoolArray:
    """Samples (N,) from a jump of a channel to the last of those that follow soon."""
    marks, at = np.zeros(len(x), dtype=bool), np.flatnonzero(np.isfinite(x))
    moves = np.abs(np.diff(x[at]))
    least = max(GROSS * MAD * np.median(moves), LEAP * np.std(x[at]))
    edges = 1 + np.flatnonzero((moves > least) & (np.diff(at) <= FEW) & ~stepped[at[1:]])
    for part in np.split(edges, 1 + np.flatnonzero(np.diff(edges) > LONG)):
        if len(part) > 1:
            marks[at[part[0] : part[-1]]] = True
    return marks


def _brief(x: Array, width: int) -> BoolArray:
    """Samples (N,) far from the median of the ``width`` samples around, lost ones left out."""
    marks, at = np.zeros(len(x), dtype=bool), np.flatnonzero(np.isfinite(x))
    steady = scipy.ndimage.median_filter(x[at], width, mode="nearest")
    off = np.abs(x[at] - steady)
    marks[at] = off > np.maximum(GROSS * MAD * np.median(off), SLIGHT * np.std(steady))
    return marks


def _regular(record: Record) -> tuple[Record, NDArray[np.intp]]:
    """The record with rows that are missing put in, empty, and where its own are now (N,)."""
    # Of longer gaps as many as make both sides independent.
    steps = np.clip(np.round(np.diff(record.t) / record.dt), 1, LAGS[1] + 2).astype(int)
    own = np.concatenate([[0], np.cumsum(steps)])
    if own[-1] == record.N - 1:
        return record, own
    k = np.arange(own[-1] + 1)
    u = [np.interp(k, own, x) for x in record.u.T]
    y = np.full((len(k), record.ny), np.nan)
    y[own] = record.y
    t = record.t[0] + record.dt * k
    return replace(record, t=t, u=np.reshape(u, (record.nu, -1)).T, y=y), own


def _judged(whole: Record, lost: BoolArray) -> tuple[Array, Array, int]:
    """Smoothing residuals, limits that make an outlier of a sample, (N, ny), and the lags p.

    Nothing after a gap follows from before it: what is between gaps is judged by itself, its first
    p samples, which have nothing before them, back in time. Between gaps of up to p samples there
    is no saying.
    """
    model = autoregression(whole, whole.y, lost)
    p = len(model.A)
    back = replace(whole, u=whole.u[::-1], y=whole.y[::-1])
    behind = autoregression(back, back.y, lost[::-1])
    off, std = np.zeros(lost.shape), np.full(lost.shape, np.inf)
    for a, b in runs(~_gap(lost)):
        if b - a > p:
            part, first = np.arange(a, b), np.arange(a, min(b, a + SPAN * p))[::-1]
            off[part], std[part] = _apart(model, whole, lost, part)
            early = np.array(_apart(behind, whole, lost, first))[:, -p:]
            off[first[-p:]], std[first[-p:]] = early
    seen = np.where(lost | np.isinf(std), np.nan, 1.0)
    std = std * np.maximum(MAD * np.nanmedian(seen * np.abs(off) / std, axis=0), 1.0)
    e = np.abs(model.innovations(whole.u, whole.y))
    # What is counted in steps is off by up to half of one.
    step = [least_step(x) / np.sqrt(12) for x in np.where(lost, np.nan, whole.y).T]
    std = np.maximum(std, step)
    limit = FAR * np.maximum(std, MAD * np.nanmedian(seen[p:] * e, axis=0))
    return off, np.maximum(limit, SLIGHT * np.std(whole.y, axis=0)), p


def _apart(
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


def _whitening(model: Autoregression) -> tuple[Array, float]:
    """What whitens innovations but for a size: squares of it all may be too large."""
    W = np.linalg.inv(np.linalg.cholesky(model.R))
    size = float(np.abs(W).max())
    return W / size, size


def _gap(lost: BoolArray) -> BoolArray:
    """Rows of gaps (N,): all outputs lost for over `GAP` samples.

    What inputs did there is not known, and `_regular` makes a long one shorter than it was.
    """
    gap = np.zeros(len(lost), dtype=bool)
    for a, b in runs(np.asarray(lost.all(axis=1))):
        gap[a:b] = b - a > GAP
    return gap


def _smoothed(model: Autoregression, u: Array, y: Array, lost: BoolArray) -> Array:
    """Outputs (N, ny), lost ones estimated by least squares of the whitened innovations."""
    normal, slope = _normal(model, u, y, lost)
    with warnings.catch_warnings():  # what a singular system gives is not taken
        warnings.simplefilter("ignore", scipy.sparse.linalg.MatrixRankWarning)
        step = scipy.sparse.linalg.spsolve(normal, slope)
    out = y.copy()
    out[lost] -= step
    return out


def _unsure(model: Autoregression, whole: Record, lost: BoolArray, marks: BoolArray) -> Array:
    """Standard deviations (N, ny) of what `_smoothed` makes of these lost samples, 0 elsewhere."""
    normal, _ = _normal(model, whole.u, whole.y, lost)
    own = np.flatnonzero(marks[lost])
    unit = np.zeros((normal.shape[0], len(own)))
    unit[own, np.arange(len(own))] = 1.0
    variance = scipy.sparse.linalg.splu(normal).solve(unit)[own, np.arange(len(own))]
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
