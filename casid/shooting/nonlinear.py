"""Residuals of a nonlinear structure over all shooting intervals, and their derivatives.

    x_{k+1} = Φ(x_k, u; λ)            r_k = h(x_k, u(t_k - τ); λ) + b - y_k

Φ is the classical Runge-Kutta method of fourth order, in the steps and with the inputs of
`casid.shooting.runge_kutta_inputs`. The states known, ∂Φ/∂x and ∂Φ/∂λ come of the derivatives of f
at the stages, for many samples at once; S⁺ = (∂Φ/∂x) S + ∂Φ/∂λ is exact for the discrete states, so
that the cost and its gradient belong to each other whatever the step.
"""

import copy
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from casid.arrays import Array, BoolArray
from casid.free import Free
from casid.intersample import ORDER
from casid.nonlinear.coverage import reached
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.switches import passages, told
from casid.record import Record
from casid.shooting.flow import STAGES, Flow, Slopes, weights
from casid.shooting.intervals import Layout
from casid.shooting.runge_kutta_inputs import Stages, stage_inputs
from casid.shooting.sensitivity import Evaluator, Motion, Point, Sweep, counts
from casid.shooting.stiffness import first_steps
from casid.shooting.unknowns import FilterMatrices
from casid.values import storable

PIECE = 128  # samples whose derivatives are advanced at once
KEPT_BYTES = 256e6  # of derivatives by λ kept for a second pass


@storable
@dataclass(frozen=True, kw_only=True)
class Integration:
    """How a nonlinear structure was integrated.

    Parameters
    ----------
    steps : int
        Runge-Kutta steps a sampling interval, of which some may be cut at breaks of the inputs.
    shift : float
        By how many standard deviations the estimate that is moved most would move, were the steps
        half as long.
    moved : str
        Its name.
    widened : float
        By what share of itself the standard deviation that changes most would change then: where
        the method comes close to diverging it is the method that holds an estimate, not the data.
    """

    steps: int
    shift: float
    moved: str
    widened: float = 0.0


@dataclass(frozen=True, eq=False)
class Track(Motion):
    """A simulation with the states at the beginning of every step within the samples'."""

    inner: Array  # (N, S, nx); what `Stages.count` leaves out is not set


