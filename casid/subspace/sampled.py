"""Black boxes of the samples themselves, chosen by the simulation of stretches held out.

The second half of every record is cut into stretches. Each is simulated by the model of all before
it and of the other records, from the initial state and trim of least squares over what was learnt
of its record; the stretches are judged as one. First the orders, with the subspace estimate as it
is and with B, K and D regressed anew; then, at the best orders, what moves the poles as well.
Simulations show most what a model leaves out where the process is slow or hardly damped: the place
of samples. Many outputs leave little to refine in the subspace estimate, and there nothing is
moved. Where a simulation leaves no more than one-step predictions do, which know the outputs' past
as well, that is the sensors' noise, and nothing is left to be found: there the likelihood of
prediction errors is taken, of which errors are known.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from casid.arrays import Array
from casid.linear import StateSpace, recursion
from casid.record import Record
from casid.records import same_interval
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.candidates import Candidate, Refinement
from casid.subspace.columns import input_bandwidth
from casid.subspace.feedback import fed_back_noise, prediction_errors
from casid.subspace.held_inputs import discretised
from casid.subspace.predictor import accumulate
from casid.subspace.refinement_choice import FED_BACK, Estimate, refine_projected, refine_sampled

ORDERS = (*range(1, 11), *range(12, 21, 2))
WINDOWS = (20, 10, 5)  # samples; the shorter ones where records do not suffice
COLUMNS = 400  # of past channels: with more, the shorter windows
MANY = 8  # outputs: with more, the subspace estimate as it is
STRETCHES = 6
REFINED = 2  # of the best orders: those whose poles are moved
COARSE = 1 / 3  # rad a sample, of the inputs: where they reach less, projections lose nothing
BLOCK = 4096  # rows of a regression at once
HUGE = 1e100  # what is larger is no simulation
ROUNDING = 1e-10  # relative to what is added up: what is smaller is none of it
NOISE = 1.05  # of what one-step predictions leave: what simulations leave no more than is noise
GROWTH = 2.0  # of an exponent over the longest record: what grows more cannot be simulated


def are_candidates(campaign: Campaign, projected: StateSpace | None) -> bool:
    """Whether a model of the samples can be better than one of projections, and be judged so."""
    # The records are complete, of one interval, and sampled no faster than their inputs move; a
    # direct term is free where straight lines between samples need one; and the aircraft, as
    # projections show it, is stable enough for a simulation of whole records.
    first, records = campaign.records[0], campaign.records
    alike = all(
        r.equidistant
        and same_interval(r, first)
        and r.hold == first.hold
        and np.isfinite(r.y).all()
        for r in records
    )
    if not alike or input_bandwidth(records) * first.dt < COARSE:
        return False
    if first.hold == "foh" and (len(records) > 1 or not campaign.mask.all()):
        return False
    longest = max(record.duration for record in records)
    return projected is None or float(projected.poles().real.max()) * longest < GROWTH


def usual_windows(channels: int) -> tuple[int, ...]:
    """What windows are chosen from; their cost grows by the square of the channels in them."""
    return tuple(past for past in WINDOWS if past * channels <= COLUMNS) or WINDOWS[-1:]


def choose_samples(
    campaign: Campaign,
    orders: Sequence[int],
    windows: Sequence[Windows],
    *,
    move: bool,
    bound: float = np.inf,
) -> tuple[list[Candidate], Candidate | None]:
    """Candidates, each with the power it leaves, for the first windows that give a model; the best.

    None that leaves more than a ``bound`` is of use.
    """
    judge, move = Stretches.of(campaign), move and len(campaign.sy) <= MANY
    found: list[Candidate] = []
    for each in windows:
        tried = [
            judge.score(order, each, how)
            for order in orders
            if order <= each.past * len(campaign.sy)
            for how in (("unrefined", "linear") if move else ("unrefined",))
        ]
        found = sorted((c for c in tried if c is not None), key=lambda c: c.score)
        if found:
            break
    if not found or not move:
        return found, next(iter(found), None)
    if judge.noise(found[0]) * NOISE >= found[0].score:
        return _likeliest(judge, found, bound)
    return _moved(judge, found, bound)


def _likeliest(
    judge: "Stretches", found: list[Candidate], bound: float
) -> tuple[list[Candidate], Candidate]:
    """That of prediction errors at the best order, unless it is worse."""
    best = found[0]
    if best.score > bound:
        return found, best
    likeliest = judge.score(best.order, best.windows, "prediction", best.score * NOISE)
    return ([*found, likeliest], likeliest) if likeliest else _moved(judge, found, bound)


def _moved(
    judge: "Stretches", found: list[Candidate], bound: float
) -> tuple[list[Candidate], Candidate]:
    """The best of all that move the poles at the best orders, and of what was found before."""
    best, each = list(dict.fromkeys(candidate.order for candidate in found))[:REFINED], found[0]
    more: list[tuple[int, Refinement]] = [(order, "prediction") for order in best]
    if not judge.fed_back(best[0], each.windows):
        more += [(best[0], "simulation"), (best[0], "local simulation")]
    for order, how in more:
        least = min(bound, *(candidate.score for candidate in found))
        candidate = judge.score(order, each.windows, how, least)
        found = found if candidate is None else [*found, candidate]
    return found, min(found, key=lambda candidate: candidate.score)


@dataclass(frozen=True, eq=False)
class _Fold:
    """A record up to the end of a stretch, ``known`` of its samples in the campaign learnt from."""

    learnt: Campaign
    shown: Record
    known: int


@dataclass(frozen=True, eq=False)
class Stretches:
    """What models are judged by; ``power`` (ny,) is that of the outputs in all stretches."""

    campaign: Campaign
    folds: tuple[_Fold, ...]
    power: Array

    @classmethod
    def of(cls, campaign: Campaign) -> "Stretches":
        """Cut every record into stretches, `STRETCHES` in all or one each."""
        each = -(-STRETCHES // len(campaign.records))
        folds, shown = [], []
        for i, record in enumerate(campaign.records):
            others = [r for j, r in enumerate(campaign.records) if j != i]
            edges = np.linspace(record.N // 2, record.N, each + 1).astype(int)
            for start, end in pairwise(edges):
                learnt = campaign.part([*others, record.take(slice(start))])
                folds.append(_Fold(learnt, record.take(slice(end)), int(start)))
            shown.append(record.y[edges[0] :])
        y = np.vstack(shown)
        return cls(campaign, tuple(folds), np.sum((y - y.mean(axis=0)) ** 2, axis=0))

    def score(
        self, order: int, windows: Windows, how: Refinement, least: float = np.inf
    ) -> Candidate | None:
        """The candidate; None where a fold gives no model, or errors exceed a share of ``least``.

        Errors add up from fold to fold, so that what is too bad is not looked at further.
        """
        shares, share = [], np.inf
        sums = np.zeros((3, len(self.power)))
        for fold in self.folds:
            try:
                e = _simulation_errors(fold, _learnt(fold.learnt, order, windows, how).system)
            except (ValueError, np.linalg.LinAlgError):
                return None
            sums += [e.sum(axis=0), (e**2).sum(axis=0), np.full(len(self.power), len(e))]
            share = float(np.mean((sums[1] - sums[0] ** 2 / sums[2]) / self.power))
            if not share < least:
                return None
            shares.append(float(len(self.folds) * np.mean((e**2).sum(axis=0) / self.power)))
        return replace(Candidate.of(order, windows, how).scored(shares), score=share)

    def noise(self, candidate: Candidate) -> float:
        """What one-step predictions of the stretches leave, as `score`, by unmoved poles."""
        sums = np.zeros((3, len(self.power)))
        for fold in self.folds:
            model = _learnt(fold.learnt, candidate.order, candidate.windows, candidate.refinement)
            e = _prediction_errors(fold, model)
            sums += [e.sum(axis=0), (e**2).sum(axis=0), np.full(len(self.power), len(e))]
        return float(np.mean((sums[1] - sums[0] ** 2 / sums[2]) / self.power))

    def fed_back(self, order: int, windows: Windows) -> bool:
        """Whether noise that a controller feeds back would bias simulations."""
        c = self.campaign
        found = c.subspace(order, windows)
        return fed_back_noise(found.system, found.K, c.records, c.su, c.sy) > FED_BACK


def _learnt(campaign: Campaign, order: int, windows: Windows, how: Refinement) -> Estimate:
    found = campaign.subspace(order, windows)
    if how != "fourier":
        return refine_sampled(campaign, found, how)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is said is said of the whole records
        return refine_projected(campaign, found, windows.pole, move=True)


def _simulation_errors(fold: _Fold, system: StateSpace) -> Array:
    """Errors (N, ny) of a stretch, simulated from the state and trim of what is before it."""
    # The trim of the inputs is no mean of theirs: what integrates them would drift away. Nor is
    # that of the outputs while the aircraft is still on its way.
    record, known, sy = fold.shown, fold.known, fold.learnt.sy
    if system.dt is None:
        system = discretised(system, record.dt, record.hold)
    u, y = (v - v[:known].mean(axis=0) for v in (record.u, record.y))
    with np.errstate(over="ignore", invalid="ignore"):
        left = (y - _simulated(system, u)) / sy  # of all outputs alike, in whatever units
        # What is at right angles to C is no effect of the state.
        Q, C = np.linalg.qr(system.C / sy[:, None])
        free = _observability(system.A, C, len(u))
        steps = np.cumsum(free @ system.B, axis=0)  # of the inputs
    steps = np.concatenate([0 * steps[:1], steps[:-1]])
    basis = np.concatenate([free, steps], axis=2)
    if not (np.abs(left).max() < HUGE and np.abs(basis).max() < HUGE):
        raise ValueError("an unstable model cannot be simulated so long")
    whole = np.linalg.norm(basis[:known], axis=(0, 1))
    basis, left = (v - v[:known].mean(axis=0) for v in (basis, left))  # but for the outputs' trim
    columns = basis[:known].reshape(-1, basis.shape[2])
    # Of what is constant rounding is left, which means nothing.
    size = np.maximum(np.linalg.norm(columns, axis=0), np.maximum(ROUNDING * whole, 1e-300))
    rows = np.column_stack([columns / size, (left[:known] @ Q).ravel()])
    parts = np.array_split(rows, -(-len(rows) // BLOCK))
    R, _ = accumulate(parts, constant=False)
    found = np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=ROUNDING)[0] / size
    return np.asarray(sy * (left[known:] - basis[known:] @ found @ Q.T))


def _prediction_errors(fold: _Fold, model: Estimate) -> Array:
    """One-step prediction errors (N, ny) of a stretch, but for a constant of what is before it."""
    known, u, y = fold.known, fold.shown.u, fold.shown.y
    centred = replace(fold.shown, u=u - u[:known].mean(axis=0), y=y - y[:known].mean(axis=0))
    e = prediction_errors(model.system, model.K, centred)
    return np.asarray(e[known:] - e[known // 2 : known].mean(axis=0))  # once it has begun


def _simulated(system: StateSpace, u: Array) -> Array:
    """Outputs (N, ny) from rest."""
    driven = (u @ system.B.T)[:, :, None]
    x = recursion(system.A, driven[:-1], np.zeros((system.nx, 1)))[:, :, 0]
    return np.asarray(x @ system.C.T + u @ system.D.T)


def _observability(A: Array, C: Array, N: int) -> Array:
    """C Aᵏ for k < N, (N, rows of C, nx); each doubling of the rows takes one product."""
    rows, step = C[None], A
    while len(rows) < N:
        rows, step = np.concatenate([rows, rows @ step]), step @ step
    return rows[:N]
