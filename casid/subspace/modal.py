"""Real linear models by their modes, and least squares on them.

In modal coordinates every derivative of an output is a pole factor times a signal, and an output
enters through its row of C alone: the normal equations of all outputs are assembled from one small
Gram matrix each, instead of a tall Jacobian.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.values import storable

S = TypeVar("S", Array, ComplexArray)  # signals, or products of signals

DEFECTIVE = 1e9  # condition number of the modes' shapes
HIDDEN = 1e-15  # of the largest information: what rounding leaves of none, about
RIDGE = 1e-13  # of the size of each transient: what two that look alike are told apart by


@storable
@dataclass(frozen=True, eq=False)
class Modal:
    """A real model of scaled channels by its modes: one of each complex pair (Im λ > 0)."""

    lam: ComplexArray  # (nm,)
    B: ComplexArray  # (nm, nu)
    C: ComplexArray  # (ny, nm)
    D: Array  # (ny, nu)

    @property
    def real(self) -> BoolArray:
        """Which modes are real."""
        return np.asarray(self.lam.imag == 0)

    @property
    def order(self) -> int:
        """Number of states: two of every complex pair."""
        return len(self.lam) + int((~self.real).sum())

    def place(self, columns: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions of real and imaginary parts of ``columns`` numbers a mode, (nm, columns)."""
        nm, nc = len(self.lam), int((~self.real).sum())
        first = np.arange(nm * columns).reshape(nm, columns)
        second = np.full((nm, columns), -1)
        second[~self.real] = nm * columns + np.arange(nc * columns).reshape(nc, columns)
        return first, second


def to_modal(system: StateSpace, su: Array, sy: Array, feedthrough: BoolArray) -> Modal:
    """Balanced modes of a system of scaled channels; ValueError for modes too close for a basis."""
    lam, V = np.linalg.eig(system.A)
    if np.linalg.cond(V) > DEFECTIVE:
        raise ValueError(
            f"a model of order {system.nx} has modes that cannot be told from one another, and "
            "cannot be refined: lower the order, lengthen the past or leave the refinement out"
        )
    C = (system.C / sy[:, None]) @ V
    B = np.linalg.solve(V, (system.B * su).astype(complex))
    keep = lam.imag >= 0
    B, C = np.asarray(B[keep], dtype=complex), np.asarray(C[:, keep], dtype=complex)
    lam = np.asarray(lam[keep], dtype=complex)
    real = lam.imag == 0
    phase = np.where(real & (np.abs(B.imag).max(axis=1) > np.abs(B.real).max(axis=1)), 1j, 1.0)
    B, C = np.asarray(B / phase[:, None]), np.asarray(C * phase)
    B[real], C[:, real] = B[real].real, C[:, real].real
    nb, nc = np.linalg.norm(B, axis=1), np.linalg.norm(C, axis=0)
    balance = np.sqrt(np.where((nb > 0) & (nc > 0), nc / np.where(nb > 0, nb, 1.0), 1.0))
    D = np.where(feedthrough, system.D * su / sy[:, None], 0.0)
    return Modal(lam, np.asarray(B * balance[:, None]), np.asarray(C / balance), D)


def from_modal(modal: Modal, su: Array, sy: Array, like: StateSpace) -> StateSpace:
    """Real state-space model with physical channels; blocks of one or two states."""
    blocks, rows, columns = [], [], []
    for lam, b, c in zip(modal.lam, modal.B, modal.C.T, strict=True):
        if lam.imag == 0:
            blocks.append(np.array([[lam.real]]))
            rows.append(b.real[None])
            columns.append(c.real[None])
        else:
            blocks.append(np.array([[lam.real, -lam.imag], [lam.imag, lam.real]]))
            rows.append(np.vstack([b.real, b.imag]))
            columns.append(np.vstack([2 * c.real, -2 * c.imag]))
    A = scipy.linalg.block_diag(*blocks)
    B, C = np.vstack(rows) / su, np.vstack(columns).T * sy[:, None]
    D = modal.D * sy[:, None] / su
    return StateSpace(A, B, C, D, None, like.inputs, like.outputs)


def pair(phi: ComplexArray, conjugate: ComplexArray, real: BoolArray) -> ComplexArray:
    """Real basis (..., n) of modal signals (..., nm): sums of all modes, differences of pairs."""
    return np.concatenate([phi + conjugate, 1j * (phi - conjugate)[..., ~real]], axis=-1)


def mixing(c: ComplexArray, real: BoolArray) -> Array:
    """Matrices (..., n, n) by which the real basis of modal signals becomes that of c times them.

    The numbers c (..., nm) are rows of C, say, and the result what each output sees of the modes.
    """
    # Re c on the basis itself, Im c across the two signals of a pair.
    i, k = np.arange(len(real)), np.flatnonzero(~real)
    j = len(i) + np.arange(len(k))
    M = np.zeros((*c.shape[:-1], len(i) + len(k), len(i) + len(k)))
    M[..., i, i], M[..., j, j] = c.real, c.real[..., k]
    M[..., j, k], M[..., k, j] = c.imag[..., k], -c.imag[..., k]
    return M


