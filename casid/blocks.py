"""Programmes made of one small block of constraints, repeated over data.

A lifted programme has a few shared variables (the parameters) and many local ones (the states at
each frequency). Its derivatives are those of one block, evaluated for every column of the data and
scattered into place: exact, sparse, and built in a time that does not grow with the repetitions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse

from casid.arrays import Array
from casid.nlp import Problem


@dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """f += f(w; d) and lower <= g(w; d) <= upper for every column of index and data."""

    w: ca.SX  # (nw,) variables of the block
    d: ca.SX  # (nd,) its data
    f: ca.SX  # scalar objective
    g: ca.SX  # (ng,) constraints
    index: np.ndarray  # (nw, K) where each of w sits in the programme's vector
    data: Array  # (nd, K) values of d
    lower: Array  # (ng,) bounds of g
    upper: Array  # (ng,)

    @property
    def count(self) -> int:
        """Number of repetitions K."""
        return int(self.index.shape[1])


def assemble(blocks: Sequence[Block], x0: Array, lower_x: Array, upper_x: Array) -> Problem:
    """The programme of all blocks over the vector x, with exact sparse derivatives."""
    n = len(x0)
    x = ca.MX.sym("x", n)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", sum(map(_rows, blocks)))
    f, g, gradient, start = ca.MX(0), [], ca.MX(n, 1), 0
    jacobian, hessian = _Triplets(), _Triplets()
    for block in blocks:
        parts = _functions(block)
        local = ca.reshape(x[_flat(block.index)], block.index.shape)
        fk, gk, gf, J = parts["first"](local, block.data)
        f += ca.sum2(fk)
        g.append(ca.vec(gk))
        gradient += _scatter(block.index, n) @ ca.vec(gf)
        stop = start + _rows(block)
        mu = ca.reshape(lam_g[start:stop], block.g.numel(), block.count)
        H = parts["second"](local, block.data, lam_f, mu)
        rows = start + np.arange(_rows(block)).reshape(-1, block.count, order="F")
        jacobian.add(parts["J"], rows, block.index, ca.vec(J))
        hessian.add(parts["H"], block.index, block.index, ca.vec(H))
        start = stop
    g = ca.vertcat(*g)
    J = jacobian.matrix((start, n))
    symbols = {"x": x, "p": ca.MX(0, 1), "lam_f": lam_f, "lam_g": lam_g}

    def function(name: str, inputs: Sequence[str], **results: ca.MX) -> ca.Function:
        given = [symbols[each] for each in inputs]
        return ca.Function(name, given, [*results.values()], [*inputs], [*results])

    functions = {
        "nlp_grad_f": function("nlp_grad_f", ("x", "p"), f=f, grad_f_x=gradient),
        "nlp_jac_g": function("nlp_jac_g", ("x", "p"), g=g, jac_g_x=J),
    }
    H = hessian.matrix((n, n), upper=True)
    second = function("nlp_hess_l", [*symbols], triu_hess_gamma_x_x=H)
    return Problem(
        x=x, f=f, g=g, x0=x0, lower_x=lower_x, upper_x=upper_x,
        lower_g=np.concatenate([np.tile(block.lower, block.count) for block in blocks]),
        upper_g=np.concatenate([np.tile(block.upper, block.count) for block in blocks]),
        hessian=second, functions=functions,
    )  # fmt: skip


def _rows(block: Block) -> int:
    return int(block.g.numel()) * block.count


def _flat(index: np.ndarray) -> list[int]:
    flat: list[int] = index.ravel(order="F").tolist()
    return flat


def _scatter(index: np.ndarray, n: int) -> ca.DM:
    """0-1 matrix that adds the columns' entries into the programme's vector."""
    flat = index.ravel(order="F")
    shape = (n, len(flat))
    entries = (np.ones(len(flat)), (flat, np.arange(len(flat))))
    return ca.DM(scipy.sparse.csc_matrix(entries, shape=shape))


def _functions(block: Block) -> dict[str, Any]:
    """Mapped functions of one block, and the sparsity of its derivatives."""
    J = ca.jacobian(block.g, block.w)
    mu, lam_f = ca.SX.sym("mu", block.g.numel()), ca.SX.sym("lam_f")
    lagrangian = lam_f * block.f + ca.dot(mu, block.g)
    H, _ = ca.hessian(lagrangian, block.w)
    first = ca.Function(
        "first",
        [block.w, block.d],
        [block.f, ca.densify(block.g), ca.densify(ca.gradient(block.f, block.w)), _nonzeros(J)],
    )
    second = ca.Function("second", [block.w, block.d, lam_f, mu], [_nonzeros(H)])
    K = block.count
    return {
        "first": first.map(K),
        "second": second.map("second_map", "serial", K, [2], []),
        "J": J.sparsity(),
        "H": H.sparsity(),
    }


def _nonzeros(matrix: ca.SX) -> ca.SX:
    """The structural nonzeros as a dense column, in the order of the sparsity pattern."""
    entries: list[Any] = matrix.nonzeros()
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *entries)
    return column


class _Triplets:
    """Local nonzeros of many blocks, summed into one sparse matrix."""

    def __init__(self) -> None:
        self._rows: list[np.ndarray] = []
        self._columns: list[np.ndarray] = []
        self._values: list[ca.MX] = []

    def add(
        self, sparsity: ca.Sparsity, rows: np.ndarray, columns: np.ndarray, values: ca.MX
    ) -> None:
        i, j = (np.array(part, dtype=int) for part in sparsity.get_triplet())
        self._rows.append(rows[i].ravel(order="F"))
        self._columns.append(columns[j].ravel(order="F"))
        self._values.append(values)

    def matrix(self, shape: tuple[int, int], *, upper: bool = False) -> ca.MX:
        i, j = np.concatenate(self._rows), np.concatenate(self._columns)
        values = ca.vertcat(*self._values)
        keep = np.flatnonzero(i <= j) if upper else np.arange(len(i))
        places, which = np.unique(j[keep] * shape[0] + i[keep], return_inverse=True)
        columns, rows = np.divmod(places, shape[0])
        pattern = ca.Sparsity.triplet(*shape, rows.tolist(), columns.tolist())
        entries = (np.ones(len(keep)), (which, keep))
        gather = scipy.sparse.csc_matrix(entries, shape=(len(places), len(i)))
        return ca.MX(pattern, ca.DM(gather) @ values)
