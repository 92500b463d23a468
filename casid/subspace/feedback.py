"""What a controller does to an estimate: noise it feeds back into the inputs.

Methods that take the inputs as given are biased by the part of them that the controller made of the
outputs' noise v: |bias| <= |Φ_vu|/Φ_u at every frequency, and by Schwarz

    |bias|/|G| <= √(Φ_fed/Φ_u) √(Φ_v/(|G|² Φ_u)),

the share of the input that is noise fed back times the noise-to-signal ratio of the output. The
share follows from the one-step prediction errors e of a model with a stable predictor; so does the
ratio where v is white. Where it is not, as in turbulence, v is many times e at low frequency, and
the share alone says whether there may be a bias (`casid.subspace.refinement_choice`), where it is
more than chance makes of short records of slow inputs.

Of residuals of a simulation, that an input comes to follow them shows in its future: it explains
what its past and present, and the residuals' own past, leave of them (C. A. Sims, Money, income,
and causality, Am. Econ. Rev. 62, 1972; with their past for colour: J. Geweke, R. Meese & W. Dent,
J. Econometrics 21, 1983). What a structure misses is explained by the past of inputs.
"""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace.predictor import Stack, triangular
from casid.vector_autoregression import lagged_products

MEMORY = 0.5  # s: how long after an error its way through the controller is looked for
LAGS = 25  # at most
ENOUGH = 20_000  # samples looked at, shared by the records
RARE = 0.05  # how often chance makes a share as large as is told beside it
LEVEL = 1e-3  # of the tests for feedback and for a direct term
SURE = 1e-6  # of that of residuals: what is not linear, a manoeuvre may repeat in its next input
COLOUR = 0.1  # share of a residual's power that its past explains, below which it counts as white
ROWS = 3.0  # samples for every regressor, at least
EXACT = 5e-3  # share of a residual's power, below which what is new in it is no gust's or noise


def fed_back_noise(
    system: StateSpace, K: Array, records: Sequence[Record], su: Array, sy: Array
) -> float:
    """Bound on the relative bias that white noise fed back by a controller gives the response."""
    share, size, _ = fed_back(system, K, records, su, sy)
    return float(np.sqrt(share)) * size


def fed_back(
    system: StateSpace, K: Array, records: Sequence[Record], su: Array, sy: Array
) -> tuple[float, float, float]:
    """Share of an input's power that prediction errors make, size of these, share by chance."""
    # The largest over inputs, for the average output; 0 where no feedback shows. A - KC is stable,
    # no sample is missing. An input that does not act in its own sample may be made of its error.
    lags = _lags(max(record.dt for record in records))
    ny, products, targets, errors = len(sy), [], [], []
    lines = any(record.hold == "foh" for record in records)
    now = np.asarray(system.D.any(axis=1) | lines)
    most = ENOUGH // len(records) + 1
    for record in (r if most >= r.N else r.cut(r.t[0], r.t[most]) for r in records):
        if 6 * lags * (len(su) + 1) >= record.N:
            continue
        u = (record.u - record.u.mean(axis=0)) / su
        e = _without_model_error(prediction_errors(system, K, record) / sy, u, lags, now=now)
        errors.append(e)
        products.append(lagged_products(np.hstack([e, u[-len(e) :]]), lags))
        targets.append(u[lags - len(e) :])
    made = np.zeros((lags + 1, ny + len(su)), dtype=bool)
    made[:, :ny], made[0, :ny] = True, ~now
    N, size = sum(map(len, targets)), int(made.sum())
    if 2 * size >= N:
        return 0.0, 0.0, 1.0
    # The share of u(k) that errors up to e(k-lags) explain is compared with some per cent: products
    # are precise enough.
    G, rows = np.sum(products, axis=0), np.flatnonzero(made)
    inner, outer = G[np.ix_(rows, rows)], G[rows, ny : ny + len(su)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))[:, None]
    inner, outer = inner / (scale * scale.T) + 1e-10 * np.eye(size), outer / scale
    explained = np.sum(outer * scipy.linalg.solve(inner, outer, assume_a="pos"), axis=0)
    power = np.diag(G)[ny : ny + len(su)]
    left = (power - explained) / (N - size)
    fed = np.max(1 - left / (power / N))
    noise = float(np.mean(np.std(np.vstack(errors), axis=0)))
    return max(float(fed), 0.0), noise, _by_chance(targets, lags, ny) * size / N


def _lags(dt: float) -> int:
    """Samples after an error in which its way through the controller is looked for."""
    return min(LAGS, max(int(MEMORY / dt), 2))


