"""How states and their derivatives advance by one sample, for every sampling interval there is.

A handful of distinct intervals gets a map each. Where the sampling is irregular the map is a smooth
function of the interval h, and so are its derivatives: they are interpolated between Chebyshev
nodes, exact to rounding since exp(A h) is entire, and no exponential is computed per sample.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.record import Hold
from casid.shooting.integrate import step_map, step_slopes
from casid.shooting.unknowns import Numbers

MANY = 8  # distinct intervals within a factor of two that are worth interpolating
EXACT = 1e-15  # interpolation error, relative


@dataclass(frozen=True, eq=False)
class Advance:
    """One step of length h: how states and their derivatives move.

    ``now`` is (A_d, B0, B1), against (x, u_k, u_k+1); ``drive`` (nx, nx + 2 nu, nf) its derivative,
    ``delay`` (nx, 2 nu, nd) against the delay-derivatives of u_k, u_k+1; ``gain`` is K_d and
    ``gain_drive`` (nx, ny, nf) its derivative.
    """

    now: Array
    gain: Array
    drive: Array
    delay: Array
    gain_drive: Array

    @classmethod
    def of(cls, numbers: Numbers, h: float, hold: Hold, filtering: bool, slopes: bool) -> "Advance":
        """Step of length h, with what moves its derivatives if ``slopes``."""
        ny = numbers.K.shape[1] if filtering else 0
        A, B, K = numbers.A, numbers.B, numbers.K[:, :ny]
        m = step_map(A, B, K, h, hold)
        now = np.hstack([m.Ad, m.B0, m.B1])
        if not slopes:
            none = np.zeros((0, 0, 0))
            return cls(now, m.Kd, none, none, none)
        d = step_slopes(A, B, K, h, hold, (numbers.A_lam, numbers.B_lam, numbers.K_lam[:, :ny]))
        drive = np.concatenate([d.Ad, d.B0, d.B1], axis=1)
        moving = numbers.tau_lam[:, numbers.delaying]
        delay = np.concatenate([m.B0[:, :, None] * moving, m.B1[:, :, None] * moving], axis=1)
        return cls(now, m.Kd, drive, delay, d.Kd)


class Steps:
    """The steps of all sampling intervals of a layout at one parameter set.

    Parameters
    ----------
    numbers : Numbers
        Model matrices.
    classes : sequence of (float, Hold)
        Distinct sampling intervals [s].
    filtering, slopes : bool
        Whether innovations drive the states, and whether derivatives are wanted.
    """

    def __init__(
        self,
        numbers: Numbers,
        classes: Sequence[tuple[float, Hold]],
        filtering: bool,
        slopes: bool,
    ) -> None:
        self.nx, self.filtering = len(numbers.A), filtering
        self.delaying = numbers.delaying
        self._groups: list[_Group] = []
        self._group_of = np.empty(len(classes), dtype=int)
        self._weights_of: list[Array] = []
        for members in _octaves(classes):
            nodes, weights = _nodes(np.array([classes[i][0] for i in members]), numbers.A)
            hold = classes[members[0]][1]
            steps = [Advance.of(numbers, h, hold, filtering, slopes) for h in nodes]
            table = np.zeros((len(classes), len(nodes)))
            table[members] = weights
            self._group_of[members] = len(self._groups)
            self._groups.append(_Group(steps, table, self.nx))

    def state(self, step: np.ndarray, V: Array, r: Array) -> Array:
        """States one step on, from (x, u_k, u_k+1) and residuals; ``step`` is each row's class."""
        new = np.empty((len(V), self.nx))
        for g, mine in groups(self._group_of[step], len(self._groups)):
            group = self._groups[g]
            new[mine] = group.apply(group.now, V[mine], step[mine])
            if self.filtering:
                new[mine] -= group.apply(group.gain, r[mine], step[mine])
        return new

    def back(self, step: np.ndarray, p: Array) -> Array:
        """Costates (n, nx) one step before, A_dᵀ p."""
        new = np.empty_like(p)
        for g, mine in groups(self._group_of[step], len(self._groups)):
            group = self._groups[g]
            new[mine] = group.apply(group.Ad.transpose(0, 2, 1), p[mine], step[mine])
        return new

    def force(self, step: np.ndarray, V: Array, dV: Array, r: Array) -> Array:
        """What drives the derivatives of the states over each step, (nx, rows, nf).

        From (x, u_k, u_k+1), the delay-derivatives of (u_k, u_k+1), and the residuals.
        """
        parts: list[tuple[Any, Array]] = []
        for g, mine in groups(self._group_of[step], len(self._groups)):
            group, kind = self._groups[g], step[mine]
            part = group.spread(group.drive, V[mine], kind)
            if len(self.delaying):
                part[:, :, self.delaying] += group.spread(group.delay, dV[mine], kind)
            if self.filtering:
                part -= group.spread(group.gain_drive, r[mine], kind)
            parts.append((mine, part))
        if len(parts) == 1:
            return parts[0][1]
        new = np.empty((self.nx, len(step), parts[0][1].shape[2]))
        for mine, part in parts:
            new[:, mine] = part
        return new

    def carry(self, step: np.ndarray, S: Array, heard: Array | None) -> Array:
        """Derivatives (nx, n, ns) of the states one step on, but for what drives them.

        ``heard`` (ny, n, ns) are those of the residuals that were measured, of a filter.
        """
        parts: list[tuple[Any, Array]] = []
        for g, mine in groups(self._group_of[step], len(self._groups)):
            group, kind = self._groups[g], step[mine]
            part = group.carry(group.Ad, S[:, mine], kind)
            if heard is not None:
                part -= group.carry(group.gain, heard[:, mine], kind)
            parts.append((mine, part))
        if len(parts) == 1:
            return parts[0][1]
        new = np.empty_like(S)
        for mine, part in parts:
            new[:, mine] = part
        return new


