"""A structure in numbers: its matrices, delays and constraints, its response, and derivatives.

    G(s; λ) = (C (sI − A)⁻¹ B + D) e^(−sτ),    N = [A B; C D],

    dG = [C (sI − A)⁻¹  I] dN [(sI − A)⁻¹ B; I] e^(−sτ) − s G dτ,

and the second derivative of the first term [C (sI − A)⁻¹  I] dN [(sI − A)⁻¹ 0; 0 0] dN [...] twice.

The one place where estimators turn a structure's expressions into numbers. Parts that nothing
couples, as flight conditions side by side, are evaluated one by one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray, ComplexArray
from casid.free import Free


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """Channels that nothing couples to the others', by their positions."""

    states: NDArray[np.intp]
    inputs: NDArray[np.intp]
    outputs: NDArray[np.intp]
    order: scipy.sparse.csr_array  # of the derivatives of the part's own entries
    used: NDArray[np.intp]  # where these are in its own N

    def place(self, points: NDArray[np.intp]) -> tuple[NDArray[np.intp], ...]:
        """Where its response at some points is in the whole, (K, ny, nu)."""
        return np.ix_(points, self.outputs, self.inputs)

    def rows(self, nx: int) -> NDArray[np.intp]:
        """Its rows of N."""
        return np.concatenate([self.states, nx + self.outputs])

    def columns(self, nx: int) -> NDArray[np.intp]:
        """Its columns of N."""
        return np.concatenate([self.states, nx + self.inputs])


