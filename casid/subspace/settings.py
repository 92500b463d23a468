"""Settings of the black box of projections chosen from data: order, window, pole, regularisation.

Where every input is excited in two records or more, records are held out whole, one fold after the
other, and predicted by the model of the rest, with a free transient (`casid.subspace.fourier`). The
score is the mean logarithm of the residual power in frequency bins: the log-likelihood with an
unknown residual spectrum. Chosen is the lowest order within one standard error of the best.

Where records are too few for that, the score is the corrected Akaike criterion of the refined
model, the large-sample equivalent of leaving out one Fourier line after the other (M. Stone, J. R.
Stat. Soc. B 39 (1977) 44-47); the criterion before the refinement says what is worth refining, and
orders are tried until some in a row are no better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from casid.arrays import Array
from casid.linear import StateSpace
from casid.record import Record
from casid.records import Records
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.candidates import Candidate, OrderSelection
from casid.subspace.columns import Feedthrough
from casid.subspace.fourier import Spectrum
from casid.subspace.laguerre import support
from casid.subspace.poles import COST, PASTS, clear_bandwidth, usable_poles
from casid.subspace.refinement import information_criteria, refined_system, residual_powers
from casid.threads import one_thread

HIGHEST = 2.0  # of the Laguerre pole: frequencies above it are not looked at
REGULARISATIONS = (1e-3, 1e-2)
FOLDS = 8
BINS = 8
SUPPORT = 6.0  # of AICc, of one record: what is no closer to the best has much less support
OVERFLOW = 30.0  # exponent by which no mode grows between two samples
LARGEST = 30  # order that is tried unasked
PATIENCE = 4  # orders in a row that are no better, after which no higher one is tried
STARTS = 2  # poles and windows refined at every order where nothing is held out
EXCITED = 0.3  # of the largest standard deviation: what counts as exciting an input


@dataclass(frozen=True)
class Grid:
    """What settings are chosen from; empty where the records say what is usual."""

    orders: Sequence[int]
    pasts: Sequence[int]
    poles: Sequence[float]
    regularisations: Sequence[float]

    def windows(self, records: Sequence[Record]) -> list[Windows]:
        """Poles and windows whose kernels cost at most a quarter of the longest record."""
        # All of them where there is nothing to choose; with the first regularisation.
        pairs = list(product(self.poles, self.pasts))
        longest = max(record.duration for record in records)
        fit = [(a, past) for a, past in pairs if support(a, past) <= COST * longest]
        return [
            Windows(past, past, a, self.regularisations[0])
            for a, past in (pairs if len(pairs) == 1 else fit)
        ]


@one_thread
def select_order(
    records: Records,
    *,
    orders: Sequence[int] | None = None,
    pasts: Sequence[int] | None = None,
    poles: Sequence[float] | None = None,
    regularisations: Sequence[float] | None = None,
    feedthrough: Feedthrough = True,
) -> OrderSelection:
    """Choose the settings of `pbsid` on projections from the records themselves; deterministic.

    Parameters
    ----------
    records : Record or sequence of Record
        The campaign.
    orders, pasts, poles, regularisations : sequence
        What to choose from; one entry fixes that setting. With records held out the order is
        searched for every pole at one window length, then the window and the regularisation at the
        best of these.
    feedthrough : bool, mask or output names
        As in `pbsid`.

    Raises
    ------
    ValueError
        No candidate can be identified from these records.
    """
    grid = Grid(orders or (), pasts or (), poles or (), regularisations or ())
    return choose_projections(Campaign.of(records, feedthrough), grid)


def choose_projections(campaign: Campaign, grid: Grid) -> OrderSelection:
    """`select_order` of a campaign."""
    records, ny = _measured(campaign.records), len(campaign.sy)
    poles = [float(a) for a in grid.poles] or usable_poles(records)
    pasts = grid.pasts or PASTS
    orders = grid.orders or _default_orders(ny, sorted(pasts)[len(pasts) // 2] * ny)
    grid = Grid(orders, pasts, poles, grid.regularisations or REGULARISATIONS)
    held_out = held_out_suffices(_projected(campaign, grid))
    tried = _held_out_search(campaign, grid) if held_out else []
    if not tried:  # nothing to hold out, or without it the rest is too short to be identified
        held_out, tried = False, _akaike_search(campaign, grid)
    if not tried:
        raise ValueError(
            f"no settings can be identified from {len(records)} record(s), the longest of "
            f"{max(r.duration for r in records):.3g} s: tried orders {orders}, past {pasts}, "
            f"poles {poles} rad/s; give longer records, or a lower order and past"
        )
    tried = with_errors(tried)
    chosen = _parsimonious(tried)
    if held_out and clear_bandwidth(records)[1]:
        chosen = _likeliest(campaign, [c for c in tried if c.order == chosen.order], grid)
    return OrderSelection(
        chosen=chosen,
        candidates=tuple(tried),
        criterion="held-out records" if held_out else "AICc",
        singular_values=campaign.subspace(chosen.order, chosen.windows).singular_values,
    )


def refuse_order(order: int | None, ny: int, window: int) -> None:
    """ValueError: windows of that length hold no model of that order, of ``ny`` outputs."""
    raise ValueError(
        f"order = {order} is above the {window * ny} that projections with windows of {window} and "
        f"{ny} outputs allow; lower it, or give a longer past"
    )


def _measured(records: Sequence[Record]) -> Sequence[Record]:
    """Those in which every output is measured at some time; all, if there are none."""
    # What is never measured is a gap from end to end: such a record gives no projections.
    return [r for r in records if np.isfinite(r.y).any(axis=0).all()] or records


def held_out_suffices(records: Sequence[Record]) -> bool:
    """Whether every input is excited in two records or more, so that one may be held out."""
    std = np.array([np.std(record.u, axis=0) for record in records])
    return len(std) > 1 and bool(np.all((std >= EXCITED * std.max(axis=0)).sum(axis=0) >= 2))


def _projected(campaign: Campaign, grid: Grid) -> list[Record]:
    """Records that the shortest kernels fit in: others are of no use to any of the candidates."""
    a = max(grid.poles)
    shortest = support(a, min(grid.pasts))
    each = ((r, campaign.pieces(a, slice(i, i + 1))) for i, r in enumerate(campaign.records))
    return [r for r, pieces in each if any(p.t[-1] - p.t[0] >= shortest for p in pieces)]


def _transforms(campaign: Campaign, grid: Grid) -> list[tuple[Spectrum, ...]]:
    """Fourier transforms of every record, as the refinement sees them, for all poles alike.

    None of a record too short for projections, by which no candidate is to be judged.
    """
    low, high, used = min(grid.poles), HIGHEST * max(grid.poles), _projected(campaign, grid)
    return [
        campaign.spectra(low, high, slice(i, i + 1)) if record in used else ()
        for i, record in enumerate(campaign.records)
    ]


def _held_out_search(campaign: Campaign, grid: Grid) -> list[Candidate]:
    """Candidates by leaving out whole records, settings one after the other."""
    score = _HeldOut(campaign, _transforms(campaign, grid))
    first = sorted(grid.pasts)[len(grid.pasts) // 2]
    rest = [past for past in grid.pasts if past != first]
    if tried := score(replace(grid, pasts=[first])):
        best = best_of(tried)
        near = [order for order in grid.orders if abs(order - best.order) <= 2]
        tried += score(replace(grid, orders=near, pasts=rest, poles=[best.pole]))
    else:
        tried = score(replace(grid, pasts=rest))
    if not tried:
        return []
    best = best_of(tried)
    last = replace(grid, orders=[best.order], pasts=[best.past], poles=[best.pole])
    for other in grid.regularisations[1:]:
        tried += score(replace(last, regularisations=[other]))
    return tried


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Scores of settings by leaving out whole records; ``data`` are spectra by record."""

    campaign: Campaign
    data: Sequence[Sequence[Spectrum]]

    def __call__(self, grid: Grid) -> list[Candidate]:
        """One Candidate per combination that can be identified."""
        known = [i for i, own in enumerate(self.data) if own]
        folds = [known[i::FOLDS] for i in range(min(FOLDS, len(known)))]
        found = []
        for windows, order in product(grid.windows(_measured(self.campaign.records)), grid.orders):
            models = [_model(self.campaign, order, windows, fold) for fold in folds]
            values = [
                _log_power(model, [s for i in fold for s in self.data[i]], self.campaign)
                for model, fold in zip(models, folds, strict=True)
                if model is not None
            ]
            if folds and len(values) == len(folds):
                found.append(Candidate.of(order, windows).scored(values))
        return found


