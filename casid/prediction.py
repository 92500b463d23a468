"""What a model makes of a record's inputs: simulated over all of it, or predicted piece by piece.

The output is linear in what is not known of a record,

    y(t) = y_forced(t) + Φ(t) z + b,

so initial state and biases are one linear least-squares problem, outputs weighted by the inverse of
their standard deviations.

Growing modes would swamp the columns of Φ = C exp(A t), therefore the state is split (real Schur
form, Sylvester equation) into a part that runs forward from its value at the start of the record
and a fast growing part that runs backward from its value at the end.

A model that grows by more than a few e-folds over a record cannot be simulated from its first
state. It is judged by predictions instead: of pieces as long as a stated horizon, each from a state
that is estimated on the past before it and nothing else (`casid.filtering`). They begin after three
horizons; where most of what an output does lies before that, as soon as initial state and biases
can be told so well that their errors add less to the first piece than the noise that hides them: so
a manoeuvre flown early in a short record is predicted, and not the quiet flight after it alone.

Of a flight in closed loop more is known: a controller answers disturbances, therefore outputs stay
where they use to be, however fast the aircraft alone would leave, and move as they use to. Among
the disturbances that the filter allows for, those are likely ahead with which the inputs ahead keep
outputs about their means, within their covariances over all lags in the rest of the record: as in
the stable inversion of unstable systems (S. Devasia, D. Chen, B. Paden, "Nonlinear inversion-based
output tracking", IEEE Transactions on Automatic Control 41, 1996), inputs tell growing modes
backward.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from casid import filtering
from casid.arrays import Array, BoolArray
from casid.linear import StateSpace, Steps
from casid.record import Record
from casid.records import standard_deviations
from casid.samples import known_mean

RANK = 1e-10  # singular values below this share of the largest are directions without effect
DISTINCT = 1e-12  # the same of their squares, for directions that are counted
GROWTH = 10.0  # e-folds over a record that a simulation from its first state may grow
AHEAD = 0.1  # of a record: the horizon of predictions at most
FOLDS = 3.0  # e-folds that the least unstable model grows over the horizon at most
PAST = 3.0  # horizons before the first prediction at most
PER_UNKNOWN = 3.0  # measurements before it at least
INSTANTS = 10  # of a piece: where a controller keeps outputs, and apart what may begin earlier


@dataclass(frozen=True)
class PredictionPlan:
    """Horizon of the predictions of one record, and the samples at which they begin."""

    horizon: float  # [s], infinite for a simulation over all of it
    starts: tuple[int, ...] = ()  # samples at which predictions begin
    past: int = 0  # samples before the first
    closed_loop: bool = False  # whether inputs ahead answer what comes, and keep outputs bounded


@dataclass(frozen=True, eq=False)
class Prediction:
    """Outputs of a model over a record, NaN where it has none or nothing can be predicted yet."""

    y: Array  # (N, ny)
    x0: Array  # state at the first sample used
    b: Array  # (ny,) mean biases
    states: Array  # (N, nx)
    reached: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # if nonlinear
    taken: Array | None = None  # (ny,) degrees of freedom that x0 and b take, of a simulation

    def placed(self, columns: np.ndarray, ny: int) -> "Prediction":
        """Own outputs in columns of ny of a record's; -1 is none."""
        y, ours = np.full((len(self.y), ny), np.nan), columns >= 0
        b, taken = np.full(ny, np.nan), np.zeros(ny)
        own_taken = np.zeros(len(columns)) if self.taken is None else self.taken
        for place, own in zip((y.T, b, taken), (self.y.T, self.b, own_taken), strict=True):
            place[columns[ours]] = own[ours]
        return replace(self, y=y, b=b, taken=None if self.taken is None else taken)


def growth_rate(system: StateSpace) -> float:
    """Rate [1/s] of the fastest growing mode; 0 of a stable system."""
    poles = system.poles()
    if system.dt is None:
        return max(0.0, float(poles.real.max(initial=0.0)))
    return max(0.0, float(np.log(np.abs(poles).max(initial=1.0)) / system.dt))


