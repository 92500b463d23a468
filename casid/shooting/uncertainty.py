"""How well parameters are determined: Fisher information, Cramér-Rao bounds and what spoils them.

V. Klein, E. A. Morelli, Aircraft System Identification: Theory and Practice, AIAA 2006, sections
6.1.2 (information and bounds), 6.1.3 and 5.2.3 (coloured residuals), 5.5 (collinearity).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy
import scipy.linalg
from numpy.lib.stride_tricks import sliding_window_view

from casid import truncated
from casid.arrays import Array, BoolArray
from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.switches import deciding
from casid.shooting.scores import (
    NO_SCORES,
    PARTS,
    BlockScores,
    ProcessScores,
    RecordScores,
    Scores,
    summed,
)
from casid.truncated import OnBounds
from casid.values import storable

Sparse: TypeAlias = scipy.sparse.csc_array

RIDGE = 1e-16  # on nuisance blocks, relative; an unobservable nuisance must not stop the rest
SAME = 1e-14  # the same where that is lost in rounding
MANY = 500  # neighbours of a nuisance variable (the bias of a long record) that would fill factors
SINGULAR = 1e-11  # eigenvalue of the information scaled to unit diagonal that counts as zero
NOTHING = 1e-24  # of the largest information of a parameter, in units of their sizes: none
GONE = 1e-10  # share of a parameter's information that is rounding if no more is left
CONDITION = 30.0  # condition index above which parameters are collinear (Belsley 1991)
SHARE = 0.5  # of a parameter's variance, for it to be named
LAGS = 0.2  # longest lag of the residuals' correlation, of the record (Klein & Morelli)
RUN = 5  # lags without a significant correlation that end it
SELDOM = 0.1  # of the pairs of the commonest lag, below which a lag is a channel's by chance
BLOCKS, FEWEST = 3, 20  # blocks: as many for a parameter, and in all, at least
MOST_LAGS = 5000  # samples; at 50 Hz the correlation of residuals is over long before


@storable
@dataclass(frozen=True)
class Collinearity:
    """Parameters that the data determine only in combination.

    ``names`` share a direction whose condition index is ``condition`` (infinite: not determined at
    all); ``shares`` says how much of each parameter's variance comes from it.
    """

    names: tuple[str, ...]
    condition: float
    shares: tuple[float, ...]


def eliminate(
    H: Array, H_nuisance: Sparse, H_cross: Array, G: Sparse, G_cross: Array
) -> tuple[Array, Array]:
    """Fisher information of λ with nuisance variables ν eliminated, and the derivatives of these.

    The log-likelihood is quadratic with Hessian [H, crossᵀ; cross, H_nuisance] under the linear
    constraints G ν + G_cross λ = 0 (continuity); its Schur complement by the KKT system is the
    information an optimal estimator of λ alone has. Works for unstable dynamics, since no
    sensitivity is carried over a whole record.

    Of H (nf, nf), H_nuisance (nn, nn), H_cross (nn, nf), G (m, nn), G_cross (m, nf): the
    information (nf, nf), and the derivatives (nn + m, nf) by λ of ν and of the constraints'
    multipliers.
    """
    many = np.diff(H_nuisance.indptr) > MANY
    if many.any():
        return _in_two_steps(H, H_nuisance, H_cross, G, G_cross, many)
    cross = np.vstack([H_cross, G_cross])
    try:
        solved = _factor(H_nuisance, G, RIDGE).solve(np.ascontiguousarray(cross))
    except RuntimeError:  # exactly singular: two nuisances are the same, an integral and its bias
        solved = _factor(H_nuisance, G, SAME).solve(np.ascontiguousarray(cross))
    F = H - cross.T @ solved
    return (F + F.T) / 2, -solved


def _factor(H: Sparse, G: Sparse, ridge: float) -> scipy.sparse.linalg.SuperLU:
    """Factor of [H, Gᵀ; G, 0], H with a ridge relative to its largest diagonal entry."""
    (m, nn), size = G.shape, max(float(H.diagonal().max()), 1e-300)
    top = scipy.sparse.hstack([H + ridge * size * scipy.sparse.eye_array(nn), G.T])
    bottom = scipy.sparse.hstack([G, scipy.sparse.csc_array((m, m))])
    return scipy.sparse.linalg.splu(scipy.sparse.csc_array(scipy.sparse.vstack([top, bottom])))


def _in_two_steps(
    H: Array, H_nuisance: Sparse, H_cross: Array, G: Sparse, G_cross: Array, late: BoolArray
) -> tuple[Array, Array]:
    """Eliminate the other nuisance variables first, then the ``late`` ones among themselves."""
    nf = len(H)
    inner, early = H_nuisance[late][:, late].toarray(), ~late
    F, follow = eliminate(
        np.block([[H, H_cross[late].T], [H_cross[late], inner]]),
        H_nuisance[early][:, early],
        np.hstack([H_cross[early], H_nuisance[early][:, late].toarray()]),
        G[:, early],
        np.hstack([G_cross, G[:, late].toarray()]),
    )
    ridge = RIDGE * float(inner.diagonal().max()) * np.eye(len(inner))
    gain = -scipy.linalg.solve(F[nf:, nf:] + ridge, F[nf:, :nf], assume_a="sym")
    rest, total = follow[:, :nf] + follow[:, nf:] @ gain, np.empty_like(H_cross)
    first = int(early.sum())
    total[late], total[early] = gain, rest[:first]
    F = F[:nf, :nf] + F[:nf, nf:] @ gain
    return (F + F.T) / 2, np.vstack([total, rest[first:]])


def bound(F: Array, ties: Array, alone: Array | None = None) -> Array:
    """Cramér-Rao bound of the covariance, (nf, nf), on the tangent space of the ties.

    ``ties`` (m, nf) are gradients of equality constraints that hold between the parameters,
    ``alone`` (nf,) the information of every parameter were all else known: what little of it is
    left in F (nf, nf) after initial states and biases took their share may be rounding. Directions
    without information have infinite variance: the rows of the parameters in them are
    infinite on the diagonal and NaN elsewhere.
    """
    _, _, directions, lost = _directions(F, ties, alone)
    covariance = determined(F, ties, alone)
    unknown = np.flatnonzero((np.abs(directions[:, lost]) > 1e-3).any(axis=1))
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    covariance[unknown, unknown] = np.inf
    return covariance


def determined(F: Array, ties: Array, alone: Array | None = None) -> Array:
    """`bound` with directions without information held: finite, (nf, nf)."""
    unit, values, directions, lost = _directions(F, ties, alone)
    root = directions[:, ~lost] / np.sqrt(values[~lost])
    return np.asarray(root @ root.T * np.outer(unit, unit))


def beside_bounds(
    F: Array, ties: Array, alone: Array, held: OnBounds, covariances: tuple[Array, Array]
) -> Array:
    """Covariance (nf, nf) that what is on bounds adds to one in which it is known.

    ``ties`` (m, nf) are without the bounds, ``covariances`` (nf, nf) of white residuals and of
    those that there are.
    """
    more = held.information
    K = determined(F + more, ties, alone + np.diag(more))
    return truncated.beside_bounds(K, held, covariances)


def singular(names: Sequence[str], model: Model | None = None) -> str:
    """What is said of parameters in directions without information, of a nonlinear structure, too.

    One that only decides where the equations jump has no derivative, whatever is flown.
    """
    known = deciding(model) if isinstance(model, NonlinearModel) else []
    if mute := [name for name in names if name in known]:
        rest = [name for name in names if name not in mute]
        return (
            f"{', '.join(mute)} only decides between two expressions (if_else) and has no "
            "derivative, which is no lack of data: write the condition as something smooth "
            "(casadi.tanh, casid.spline), or fix it and compare the costs of fits at several values"
        ) + (f"; {singular(rest)}" if rest else "")
    return (
        f"the records do not determine {', '.join(names)} here (singular information matrix): "
        "fix or tie some of them, or add a manoeuvre that excites them. Where one of them "
        "multiplies another that is zero, this is a saddle of the cost and no lack of data: "
        "start elsewhere. Between two samples the delay of an input held in steps may be "
        "indistinguishable from a gain: hold the delay, sample faster or off the input's grid, "
        "or add an output"
    )


def correlation(covariance: Array) -> Array:
    """Correlation matrix of a covariance; NaN where a variance is infinite or zero."""
    std = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(covariance / np.outer(std, std))


def collinearities(
    F: Array, ties: Array, names: Sequence[str], alone: Array | None = None
) -> tuple[Collinearity, ...]:
    """Which parameters are determined only in combination, the worst combination first.

    Condition indices and variance shares of the information scaled to unit diagonal (Belsley,
    Conditioning Diagnostics, 1991): an index over 30 with two or more shares over a half, or a
    direction with no information at all.
    """
    _, values, directions, lost = _directions(F, ties, alone)
    floor = np.where(lost, SINGULAR * values.max(initial=0.0) * 1e-3, values)
    parts = directions**2 / floor
    shares = parts / np.maximum(parts.sum(axis=1, keepdims=True), 1e-300)
    found = []
    for k, value in enumerate(values):
        condition = np.inf if lost[k] else float(np.sqrt(values.max() / value))
        named = np.flatnonzero((shares[:, k] > SHARE) & (np.abs(directions[:, k]) > 1e-3))
        if condition > CONDITION and (len(named) > 1 or (lost[k] and len(named))):
            order = named[np.argsort(-shares[named, k])]
            found.append(
                Collinearity(
                    tuple(names[i] for i in order),
                    condition,
                    tuple(float(shares[i, k]) for i in order),
                )
            )
    return tuple(found)


def _directions(
    F: Array, ties: Array, alone: Array | None
) -> tuple[Array, Array, Array, BoolArray]:
    """Principal directions of F in units that give it unit diagonal, on the ties' tangent space.

    The units (nf,), the information (n,) in every direction (nf, n), and which have none: what F
    has there is rounding of the information ``alone`` that initial states and biases took away.
    """
    diagonal = np.diag(F)
    given = diagonal if alone is None else alone
    alone = np.maximum(diagonal, given)
    left = np.where(diagonal > GONE * alone, diagonal, alone)
    # What no interval feels by itself may yet be felt through the nodes, but not by rounding alone.
    some = left > np.where(given > 0, NOTHING, GONE) * left.max()
    F, unit = F * np.outer(some, some), 1 / np.sqrt(np.where(some, left, 1.0))
    rows = ties * unit  # of one length: how many hold is told by comparison
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    Z = scipy.linalg.null_space(rows) if len(ties) else np.eye(len(F))
    values, vectors = np.linalg.eigh(Z.T @ (F * np.outer(unit, unit)) @ Z)
    directions = Z @ vectors
    rounding = np.maximum(directions.T**2 @ (alone * unit**2), 1.0)
    return unit, values, directions, values <= SINGULAR * len(F) * rounding


def coloured_covariance(
    covariance: Array,
    residuals: Sequence[Array],
    slopes: Callable[[Array], Iterable[Iterable[Array]]],
    also: Sequence[Scores] = (),
) -> tuple[Array, RecordScores]:
    """Covariance of the estimates under the correlation the residuals really have.

    P K P (Klein & Morelli, section 6.1.3; E. A. Morelli, V. Klein, J. Aircraft 34(2), 1997) with P
    the white-noise covariance and K that of the scores' sum: of a process of its own, which the
    residuals may be. Correlated in time, they mostly come of what the structure leaves out and
    depend on the slopes; then K is in every direction the larger of that and of the blocks'. Of
    fewer samples than blocks take a correlation is chance as much, and K not below white noise's.

    With it come the scores of whole records, by which combinations are tested
    (`casid.bounds.robust`); none of white residuals.

    ``covariance`` (nf, nf) is the Cramér-Rao bound for white residuals, ``residuals`` (N, ny) those
    of every record, whitened, 0 where missing. ``slopes`` returns their total derivatives by λ
    times an (nf, k) array, in the same order: iterables of (n, ny, k) arrays, one a record, piece
    after piece, so that memory does not grow with the records. In the directions of `coordinates`
    they go to what is ``also`` to be summed, too.
    """
    C = residual_covariance(residuals)
    root, inverse = coordinates(covariance)
    process, k = ProcessScores(C, root.shape[1]), root.shape[1]
    blocks, samples = max(BLOCKS * k, FEWEST), sum(len(r) for r in residuals)
    length, records = samples // (PARTS * blocks), NO_SCORES
    together = BlockScores(length, k) if len(C) > 1 and length > 0 else None
    own = [process] if together is None else [process, together]
    summed(residuals, slopes(root), [*own, *also])
    K = process.total()
    if together is not None:
        g, H = together.records()
        records = g @ inverse, inverse.T @ H @ inverse
        K = larger(K, together.K) if PARTS * length >= len(C) else K
    elif length == 0:
        K = larger(K, np.eye(len(K)))
    return np.asarray(root @ K @ root.T), records


def coordinates(P: Array) -> tuple[Array, Array]:
    """(nf, k) by which the parameters follow from coordinates whose information is I; its inverse.

    ``P`` (nf, nf) = root rootᵀ is the inverse information; directions without variance are left
    out.
    """
    size = np.sqrt(np.diag(P))  # of which one may be a million times the others
    unit = np.where(size > 0, size, 1.0)
    values, axes = np.linalg.eigh(P / np.outer(unit, unit))
    known = values > GONE * values.max(initial=0.0)
    axes, size = axes[:, known], np.sqrt(values[known])
    return unit[:, None] * axes * size, (axes / size).T / unit


def own_step(g: Array, F: Array) -> tuple[Array, int]:
    """F⁻¹ g (k,) in the directions that an information F (k, k) tells of, and their number."""
    values, axes = np.linalg.eigh(F)
    known = values > GONE * values.max(initial=0.0)
    return axes[:, known] @ (axes[:, known].T @ g / values[known]), int(known.sum())


def larger(A: Array, B: Array) -> Array:
    """In the directions that make both diagonal the larger of two symmetric matrices."""
    values, axes = np.linalg.eigh(A)
    root = axes * np.sqrt(np.maximum(values, GONE * values.max(initial=0.0)))
    inverse = np.linalg.pinv(root)
    values, axes = np.linalg.eigh(inverse @ B @ inverse.T)
    return np.asarray((root @ axes * np.maximum(values, 1.0)) @ (root @ axes).T)


def residual_covariance(residuals: Sequence[Array]) -> Array:
    """C(m), m = 0 .. lags, C(m)[a, b] = mean of r_a(i) r_b(i + m): (lags + 1, ny, ny).

    Sample values as far as the residuals are correlated, which is to where no channel's correlation
    is significant at the next lags, then tapered to zero over as many again (D. N. Politis, J.
    Nonparametric Statistics 15, 2003). Each channel counts at the lags it has pairs for: of one
    slower than the others none is at the first. White residuals have C(0) alone. Sample values at
    all lags would be those of residuals that the fit has made orthogonal to the slopes.
    """
    C, pairs = _autocovariance(residuals)
    own = np.einsum("maa->ma", C) / np.maximum(np.einsum("aa->a", C[0]), 1e-300)
    count = np.einsum("maa->ma", pairs)
    told = count >= np.maximum(SELDOM * count[1:].max(axis=0), 1.0)
    count = np.maximum(count, 1.0)
    small = np.abs(own) <= 2 * np.sqrt(np.log10(count[0]) / count)
    quiet = np.array([_quiet(*each) for each in zip(small.T, told.T, strict=True)])
    reach = int(np.argmax(quiet.all(axis=0)))  # lags up to which something is correlated
    taper = np.clip(2 - np.arange(len(C)) / max(reach, 0.5), 0.0, 1.0)
    return np.asarray((C * taper[:, None, None])[: 2 * reach + 1])


def _quiet(small: BoolArray, told: BoolArray) -> BoolArray:
    """Whether a channel's correlation is small at the next lags told of, after each (lags + 1,)."""
    lags = np.flatnonzero(told)
    silent = np.append(small[lags], np.ones(RUN, dtype=bool))
    runs = sliding_window_view(silent, RUN)
    after = np.searchsorted(lags, np.arange(len(small)), side="right")
    return np.asarray(runs[after].all(axis=1))


def _autocovariance(residuals: Sequence[Array]) -> tuple[Array, Array]:
    """Sample values of C(m), pooled over the records, and of how many pairs (lags + 1, ny, ny)."""
    # Each is a mean over the pairs of residuals that are there: missing ones are 0.
    lags = min(max(1, int(LAGS * max(len(r) for r in residuals))), MOST_LAGS)
    C, pairs = (
        sum(_lagged_products(part, lags) for part in parts)
        for parts in (residuals, [(r != 0).astype(float) for r in residuals])
    )
    pairs = np.round(pairs)
    return C / np.maximum(pairs, 1), pairs


def _lagged_products(r: Array, lags: int) -> Array:
    """Σ_i r_a(i) r_b(i + m) of one record, (lags + 1, ny, ny)."""
    n = scipy.fft.next_fast_len(len(r) + lags + 1, real=True)
    R = scipy.fft.rfft(r, n, axis=0)
    columns = [scipy.fft.irfft(R[:, [a]].conj() * R, n, axis=0) for a in range(r.shape[1])]
    return np.stack([column[: lags + 1] for column in columns], axis=1)