class NonlinearEvaluator(Evaluator):
    """Residuals and Gauss-Newton blocks of a nonlinear structure over one layout."""

    smoothings = 4

    def __init__(self, free: Free, layout: Layout, substeps: int | None = None) -> None:
        self.flow, self.model = Flow(free), cast("NonlinearModel", free.model)
        super().__init__(free, layout)
        self._full = free.full
        self.lengths = layout.classes[layout.step]
        self.whole = substeps or first_steps(self, free.guess)
        self.shares = 1
        self._stages: tuple[bytes, Stages] | None = None

    @property
    def direct(self) -> BoolArray:
        """See `Evaluator.direct`: of the equations, of which the reference is but one point."""
        return self.flow.direct

    @property
    def substeps(self) -> int:
        """Steps a sampling interval, but for those cut at breaks of the inputs."""
        return self.whole * self.shares

    def finer(self, factor: int) -> "NonlinearEvaluator":
        """The same with so many times the steps."""
        other = copy.copy(self)
        other.shares, other._stages = self.shares * factor, None
        return other

    def within(self, delays: Array | None) -> "NonlinearEvaluator":
        """See `Evaluator.within`."""
        other = super().within(delays)
        other._stages = None
        return other

    def stages(self, m: FilterMatrices) -> Stages:
        """Steps within the sampling intervals, and inputs at their stages."""
        key = m.tau.tobytes() + m.tau_lam.tobytes()
        if self._stages is None or self._stages[0] != key:
            records, cut = self.layout.records, self.flow.cut
            holds = [record.hold for record in records]
            steps = self.whole, self.shares
            found = stage_inputs(self.held(m), holds, self.lengths, steps, cut, m.tau_lam)
            self._clip(found.u, cut)
            self._stages = key, found
        return self._stages[1]

    def inputs(self, m: FilterMatrices) -> Array:
        """Delayed inputs (N, nu) at the samples."""
        u = np.concatenate([part.value for part in self.held(m)])
        self._clip(u, ORDER)
        return u

    def _clip(self, u: Array, holds: Collection[str]) -> None:
        """Keep what is computed of inputs from leaving the range of the record's by roundings."""
        first = 0
        for record in self.layout.records:
            mine = u[first : first + record.N]
            if record.hold in holds:
                np.clip(mine, record.u.min(axis=0), record.u.max(axis=0), out=mine)
            first += record.N

    def advance(
        self, stages: Stages, at: np.ndarray, x: Array, lam: Array, inner: Array | None = None
    ) -> Array:
        """States (n, nx) one sample on from those at samples; ``inner`` of a `Track` is filled."""
        u, (_, S), count = stages.u.reshape(*stages.eta.shape, -1), stages.eta.shape, None
        for s in range(S):
            some: Any = slice(None)
            if s >= stages.least:
                count = stages.count[at] if count is None else count
                some = np.flatnonzero(count > s)
                if not len(some):
                    break
            here, before = at[some], x[some]
            if inner is not None:
                inner[here, s] = before
            after = self.flow.step(before, u[here, s], stages.eta[here, s], lam)
            if s < stages.least:
                x = after
            else:
                x[some] = after
        return x

    def simulate(self, point: Point) -> Track:
        """States and residuals over all intervals."""
        layout, m = self.layout, self.matrices(point.lam)
        stages = self.stages(m)
        inner = np.empty((*stages.eta.shape, self.nx))
        ends = np.empty((len(layout.count), self.nx))
        x, active = point.nodes[layout.node], counts(layout.count)
        for k, n in enumerate(active):
            x = self.advance(stages, layout.start[:n] + k, x[:n], point.lam, inner)
            if k + 1 == len(active) or active[k + 1] < n:
                done = layout.count[:n] == k + 1
                ends[:n][done] = x[done]
        bias = np.repeat(point.bias, [record.N for record in layout.records], axis=0)
        r = self.flow.output(inner[:, 0], self.inputs(m), point.lam) + bias - layout.y
        return Track(inner[:, 0], r * layout.patterns[layout.pattern], ends, inner)

    def along(self, point: Point, x: Array) -> Track:
        """The motion whose states at the samples (N, nx) are known, as they are; no residuals."""
        inner = np.zeros((*(stages := self.stages(self.matrices(point.lam))).eta.shape, self.nx))
        after = self.advance(stages, np.arange(len(x)), x.copy(), point.lam, inner)
        ends = after[self.layout.start + self.layout.count - 1]
        return Track(inner[:, 0], np.zeros_like(self.layout.y), ends, inner)

    def sweep(self, point: Point, motion: Motion, W: Array) -> "NonlinearSweep":
        """What turns a simulation into rows of the Jacobian."""
        return NonlinearSweep(self, point, cast("Track", motion), W)

    def resting(self) -> Array:
        """Nodes (J, nx) to start from: measured states, else the trim's, else the reference."""
        first = np.empty(len(self.layout.count), dtype=int)
        first[self.layout.node] = self.layout.start
        return self.flown(first)

    def flown(self, rows: np.ndarray) -> Array:
        """States (n, nx) at samples: measured ones, else the trim's, else the reference's."""
        layout, model = self.layout, self.model
        x = np.tile(model.operating_point()[0], (len(rows), 1))
        edges = np.cumsum([0, *(record.N for record in layout.records)])
        for i, name in enumerate(model.states):
            for record, begin in zip(layout.records, edges, strict=False):
                inside = (rows >= begin) & (rows < begin + record.N)
                if (y := _measured(record, name)) is not None:
                    x[inside, i] = y[rows[inside] - begin]
                elif name in record.trim:
                    x[inside, i] = record.trim[name]
        return x

    def covered(self, point: Point) -> dict[str, tuple[float, float]]:
        """See `Evaluator.covered`."""
        u = np.concatenate([record.u for record in self.layout.records])
        return reached(
            self.model.with_vector(self._full(point.lam)), self.simulate(point).states, u
        )

    def jumps(self, point: Point, motion: Motion | None = None) -> str:
        """What is said of jumps that records pass in a motion, else from a point; "" of none."""
        edges = np.cumsum([record.N for record in self.layout.records])[:-1]
        m = self.matrices(point.lam)
        x, u = (motion or self.simulate(point)).states, self.inputs(m)
        pairs = zip(np.split(x, edges), np.split(u, edges), strict=True)
        flights = [(x[known], u[known]) for x, u in pairs if (known := np.isfinite(x).all(1)).any()]
        lines = any(record.hold == "foh" for record in self.layout.records)
        late = np.array(self.model.inputs)[lines & m.tau_lam.any(axis=1)].tolist()
        return told(passages(self.model.with_vector(self._full(point.lam)), flights, late))

    def lost(self, point: Point) -> str:
        """Where equations first have no value in a simulation from a point; "" if all have."""
        x = self.simulate(point).states
        u = self.inputs(self.matrices(point.lam))
        f = self.flow.f(x, u, point.lam)[0]
        rows, columns = np.nonzero(~np.isfinite(f) & np.isfinite(x).all(axis=1, keepdims=True))
        if not len(rows):
            return ""
        first, model, records = int(rows[0]), self.model, self.layout.records
        edges = np.cumsum([0, *(record.N for record in records)])
        number = int(np.searchsorted(edges, first, side="right")) - 1
        record, time = records[number], records[number].t[first - edges[number]]
        named = zip((*model.states, *model.inputs), (*x[first], *u[first]), strict=True)
        return (
            f": d{model.states[columns[0]]}/dt is no number in record {record.name!r} at "
            f"{time:.4g} s, where {', '.join(f'{name} = {value:.4g}' for name, value in named)} "
            "(write an equation that has a value there, or cut the record)"
        )

    def level(self) -> tuple[Array, Array]:
        """Inputs (nu,) and outputs (ny,) from which their sizes are counted: their means."""
        u, y = (np.concatenate([getattr(r, n) for r in self.layout.records]) for n in "uy")
        return u.mean(axis=0), np.nanmean(y, axis=0)


