"""A nonlinear structure in numbers: its equations and their derivatives at many points at once.

One CasADi function gives f, f_x, f_u and f_λ (or h and its derivatives) with their common
subexpressions, mapped over points; only structural nonzeros are computed.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np

from casid.arrays import Array, BoolArray
from casid.free import Free
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold

POINTS = 128  # evaluated by one call
# Of the method: which of a step's instants, how far ahead of its beginning, six times the weight.
STAGES = (0, 0.0, 1.0), (1, 0.5, 2.0), (1, 0.5, 2.0), (2, 1.0, 1.0)


class Mapped:
    """A CasADi function of columns and shared arguments, for arrays (n, size) of NumPy."""

    def __init__(self, function: ca.Function, shared: Sequence[int]) -> None:
        self._function, self._shared = function, list(shared)
        self._sizes = [function.numel_in(i) for i in range(function.n_in())]
        self._widths = [function.numel_out(i) for i in range(function.n_out())]
        self._kept: dict[int, tuple[list[Array], list[Array], Any]] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Results (n, size) at n points; arguments are (n, size), those shared (size,)."""
        n = next(len(a) for i, a in enumerate(arguments) if i not in self._shared)
        size = -(-n // -(-n // POINTS)) if n else 1  # of calls alike, the last one padded least
        results: list[Array] = [np.empty((n, width)) for width in self._widths]
        for first in range(0, n, size):
            inputs, outputs, run = self._buffers(size)
            rows = slice(first, min(first + size, n))
            count = rows.stop - first
            for i, (target, value) in enumerate(zip(inputs, arguments, strict=True)):
                if i in self._shared:
                    target[0] = value
                else:
                    target[:count], target[count:] = value[rows], value[rows.stop - 1]
            run()
            for result, values in zip(results, outputs, strict=True):
                result[rows] = values[:count]
        return results

    def _buffers(self, size: int) -> tuple[list[Array], list[Array], Callable[[], None]]:
        """Memory and call of the function mapped over so many points; made once."""
        if size not in self._kept:
            mapped = self._function.map(f"points{size}", "serial", size, self._shared, [])
            rows = [1 if i in self._shared else size for i in range(len(self._sizes))]
            inputs: list[Array] = [np.zeros((r, n)) for r, n in zip(rows, self._sizes, strict=True)]
            outputs: list[Array] = [np.zeros((size, width)) for width in self._widths]
            buffer: Any
            buffer, run = mapped.buffer()
            for i, array in enumerate(inputs):
                buffer.set_arg(i, array.data)
            for i, array in enumerate(outputs):
                buffer.set_res(i, array.data)
            self._kept[size] = inputs, outputs, _Call(mapped, buffer, run)
        return self._kept[size]


class _Call:
    """A call in prepared memory, which keeps what it needs alive."""

    def __init__(self, *parts: Any) -> None:  # noqa: ANN401 - CasADi's own
        self._parts = parts

    def __call__(self) -> None:
        self._parts[-1]()


class Entries:
    """Where the nonzeros of a matrix stand."""

    def __init__(self, sparsity: ca.Sparsity) -> None:
        self._row, self._col = (np.array(part, dtype=int) for part in sparsity.get_triplet())

    def add(self, target: Array, nonzeros: Array) -> None:
        """Add nonzeros (n, nnz) to matrices (n, rows, columns or more)."""
        target[:, self._row, self._col] += nonzeros

    def put(self, target: Array, nonzeros: Array) -> None:
        """Write them into matrices that are zero elsewhere."""
        target[:, self._row, self._col] = nonzeros


class Slopes:
    """Derivatives of a vector function by x, u and λ: dense by x and u, nonzeros by λ."""

    def __init__(self, value: ca.SX, x: ca.SX, u: ca.SX, lam: ca.SX) -> None:
        J = ca.jacobian(value, lam)
        parts = [value, ca.jacobian(value, x).T, ca.jacobian(value, u).T]
        dense = [ca.vec(ca.densify(part)) for part in parts]  # transposed: rows of NumPy's arrays
        found = ca.cse([*dense, _nonzeros(J)])
        self._mapped = Mapped(ca.Function("slopes", [x, u, lam], found), [2])
        self.lam, self._m = Entries(J.sparsity()), value.numel()

    def __call__(self, x: Array, u: Array, lam: Array) -> tuple[Array, Array, Array, Array]:
        """Values (n, m), derivatives (n, m, nx) and (n, m, nu), nonzeros by λ (n, nnz)."""
        value, by_x, by_u, by_lam = self._mapped(x, u, lam)
        return value, by_x.reshape(len(x), self._m, -1), by_u.reshape(len(x), self._m, -1), by_lam


class Bend:
    """Second derivatives of pᵀf + ρᵀh by x and λ, through the delays of inputs u(t - τ) too."""

    def __init__(self, free: Free) -> None:
        model = cast("NonlinearModel", free.model)
        names = "x", "u", "rate", "p", "rho", "lam", "tau"
        nx, nu, ny = len(model.states), len(model.inputs), len(model.outputs)
        sizes = nx, nu, nu, nx, ny, len(free.index), nu
        x, u, rate, p, rho, lam, tau = arguments = [
            ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)
        ]
        full = free.full(lam)
        late = model.matrices()(full)[4] - tau  # zero, but for its derivatives
        f, h = model.equations()(x, u - rate * late, full)
        total = ca.dot(p, f) + ca.dot(rho, h)
        xx, x_lam = (ca.jacobian(ca.gradient(total, x), by) for by in (x, lam))
        lam_lam = ca.jacobian(ca.gradient(total, lam), lam)
        found = [ca.vec(ca.densify(xx)), _nonzeros(x_lam), _nonzeros(lam_lam)]
        self._mapped = Mapped(ca.Function("bend", arguments, ca.cse(found)), [5, 6])
        self.x_lam, self.lam_lam = Entries(x_lam.sparsity()), Entries(lam_lam.sparsity())

    def __call__(self, *arguments: Array) -> list[Array]:
        """By x twice (n, nx nx), and nonzeros by x and λ and by λ twice (n, nnz).

        Of x, u, its rate, p and ρ, (n, size), and λ and τ, (size,).
        """
        return self._mapped(*arguments)