def prediction_plan(
    systems: Sequence[StateSpace],
    record: Record,
    horizon: float | None,
    closed_loop: bool = False,
) -> PredictionPlan:
    """How far all of these models are predicted in a record.

    They are simulated if none grows too much over it, unless a horizon [s] is given. One horizon
    serves them all: the least unstable of those that grow too much sets it. ValueError: a horizon
    that leaves no past to estimate a state on, or no sample to predict.
    """
    length, pace = record.duration, record.dt
    fast = [rate for rate in map(growth_rate, systems) if rate * length > GROWTH]
    if horizon is None:
        horizon = min(AHEAD * length, FOLDS / min(fast)) if fast else np.inf
    if np.isinf(horizon):
        return PredictionPlan(np.inf, closed_loop=closed_loop)
    unknowns = max(each.nx for each in systems) + record.ny
    most = max(round(PAST * horizon / pace), int(PER_UNKNOWN * unknowns))
    ahead = int(horizon / pace + 1e-9)
    if ahead < 1:
        raise ValueError(
            f"record {record.name!r} has a sample every {pace:g} s, none within a horizon of "
            f"{horizon:g} s; give another horizon"
        )
    if most >= record.N - 1:
        raise ValueError(
            f"record {record.name!r} of {length:g} s is too short to predict {horizon:g} s ahead "
            f"from {most * pace:g} s of past; give another horizon"
        )
    least, last = int(PER_UNKNOWN * unknowns), min(most, record.N - 1 - ahead)
    early = range(least, last, max(ahead // INSTANTS, 1))
    past = most
    if np.greater(*movement(record, past + 1)).any():
        past = max(_settled(system, record, early, ahead, most) for system in systems)
    # The pieces that come later begin where they do after the longest past.
    starts = (past, *range(past + 1 + (most - past - 1) % ahead, record.N - 1, ahead))
    return PredictionPlan(horizon, starts, past, closed_loop)


def movement(record: Record, begin: int) -> tuple[Array, Array]:
    """Squared deviations of each output, (ny,), added up before a sample, and from it on."""
    before, after = (part - known_mean(part) for part in (record.y[:begin], record.y[begin:]))
    return np.nansum(before**2, axis=0), np.nansum(after**2, axis=0)


def _settled(system: StateSpace, record: Record, early: range, ahead: int, most: int) -> int:
    """The first of some samples, or the last, at which a model's state is told by the past."""
    try:
        follower = RecordPredictor(system, record, standard_deviations([record])[1])
    except ValueError as error:
        raise ValueError(f"record {record.name!r}: {error}") from error
    with np.errstate(over="ignore", invalid="ignore"):  # what runs away tells nothing
        told = zip(early, follower.known(early) if early else (), strict=True)
        return next((k for k, known in told if follower.is_told(known, k, ahead)), most)


def predict(
    system: StateSpace,
    record: Record,
    scale: Array,
    far: PredictionPlan,
    biased: Collection[str] | None = None,
) -> Prediction:
    """Outputs of a model over a record; ``scale`` (ny,) weighs them, the intervals must agree.

    Every output has a bias, unless it is said which are ``biased``.
    """
    follower = RecordPredictor(system, record, scale, biased)
    if np.isinf(far.horizon):
        states, bias, taken = follower.estimate()
        y = follower.outputs(states, 0) + bias
        found = Prediction(y, states[0], bias, states, taken=taken)
    else:
        found = follower.pieces(far)
    return found.placed(np.array(follower.shared), record.ny)


def which_biased(outputs: Sequence[str], biased: Collection[str] | None) -> BoolArray:
    """Which outputs (ny,) have a bias: all, unless it is said which."""
    return np.array([biased is None or name in biased for name in outputs], dtype=bool)


class RecordPredictor:
    """Estimates and continues the state of one model, linear unless derived, along one record."""

    origin: Array  # (nx,) state that the filters count from
    steps: Steps
    C: Array  # (N, ny, nx)
    biased: BoolArray  # (ny,) outputs with a bias

    def __init__(
        self,
        system: StateSpace,
        record: Record,
        scale: Array,
        biased: Collection[str] | None = None,
    ) -> None:
        self.shared = [i for i, name in enumerate(record.outputs) if name in system.outputs]
        rows = [system.outputs.index(record.outputs[i]) for i in self.shared]
        u = record.u[:, [record.inputs.index(channel) for channel in system.inputs]]
        self.system, self.steps = system, system.steps(record.t, u, record.hold)
        self.steps = replace(self.steps, direct=self.steps.direct[:, rows])
        self.C = np.broadcast_to(system.C[rows], (record.N, len(rows), system.nx))
        self.origin = np.zeros(system.nx)
        self.t, self.y, self.scale = record.t, record.y[:, self.shared], scale[self.shared]
        self.biased = which_biased([record.outputs[i] for i in self.shared], biased)

    def pieces(self, far: PredictionPlan) -> Prediction:
        """Predictions from each start to the next, each from what is known there."""
        starts = far.starts
        N, ny, nx = self.C.shape
        y, states = np.full((N, ny), np.nan), np.full((N, nx), np.nan)
        biases, first = [], np.zeros(0)
        ends = (*starts[1:], N - 1)
        for start, end, known in zip(starts, ends, self.known(starts), strict=True):
            path = self.forward(self.origin + known.x, start, end)
            if far.closed_loop:
                path = self._bounded(path, start, known)
            ahead = slice(start + 1, end + 1)
            states[ahead], y[ahead] = path[1:], self.outputs(path, start)[1:] + known.bias
            biases.append(known.bias)
            first = first if len(first) else self.origin + known.likeliest[1][1 : 1 + nx]
        return Prediction(y, first, np.mean(biases, axis=0), states)

    def outputs(self, x: Array, begin: int) -> Array:
        """Outputs without biases of states (n, nx) from a sample on."""
        return np.asarray(x @ self.C[0].T + self.steps.direct[begin : begin + len(x)])

    def forward(self, x: Array, begin: int, end: int) -> Array:
        """States from one sample to another."""
        found = [x]
        for k in range(begin, end):
            found.append(self.steps.maps[self.steps.which[k]] @ found[-1] + self.steps.forcing[k])
        return np.array(found)

    def is_told(self, known: filtering.FilterState, begin: int, ahead: int) -> bool:
        """Whether what noise hides of the record's beginning adds less to a piece than noise."""
        # Whatever is measured, so that no model puts off the manoeuvre that it does not explain.
        (ny, nx), added, P = self.C.shape[1:], 0.0, known.unsettled
        M = np.eye(nx)
        for k in range(begin, begin + ahead):
            M = self.steps.maps[self.steps.which[k]] @ M
            felt = np.hstack([self.C[k + 1] @ M, np.eye(ny)])
            added = added + np.einsum("ij,jk,ik->i", felt, P, felt)
        return bool((added <= ahead * known.r).all())

    def _bounded(self, path: Array, begin: int, known: filtering.FilterState) -> Array:
        """States of a piece, outputs at instants of it being about their means as elsewhere."""
        # A smoother's, to which these are measurements with errors correlated in time.
        (n, nx), level = path.shape, known.likeliest[0]
        at = np.unique(np.linspace(0, n - 1, INSTANTS + 1).round().astype(int)[1:])
        some, mean, usual = self._usual(begin, n, at)
        C, unit = self.C[begin + at][:, some], np.diff(self.t) / np.median(np.diff(self.t))
        maps = [self.steps.maps[self.steps.which[k]] for k in range(begin, begin + n - 1)]
        P = [known.P[level]]
        for k, A in enumerate(maps, begin):
            P.append(A @ P[-1] @ A.T + unit[k] * known.Q[level])
        W = np.zeros((len(at), n, nx, C.shape[1]))  # covariances of states with these outputs
        for row, j, Cj in zip(W, at, C, strict=True):
            felt = Cj.T
            row[j] = P[j] @ felt
            for k in range(j - 1, -1, -1):
                felt = maps[k].T @ felt
                row[k] = P[k] @ felt
            for k in range(j, n - 1):
                row[k + 1] = maps[k] @ row[k]
        S = np.einsum("ioy,jiyp->iojp", C, W[:, at]).reshape(usual.shape) + usual
        S += np.diag(np.tile(known.r[some], len(at)))
        away = (self.outputs(path, begin)[at] + known.bias)[:, some] - mean
        gain = np.linalg.solve(S, away.ravel()).reshape(away.shape)
        return np.asarray(path - np.einsum("jkyp,jp->ky", W, gain))

    def _usual(self, begin: int, n: int, at: NDArray[np.intp]) -> tuple[BoolArray, Array, Array]:
        """Outputs seen, their means and covariances at instants of a piece, from all else."""
        seen = np.isfinite(self.y)
        seen[begin + 1 : begin + n] = False
        some: BoolArray = np.asarray(seen.any(axis=0))
        count = np.maximum(seen.sum(axis=0), 1)
        mean = np.where(seen, self.y, 0.0).sum(axis=0) / count
        apart = (np.where(seen, self.y - mean, 0.0) / np.sqrt(count))[:, some]
        steps = np.unique(np.abs(at[:, None] - at)).tolist()
        lags = {lag: apart[lag:].T @ apart[: len(apart) - lag] for lag in steps}
        usual = [[lags[i - j] if i >= j else lags[j - i].T for j in at] for i in at]
        return some, mean[some], np.block(usual)

    def known(self, starts: Sequence[int]) -> Iterator[filtering.FilterState]:
        """Filtered states at each of these samples, from the record up to it."""
        return filtering.filter_states(
            self.steps, self.C, self.y, self.t, self.scale, starts, self.biased
        )

    def estimate(self) -> tuple[Array, Array, Array]:
        """States (N, nx) and biases that fit all measurements best, and freedom (ny,) they take."""
        states = self._states()
        response = self.C[0] @ states  # (N, outputs shared, 1 + nx)
        residual = self.y - response[:, :, 0] - self.steps.direct
        z, bias, taken = _fit_unknowns(residual, response[:, :, 1:], self.scale, self.biased)
        return states[:, :, 0] + states[:, :, 1:] @ z, bias, taken

    def _states(self) -> Array:
        """Forced and free responses of the state, all bounded, (N, nx, 1 + nx).

        Column 0: the response to u with slow modes at zero at the start and fast growing ones at
        zero at the end; the others: free responses to a unit of either.
        """
        which, n, nx = self.steps.which, len(self.t) - 1, self.system.nx
        V, ns = _split(self.system, float(self.t[-1] - self.t[0]))
        maps = [np.linalg.solve(V, Ad @ V) for Ad in self.steps.maps]
        forcing = np.linalg.solve(V, self.steps.forcing.T).T
        z = np.zeros((n + 1, nx, 1 + nx))
        z[0, :ns, 1 : 1 + ns] = np.eye(ns)
        z[n, ns:, 1 + ns :] = np.eye(nx - ns)
        slow = [Ad[:ns, :ns] for Ad in maps]
        fast = [np.linalg.inv(Ad[ns:, ns:]) for Ad in maps]
        if n and (which == which[0]).all():
            k = which[0]
            z[:, :ns, 1 : 1 + ns], z[:, :ns, 0] = _carried(slow[k], forcing[:, :ns])
            back, driven = _carried(fast[k], -(forcing[:, ns:] @ fast[k].T)[::-1])
            z[:, ns:, 1 + ns :], z[:, ns:, 0] = back[::-1], driven[::-1]
            return np.asarray(V @ z)
        for k in range(n):
            z[k + 1, :ns] = slow[which[k]] @ z[k, :ns]
            z[k + 1, :ns, 0] += forcing[k, :ns]
        for k in range(n - 1, -1, -1):
            ahead = z[k + 1, ns:].copy()
            ahead[:, 0] -= forcing[k, ns:]
            z[k, ns:] = fast[which[k]] @ ahead
        return np.asarray(V @ z)


def _carried(A: Array, f: Array) -> tuple[Array, Array]:
    """Powers of A (m, m), from 0 to n, and x_{k+1} = A x_k + f_k from x_0 = 0: f is (n, m).

    In blocks of √n steps, all at once.
    """
    (n, m), b = f.shape, max(1, int(np.sqrt(len(f))))
    powers, ahead = np.eye(m)[None], A
    while len(powers) <= n:
        powers, ahead = np.concatenate([powers, powers @ ahead]), ahead @ ahead
    count = -(-n // b)
    driven, x = np.zeros((count, b, m)), np.zeros((count, b + 1, m))
    driven.reshape(count * b, m)[:n] = f
    for j in range(b):
        x[:, j + 1] = x[:, j] @ A.T + driven[:, j]
    begin = np.zeros((count, m))
    for i in range(count - 1):
        begin[i + 1] = powers[b] @ begin[i] + x[i, b]
    whole = x[:, 1:] + (begin @ powers[1 : b + 1].swapaxes(1, 2)).swapaxes(0, 1)
    return powers[: n + 1], np.concatenate([np.zeros((1, m)), whole.reshape(count * b, m)[:n]])


def _split(system: StateSpace, span: float) -> tuple[Array, int]:
    """Coordinates V and a number ns: V⁻¹ A V is block diagonal, slow modes first."""
    # Fast is what grows more than about e² over the record; the border lies in the widest gap
    # between the growth rates near there, so that the Sylvester equation is well conditioned.
    poles = np.linalg.eigvals(system.A)
    if system.dt is None:
        rates, border = poles.real, np.array([0.5, 5.0]) / span
    else:
        rates, border = np.abs(poles), np.exp(np.array([0.5, 5.0]) * system.dt / span)
    near = np.sort(rates[(rates > border[0]) & (rates < border[1])])
    edges = np.concatenate([border[:1], near, border[1:]])
    widest = int(np.argmax(np.diff(edges)))
    limit = edges[widest : widest + 2].mean()

    def slow(real: float, imag: float) -> bool:
        return bool((real if system.dt is None else np.hypot(real, imag)) < limit)

    S, Z, ns = scipy.linalg.schur(system.A, output="real", sort=slow)
    X = scipy.linalg.solve_sylvester(S[:ns, :ns], -S[ns:, ns:], -S[:ns, ns:])
    V = Z.copy()
    V[:, ns:] += Z[:, :ns] @ X
    return V, ns


def _fit_unknowns(
    residual: Array, free: Array, scale: Array, biased: BoolArray
) -> tuple[Array, Array, Array]:
    """Least squares for free responses z (nx,) and biases b (ny,); missing samples are left out.

    Last, the degrees of freedom (ny,) that they take of each output's samples.
    """
    # Columns are scaled to one; directions without effect on the outputs get zero.
    N, ny, nx = free.shape
    biases = np.broadcast_to(np.eye(ny)[:, biased], (N, ny, biased.sum()))
    columns = np.concatenate([free, biases], axis=2) / scale[:, None]
    target = residual / scale
    columns[np.isnan(target)] = 0.0
    rows = columns.reshape(N * ny, -1)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    rows /= size  # and with them the columns
    solution = np.linalg.lstsq(rows, np.nan_to_num(target).ravel(), rcond=RANK)[0] / size
    products = np.matmul(columns.transpose(1, 2, 0), columns.transpose(1, 0, 2))
    inverse = np.linalg.pinv(products.sum(axis=0), rcond=DISTINCT, hermitian=True)
    b = np.zeros(ny)
    b[biased] = solution[nx:]
    return solution[:nx], b, np.einsum("iab,ab->i", products, inverse)
