"""The matrices of a model as functions of the unknowns, with their derivatives, in numbers."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model import Free


@dataclass(frozen=True, eq=False)
class Numbers:
    """Model matrices and their derivatives by the unknowns (last axis, nf); K may be None."""

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

    @cached_property
    def delaying(self) -> np.ndarray:
        """Which unknowns move a delay."""
        return np.flatnonzero(self.tau_lam.any(axis=0))


class Structure:
    """The matrices of a model as functions of the unknowns: free λ, then K by rows if free."""

    def __init__(self, free: Free, gain: Array | None, gain_free: bool) -> None:
        nx, ny = len(free.model.states), len(free.model.outputs)
        lam = ca.SX.sym("lam", len(free.index))
        entries = ca.SX.sym("K", ny, nx if gain_free else 0)
        K = np.zeros((nx, ny)) if gain is None else gain
        dense = [ca.densify(m) for m in free.model.matrices()(free.full(lam))]
        dense.append(entries.T if gain_free else ca.densify(ca.SX(K)))
        unknown = ca.vertcat(lam, ca.vec(entries))
        slopes = [ca.densify(ca.jacobian(ca.vec(m), unknown)) for m in dense]
        self._function = ca.Function("structure", [unknown], [*dense, *slopes])
        self._last: tuple[bytes, Numbers] | None = None

    def __call__(self, lam: Array) -> Numbers:
        """Matrices and derivatives at the unknowns (nf,)."""
        key = lam.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._numbers(lam)
        return self._last[1]

    def _numbers(self, lam: Array) -> Numbers:
        found = [m.full() for m in self._function(lam)]
        values, slopes = found[:7], found[7:]
        shaped = [
            slope.reshape((*value.shape, len(lam)), order="F")
            for value, slope in zip(values, slopes, strict=True)
        ]
        for vector in (4, 5):
            values[vector], shaped[vector] = values[vector].ravel(), shaped[vector][:, 0]
        return Numbers(*values, *shaped)
