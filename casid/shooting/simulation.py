"""Nonlinear structures simulated, and predicted from states that a record's past tells."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.free import Free
from casid.nonlinear.coverage import joined, reached, warn_beyond
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_unbalanced
from casid.prediction import Outlook, Prediction
from casid.record import Record
from casid.records import standard_deviations
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import MOST, NonlinearEvaluator
from casid.shooting.sensitivity import Point
from casid.threads import one_thread

SAME = 1e-6  # change of outputs, over their size, from halving the steps that ends it
ROUNDS = 20  # of Gauss-Newton steps for a state
STILL = 1e-10  # change of the cost, relative, that ends them
AWAY = "the structure runs away from its start; predict over a shorter horizon"
WEAK = 1e-8  # information below this share of the largest moves nothing


@one_thread
def simulate(
    model: NonlinearModel, record: Record, start: Mapping[str, float] | None = None
) -> Record:
    """The record as a nonlinear structure answers its inputs: total values, no noise.

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
        `DataWarning` tells of states beyond the structure's tables, and of a start from a
        reference condition that is no trim.
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
    while evaluator.substeps < MOST:
        evaluator, last = evaluator.finer(2), y
        y = _finite(model, evaluator.simulate(point).residuals)
        if np.abs(y - last).max() <= SAME * max(np.abs(y).max(), 1e-300):
            break
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
    return dict(zip(model.states, _answer(model, known, weight)[0][0].tolist(), strict=True))


def predict_nonlinear(
    model: NonlinearModel, record: Record, scale: Array, far: Outlook
) -> Prediction:
    """Outputs of a nonlinear structure over a record, as `casid.prediction.predict` has a linear's.

    Initial state and biases are those of least squares weighted by ``scale`` (ny,): over all of
    the record, or before each prediction on its past alone. ValueError: a missing channel, a state
    that no step from the measured one on improves.
    """
    own = [name for name in model.outputs if name in record.outputs]
    mine = [model.outputs.index(name) for name in own]
    columns = [record.outputs.index(name) for name in own]
    total = record.total().select(model.inputs, own)
    y, weight = np.full((record.N, len(model.outputs)), np.nan), np.ones(len(model.outputs))
    y[:, mine], weight[mine] = total.y, 1 / scale[columns]
    whole = replace(total, y=y, outputs=model.outputs)
    found, biases, visited = np.full(record.y.shape, np.nan), [], []
    inner = np.full((record.N, len(model.states)), np.nan)
    first: Array = np.zeros(0)
    for start, end in zip(far.starts or (-1,), (*far.starts[1:], record.N - 1), strict=True):
        begin = max(start - far.past, 0)
        piece = whole.take(slice(begin, end + 1))
        known = piece.y.copy()
        if far.starts:
            known[far.past + 1 :] = np.nan  # what is predicted is not looked at
        (x0, bias), outputs, states = _answer(model, replace(piece, y=known), weight)
        visited.append(reached(model, states, piece.u))
        first = first if len(first) else x0
        found[start + 1 : end + 1, columns] = outputs[start + 1 - begin :, mine]
        inner[start + 1 : end + 1] = states[start + 1 - begin :]
        biases.append(bias)
    mean = np.full(record.ny, np.nan)
    mean[columns] = np.mean(biases, axis=0)[mine]
    trim = np.array([record.trim.get(name, 0.0) for name in record.outputs])
    unknown = np.full(record.ny, np.nan)
    return Prediction(found - trim, first, mean, unknown, joined(visited), inner)


def _answer(
    model: NonlinearModel, record: Record, weight: Array
) -> tuple[tuple[Array, Array], Array, Array]:
    """State at the first sample and biases that fit best, outputs (N, ny), states (N, nx) then."""
    evaluator = NonlinearEvaluator(_all_free(model), lay_out([record], 1e9))
    nf, nx, ny = evaluator.nf, evaluator.nx, evaluator.ny
    W = np.tile(np.diag(weight), (len(evaluator.layout.patterns), 1, 1))
    W *= evaluator.layout.patterns[:, None, :]

    def at(z: Array) -> Point:
        return Point(lam=model.vector(), bias=z[None, nx:], nodes=z[None, :nx])

    def cost(z: Array) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            total = float(np.sum((evaluator.simulate(at(z)).residuals * weight) ** 2))
        return total if np.isfinite(total) else np.inf

    z = np.concatenate([evaluator.resting()[0], np.zeros(ny)])
    now = cost(z)
    for _ in range(ROUNDS):
        gram = _gram(evaluator, at(z), W)[nf:, nf:]
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
    if not np.isfinite(now):
        raise ValueError(AWAY)
    motion = evaluator.simulate(at(z))
    u = np.concatenate([part.value for part in evaluator.held(evaluator.matrices(model.vector()))])
    outputs = evaluator.flow.output(motion.states, u, model.vector()) + z[nx:]
    return (z[:nx], z[nx:]), outputs, motion.states


def _gram(evaluator: NonlinearEvaluator, point: Point, W: Array) -> Array:
    """Gauss-Newton's matrix of the only interval; ValueError where the derivatives overflow."""
    with np.errstate(over="ignore", invalid="ignore"):
        sweep = evaluator.sweep(point, evaluator.simulate(point), W)
        gram = next(iter(sweep.batches())).gram[0]
    if not np.isfinite(gram).all():
        raise ValueError(AWAY)
    return np.asarray(gram)