def _measured(record: Record, name: str) -> Array | None:
    """A state measured as the output of its name, at all samples; None if it is not."""
    if name not in record.outputs:
        return None
    y, known = record.channel(name), np.isfinite(record.channel(name))
    return np.interp(record.t, record.t[known], y[known]) if known.any() else None


class NonlinearSweep(Sweep):
    """`Sweep` of a nonlinear structure."""

    e: NonlinearEvaluator

    def __init__(
        self, evaluator: NonlinearEvaluator, point: Point, motion: Track, W: Array
    ) -> None:
        self.e, self.layout, self.motion, self.W = evaluator, evaluator.layout, motion, W
        self.kind, self.gains = evaluator.layout.pattern, None
        self._track, self._flow, self._lam = motion, evaluator.flow, point.lam
        self.matrices = m = evaluator.matrices(point.lam)
        self.ns = evaluator.nf + evaluator.nx
        self.apart = not np.any(W * (1 - np.eye(evaluator.ny)))
        self._stages, self._value = evaluator.stages(m), evaluator.inputs(m)
        self._slope = np.concatenate([part.slope for part in evaluator.held(m)])
        self._delayed = np.flatnonzero(m.tau_lam.any(axis=0))
        self._tau = m.tau_lam[:, self._delayed]
        self._moves = np.vstack([self._tau, np.zeros((1, len(self._delayed)))])  # the last: -1
        N, nx, nf = len(evaluator.layout.y), evaluator.nx, evaluator.nf
        self.by_x: Array = np.empty((N, nx, nx))  # of the steps from the samples passed
        self._kept: dict[bytes, tuple[Array, Array]] = {}
        self._room = KEPT_BYTES
        self._F: Array = np.zeros((PIECE, len(STAGES), nx, nf))  # other entries stay zero

    def _block(self, at: np.ndarray, S: Array) -> Array:
        """Sensitivities before each of K samples and after the last, (K + 1, nx, n, ns)."""
        (K, n), nx, nf = at.shape, self.e.nx, self.e.nf
        by_x, by_lam = self._transitions(at.ravel())
        by_x, by_lam = by_x.reshape(K, n, nx, nx), by_lam.reshape(K, n, nx, nf)
        trail = np.empty((K + 1, n, nx, S.shape[2]))
        trail[0] = S.transpose(1, 0, 2)
        for k in range(K):
            np.matmul(by_x[k], trail[k], out=trail[k + 1])
            trail[k + 1][:, :, :nf] += by_lam[k]
        return trail.transpose(0, 2, 1, 3)

    def _transitions(self, flat: np.ndarray) -> tuple[Array, Array]:
        """∂Φ/∂x (n, nx, nx) and ∂Φ/∂λ (n, nx, nf) of the steps from samples."""
        key = flat.tobytes()
        if key in self._kept:
            return self._kept[key]
        n, nx, nf = len(flat), self.e.nx, self.e.nf
        by_x: Array = np.empty((n, nx, nx))
        by_lam: Array = np.empty((n, nx, nf))
        for first in range(0, n, PIECE):
            piece = slice(first, first + PIECE)
            by_x[piece], by_lam[piece] = self.advanced(flat[piece])
        self.by_x[flat] = by_x
        self._room -= by_lam.nbytes
        if self._room > 0:
            self._kept[key] = by_x, by_lam
        return by_x, by_lam

    def advanced(self, flat: np.ndarray) -> tuple[Array, Array]:
        """Derivatives (n, nx, nx) by the states before and (n, nx, nf) by λ of those one sample on.

        At most `PIECE` samples at once.
        """
        count = self._stages.count[flat]
        by_x, by_lam = self._across(flat, 0)
        for s in range(1, int(count.max())):
            mine = np.flatnonzero(count > s)
            own, moved = self._across(flat[mine], s)
            by_x[mine], by_lam[mine] = own @ by_x[mine], own @ by_lam[mine] + moved
        return by_x, by_lam

    def _across(self, flat: np.ndarray, s: int) -> tuple[Array, Array]:
        """The same of one step.

        With slopes A_i, F_i of f by x and λ at the stages, at c_i after a step's beginning, those
        of a step of length η are I + η Σ M_i A_i and η Σ M_i F_i, where
        M_i = w_i I + c_{i+1} M_{i+1} η A_{i+1}, and that by η is Σ M_i f_i.
        """
        nx, nf, n, stages = self.e.nx, self.e.nf, len(flat), self._stages
        A, F, f = np.empty((n, len(STAGES), nx, nx)), self._F[:n], np.empty((n, len(STAGES), nx))
        h, x = stages.eta[flat, s, None, None], self._track.inner[flat, s]
        part, step = divmod(s, len(stages.share) - 1)
        ends = stages.mover[flat, part : part + 2]
        share, length = stages.share[step], stages.share[step + 1] - stages.share[step]
        moving: tuple[Array, Array] | None = None
        if (ends >= 0).any():
            begin, end = self._moves[ends.T]
            moving = begin + share * (end - begin), length * (end - begin)
        k = np.zeros_like(x)
        for i, (stage, ahead, _) in enumerate(STAGES):
            u, late = stages.u[flat, s, stage], stages.late[flat, s, stage]
            k, A[:, i], f_u, f_lam = self._flow.f(x + ahead * h[:, 0] * k, u, self._lam)
            f[:, i] = k
            F[:, i, :, self._delayed] = 0.0
            self._flow.f.lam.put(F[:, i], f_lam)
            place = moving[0] + ahead * moving[1] if moving else None
            self._add_delays(F[:, i], f_u, late, place)
        A *= h[..., None]
        M = weights(A)
        own, moved = M @ A.reshape(n, -1, nx) + np.eye(nx), h * (M @ F.reshape(n, -1, nf))
        if moving:
            moved[:, :, self._delayed] += (M @ f.reshape(n, -1, 1)) * moving[1][:, None]
        return own, moved

    def _add_delays(
        self, target: Array, by_u: Array, late: Array, place: Array | None = None
    ) -> None:
        """Add what the delays do to derivatives (n, m, nf or more), by f_u or h_u (n, m, nu).

        Inputs change by ``late`` (n, nu) as they come later, and back where one sees them at a
        place that moves by λ (n, those by which inputs are delayed), too.
        """
        if len(self._delayed):
            finite = np.where(np.isfinite(by_u), by_u, 0.0)  # infinite: a root's, at one instant
            moved = (by_tau := finite * late[:, None]) @ self._tau
            if place is not None:
                moved -= by_tau.sum(axis=2)[..., None] * place[:, None]
            target[:, :, self._delayed] += moved

    def slopes(self, function: Slopes) -> tuple[Array, Array]:
        """Derivatives of f or h by x (N, m, nx) and u (N, m, nu) at the samples."""
        return function(self.motion.states, self._value, self._lam)[1:3]

    def second(self, flat: np.ndarray, p: Array, rho: Array) -> list[Array]:
        """`Bend` at samples, of pᵀf + ρᵀh, but for what is infinite, as of the root of zero."""
        x, u, rate = (part[flat] for part in (self.motion.states, self._value, self._slope))
        found = self._flow.bend(x, u, rate, p, rho, self._lam, self.matrices.tau)
        return [np.nan_to_num(part, nan=0.0, posinf=0.0, neginf=0.0) for part in found]

    def rows(self, at: np.ndarray, S: Array) -> Array:
        """Whitened Jacobian rows and residuals of K samples, (n, K, ny, nc)."""
        e, (K, n), flat = self.e, at.shape, at.ravel()
        _, h_x, h_u, h_lam = self._flow.h(self.motion.states[flat], self._value[flat], self._lam)
        through = h_x @ S.transpose(0, 2, 1, 3).reshape(K * n, e.nx, -1)
        self._flow.h.lam.add(through, h_lam)
        self._add_delays(through, h_u, -self._slope[flat])
        out = np.empty((n, K, e.ny, self.ns + e.ny + 1))
        out[..., self.ns : -1] = np.eye(e.ny)
        out[..., : self.ns] = through.reshape(K, n, e.ny, -1).transpose(1, 0, 2, 3)
        out[..., -1] = self.motion.residuals[at.T]
        return self._whitened(out, at)
