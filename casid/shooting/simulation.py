"""Nonlinear structures simulated, and predicted from states that a record's past tells."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid import filtering
from casid.arrays import Array, BoolArray
from casid.errors import ModelError, warn
from casid.free import Free
from casid.linear import Steps
from casid.nonlinear.coverage import reached, warn_beyond
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_unbalanced
from casid.prediction import (
    PER_UNKNOWN,
    Prediction,
    PredictionPlan,
    RecordPredictor,
    which_biased,
)
from casid.record import Record
from casid.records import standard_deviations
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import PIECE, NonlinearEvaluator, Track
from casid.shooting.sensitivity import Point
from casid.shooting.stiffness import MOST, TYPICAL
from casid.threads import one_thread

SAME = 1e-6  # change of an output, over its span, from halving the steps that ends it
TOLD = 1e-5  # what is left of that where no shorter steps are, and told
ROUNDING = 1e-12  # of the largest value, a change that counts as none
ROUNDS = 20  # of Gauss-Newton steps for a state
STILL = 1e-10  # change of the cost, relative, that ends them
AWAY = "the structure runs away from its start; predict over a shorter horizon"
PASSES = 5  # along the past before the first prediction, each linearised about the one before
SHARP = 1e-3  # change of predictions, over a channel's scale, from halving the steps that ends it
WEAK = 1e-8  # information below this share of the largest moves nothing


@one_thread
def simulate(
    model: NonlinearModel, record: Record, start: Mapping[str, float] | None = None
) -> Record:
    """Simulate a nonlinear structure on the inputs of a record: total values, no noise.

    Parameters
    ----------
    model : NonlinearModel
        At its parameter values.
    record : Record
        Its inputs, by name, instants and hold; outputs do not count.
    start : mapping
        States at the first sample; the reference condition's where not named.

    Raises
    ------
    ValueError, ModelError
        An input that the record lacks, a state that is none; a solution that runs away. A
        `DataWarning` tells of states beyond the structure's tables, of a start from a reference
        condition that is no trim, of steps that cannot be short enough.
    """
    total = record.total().select(model.inputs, ())
    empty = replace(total, y=np.zeros((record.N, len(model.outputs))), outputs=model.outputs)
    x0 = dict(zip(model.states, map(float, model.operating_point()[0]), strict=True))
    if unknown := sorted(set(start or {}) - set(x0)):
        raise ValueError(f"start names {unknown[0]!r}; the states are {', '.join(x0)}")
    if set(x0) - set(start or {}):
        warn_unbalanced(model, "the simulation starts from states of it")
    free, node = _all_free(model), np.array([list((x0 | dict(start or {})).values())])
    evaluator = NonlinearEvaluator(free, lay_out([empty], 1e9))
    point = Point(lam=model.vector(), bias=np.zeros((1, len(model.outputs))), nodes=node)
    motion = evaluator.simulate(point)
    y = _finite(model, motion.residuals)
    moved = np.full(len(model.outputs), np.inf)
    while (moved > SAME).any() and (evaluator.substeps < MOST or np.isinf(moved).any()):
        evaluator, last = evaluator.finer(2), y
        y = _finite(model, evaluator.simulate(point).residuals)
        least = ROUNDING / SAME * np.abs(y).max() + 1e-300
        moved = np.abs(y - last).max(axis=0) / np.maximum(np.ptp(y, axis=0), least)
    if (moved > TOLD).any():
        worst = int(np.argmax(moved))
        warn(
            f"simulate: {model.outputs[worst]} over record {record.name!r} moves by "
            f"{moved[worst]:.1g} of its span as steps are halved to {evaluator.substeps} a "
            "sampling interval, the most; give inputs at shorter intervals"
        )
    warn_beyond(model, f"record {record.name!r}", reached(model, motion.states, empty.u))
    return replace(empty, y=y)


def _finite(model: NonlinearModel, y: Array) -> Array:
    bad = np.flatnonzero(~np.isfinite(y).all(axis=1))
    if len(bad):
        raise ModelError(
            f"{type(model).__name__} runs away: outputs are not finite from sample {bad[0]} on; "
            "simulate a shorter record, or start nearer to the measured states"
        )
    return y


def _all_free(model: NonlinearModel) -> Free:
    """All parameters as variables, within no bounds: for derivatives, not for an estimation."""
    n = len(model.vector())
    return Free(model, np.arange(n), np.full(n, -np.inf), np.full(n, np.inf), np.ones(n))


def fitting_start(model: NonlinearModel, record: Record) -> dict[str, float]:
    """State at a record's first sample that fits it best, biases free, for `simulate`.

    Outputs that never move tell nothing; what none tells is that of the reference condition.
    """
    total = record.total().select(model.inputs, model.outputs)
    moves = [len(np.unique(y[np.isfinite(y)])) > 1 for y in total.y.T]
    known = replace(total, y=np.where(moves, total.y, np.nan))
    weight = 1 / standard_deviations([total])[1]
    x0 = _answer(model, known, weight, which_biased(model.outputs, None))[0][0]
    return dict(zip(model.states, x0.tolist(), strict=True))


def predict_nonlinear(
    model: NonlinearModel,
    record: Record,
    scale: Array,
    far: PredictionPlan,
    biased: Collection[str] | None = None,
) -> Prediction:
    """Outputs of a nonlinear structure over a record, as `casid.prediction.predict` has a linear's.

    Simulated with the initial state and the biases of least squares weighted by ``scale`` (ny,), or
    predicted from what extended Kalman filters tell at each start. Every output has a bias, unless
    it is said which are ``biased``. ValueError: a missing channel, a state that no step from the
    measured one on improves, a solution that runs away.
    """
    total = record.total()
    columns = np.array(
        [record.outputs.index(n) if n in record.outputs else -1 for n in model.outputs]
    )
    y, sizes = np.where(columns < 0, np.nan, total.y[:, columns]), scale[columns]
    whole = replace(total.select(model.inputs, ()), y=y, outputs=model.outputs)
    if far.starts:
        found = _ExtendedFilter(model, whole, sizes, far.horizon, biased).pieces(far)
    else:
        own = which_biased(model.outputs, biased)
        (x0, bias), y, states = _answer(model, whole, 1 / sizes, own)
        found = Prediction(y, x0, bias, states)
    found = found.placed(columns, record.ny)
    trim = np.array([record.trim.get(name, 0.0) for name in record.outputs])
    return replace(found, y=found.y - trim, reached=reached(model, found.states, whole.u))


class _ExtendedFilter(RecordPredictor):
    """What a record's past tells of a nonlinear structure's states: `casid.filtering`, extended.

    The filters are of deviations from one state. Steps and outputs are linearised about what is
    known at each sample; up to the first start, before which nothing is predicted, about the states
    that all of that past tells, in some passes.
    """

    def __init__(
        self,
        model: NonlinearModel,
        record: Record,
        scale: Array,
        horizon: float,
        biased: Collection[str] | None = None,
    ) -> None:
        e = NonlinearEvaluator(_all_free(model), lay_out([record], 1e9))
        self._e = e = _following(e, model.vector(), scale, horizon)
        self._lam, self.y, self.t, self.scale = model.vector(), record.y, record.t, scale
        self.biased = which_biased(record.outputs, biased)
        m, (N, ny), nx = e.matrices(self._lam), record.y.shape, e.nx
        self._u, self._stages = e.inputs(m), e.stages(m)
        point = Point(lam=self._lam, bias=np.zeros((1, ny)), nodes=e.resting())
        self._inner = np.zeros((*self._stages.eta.shape, nx))
        track = Track(self._inner[:, 0], np.zeros((N, ny)), point.nodes, self._inner)
        self._sweep = e.sweep(point, track, np.zeros((1, ny, ny)))
        self.origin, self.C, self._A = point.nodes[0], np.zeros((N, ny, nx)), np.zeros((N, nx, nx))
        self.steps = Steps(tuple(self._A), np.arange(N - 1), np.zeros((N, nx)), np.zeros((N, ny)))
        self._linearise(np.arange(N), np.tile(self.origin, (N, 1)))

    def known(self, starts: Sequence[int]) -> Iterator[filtering.FilterState]:
        """What is known at each start; asked for the next, it forgets linearisations ahead."""
        past, rest = range(starts[0] + 1), range(starts[0], starts[-1] + 1)
        for _ in range(PASSES):
            found = list(super().known(past))
            near = np.array([each.known_by(found[-1]) for each in found])
            self._linearise(np.array(past), self.origin + near)
        for k, known in zip(rest, super().known(rest), strict=True):
            if k in starts:
                yield known
            self.forward(self.origin + known.x, k, k + 1)

    def forward(self, x: Array, begin: int, end: int) -> Array:
        """States from one sample to another; steps and outputs are linearised about them."""
        found = [x[None]]
        for k in range(begin, end):
            found.append(self._step(np.array([k]), found[-1]))
        self._linearise(np.arange(begin, end + 1), states := np.concatenate(found))
        return states

    def outputs(self, x: Array, begin: int) -> Array:
        """Outputs without biases of states (n, nx) from a sample on."""
        y = self._e.flow.output(x, self._u[begin : begin + len(x)], self._lam)
        if not np.isfinite(y).all():
            raise ValueError(AWAY)
        return y

    def _linearise(self, at: np.ndarray, x: Array) -> None:
        """Take steps from samples and outputs there about states (n, nx), if they have values."""
        ends, parts = self._step(at, x), np.split(at, range(PIECE, len(at), PIECE))
        A = np.concatenate([self._sweep.advanced(part)[0] for part in parts])
        h, C = self._e.flow.h(x, self._u[at], self._lam)[:2]
        away = (x - self.origin)[:, :, None]
        forcing = ends - self.origin - (A @ away)[:, :, 0]
        direct = h - (C @ away)[:, :, 0]
        values = np.hstack([forcing, direct, A.reshape(len(at), -1), C.reshape(len(at), -1)])
        good = np.isfinite(values).all(axis=1)
        places = self.steps.forcing, self.steps.direct, self._A, self.C
        for place, value in zip(places, (forcing, direct, A, C), strict=True):
            place[at[good]] = value[good]

    def _step(self, at: np.ndarray, x: Array) -> Array:
        """States (n, nx) one sample on, those at Runge-Kutta steps within being kept."""
        return self._e.advance(self._stages, at, x, self._lam, self._inner)


def _following(
    evaluator: NonlinearEvaluator, lam: Array, scale: Array, horizon: float
) -> NonlinearEvaluator:
    """The same with steps so short that halving them changes no prediction over a horizon.

    Judged by single samples from measured states on, whose changes add up over the horizon.
    """
    rows = np.arange(len(evaluator.layout.y) - 1)
    x, m = evaluator.flown(rows), evaluator.matrices(lam)
    u = evaluator.inputs(m)[rows]
    count = horizon / evaluator.lengths[rows]

    def ends(e: NonlinearEvaluator) -> Array:
        return e.flow.output(e.advance(e.stages(m), rows, x, lam), u, lam)

    with np.errstate(all="ignore"):
        coarse = ends(evaluator)
        while evaluator.substeps < MOST:
            finer = evaluator.finer(2)
            fine = ends(finer)
            off = np.abs(fine - coarse) / scale
            change = np.nanquantile(np.where(np.isfinite(off), off, np.inf), TYPICAL, axis=0)
            if (change * np.median(count) <= SHARP).all():
                break
            evaluator, coarse = finer, fine
    return evaluator


def _answer(
    model: NonlinearModel, record: Record, weight: Array, biased: BoolArray
) -> tuple[tuple[Array, Array], Array, Array]:
    """State at the first sample and biases that fit best, outputs (N, ny), states (N, nx) then.

    Only outputs ``biased`` (ny,) have a bias. What fits the record's beginning comes first: from
    farther off, what grows leads astray.
    """
    nx, ny, N = len(model.states), len(model.outputs), record.N
    counts = [n for n in (N // 16, N // 4) if n >= PER_UNKNOWN * (nx + ny)]
    parts = [lay_out([record.take(slice(n))], 1e9) for n in (*counts, N)]
    evaluators = [NonlinearEvaluator(_all_free(model), part) for part in parts]
    lam, z = model.vector(), np.concatenate([evaluators[0].resting()[0], np.zeros(ny)])
    while True:
        cost = np.inf
        for evaluator in evaluators:
            z, cost = _best_start(evaluator, lam, z, weight, biased)
        finer = [evaluator.finer(2) for evaluator in evaluators]
        if evaluator.substeps >= MOST or _same(evaluator, finer[-1], _start(lam, z, nx), weight):
            break
        evaluators = finer
    if not np.isfinite(cost):
        raise ValueError(AWAY)
    motion = evaluator.simulate(_start(model.vector(), z, nx))
    u = evaluator.inputs(evaluator.matrices(model.vector()))
    outputs = evaluator.flow.output(motion.states, u, model.vector()) + z[nx:]
    return (z[:nx], z[nx:]), outputs, motion.states


def _same(
    coarse: NonlinearEvaluator, fine: NonlinearEvaluator, point: Point, weight: Array
) -> bool:
    """Whether shorter steps change no output of a simulation."""
    with np.errstate(over="ignore", invalid="ignore"):
        moved = coarse.simulate(point).residuals - fine.simulate(point).residuals
        return bool(np.abs(moved * weight).max() <= SHARP)


def _start(lam: Array, z: Array, nx: int) -> Point:
    """Parameters with the state and the biases in z (nx + ny,)."""
    return Point(lam=lam, bias=z[None, nx:], nodes=z[None, :nx])


def _best_start(
    evaluator: NonlinearEvaluator, lam: Array, z: Array, weight: Array, biased: BoolArray
) -> tuple[Array, float]:
    """State and biases of least squares, by Gauss-Newton from z, and the sum of squares."""
    nf, nx = evaluator.nf, evaluator.nx
    moving = np.r_[np.ones(nx, dtype=bool), biased, True]  # the last is the residual
    W = np.tile(np.diag(weight), (len(evaluator.layout.patterns), 1, 1))
    W *= evaluator.layout.patterns[:, None, :]

    def cost(z: Array) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = evaluator.simulate(_start(lam, z, nx)).residuals
            total = float(np.sum((residuals * weight) ** 2))
        return total if np.isfinite(total) else np.inf

    now = cost(z)
    if not np.isfinite(now):
        return z, now
    for _ in range(ROUNDS):
        gram = _gram(evaluator, _start(lam, z, nx), W)[nf:, nf:] * np.outer(moving, moving)
        unit = 1 / np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
        H = gram[:-1, :-1] * np.outer(unit, unit)
        step = -unit * np.linalg.lstsq(H, unit * gram[:-1, -1], rcond=WEAK)[0]
        share, new = 1.0, cost(z + step)
        while not new <= now and share > 1e-3:
            share /= 2
            new = cost(z + share * step)
        if not new < now:
            break
        z, gained, now = z + share * step, now - new, new
        if gained <= STILL * now:
            break
    return z, now


def _gram(evaluator: NonlinearEvaluator, point: Point, W: Array) -> Array:
    """Gauss-Newton's matrix of the only interval; ValueError where the derivatives overflow."""
    with np.errstate(over="ignore", invalid="ignore"):
        sweep = evaluator.sweep(point, evaluator.simulate(point), W)
        gram = next(iter(sweep.batches())).gram[0]
    if not np.isfinite(gram).all():
        raise ValueError(AWAY)
    return np.asarray(gram)
