"""Matrices, delays and innovation gain as functions of the unknowns, with their derivatives."""

from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.evaluation import MatrixFunction
from casid.model import Free


@dataclass(frozen=True, eq=False)
class FilterMatrices:
    """Matrices of a model with its gain K, and their derivatives by the unknowns (last axis, nf).

    K is zero for output error; ``c`` are the values of the model's own constraints.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    tau: Array
    c: Array
    K: Array
    A_lam: Array
    B_lam: Array
    C_lam: Array
    D_lam: Array
    tau_lam: Array
    c_lam: Array
    K_lam: Array


class FilterFunction:
    """The same as functions of the unknowns: free λ, then K by rows if it is free."""

    def __init__(self, free: Free, gain: Array | None, gain_free: bool) -> None:
        self._matrices, self._gain_free = MatrixFunction(free), gain_free
        nx, ny = self._matrices.nx, self._matrices.ny
        self._gain = np.zeros((nx, ny)) if gain is None else gain
        self.nf: int = self._matrices.nf + gain_free * nx * ny

    def __call__(self, unknowns: Array) -> FilterMatrices:
        """Matrices and derivatives at the unknowns (nf,)."""
        n, nf = self._matrices.nf, self.nf
        m = self._matrices(unknowns[:n])
        slopes, tau_lam, c_lam = (
            np.concatenate([np.moveaxis(part, 0, -1), np.zeros((*part.shape[1:], nf - n))], axis=-1)
            for part in (m.slopes, m.dtau, m.dc)
        )
        K, K_lam = self._gain, np.zeros((*self._gain.shape, nf))
        if self._gain_free:
            K = unknowns[n:].reshape(K.shape)
            K_lam.reshape(K.size, nf)[:, n:] = np.eye(K.size)
        x, y = slice(0, m.nx), slice(m.nx, None)
        blocks = (slopes[x, : m.nx], slopes[x, m.nx :], slopes[y, : m.nx], slopes[y, m.nx :])
        return FilterMatrices(*m.blocks, m.tau, m.c, K, *blocks, tau_lam, c_lam, K_lam)