def _nonzeros(matrix: ca.SX) -> ca.SX:
    """Column of the structural nonzeros."""
    entries: list[Any] = matrix.nonzeros()
    return ca.vertcat(ca.SX(0, 1), *entries)


class Flow:
    """Equations, outputs and one Runge-Kutta step of a nonlinear structure in its free λ."""

    def __init__(self, free: Free) -> None:
        model = cast("NonlinearModel", free.model)
        equations = model.equations()
        x, u = ca.SX.sym("x", equations.numel_in(0)), ca.SX.sym("u", equations.numel_in(1))
        lam = ca.SX.sym("lam", len(free.index))
        full = free.full(lam)
        f, h = equations(x, u, full)
        self.f, self.h, self._free = Slopes(f, x, u, lam), Slopes(h, x, u, lam), free
        self.cut = cut(model)
        self.direct: BoolArray = np.array(ca.which_depends(h, u, 1), dtype=bool)  # (nu,)
        stages, step = ca.SX.sym("stages", 3 * u.numel()), ca.SX.sym("step")
        first, middle, last = ca.vertsplit(stages, u.numel()) if u.numel() else [stages] * 3
        k1 = equations(x, first, full)[0]
        k2 = equations(x + step / 2 * k1, middle, full)[0]
        k3 = equations(x + step / 2 * k2, middle, full)[0]
        k4 = equations(x + step * k3, last, full)[0]
        after = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self._step = Mapped(ca.Function("step", [x, stages, step, lam], [ca.densify(after)]), [3])
        self._output = Mapped(ca.Function("output", [x, u, lam], [ca.densify(h)]), [2])

    @cached_property
    def bend(self) -> Bend:
        """Second derivatives; made where an iteration first wants them."""
        return Bend(self._free)

    def step(self, x: Array, stages: Array, h: Array, lam: Array) -> Array:
        """States (n, nx) one step on; stages (n, 3 nu) are the inputs there, h (n,) lengths [s]."""
        return self._step(x, stages, h[:, None], lam)[0]

    def output(self, x: Array, u: Array, lam: Array) -> Array:
        """Outputs (n, ny)."""
        return self._output(x, u, lam)[0]


def cut(model: NonlinearModel) -> tuple[Hold, ...]:
    """Of inputs held how breaks cut steps of integration, see `casid.shooting.runge_kutta_inputs`.

    Kinks do not where dx/dt = f(x) + g(x) u, nor jumps where g is the same at all states.
    """
    equations = model.equations()
    x, u, lam = (ca.SX.sym("of", equations.numel_in(i)) for i in range(3))
    f = equations(x, u, lam)[0]
    if any(ca.which_depends(f, u, 2)):
        return "foh", "zoh"
    return ("zoh",) if any(ca.which_depends(ca.jacobian(f, u), x, 1)) else ()


def weights(A: Array) -> Array:
    """What a unit of f at each stage moves a step's end, side by side (n, nx, stages * nx).

    Over the step's length, A (n, stages, nx, nx) times which are the slopes of f by x.
    """
    eye, M = np.eye(A.shape[2]), np.empty_like(A)
    for i in range(len(STAGES) - 1, -1, -1):
        M[:, i] = STAGES[i][2] / 6 * eye
        if i + 1 < len(STAGES):
            M[:, i] += STAGES[i + 1][1] * (M[:, i + 1] @ A[:, i + 1])
    return M.transpose(0, 2, 1, 3).reshape(len(A), A.shape[2], -1)