def _akaike_search(campaign: Campaign, grid: Grid) -> list[Candidate]:
    """Candidates by the corrected Akaike criterion of rough models, `STARTS` an order."""
    data = [own for own in _transforms(campaign, grid) if own]
    direct = int(campaign.mask.sum())
    judge = partial(information_criteria, data=data, su=campaign.su, sy=campaign.sy, direct=direct)
    windows = grid.windows(_measured(campaign.records))
    tried = []
    for order in grid.orders if data else ():
        starts = [(w, _model(campaign, order, w)) for w in windows]
        found = [(w, model) for w, model in starts if model is not None]
        for w, start in sorted(found, key=lambda pair: judge(pair[1]).mean())[:STARTS]:
            tried += _refined(campaign, start, w, data, judge)
        best = best_of(tried)
        if tried and grid.orders.index(order) - grid.orders.index(best.order) >= PATIENCE:
            break
    best = best_of(tried)
    for other in grid.regularisations[1:] if tried else []:
        w = replace(best.windows, regularisation=other)
        again = _model(campaign, best.order, w)
        if again is not None:
            tried += _refined(campaign, again, w, data, judge)
    if len(data) > 1:
        return tried
    N = 2 * len(campaign.sy) * sum(len(spectrum.omega) for spectrum in data[0])
    return [replace(c, error=SUPPORT / N) for c in tried]