def seen(basis: S, mix: Array, blocks: int) -> S:
    """What spans all derivatives (..., K, m), as the output sees it whose `mixing` is (..., n, n).

    That is signals of the transient, if any, of λ and of B, input by input, so many ``blocks`` of
    n, which are mixed; then those of C and D, which outputs see as they are.
    """
    n, (*stack, K, _) = mix.shape[-1], basis.shape
    C = blocks * n  # where those of C begin
    mixed = basis[..., :C].reshape(*stack, K * blocks, n) @ mix
    return np.concatenate([mixed.reshape(*stack, K, C), basis[..., C:]], axis=-1)


def places(modal: Modal, o: int, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the signals that output o has `seen` are derivatives of it, and by what.

    By the transient, which comes first, and by parameters: B mode by mode, C and D its own.
    """
    (ny, nu), n = modal.D.shape, modal.order
    direct = np.flatnonzero(free[:, 0] == o)
    B = np.arange(n * nu).reshape(n, nu).T.ravel()
    D, C = (3 + nu) * n, (2 + nu) * n
    which = [np.arange(D), D + free[direct, 1]]
    where = [np.arange(2 * n), 2 * n + B, C + o * n + np.arange(n), C + ny * n + direct]
    return np.concatenate(which), np.concatenate(where)


def output_derivative(basis: S, modal: Modal, o: int, free: np.ndarray) -> tuple[S, np.ndarray]:
    """Derivatives of output o by the transient and the parameters it depends on, and which."""
    which, where = places(modal, o, free)
    return seen(basis, mixing(modal.C[o], modal.real), 2 + modal.D.shape[1])[:, which], where


@dataclass(frozen=True, eq=False)
class Tangents:
    """Weighted residuals of a spectrum and what spans their slopes, S = (Q, J - Q Qᵀ J).

    Q (2 K ny, n) is an orthonormal basis of what the transient does, which is eliminated from the
    residuals and from their slopes J by the parameters. Of these an output depends on some: S is
    never written out. Rows are real and imaginary parts of lines `by_turns`.
    """

    e: Array  # (ny, 2 K)
    rows: tuple[Array, ...]  # of every output (2 K, n + k): Q, and the columns of J that it has
    where: tuple[np.ndarray, ...]  # which of all columns these are
    QJ: Array  # (n, parameters) QᵀJ

    def products(self, X: Array, outputs: Sequence[int], starts: Sequence[int]) -> Array:
        """SᵀX (bands, n + parameters, m) over bands of rows that start there.

        X (len(outputs), 2 K, m) are rows of these outputs, those of others are zero.
        """
        n, p = self.QJ.shape
        bands = [slice(*edges) for edges in pairwise([*starts, self.e.shape[1]])]
        found = np.zeros((len(bands), n + p, X.shape[2]))
        for o, x in zip(outputs, X, strict=True):
            rows = self.rows[o]
            found[:, self.where[o]] += np.array([rows[band].T @ x[band] for band in bands])
        found[:, n:] -= self.QJ.T @ found[:, :n]
        return found


def tangents(
    modal: Modal, E: ComplexArray, basis: ComplexArray, w: Array, free: np.ndarray
) -> Tangents:
    """Those of residuals E (K, ny) and of slopes that ``basis`` spans, as `output_derivative`."""
    ny, nu = modal.D.shape
    n, real = modal.order, by_turns(basis)
    derived = [output_derivative(real, modal, o, free) for o in range(ny)]
    scales = np.repeat(w, 2, axis=0).T[..., None]
    rows = tuple(own * scale for (own, _), scale in zip(derived, scales, strict=True))
    Q = np.linalg.qr(np.vstack([own[:, :n] for own in rows]))[0]
    size = n * nu + n + ny * n + len(free)
    QJ = np.zeros((n, size))
    for own, part, (_, where) in zip(rows, np.split(Q, ny), derived, strict=True):
        own[:, :n] = 0.0
        own[:, : Q.shape[1]] = part  # all there is, where a spectrum has fewer lines than that
        QJ[:, where[n:] - n] += own[:, :n].T @ own[:, n:]
    e = by_turns(E * w).T.reshape(-1)
    e -= Q @ (Q.T @ e)
    return Tangents(e.reshape(ny, -1), rows, tuple(where for _, where in derived), QJ)


def by_turns(rows: ComplexArray) -> Array:
    """Real and imaginary part of every line, (..., 2K, n): neighbouring lines stay together."""
    both = np.stack([rows.real, rows.imag], axis=-2)
    return both.reshape(*rows.shape[:-2], -1, rows.shape[-1])


def gram(rows: Array | ComplexArray) -> Array:
    """Re(rowsᴴ rows)."""
    real = stacked(rows) if np.iscomplexobj(rows) else rows
    return np.asarray(real.T @ real)


def stacked(rows: Array | ComplexArray) -> Array:
    """Real parts over imaginary ones, (..., 2K, n)."""
    return np.concatenate([rows.real, rows.imag], axis=-2)


def moved(modal: Modal, step: Array, free: np.ndarray) -> Modal:
    """The model a step further; a complex pair stays one, a real mode stays real."""
    ny, nu = modal.D.shape
    n = modal.order
    dlam = to_complex(modal, step[:n], 1)[:, 0]
    dB = to_complex(modal, step[n : n + n * nu], nu)
    start = n + n * nu
    dC = [to_complex(modal, step[start + o * n : start + (o + 1) * n], 1)[:, 0] for o in range(ny)]
    D = modal.D.copy()
    D[free[:, 0], free[:, 1]] += step[start + ny * n :]
    lam = modal.lam + dlam
    lam = np.where(modal.real, lam, lam.real + 1j * np.maximum(np.abs(lam.imag), 1e-6))
    return Modal(lam, modal.B + dB, modal.C + np.array(dC), D)


def to_complex(modal: Modal, values: Array, columns: int) -> ComplexArray:
    """Complex numbers (nm, columns) of each mode from their real and imaginary parts."""
    first, second = modal.place(columns)
    imaginary = np.where(second >= 0, values[np.maximum(second, 0)], 0.0)
    return np.asarray(values[first] + 1j * imaginary)


def gauge(modal: Modal, size: int) -> Array:
    """Directions (size, n) in which no output changes: B and C of a mode against each other.

    One of every real mode and two of a pair, whose B may turn, too; at the places of the real and
    imaginary parts of its λ.
    """
    n, (ny, nu) = modal.order, modal.D.shape
    (_, second), (real, imaginary) = modal.place(1), modal.place(nu)
    found, C = np.zeros((size, n)), n + n * nu + n * np.arange(ny)
    for k, (b, c) in enumerate(zip(modal.B, modal.C.T, strict=True)):
        other = int(second[k, 0])
        for column, turn in ((k, 1.0), (other, 1j))[: 1 if modal.real[k] else 2]:
            found[n + real[k], column] = (turn * b).real
            found[C + k, column] = -(turn * c).real
            if not modal.real[k]:
                found[n + imaginary[k], column] = (turn * b).imag
                found[C + other, column] = -(turn * c).imag
    return found


def covariance_factor(H: Array, modal: Modal) -> Array:
    """L (parameters, rank) with L Lᵀ = H⁺, the covariance of the parameters of a modal model.

    Only the `gauge` is left out. Where poles nearly meet, B and C of each are large and against one
    another, and what tells the poles apart is 1e-11 of the largest and less, but is told: without
    it poles would be known that are not. What rounding hides counts as `HIDDEN`, not as known.
    """
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    none = gauge(modal, len(H)) * scale[:, None]
    size = np.linalg.norm(none, axis=0)
    none = np.where(size > 0, none / np.maximum(size, 1e-300), np.eye(*none.shape))
    Q = np.linalg.qr(none, mode="complete")[0][:, modal.order :]
    s, V = np.linalg.eigh(Q.T @ (H / np.outer(scale, scale)) @ Q)
    shown = np.where(np.diag(H) > 0, 1 / scale, 0.0)  # of what shows nowhere no error is told
    return np.asarray(Q @ V / np.sqrt(np.maximum(s, HIDDEN * s[-1])) * shown[:, None])


def schur(G: Array, n: int) -> Array:
    """Eliminate the first n unknowns (the transient of one record)."""
    return np.asarray(G[n:, n:] - G[n:, :n] @ eliminator(G, n))


def eliminator(G: Array, n: int) -> Array:
    """The first n unknowns as they follow from the others; the last column for none of those.

    Of one matrix, or of the first n rows at least of each of a stack.
    """
    head = G[..., :n, :n]
    scale = np.sqrt(np.maximum(np.diagonal(head, axis1=-2, axis2=-1), 1e-300))[..., None]
    scaled = head / (scale * scale.swapaxes(-1, -2)) + RIDGE * np.eye(n)
    return np.asarray(np.linalg.solve(scaled, G[..., :n, n:] / scale) / scale)


def descend(
    modal: Modal,
    *,
    cost: Callable[[Modal], float],
    normal: Callable[[Modal], tuple[Array, Array]],
    tidy: Callable[[Modal], Modal],
    free: np.ndarray,
    steps: int,
    settled: float,
) -> Modal:
    """Levenberg-Marquardt steps until the cost, squared residuals, decreases by less than settled.

    ``normal`` gives the Gauss-Newton matrix and the descent direction, ``tidy`` moves a trial model
    back to where it is allowed to be, ``free`` (nfree, 2) are the entries of D that are parameters.
    """
    damping, value = 1e-3, cost(modal)
    for _ in range(steps):
        H, gradient = normal(modal)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        scaled, right = H / np.outer(scale, scale), gradient / scale
        before = value
        for _ in range(8):
            damped = scaled + damping * np.eye(len(H))
            step = scipy.linalg.solve(damped, right, assume_a="pos") / scale
            trial = tidy(moved(modal, step, free))
            trial_value = cost(trial)
            if trial_value < value:
                modal, value, damping = trial, trial_value, max(damping / 5, 1e-9)
                break
            damping *= 10
        if before - value <= settled * before:  # both are zero where nothing is left
            break
    return modal