def followed(
    residuals: Sequence[Array], inputs: Sequence[Array], dt: float, *, now: bool
) -> tuple[BoolArray, BoolArray]:
    """Which residuals are coloured, (ny,), and which inputs follow some of these, (nu,).

    Of residuals (N, ny), 0 where missing, and inputs (N, nu) of every record, sampled every ``dt``
    seconds; ``now`` says that inputs act in their own sample. White residuals are followed without
    harm: what is simulated knows the past of its inputs only. None of either where records are too
    short to tell.
    """
    ny, nu = residuals[0].shape[1], inputs[0].shape[1]
    followers, most, each = np.zeros(nu, dtype=bool), _lags(dt), 2 * ny + 4 * nu
    for lags in (most, most // 2, most // 4):
        rows = sum(max(len(u) - 3 * lags, 0) for u in inputs)
        if lags and rows >= ROWS * lags * each:
            break
    else:
        return np.zeros(ny, dtype=bool), followers
    pairs = zip(residuals, inputs, strict=True)
    columns = [np.hstack([_centred(r, r != 0), _centred(u, np.isfinite(u))]) for r, u in pairs]
    size = np.sqrt(np.sum([np.sum(z**2, axis=0) for z in columns], axis=0) / rows)
    size = np.where(size > 0, size, 1.0)
    long = [z / size for z in columns if len(z) > 3 * lags]
    G = np.sum([lagged_products(z, 3 * lags) for z in long], axis=0)
    lag, channel = np.divmod(np.arange(len(G)), ny + nu)  # the sample itself is at lag ``lags``
    target, later = (channel < ny) & (lag == lags), lag < lags + (not now)
    past = (channel >= ny) & ~later
    own = past | (channel < ny) & (lag > lags)
    first, second = (np.diag(_left(G, target, x)) for x in (past, own))
    coloured = _coloured(first, second, rows - int(own.sum()), int(own.sum() - past.sum()))
    target[target] = coloured
    for j in range(nu) if coloured.any() else ():
        more = later & (channel == ny + j)
        before, after = (np.linalg.slogdet(_left(G, target, x))[1] for x in (own, own | more))
        n, m = target.sum(), more.sum()
        freedom = rows - own.sum() - (n + m + 1) / 2  # Bartlett's
        followers[j] = freedom * (before - after) > scipy.special.chdtri(n * m, SURE / nu)
    return coloured, followers


def _coloured(first: Array, second: Array, freedom: int, more: int) -> BoolArray:
    """Whether squares of residuals (ny,) are much less with ``more`` regressors, of their past."""
    alive = second > EXACT * freedom
    ratio = np.where(alive, first, 1.0) / np.where(alive, second, 1.0)
    much = ratio * freedom / (freedom + more) > 1 / (1 - COLOUR)
    return np.asarray(much & (freedom * np.log(ratio) > scipy.special.chdtri(more, SURE)))


def _left(G: Array, target: BoolArray, known: BoolArray) -> Array:
    """Products of what ``known`` regressors leave of the ``target``, of products G of all."""
    inner = G[np.ix_(known, known)] + 1e-10 * G.max() * np.eye(known.sum())
    outer = G[np.ix_(known, target)]
    return np.asarray(G[np.ix_(target, target)] - outer.T @ np.linalg.solve(inner, outer))


def _centred(x: Array, seen: BoolArray) -> Array:
    """Without the mean of what is ``seen``; 0 elsewhere."""
    return np.where(seen, x - x.sum(axis=0) / np.maximum(seen.sum(axis=0), 1), 0.0)


def _by_chance(inputs: Sequence[Array], lags: int, ny: int) -> float:
    """Share that errors of ``ny`` outputs seldom make of inputs they have no part in.

    In that which as many regressors without use make in the mean. An input that moves slowly is the
    same at all lags of white errors, whose squared correlations with it come in few independent
    terms: those of χ² of Welch and Satterthwaite's number (Biometrics Bulletin 2, 1946).
    """
    products = [sum(np.sum(u[i:] * u[: len(u) - i], axis=0) for u in inputs) for i in range(lags)]
    alike = np.array(products) / np.maximum(products[0], 1e-300)
    squares = lags + 2 * np.sum(np.arange(lags - 1, 0, -1)[:, None] * alike[1:] ** 2, axis=0)
    terms = ny * lags**2 / np.max(squares)
    return float(scipy.special.chdtri(terms, RARE / inputs[0].shape[1]) / terms - 1)


def _without_model_error(e: Array, u: Array, lags: int, now: BoolArray) -> Array:
    """What inputs do not explain of the prediction errors; the first 2 ``lags`` are cut.

    White noise is not explained by what came before it, fed back or not; an error of the model is.
    Inputs of this sample count for outputs on which they act ``now``, (ny,): a controller may have
    made them of it.
    """
    left = e[2 * lags :].copy()
    for first, which in enumerate((now, ~now)):
        window = sliding_window_view(u, 2 * lags + 1, axis=0)[:, :, first::2]
        past = window.reshape(len(window), -1)
        left[:, which] -= past @ np.linalg.lstsq(past, left[:, which], rcond=1e-10)[0]
    return left


def prediction_errors(system: StateSpace, K: Array, record: Record) -> Array:
    """One-step prediction errors (N, ny) of an innovation model."""
    B = np.hstack([system.B - K @ system.D, K])
    D = np.hstack([system.D, np.zeros((system.ny, system.ny))])
    predictor = StateSpace(system.A - K @ system.C, B, system.C, D, system.dt)
    return record.y - predictor.simulate(
        record.t, np.hstack([record.u, record.y]), hold=record.hold
    )


def direct_term_is_ambiguous(stack: Stack) -> bool:
    """Whether samples show feedback and a correlation of present inputs with present outputs."""
    # Then a direct term of the plant cannot be told from one of the controller: both give the
    # innovations of u and y the same correlation. Two likelihood-ratio tests at `LEVEL`.
    nu, nz, p = stack.nu, stack.nz, stack.past
    Z = stack.Z.reshape(len(stack.R), p, nz)
    inputs, outputs = Z[:, :, :nu].reshape(len(Z), -1), Z[:, :, nu:].reshape(len(Z), -1)
    R = triangular(np.hstack([inputs, outputs, stack.u, stack.y]))
    own, both = p * nu, p * nz
    u = R[:, both : both + nu]
    feedback = stack.columns * (_log_det(u[own:]) - _log_det(u[both:]))
    y = R[both:, both + nu :]
    direct = stack.columns * (_log_det(y) - _log_det(y[nu:]))
    rare = [scipy.special.chdtri(freedom * stack.ny, LEVEL) for freedom in (nu * p, nu)]
    return bool(feedback > rare[0] and direct > rare[1])


def _log_det(rows: Array) -> float:
    """Logarithm of the determinant of rowsᵀ rows."""
    return float(2 * np.sum(np.log(np.maximum(np.abs(np.diag(triangular(rows))), 1e-300))))