class _Group:
    """Steps of similar length: one, or the nodes between which the others are interpolated."""

    def __init__(self, steps: Sequence[Advance], weights: Array, nx: int) -> None:
        self.weights = weights
        self.now = np.stack([s.now for s in steps])
        self.Ad = np.ascontiguousarray(self.now[:, :, :nx])
        self.gain = np.stack([s.gain for s in steps])
        self.drive, self.delay, self.gain_drive = (
            np.concatenate([getattr(s, name) for s in steps], axis=1)
            for name in ("drive", "delay", "gain_drive")
        )

    def apply(self, M: Array, V: Array, kind: np.ndarray) -> Array:
        """Rows of V through the matrices M (m, rows, columns) of their steps."""
        if len(M) == 1:
            return np.asarray(V @ M[0].T)
        parts = (V @ M.reshape(-1, M.shape[2]).T).reshape(len(V), *M.shape[:2])
        return np.asarray(np.einsum("nm,nmr->nr", self.weights[kind], parts))

    def carry(self, M: Array, S: Array, kind: np.ndarray) -> Array:
        """Columns of S (columns, n, ns) through the matrices of their steps."""
        if len(M) == 1:
            return np.asarray((M[0] @ S.reshape(len(S), -1)).reshape(-1, *S.shape[1:]))
        mine = np.tensordot(self.weights[kind], M, axes=1)
        return np.asarray((mine @ S.transpose(1, 0, 2)).transpose(1, 0, 2))

    def spread(self, drive: Array, V: Array, kind: np.ndarray) -> Array:
        """What V does to every column: (rows, n, nf) by a drive (rows, m columns, nf)."""
        if self.weights.shape[1] > 1:
            V = (self.weights[kind][:, :, None] * V[:, None, :]).reshape(len(V), -1)
        return np.asarray(V @ drive)


def groups(number: np.ndarray, kinds: int) -> Iterator[tuple[int, Any]]:
    """Each number that occurs, with where it does."""
    if kinds == 1 or (number == number[0]).all():
        yield int(number[0]), slice(None)
    else:
        for i in np.unique(number):
            yield int(i), np.flatnonzero(number == i)


def _octaves(classes: Sequence[tuple[float, Hold]]) -> Iterator[list[int]]:
    """Classes that share one group: alone, or all of a hold within a factor of two if many."""
    bins: dict[tuple[int, Hold], list[int]] = {}
    for i, (h, hold) in enumerate(classes):
        bins.setdefault((int(np.round(np.log2(h))), hold), []).append(i)
    for members in bins.values():
        if len(members) >= MANY:
            yield members
        else:
            yield from ([i] for i in members)


def _nodes(h: Array, A: Array) -> tuple[Array, Array]:
    """Interpolation nodes for steps h, and the weights of each step's map, (len(h), m)."""
    middle, half = (h.max() + h.min()) / 2, (h.max() - h.min()) / 2
    if half == 0:
        return h[:1], np.ones((len(h), 1))
    rho = max(float(np.linalg.norm(A, 2)) * half, 1e-3)
    m = 4
    while (np.e * rho / (2 * m)) ** m > EXACT:  # Chebyshev coefficients of an exponential
        m += 1
    angle = (2 * np.arange(m) + 1) * np.pi / (2 * m)
    nodes, factor = np.cos(angle), np.sin(angle) * (-1.0) ** np.arange(m)
    gap = ((h - middle) / half)[:, None] - nodes
    on_node = gap == 0
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = factor / gap  # barycentric formula
        weights = parts / parts.sum(axis=1, keepdims=True)
    hit = on_node.any(axis=1)
    weights[hit] = on_node[hit]
    return middle + half * nodes, weights