def _model(
    campaign: Campaign, order: int, windows: Windows, without: Sequence[int] = ()
) -> StateSpace | None:
    """Subspace model, None where there is none of these settings."""
    try:
        model = campaign.subspace(order, windows, without).system
    except (ValueError, np.linalg.LinAlgError):
        return None
    sampled = max(record.dt for record in campaign.records)
    return model if model.poles().real.max() * sampled < OVERFLOW else None


def _refined(
    campaign: Campaign,
    start: StateSpace,
    windows: Windows,
    data: Sequence[Sequence[Spectrum]],
    judge: Callable[[StateSpace], Array],
) -> list[Candidate]:
    """The candidate with the criterion of its refined model; none where that fails."""
    lines = [spectrum for record in data for spectrum in record]
    try:
        scales = campaign.su, campaign.sy, campaign.mask
        model = refined_system(start, lines, *scales, windows.pole, rough=True)
    except (ValueError, np.linalg.LinAlgError):
        return []
    return [Candidate.of(start.nx, windows).scored(judge(model))]


def _log_power(model: StateSpace, data: Sequence[Spectrum], campaign: Campaign) -> float:
    """Mean logarithm of the residual power in bins of log ω, over outputs and bins."""
    omega, power = residual_powers(model, data, campaign.su, campaign.sy)
    edges = np.geomspace(omega.min(), omega.max() * (1 + 1e-9), BINS + 1)
    which = np.digitize(omega, edges)
    total, count = 0.0, 0
    for k in range(1, BINS + 1):
        lines = power[which == k]
        if len(lines):
            total += len(lines) * float(np.mean(np.log(lines.mean(axis=0))))
            count += len(lines)
    return total / count


def best_of(tried: Sequence[Candidate]) -> Candidate:
    """The candidate of the lowest score; a dummy for none."""
    none = Candidate.of(0, Windows(0, 0, np.nan, 0.0)).scored([np.inf])
    return min(tried, key=lambda c: c.score, default=none)


def with_errors(tried: Sequence[Candidate]) -> list[Candidate]:
    """Standard error of each candidate's mean distance from the best, record by record."""
    # That of a single record is left as it is.
    best = np.array(best_of(tried).folds)
    if len(best) < 2:
        return list(tried)
    spread = [np.std(np.array(c.folds) - best, ddof=1) / np.sqrt(len(best)) for c in tried]
    return [replace(c, error=float(e)) for c, e in zip(tried, spread, strict=True)]


def _parsimonious(tried: Sequence[Candidate]) -> Candidate:
    """Among those within one standard error of the best, the best of the lowest order."""
    best = best_of(tried)
    fair = [c for c in tried if c.score - best.score <= c.error]
    lowest = min(c.order for c in fair)
    return min((c for c in fair if c.order == lowest), key=lambda c: c.score)


def _likeliest(campaign: Campaign, tried: Sequence[Candidate], grid: Grid) -> Candidate:
    """Of the best candidates of every pole, of one order, that of the likeliest refined model."""
    # What is held out is predicted by models that are not refined, from which much noise hides that
    # the refinement of some ends at a lower maximum. Where noise is small, the likelihood rather
    # tells which model fits what is not linear.
    data = [own for own in _transforms(campaign, grid) if own]
    direct = int(campaign.mask.sum())
    judge = partial(information_criteria, data=data, su=campaign.su, sy=campaign.sy, direct=direct)
    found = []
    for pole in {c.pole: None for c in tried}:
        best = best_of([c for c in tried if c.pole == pole])
        start = _model(campaign, best.order, best.windows)
        made = [] if start is None else _refined(campaign, start, best.windows, data, judge)
        found += [(c.score, best) for c in made]
    return min(found, key=lambda pair: pair[0])[1] if found else best_of(tried)


def _default_orders(ny: int, possible: int) -> list[int]:
    """Orders up to three states an output, in steps of two when there are many."""
    highest = min(max(3 * ny, 6), LARGEST, possible)
    return list(range(1, highest + 1)) if highest <= 8 else list(range(4, highest + 1, 2))