@dataclass(frozen=True, eq=False, kw_only=True)
class Matrices:
    """Matrices, delays and constraints of a structure at some λ, and their derivatives."""

    N: Array  # (nx + ny, nx + nu): [A B; C D]
    tau: Array  # (nu,) delays [s]
    c: Array  # (nc,) values of the constraints
    dN_used: scipy.sparse.csr_array  # noqa: N815 - the derivative of the entries of N that move
    used: NDArray[np.intp]  # where these are in N
    dtau: Array  # (nf, nu)
    dc: Array  # (nf, nc)
    nx: int
    parts: "tuple[tuple[Part, Matrices], ...]" = ()  # if there are several

    @property
    def blocks(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D."""
        N, nx = self.N, self.nx
        return N[:nx, :nx], N[:nx, nx:], N[nx:, :nx], N[nx:, nx:]

    @cached_property
    def slopes(self) -> Array:
        """Derivative of N as a dense array, (nf, nx + ny, nx + nu)."""
        found = np.zeros((self.dN_used.shape[0], self.N.size))
        found[:, self.used] = self.dN_used.toarray()
        return found.reshape(-1, *self.N.shape)

    def state_response(self, s: ComplexArray) -> ComplexArray:
        """The states' responses (s I − A)⁻¹ B e^(−sτ), (K, nx, nu); raises as `response`."""
        A, B, _, _ = self.blocks
        late = B * np.exp(-s[:, None, None] * self.tau)
        return np.asarray(np.linalg.solve(s[:, None, None] * np.eye(self.nx) - A, late))

    def response(self, s: ComplexArray) -> ComplexArray:
        """G (K, ny, nu) at points s (K,) of the complex plane; LinAlgError for a pole on one."""
        _, _, C, D = self.blocks
        if self.parts:
            G = np.zeros((len(s), *D.shape), dtype=complex)
            for part, own in self.parts:
                G[part.place(np.arange(len(s)))] = own.response(s)
            return G
        return np.asarray(C @ self.state_response(s) + D * np.exp(-s[:, None, None] * self.tau))

    def response_slopes(
        self, s: ComplexArray, seen: NDArray[np.bool_] | None = None
    ) -> tuple[ComplexArray, ComplexArray]:
        """G (K, ny, nu) and its derivatives (nf, K, ny, nu) at points s; raises as `response`.

        What is not ``seen`` (K, ny, nu) may be left zero.
        """
        if self.parts:
            shape = len(s), *self.blocks[3].shape
            G, slope = (np.zeros((*more, *shape), complex) for more in ((), (len(self.dc),)))
            for part, own in self.parts:
                k = np.arange(len(s))
                if seen is not None:
                    k = k[seen[part.place(k)].any(axis=(1, 2))]
                G[part.place(k)], own_slope = own.response_slopes(s[k])
                for whole, each in zip(slope, own_slope, strict=True):
                    whole[part.place(k)] = each
            return G, slope
        left, right, _, G = self._factors(s)
        row, column = self._places
        # Points come last, which are many: outputs and inputs are too few for loops within.
        rows, columns = (x.transpose(2, 1, 0).copy() for x in (left, right.swapaxes(1, 2)))
        terms = rows[row][:, :, None] * columns[column][:, None]
        flat = np.asarray(self.dN_used @ terms.reshape(len(row), G.size))
        slope = flat.reshape(len(flat), *G.shape[1:], len(s)).transpose(0, 3, 1, 2).copy()
        late = s[:, None, None] * G
        for k, j in np.argwhere(self.dtau):
            slope[k, :, :, j] -= self.dtau[k, j] * late[:, :, j]
        return G, slope

    def response_curvature(self, s: ComplexArray, P: ComplexArray) -> tuple[Array, Array, Array]:
        """Derivatives of φ = Re Σ conj(P) ∘ G at points s, by N, by τ, and twice by λ.

        P is (K, ny, nu). Second derivatives (nf, nf) are those with N and τ linear in λ; what
        their own curvature adds, `MatrixFunction.curvature` has.
        """
        if self.parts:
            by_N, by_tau = np.zeros(self.N.shape), np.zeros(len(self.tau))
            H = np.zeros((len(self.dc), len(self.dc)))
            for part, own in self.parts:
                place = np.ix_(part.rows(self.nx), part.columns(self.nx))
                by_N[place], by_tau[part.inputs], more = own.response_curvature(
                    s, P[part.place(np.arange(len(s)))]
                )
                H += more
            return by_N, by_tau, H
        left, right, R, G = self._factors(s)
        row, column = self._places
        U = left.transpose(0, 2, 1) @ P.conj()
        T = U @ right.transpose(0, 2, 1)
        K, nx = len(s), self.nx
        flat, inner = T.reshape(K, -1).T, R.reshape(K, -1)
        twice = (flat.real @ inner.real - flat.imag @ inner.imag).reshape(*self.N.shape, nx, nx)
        through = (column < nx)[:, None] & (row < nx)  # from one entry of N to the next
        places = np.where(column < nx, column, 0)[:, None], np.where(row < nx, row, 0)
        entries = np.where(through, twice[row[:, None], column, places[0], places[1]], 0.0)
        late = -s[:, None, None]
        by_delay = np.einsum("keb,keb->eb", U[:, row], late * right[:, column]).real
        products = P.conj() * G
        dN = self.dN_used
        half = dN @ (dN @ entries.T).T + (dN @ by_delay) @ self.dtau.T
        bend = (late**2 * products).sum(axis=(0, 1)).real
        H = half + half.T + (self.dtau * bend) @ self.dtau.T
        return T.sum(axis=0).real, (late * products).sum(axis=(0, 1)).real, H

    @property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries of N that depend on a parameter."""
        return np.divmod(self.used, self.N.shape[1])

    def _factors(self, s: ComplexArray) -> tuple[ComplexArray, ...]:
        """[C (sI − A)⁻¹  I], [(sI − A)⁻¹ B; I] e^(−sτ), (sI − A)⁻¹ and G at points s."""
        A, B, C, D = self.blocks
        (ny, nu), K = D.shape, len(s)
        R = np.linalg.inv(s[:, None, None] * np.eye(self.nx) - A)
        X, delay = R @ B, np.exp(-s[:, None, None] * self.tau)
        left = np.concatenate([C @ R, np.broadcast_to(np.eye(ny), (K, ny, ny))], axis=2)
        right = np.concatenate([X, np.broadcast_to(np.eye(nu), (K, nu, nu))], axis=1)
        return left, right * delay, R, (C @ X + D) * delay


class MatrixFunction:
    """The matrices of a structure as a function of its free parameters, in physical units."""

    def __init__(self, free: Free) -> None:
        lam = ca.SX.sym("lam", len(free.index))
        A, B, C, D, tau, c = free.model.matrices()(free.full(lam))
        sparse = ca.blockcat([[A, B], [C, D]])
        N = ca.densify(sparse)
        J = ca.jacobian(ca.vec(N.T), lam)
        entries: list[Any] = J.nonzeros()
        dense = [ca.densify(part) for part in (tau, c, ca.jacobian(tau, lam), ca.jacobian(c, lam))]
        column = ca.vertcat(ca.SX(0, 1), *entries)
        # Transposed, since CasADi's numbers come column by column.
        self._function = ca.Function("matrices", [lam], [N.T, column, *dense])
        weights = ca.SX.sym("by_N", N.numel()), ca.SX.sym("by_tau", tau.numel())
        total = ca.dot(weights[0], ca.vec(N.T)) + ca.dot(weights[1], tau)
        self._bent = ca.Function("bent", [lam, *weights], [ca.densify(ca.hessian(total, lam)[0])])
        place, parameter = np.array(J.sparsity().get_triplet(), dtype=int)
        self._used, entry = np.unique(place, return_inverse=True)
        order = np.arange(len(entries)), (parameter, entry)
        self._order = scipy.sparse.csr_array(order, shape=(len(free.index), len(self._used)))
        bent = ca.which_depends(tau, lam, 2, True)
        self.linear_delays: BoolArray = ~np.array(bent, dtype=bool)  # (nu,)
        # (nu,) which inputs outputs may feel at once, whatever the direct terms are just now
        self.direct: BoolArray = ca.DM(ca.sparsify(D).sparsity(), 1).full().any(axis=0)
        self.nx, self.nu, self.ny, self.nf = A.shape[0], B.shape[1], C.shape[0], len(free.index)
        self._parts = self._split(np.array(sparse.sparsity().get_triplet(), dtype=int))
        self._last: tuple[bytes, Matrices] | None = None

    def __call__(self, values: Array) -> Matrices:
        """Matrices and derivatives at free values (nf,); those of the last call are kept."""
        key = values.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._at(values)
        return self._last[1]

    def curvature(self, values: Array, by_N: Array, by_tau: Array) -> Array:
        """Second derivative (nf, nf) of a weighted sum of all entries of N and τ."""
        return np.asarray(self._bent(values, by_N.ravel(), by_tau).full())

    def _at(self, values: Array) -> Matrices:
        N, entries, tau, c, dtau, dc = self._numbers(values)
        entries, tau, c = entries.ravel(), tau.ravel(), c.ravel()
        parts = tuple(
            (part, Matrices(
                N=N[np.ix_(part.rows(self.nx), part.columns(self.nx))], tau=tau[part.inputs], c=c,
                dN_used=_ordered(part.order, entries), used=part.used,
                dtau=dtau[:, part.inputs], dc=dc, nx=len(part.states),
            ))
            for part in self._parts
        )  # fmt: skip
        dN = _ordered(self._order, entries)
        return Matrices(
            N=N, tau=tau, c=c, dN_used=dN, used=self._used, dtau=dtau, dc=dc, nx=self.nx,
            parts=parts,
        )  # fmt: skip

    def _numbers(self, values: Array) -> list[Array]:
        """N, the entries of its derivative, τ, c, dτ (nf, nu) and dc (nf, nc)."""
        # Written by CasADi where they stay: its own matrices take longer to copy than to compute.
        buffer: Any
        buffer, run = self._function.buffer()
        given = np.ascontiguousarray(values, dtype=float)
        buffer.set_arg(0, given.data)
        shapes = map(self._function.size_out, range(self._function.n_out()))
        found = [np.zeros(shape[::-1]) for shape in shapes]
        for i, part in enumerate(found):
            buffer.set_res(i, part.ravel().data)
        run()
        return found

    def _split(self, coupled: NDArray[np.intp]) -> list[Part]:
        """Parts, by the rows and columns (2, n) of N that couple; none if there is only one."""
        nx, nu = self.nx, self.nu
        row, column = coupled
        graph = scipy.sparse.csr_array(
            (np.ones(len(row)), (np.where(row < nx, row, row + nu), column)),
            (nx + nu + self.ny,) * 2,  # states, inputs, outputs
        )
        count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
        own = [
            [np.flatnonzero(x == k) for x in np.split(label, [nx, nx + nu])] for k in range(count)
        ]
        own = [each for each in own if len(each[1]) and len(each[2])]
        if len(own) < 2 or not all(len(states) for states, _, _ in own):
            return []
        return [self._part(*each) for each in own]

    def _part(
        self, states: NDArray[np.intp], inputs: NDArray[np.intp], outputs: NDArray[np.intp]
    ) -> Part:
        """A part of N."""
        rows, columns = (np.concatenate([states, self.nx + each]) for each in (outputs, inputs))
        places = (rows[:, None] * (self.nx + self.nu) + columns).ravel()  # in the whole
        used = np.flatnonzero(np.isin(places, self._used))
        order = self._order[:, np.searchsorted(self._used, places[used])]
        return Part(states=states, inputs=inputs, outputs=outputs, order=order, used=used)


def _ordered(order: scipy.sparse.csr_array, entries: Array) -> scipy.sparse.csr_array:
    """Entries where their numbers stand."""
    sparse = (entries[order.data], order.indices, order.indptr)
    return scipy.sparse.csr_array(sparse, shape=order.shape)
