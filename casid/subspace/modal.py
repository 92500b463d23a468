"""Real linear models by their modes, and least squares on them.

In modal coordinates every derivative of an output is a pole factor times a signal, and an output
enters through its row of C alone: the normal equations of all outputs are assembled from one small
Gram matrix each, instead of a tall Jacobian.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.values import storable

S = TypeVar("S", Array, ComplexArray)  # signals, or products of signals

DEFECTIVE = 1e9  # condition number of the modes' shapes
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
    """Real basis of a modal signal (K, nm, c): sums of all modes, then differences of pairs."""
    first = (phi + conjugate).reshape(len(phi), -1)
    second = (1j * (phi - conjugate))[:, ~real].reshape(len(phi), -1)
    return np.hstack([first, second])


def mixed(piece: S, modal: Modal, o: int, columns: int) -> S:
    """A modal quantity as output o sees it: Re c on its own basis, Im c across the pair."""
    pairs = np.repeat(~modal.real, columns)
    c = np.repeat(modal.C[o], columns)
    first, second = piece[:, : len(c)], piece[:, len(c) :]
    own = first * c.real
    own[:, pairs] += second * c.imag[pairs]
    return np.hstack([own, second * c.real[pairs] - first[:, pairs] * c.imag[pairs]])


def mixing(modal: Modal) -> Array:
    """Of every output the matrix by which `mixed` makes its columns of a quantity, (ny, n, n)."""
    i, k = np.arange(len(modal.lam)), np.flatnonzero(~modal.real)
    j = len(i) + np.arange(len(k))
    M = np.zeros((len(modal.C), len(i) + len(k), len(i) + len(k)))
    M[:, i, i], M[:, j, j] = modal.C.real, modal.C.real[:, k]
    M[:, j, k], M[:, k, j] = modal.C.imag[:, k], -modal.C.imag[:, k]
    return M


def output_derivative(basis: S, modal: Modal, o: int, free: np.ndarray) -> tuple[S, np.ndarray]:
    """Derivatives of output o by the transient and the parameters it depends on, and which."""
    ny, nu = modal.D.shape
    n = modal.order
    B, C = 2 * n, 2 * n + n * nu
    direct = np.flatnonzero(free[:, 0] == o)
    J = [
        mixed(basis[:, :n], modal, o, 1),
        mixed(basis[:, n:B], modal, o, 1),
        mixed(basis[:, B:C], modal, o, nu),
        basis[:, C : C + n],
        basis[:, C + n + free[direct, 1]],
    ]
    where = [np.arange(C), C + o * n + np.arange(n), C + ny * n + direct]
    return np.hstack(J), np.concatenate(where)


def tangents(
    modal: Modal, E: ComplexArray, basis: ComplexArray, w: Array, free: np.ndarray
) -> tuple[Array, Array, Array]:
    """Weighted residuals (2 K ny,) of a spectrum, output by output, and their slopes (2 K ny, P).

    The transient is eliminated from both; the basis (2 K ny, n) of what it does comes last.
    """
    ny, nu = modal.D.shape
    n = modal.order
    J = np.zeros((ny, 2 * len(w), 2 * n + n * nu + ny * n + len(free)))
    for o, rows in enumerate(J):
        own, where = output_derivative(basis, modal, o, free)
        rows[:, where] = stacked(own * w[:, o : o + 1])
    whole = J.reshape(-1, J.shape[2])
    Q = np.linalg.qr(whole[:, :n])[0]
    e, slopes = stacked(E * w).T.ravel(), whole[:, n:]
    return e - Q @ (Q.T @ e), slopes - Q @ (Q.T @ slopes), Q


def gram(rows: Array | ComplexArray) -> Array:
    """Re(rowsᴴ rows)."""
    real = stacked(rows) if np.iscomplexobj(rows) else rows
    return np.asarray(real.T @ real)


def stacked(rows: Array | ComplexArray) -> Array:
    """Real parts over imaginary ones."""
    return np.concatenate([rows.real, rows.imag])


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


def covariance_factor(H: Array) -> Array:
    """L with L Lᵀ = H⁺; the gauge of each mode (scale between B and C) is a null direction."""
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    s, V = np.linalg.eigh(H / np.outer(scale, scale))
    keep = s > 1e-10 * s[-1]
    return np.asarray(V[:, keep] / np.sqrt(s[keep]) / scale[:, None])


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
