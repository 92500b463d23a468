"""Pieces of a sparse programme evaluated by NumPy: patterns, places of blocks, functions."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array
from casid.nlp import Problem


class Pattern:
    """A sparse matrix with fixed places, whose values come in another order."""

    def __init__(
        self, row: np.ndarray, col: np.ndarray, size: int, rows: int | None = None
    ) -> None:
        self.rows = size if rows is None else rows
        number = np.arange(1.0, len(row) + 1)  # 0 would be dropped
        matrix = scipy.sparse.csc_array((number, (row, col)), (self.rows, size))
        matrix.sort_indices()
        self._order = matrix.data.astype(int) - 1
        self._empty = matrix
        self.sparsity = ca.Sparsity(
            self.rows, size, matrix.indptr.tolist(), matrix.indices.tolist()
        )

    def order(self, values: Array) -> Array:
        """Values as the sparsity stores them."""
        return np.asarray(values[self._order])

    def matrix(self, ordered: Array) -> scipy.sparse.csc_array:
        """SciPy's form of values ordered before."""
        like = self._empty
        return scipy.sparse.csc_array((ordered, like.indices, like.indptr), like.shape)


class NumPyFunction(ca.Callback):
    """A CasADi function evaluated by NumPy, without copies through CasADi matrices."""

    def __init__(
        self,
        name: str,
        inputs: Sequence[ca.Sparsity],
        outputs: Sequence[ca.Sparsity],
        function: Callable[..., Sequence[Array | float]],
    ) -> None:
        ca.Callback.__init__(self)
        self._in, self._out, self._function = inputs, outputs, function
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Number of arguments."""
        return len(self._in)

    def get_n_out(self) -> int:
        """Number of results."""
        return len(self._out)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Shape of an argument."""
        return self._in[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Shape of a result."""
        return self._out[i]

    def has_eval_buffer(self) -> bool:
        """CasADi is to hand over its own memory."""
        return True

    def eval_buffer(
        self, arguments: Sequence[memoryview | None], results: Sequence[memoryview | None]
    ) -> int:
        """Evaluate in CasADi's memory; None where it wants no result.

        Where a matrix is singular there is no value: NaN, from which solvers step back.
        """
        values = [np.frombuffer(a) if a is not None else np.zeros(0) for a in arguments]
        try:
            found = self._function(*values)
        except np.linalg.LinAlgError:
            found = [np.nan] * len(results)
        for target, value in zip(results, found, strict=True):
            if target is not None:
                np.frombuffer(target)[:] = value
        return 0


class Calls(Protocol):
    """What IPOPT asks of a programme at its vector x."""

    def cost(self, x: Array) -> float:
        """The cost."""

    def gradient(self, x: Array) -> Array:
        """Its gradient."""

    def constraints(self, x: Array) -> Array:
        """Values of the constraints."""

    def jacobian(self, x: Array) -> Array:
        """Nonzeros of their Jacobian."""

    def hessian(self, x: Array, f: float, mu: Array) -> Array:
        """Nonzeros of the upper triangle of the Hessian of f times the cost plus mu times them."""


def grid(rows: np.ndarray, cols: np.ndarray, upper: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of every entry of a stack of blocks, (k, a) against (k, b)."""
    row = np.broadcast_to(rows[:, :, None], (*rows.shape, cols.shape[1]))
    col = np.broadcast_to(cols[:, None, :], row.shape)
    return (upper_triangle(row), upper_triangle(col)) if upper else (row.ravel(), col.ravel())


def upper_triangle(blocks: np.ndarray) -> np.ndarray:
    """Upper triangles of a stack of blocks, one after the other."""
    i, j = np.triu_indices(blocks.shape[1])
    return blocks[:, i, j].ravel()


def stack(grids: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of all grids, one after the other."""
    return np.concatenate([r for r, _ in grids]), np.concatenate([c for _, c in grids])


def by_number(number: np.ndarray, kinds: int) -> Iterator[tuple[int, Any]]:
    """Each number that occurs, with where it does."""
    if kinds == 1 or (number == number[0]).all():
        yield int(number[0]), slice(None)
    else:
        for i in np.unique(number):
            yield int(i), np.flatnonzero(number == i)


def evaluated(
    calls: "Calls",
    x: tuple[Array, Array, Array],
    g: tuple[Array, Array],
    jacobian: ca.Sparsity,
    hessian: ca.Sparsity,
) -> Problem:
    """The programme that NumPy evaluates, for `casid.nlp.solve`.

    ``x`` is the start with lower and upper bounds, ``g`` the bounds of the constraints; then the
    sparsity of the constraints' Jacobian and of the upper triangle of the Lagrangian's Hessian.
    """
    n, m = len(x[0]), len(g[0])
    X, p, one, G = (ca.Sparsity.dense(k, 1) if k else ca.Sparsity(0, 0) for k in (n, 0, 1, m))
    symbol = ca.MX.sym("x", n)
    f_of = NumPyFunction("f", [X], [one], lambda x: [calls.cost(x)])
    g_of = NumPyFunction("g", [X], [G], lambda x: [calls.constraints(x)])
    grad = NumPyFunction(
        "nlp_grad_f", [X, p], [one, X], lambda x, _: [calls.cost(x), calls.gradient(x)]
    )
    jac = NumPyFunction(
        "nlp_jac_g", [X, p], [G, jacobian], lambda x, _: [calls.constraints(x), calls.jacobian(x)]
    )
    hess = NumPyFunction(
        "nlp_hess_l", [X, p, one, G], [hessian], lambda x, _, f, mu: [calls.hessian(x, f[0], mu)]
    )
    return Problem(
        x=symbol, f=f_of(symbol), g=g_of(symbol) if m else ca.MX(0, 1), x0=x[0],
        lower_x=x[1], upper_x=x[2], lower_g=g[0], upper_g=g[1], hessian=hess,
        functions={"nlp_grad_f": grad, "nlp_jac_g": jac}, kept=(f_of, g_of),
    )  # fmt: skip
