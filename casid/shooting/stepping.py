"""How states and their derivatives advance by one sample, for every sampling interval there is.

    x_{k+1} = A_d x_k + [P_1 B, P_2 B, P_p b_j ...] V_k - K_d r_k,    V = (value, slope, jumps)

are the maps of `casid.intersample`: value and slope of the delayed inputs at the sample, and the
jumps at the breaks within the step. Where the delays enter the maps, V moves with them too; as the
derivative of the whole by τ is linear in the same V, one array of derivatives holds both.

A handful of distinct intervals gets a map each, and so do breaks by their distance from the next
sample. Where the sampling is irregular the map is a smooth function of that time, and so are its
derivatives: they are interpolated between Chebyshev nodes, exact to rounding since exp(A h) is
entire, and no exponential is computed per sample.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from casid.arrays import Array
from casid.assembly import by_number
from casid.intersample import ORDER, DelayedInput, distinct, integral_slopes
from casid.record import Hold
from casid.shooting.gains import Gains
from casid.shooting.intervals import Layout
from casid.shooting.unknowns import FilterMatrices

Slopes: TypeAlias = tuple[Array, Array]  # a value and its derivative

AT_ONCE = 8  # steps that one product makes
MANY = 8  # distinct intervals within a factor of two that are worth interpolating
EXACT = 1e-15  # interpolation error, relative
SHORT = 2.0**-8  # of the longest: intervals below are interpolated down to zero


@dataclass(frozen=True, eq=False)
class Breaks:
    """The breaks of delayed inputs in columns, for all samples."""

    jumps: Array  # (N, n) changes in the step after each sample, spread over the columns
    channel: np.ndarray  # (n,) input of every column
    order: np.ndarray  # (n,) the p of its P_p
    rest: Array  # (n,) time left until the next sample [s]; of irregular records, a node


def collect_breaks(held: Sequence[DelayedInput], holds: Sequence[Hold], A: Array) -> Breaks:
    """The breaks of all records; where they are irregular A (nx, nx) sets the number of nodes."""
    columns: dict[tuple[int, int, float], int] = {}
    entries: list[tuple[slice, np.ndarray, np.ndarray, Array]] = []
    first = 0
    for record, hold in zip(held, holds, strict=True):
        live, samples = np.flatnonzero(record.jump), slice(first, first + len(record.value))
        for mine in np.split(live, np.flatnonzero(np.diff(record.channel[live])) + 1):
            rest, place = distinct(record.rest[mine], record.instant)
            for members in octaves(rest):
                nodes, weights = interpolation(rest[members], A)
                keys = [
                    (record.channel[mine[0]], ORDER[hold], round(r, 14)) for r in nodes.tolist()
                ]
                number = np.array([columns.setdefault(key, len(columns)) for key in keys])
                row = np.full(len(rest), -1)
                row[members] = np.arange(len(members))
                here = np.flatnonzero(row[place] >= 0)
                share = weights[row[place[here]]]
                jump = record.jump[mine[here], None] * share
                entries.append((samples, record.step[mine[here]], number, jump))
        first = samples.stop
    by_column = np.zeros((len(columns), first))
    for samples, step, number, share in entries:
        for n, part in zip(number, share.T, strict=True):
            by_column[n, samples] += np.bincount(step, part, samples.stop - samples.start)
    jumps = np.ascontiguousarray(by_column.T)
    channel, order, rest = np.array(list(columns), dtype=float).reshape(-1, 3).T
    return Breaks(jumps, channel.astype(int), order.astype(int), rest)


def propagated(
    Ad: Array, forcing: Array, x: Array, start: np.ndarray, count: np.ndarray
) -> tuple[Array, Array]:
    """States (N, nx) at the samples of intervals from nodes x (J, nx), and at their ends.

    Of steps alike, x_{k+1} = A_d x_k + f_k with f (N, nx), the longest intervals first: a product
    makes several steps of all.
    """
    nx, states, ends = len(Ad), np.empty_like(forcing), np.empty_like(x)
    maps = np.zeros((1 + AT_ONCE, nx, AT_ONCE, nx))  # of state and forcings to the states ahead
    power = np.eye(nx)
    for k in range(AT_ONCE):
        for later in range(k, AT_ONCE):
            maps[1 + later - k, :, later] = power.T
        power = Ad @ power
        maps[0, :, k] = power.T
    for first in range(0, int(count[0]), AT_ONCE):
        n = int((count > first).sum())
        left, ahead = count[:n, None] - first, np.arange(AT_ONCE)
        at = start[:n, None] + first + np.minimum(ahead, left - 1)
        driven = np.hstack([x[:n], forcing[at].reshape(n, -1)])
        after = (driven @ maps.reshape(-1, AT_ONCE * nx)).reshape(n, AT_ONCE, nx)
        along = np.concatenate([x[:n, None], after], axis=1)
        within = ahead < left
        states[at[within]] = along[:, :-1][within]
        ending = np.flatnonzero(left <= AT_ONCE)
        ends[ending] = along[ending, left[ending, 0]]
        x = after[:, -1]
    return states, ends


class Steps:
    """The steps of all sampling intervals of a layout at one parameter set.

    ``held`` are the inputs of every record with their ``breaks``, ``filtering`` says whether
    innovations drive the states, by ``gains`` if those change from sample to sample.
    """

    def __init__(
        self,
        matrices: FilterMatrices,
        layout: Layout,
        held: Sequence[DelayedInput],
        breaks: Breaks,
        filtering: bool,
        gains: Gains | None = None,
    ) -> None:
        self.nx, self.filtering, self._gains = len(matrices.A), filtering, gains
        self.inputs = np.hstack(
            [np.concatenate([getattr(part, name) for part in held]) for name in ("value", "slope")]
        )
        self._breaks = breaks
        members = list(octaves(layout.classes))
        tables = [interpolation(layout.classes[each], matrices.A) for each in members]
        self._group_of = np.empty(len(layout.classes), dtype=int)
        for g, each in enumerate(members):
            self._group_of[each] = g
        where, edges = self._group_of[layout.step], np.cumsum([0, *(len(h) for h, _ in tables)])
        times = np.concatenate([*(h for h, _ in tables), self._breaks.rest])
        self._maps = maps = _Maps(matrices, times)
        jump = maps.jump(self._breaks, int(edges[-1]))
        self._groups: list[_Group] = []
        for g, (each, (_, share)) in enumerate(zip(members, tables, strict=True)):
            mine = slice(None) if len(members) == 1 else where == g
            weights = np.zeros((len(layout.classes), share.shape[1]))
            weights[each] = share
            columns = np.flatnonzero(self._breaks.jumps[mine].any(axis=0))
            nodes = slice(edges[g], edges[g + 1])
            self._groups.append(_Group(maps, nodes, weights, columns, jump))
        self._step = layout.step

    def forcing(self) -> Array:
        """What the inputs add to the states (N, nx) over each step."""
        new = np.empty((len(self.inputs), self.nx))
        for group, mine, kind in self._parts(self._step):
            new[mine] = group.apply(group.G, self.inputs[mine], kind)
            new[mine] += self._breaks.jumps[mine][:, group.columns] @ group.jump.T
        return new

    def state(self, at: np.ndarray, x: Array, forced: Array, r: Array | None) -> Array:
        """States (n, nx) one step on from samples, r the residuals of a filter."""
        new = forced.copy()
        for group, mine, kind in self._parts(self._step[at]):
            new[mine] += group.apply(group.Ad, x[mine], kind)
            if r is not None and self._gains is None:
                new[mine] -= group.apply(group.gain, r[mine], kind)
        if r is not None and self._gains is not None:
            new -= self._gains.push(at, r)
        return new

    def back(self, step: np.ndarray, p: Array) -> Array:
        """Costates (n, nx) one step before, A_dᵀ p."""
        new = np.empty_like(p)
        for group, mine, kind in self._parts(step):
            new[mine] = group.apply(group.Ad.transpose(0, 2, 1), p[mine], kind)
        return new

    def force(self, at: np.ndarray, x: Array, r: Array) -> Array:
        """What drives the derivatives of the states over the steps from samples, (nx, rows, nf)."""
        V, jumps = np.concatenate([x, self.inputs[at]], axis=1), self._breaks.jumps[at]
        parts: list[tuple[Any, Array]] = []
        for group, mine, kind in self._parts(self._step[at]):
            part = group.spread(group.drive, V[mine], kind, jumps[mine][:, group.columns])
            if self.filtering and self._gains is None:
                part -= group.spread(group.gain_drive, r[mine], kind, None)
            parts.append((mine, part))
        driven = _joined(parts, len(at))
        return driven if self._gains is None else driven - self._gains.force(at, r)

    def carry(self, at: np.ndarray, S: Array, heard: Array | None) -> Array:
        """Derivatives (nx, n, ns) of the states, and ``heard`` of the residuals, one step on."""
        parts: list[tuple[Any, Array]] = []
        for group, mine, kind in self._parts(self._step[at]):
            part = group.carry(group.Ad, S[:, mine], kind)
            if heard is not None and self._gains is None:
                part -= group.carry(group.gain, heard[:, mine], kind)
            parts.append((mine, part))
        new = _joined(parts, len(at))
        if heard is not None and self._gains is not None:
            new -= self._gains.carry(at, heard)
        return new

    def uniform(self) -> tuple[Array, Array, Array]:
        """What carries states (nx, nx) and drives derivatives (nx, columns, nf) over all steps.

        Of steps of one length; the columns are states, inputs and the third, jumps (N, n).
        """
        (group,) = self._groups
        jumps = self._breaks.jumps
        every = len(group.columns) == jumps.shape[1]
        return group.Ad[0], group.drive, jumps if every else jumps[:, group.columns]

    def delay_moments(self, p: Array) -> tuple[Array, Array]:
        """Second derivatives of Σ_k p_kᵀ x_{k+1} by the delays (nu,), and by delays and B (nx, nu).

        p (N, nx) belongs to the state one step after each sample.
        """
        nu = self.inputs.shape[1] // 2
        bend, mixed = self._maps.bend(self._breaks, p.T @ self._breaks.jumps)
        for group, mine, kind in self._parts(self._step):
            for m, P1 in enumerate(group.P1):
                slope = self.inputs[mine, nu:] * group.weights[kind, m, None]
                mixed -= P1.T @ (p[mine].T @ slope)
        return bend, mixed

    def _parts(self, step: np.ndarray) -> Iterator[tuple["_Group", Any, np.ndarray]]:
        """Groups of steps that occur, the rows of theirs, and the class of each row."""
        for g, mine in by_number(self._group_of[step], len(self._groups)):
            yield self._groups[g], mine, step[mine]


class _Maps:
    """Maps over intervals of given lengths (n,), and their derivatives by the unknowns."""

    def __init__(self, matrices: FilterMatrices, times: Array) -> None:
        self.matrices = m = matrices
        self._nf = m.A_lam.shape[2]
        self._moving = np.flatnonzero(m.A_lam.any(axis=(0, 1)))
        self.P = integral_slopes(m.A, times, m.A_lam[:, :, self._moving])
        nx = len(m.A)
        self.E, self.E_lam = self.through(0, np.eye(nx), np.zeros((nx, nx, self._nf)))
        value, value_lam = self.through(1, m.B, m.B_lam)
        ramp, ramp_lam = self.through(2, m.B, m.B_lam)
        ramp_lam -= value[..., None] * m.tau_lam
        self.G = np.concatenate([value, ramp], axis=2)
        self.G_lam = np.concatenate([value_lam, ramp_lam], axis=2)
        self.gain, self.gain_lam = self.through(1, m.K, m.K_lam)

    def through(self, p: int, M: Array, M_lam: Array) -> tuple[Array, Array]:
        """P_p M (n, nx, k) and its derivative (n, nx, k, nf)."""
        P = self.P[p]
        slope = np.tensordot(P[..., 0], M_lam, axes=1)
        slope[..., self._moving] += np.moveaxis(np.moveaxis(P[..., 1:], 3, 2) @ M, 2, 3)
        return P[..., 0] @ M, slope

    def jump(self, breaks: Breaks, first: int) -> tuple[Array, Array]:
        """What a unit jump at each break (lengths from ``first`` on) does, (nx, n), and slopes."""
        m, c = self.matrices, breaks.channel
        self._ahead = self.P[:, first:]
        P, b = self._ahead[breaks.order, np.arange(len(c))], m.B[:, c]
        slope = np.einsum("cij,jca->ica", P[..., 0], m.B_lam[:, c])
        slope[..., self._moving] += np.einsum("cija,jc->ica", P[..., 1:], b)
        earlier = self._ahead[breaks.order - 1, np.arange(len(c)), :, :, 0]
        late = np.einsum("cij,jc->ic", earlier, b)
        slope -= late[..., None] * m.tau_lam[c]
        return np.einsum("cij,jc->ic", P[..., 0], b), slope

    def bend(self, breaks: Breaks, p: Array) -> tuple[Array, Array]:
        """See `Steps.delay_moments`, of the breaks; p (nx, columns) has their jumps in it."""
        m, c, number = self.matrices, breaks.channel, np.arange(len(breaks.channel))
        E = self._ahead[0, :, :, :, 0]
        twice = np.where((breaks.order == 2)[:, None, None], E, m.A @ E)
        earlier = self._ahead[breaks.order - 1, number, :, :, 0]
        bend, mixed = np.zeros(m.B.shape[1]), np.zeros_like(m.B)
        np.add.at(bend, c, np.einsum("ic,cij,jc->c", p, twice, m.B[:, c]))
        np.add.at(mixed.T, c, -np.einsum("ic,cij->cj", p, earlier))
        return bend, mixed


class _Group:
    """Steps of similar length: one, or the nodes between which the others are interpolated."""

    def __init__(
        self, maps: _Maps, nodes: slice, weights: Array, columns: np.ndarray, jump: Slopes
    ) -> None:
        self.weights, self.columns, self.jump = weights, columns, jump[0][:, columns]
        self.Ad, self.G, self.gain = maps.E[nodes], maps.G[nodes], maps.gain[nodes]
        self.P1 = maps.P[1, nodes, :, :, 0]
        drive = np.concatenate([maps.E_lam[nodes], maps.G_lam[nodes]], axis=2)
        self.drive = np.concatenate([_flat(drive), jump[1][:, columns]], axis=1)
        self.gain_drive = _flat(maps.gain_lam[nodes])

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

    def spread(self, drive: Array, V: Array, kind: np.ndarray, more: Array | None) -> Array:
        """What V, and ``more`` columns for all nodes alike, do: (rows, n, nf) by a drive."""
        if self.weights.shape[1] > 1:
            V = (self.weights[kind][:, :, None] * V[:, None, :]).reshape(len(V), -1)
        return np.asarray((V if more is None else np.hstack([V, more])) @ drive)


def _flat(drive: Array) -> Array:
    """(nodes, nx, columns, nf) as (nx, nodes x columns, nf)."""
    nodes, nx, columns, nf = drive.shape
    return drive.transpose(1, 0, 2, 3).reshape(nx, nodes * columns, nf)


def _joined(parts: Sequence[tuple[Any, Array]], n: int) -> Array:
    """Arrays (nx, rows, columns) of parts of n rows, put together."""
    if len(parts) == 1:
        return parts[0][1]
    new = np.empty((len(parts[0][1]), n, parts[0][1].shape[2]))
    for mine, part in parts:
        new[:, mine] = part
    return new


def octaves(h: Array) -> Iterator[np.ndarray]:
    """Intervals h (n,) that share one group: alone, or all within a factor of two if many."""
    if len(h) < MANY:
        yield from np.arange(len(h))[:, None]
        return
    longest = h.max(initial=1e-300)
    bins = np.round(np.log2(np.maximum(h, SHORT * longest)))
    for octave in np.unique(bins):
        members = np.flatnonzero(bins == octave)
        yield from [members] if len(members) >= MANY else members[:, None]


def interpolation(h: Array, A: Array) -> tuple[Array, Array]:
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
