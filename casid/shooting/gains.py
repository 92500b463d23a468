"""Gains of a filter that change from sample to sample, and the likelihood of its innovations."""

from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.assembly import by_number


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains and covariances of the innovations, rows (g) of tables, and where each holds."""

    which: np.ndarray  # (N,) the row of every sample
    K: Array  # (g, nx, ny) what an innovation adds to the state one step on; 0 where missing
    S: Array  # (g, ny, ny) covariance of the innovations; that of missing ones is one
    W: Array  # (g, ny, ny) WᵀW = S⁻¹, 0 where missing
    K_lam: Array  # (g, nx, ny, nf)
    S_lam: Array  # (g, ny, ny, nf)

    def push(self, at: np.ndarray, r: Array) -> Array:
        """What innovations r (n, ny) of samples add to the states, (n, nx)."""
        return np.asarray((self.K[self.which[at]] @ r[:, :, None])[:, :, 0])

    def carry(self, at: np.ndarray, heard: Array) -> Array:
        """The same of derivatives (ny, n, ns) of innovations, (nx, n, ns)."""
        which = self.which[at]
        if (which == which[0]).all():
            return np.tensordot(self.K[which[0]], heard, axes=1)
        return np.asarray((self.K[which] @ heard.transpose(1, 0, 2)).transpose(1, 0, 2))

    def force(self, at: np.ndarray, r: Array) -> Array:
        """What innovations (n, ny) add to the derivatives of the states, (nx, n, nf)."""
        out = np.empty((self.K.shape[1], len(at), self.K_lam.shape[3]))
        for g, mine in by_number(self.which[at], len(self.K)):
            out[:, mine] = r[mine] @ self.K_lam[g]
        return out

    def whitened(self, r: Array) -> Array:
        """Innovations (N, ny) of unit covariance."""
        return np.asarray((self.W[self.which] @ r[:, :, None])[:, :, 0])

    def cost(self, r: Array) -> float:
        """½ Σ (rᵀS⁻¹r + log det S)."""
        counts = np.bincount(self.which, minlength=len(self.S))
        sizes = np.linalg.slogdet(self.S)[1]
        return float(np.sum(self.whitened(r) ** 2) + counts @ sizes) / 2

    def through_covariance(self, r: Array) -> tuple[Array, Array]:
        """Gradient (nf,) and information (nf, nf) of the unknowns through S alone."""
        counts, white = np.bincount(self.which, minlength=len(self.S)), self.whitened(r)
        moments = np.zeros_like(self.S)
        np.add.at(moments, self.which, white[:, :, None] * white[:, None, :])
        V = self.W @ self.S_lam.reshape(*self.S.shape[:2], -1)
        V = self.W[:, None] @ V.reshape(self.S_lam.shape)
        surplus = counts[:, None, None] * np.eye(self.S.shape[1]) - moments
        gradient = np.einsum("gab,gabf->f", surplus, V) / 2
        V = (V * np.sqrt(counts / 2)[:, None, None, None]).reshape(-1, V.shape[3])
        return gradient, V.T @ V
