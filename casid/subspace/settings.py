"""Settings of the black box chosen from data: order, window, Laguerre pole, regularisation.

Where every input is excited in two records or more, records are held out whole, one fold after the
other, and predicted by the model of the rest; a free transient makes unstable models no special
case (`casid.subspace.fourier`). The score is the mean logarithm of the residual power in frequency
bins: the log-likelihood with an unknown residual spectrum. The settings chosen are the lowest order
whose score is within one standard error of the best.

Where records are too few for that, holding out stretches of them leaves too little to learn from,
and the score is the corrected Akaike criterion of the refined model, the large-sample equivalent of
leaving out one Fourier line after the other (M. Stone, J. R. Stat. Soc. B 39 (1977) 44-47). At
every order the criterion before the refinement says which poles and windows are worth refining.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record, Records, same_channels, standard_deviations, stretches
from casid.subspace.columns import (
    Feedthrough,
    feedthrough_mask,
    gather,
    output_bandwidth,
    pieces_of,
)
from casid.subspace.fourier import Spectrum, spectra
from casid.subspace.laguerre import support
from casid.subspace.predictor import Stack, triangular
from casid.subspace.realisation import subspace_model
from casid.subspace.refinement import information_criteria, refine, residual_powers
from casid.values import storable

HIGHEST = 2.0  # of the Laguerre pole: frequencies above it are not looked at
POLES = (1, 1.4, 2, 3, 4, 6, 8)  # of a decade: what poles are chosen from
SPAN = (1.2, 3.6)  # of the outputs' bandwidth: 6 to 14 rad/s for most helicopters
PASTS = (8, 10, 12)
REGULARISATIONS = (1e-3, 1e-2)
COST = 0.25  # of the longest record: what kernels past its end may cost
FOLDS = 8
BINS = 8
STARTS = 2  # poles and windows refined at every order where nothing is held out
EXCITED = 0.3  # of the largest standard deviation: what counts as exciting an input


@storable
@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One choice of settings and its score, the lower the better.

    ``folds`` are the scores record by record (of those held out, or of all), ``error`` the standard
    error of their mean's distance from the best candidate.
    """

    order: int
    past: int
    pole: float
    regularisation: float
    score: float
    error: float
    folds: tuple[float, ...]


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class OrderSelection:
    """Which settings the data chose.

    Parameters
    ----------
    chosen : Candidate
        The settings.
    candidates : tuple of Candidate
        All that were tried, in that order.
    criterion : str
        "held-out records" or "AICc".
    singular_values : (min(future ny, ...),) array
        Of the predicted future at the chosen pole and past.
    """

    chosen: Candidate
    candidates: tuple[Candidate, ...]
    criterion: str
    singular_values: Array

    def to_markdown(self) -> str:
        """The table of candidates, the chosen one marked."""
        lines = [
            f"| order | past | pole [rad/s] | regularisation | {self.criterion} |",
            "|---|---|---|---|---|",
        ]
        for c in self.candidates:
            mark = " **chosen**" if c == self.chosen else ""
            lines.append(
                f"| {c.order} | {c.past} | {c.pole:g} | {c.regularisation:g} "
                f"| {c.score:.4f} ± {c.error:.4f}{mark} |"
            )
        return "\n".join(lines)


def select_order(
    records: Records,
    *,
    orders: Sequence[int] | None = None,
    pasts: Sequence[int] | None = None,
    poles: Sequence[float] | None = None,
    regularisations: Sequence[float] | None = None,
    feedthrough: Feedthrough = True,
) -> OrderSelection:
    """Choose the settings of `pbsid` from the records themselves; deterministic.

    Parameters
    ----------
    records : sequence of Record
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
        No candidate can be identified from these records; the last reason is told.
    """
    records = stretches(records)
    inputs, outputs = same_channels(records)
    su, sy = standard_deviations(records)
    mask = feedthrough_mask(feedthrough, inputs, outputs)
    campaign = _Campaign(tuple(records), su, sy, mask)
    held_out = held_out_suffices(records)
    a_grid = usable_poles(records) if poles is None else [float(a) for a in poles]
    p_grid = list(PASTS if pasts is None else pasts)
    r_grid = list(REGULARISATIONS if regularisations is None else regularisations)
    highest = sorted(p_grid)[len(p_grid) // 2] * len(outputs)
    o_grid = _default_orders(len(outputs), highest) if orders is None else list(orders)
    search = _held_out_search if held_out else _akaike_search
    tried = search(campaign, o_grid, p_grid, a_grid, r_grid)
    if not tried:
        raise ValueError(
            f"no settings can be identified from {len(records)} record(s), the longest of "
            f"{max(r.duration for r in records):.3g} s: tried orders {o_grid}, past {p_grid}, "
            f"poles {a_grid} rad/s; give longer records, or a lower order and past"
        )
    tried = _with_errors(tried)
    chosen = _parsimonious(tried)
    stack, _ = gather(records, su, sy, chosen.past, chosen.pole)
    found = subspace_model(
        stack, su, sy, chosen.pole, order=chosen.order, future=chosen.past, feedthrough=mask,
        regularisation=chosen.regularisation, dt=1.0,
    )  # fmt: skip
    return OrderSelection(
        chosen=chosen,
        candidates=tuple(tried),
        criterion="held-out records" if held_out else "AICc",
        singular_values=found.singular_values,
    )


def held_out_suffices(records: Sequence[Record]) -> bool:
    """Whether every input is excited in two records or more, so that one may be held out."""
    std = np.array([np.std(record.u, axis=0) for record in records])
    return bool(np.all((std >= EXCITED * std.max(axis=0)).sum(axis=0) >= 2))


@dataclass(frozen=True, eq=False)
class _Campaign:
    """What all candidates share."""

    records: tuple[Record, ...]
    su: Array
    sy: Array
    mask: BoolArray

    def model(self, stack: Stack, a: float, order: int, regularisation: float) -> StateSpace:
        """Continuous subspace model from gathered columns."""
        return subspace_model(
            stack, self.su, self.sy, a, order=order, future=stack.past, feedthrough=self.mask,
            regularisation=regularisation, dt=1.0,
        ).system  # fmt: skip

    def criteria(self, model: StateSpace, data: Sequence[Sequence[Spectrum]]) -> Array:
        """Corrected Akaike criterion record by record."""
        direct = int(self.mask.sum())
        return information_criteria(model, data, self.su, self.sy, direct)

    def windows(self, poles: Sequence[float], pasts: Sequence[int]) -> list[tuple[float, int]]:
        """Poles and windows whose kernels cost at most a quarter of the longest record.

        All of them where there is nothing to choose.
        """
        pairs = list(product(poles, pasts))
        longest = max(record.duration for record in self.records)
        fit = [(a, past) for a, past in pairs if support(a, past) <= COST * longest]
        return pairs if len(pairs) == 1 else fit

    def transforms(self, record: Record, poles: Sequence[float]) -> tuple[Spectrum, ...]:
        """Fourier transforms of a record, as the refinement sees them, for all poles alike."""
        pieces = [piece for piece, _ in pieces_of(record, min(poles))]
        return spectra(pieces, self.su, self.sy, HIGHEST * max(poles))


def _held_out_search(
    campaign: _Campaign,
    orders: Sequence[int],
    pasts: Sequence[int],
    poles: Sequence[float],
    regularisations: Sequence[float],
) -> list[Candidate]:
    """Candidates by leaving out whole records, settings one after the other."""
    data = [campaign.transforms(record, poles) for record in campaign.records]
    first = sorted(pasts)[len(pasts) // 2]
    tried = _held_out_scores(campaign, data, orders, [first], poles, regularisations[0])
    best = _best(tried)
    near = [order for order in orders if abs(order - best.order) <= 2]
    rest = [past for past in pasts if past != first]
    tried += _held_out_scores(campaign, data, near, rest, [best.pole], regularisations[0])
    best = _best(tried)
    for other in regularisations[1:]:
        tried += _held_out_scores(campaign, data, [best.order], [best.past], [best.pole], other)
    return tried


def _held_out_scores(
    campaign: _Campaign,
    data: Sequence[Sequence[Spectrum]],
    orders: Sequence[int],
    pasts: Sequence[int],
    poles: Sequence[float],
    regularisation: float,
) -> list[Candidate]:
    """One Candidate per combination that can be identified; ``data`` are spectra by record."""
    found = []
    folds = [range(i, len(data), FOLDS) for i in range(min(FOLDS, len(data)))]
    for a, past in campaign.windows(poles, pasts):
        stacks = [gather([r], campaign.su, campaign.sy, past, a)[0] for r in campaign.records]
        kept = [
            _joined([stack for i, stack in enumerate(stacks) if i not in fold]) for fold in folds
        ]
        for order in orders:
            try:
                models = [campaign.model(stack, a, order, regularisation) for stack in kept]
            except (ValueError, np.linalg.LinAlgError):
                continue
            values = [
                _log_power(model, [spectrum for i in fold for spectrum in data[i]], campaign)
                for model, fold in zip(models, folds, strict=True)
            ]
            found.append(_candidate(order, past, a, regularisation, values))
    return found


def _akaike_search(
    campaign: _Campaign,
    orders: Sequence[int],
    pasts: Sequence[int],
    poles: Sequence[float],
    regularisations: Sequence[float],
) -> list[Candidate]:
    """Candidates by the corrected Akaike criterion of refined models, `STARTS` an order."""
    data = [campaign.transforms(record, poles) for record in campaign.records]
    starts: dict[int, list[tuple[Candidate, StateSpace]]] = {order: [] for order in orders}
    for a, past in campaign.windows(poles, pasts):
        stack, _ = gather(campaign.records, campaign.su, campaign.sy, past, a)
        for order in orders:
            start = _start(campaign, stack, a, order, regularisations[0])
            if start is not None:
                values = campaign.criteria(start, data)
                candidate = _candidate(order, past, a, regularisations[0], values)
                starts[order].append((candidate, start))
    tried = []
    for found in starts.values():
        for like, start in sorted(found, key=lambda pair: pair[0].score)[:STARTS]:
            tried += _refined(campaign, start, like, data)
    best = _best(tried)
    for other in regularisations[1:] if tried else []:
        stack, _ = gather(campaign.records, campaign.su, campaign.sy, best.past, best.pole)
        start = _start(campaign, stack, best.pole, best.order, other)
        if start is not None:
            tried += _refined(campaign, start, replace(best, regularisation=other), data)
    return tried


def _start(
    campaign: _Campaign, stack: Stack, a: float, order: int, regularisation: float
) -> StateSpace | None:
    """Subspace model, None where there is none of these settings."""
    try:
        return campaign.model(stack, a, order, regularisation)
    except (ValueError, np.linalg.LinAlgError):
        return None


def _refined(
    campaign: _Campaign, start: StateSpace, like: Candidate, data: Sequence[Sequence[Spectrum]]
) -> list[Candidate]:
    """The candidate with the criterion of its refined model; none where that fails."""
    lines = [spectrum for record in data for spectrum in record]
    try:
        model, _ = refine(start, lines, campaign.su, campaign.sy, campaign.mask, like.pole)
    except np.linalg.LinAlgError:
        return []
    values = campaign.criteria(model, data)
    return [_candidate(like.order, like.past, like.pole, like.regularisation, values)]


def _candidate(
    order: int, past: int, a: float, regularisation: float, values: Sequence[float] | Array
) -> Candidate:
    return Candidate(
        order=order, past=past, pole=a, regularisation=regularisation,
        score=float(np.mean(values)), error=0.0, folds=tuple(map(float, values)),
    )  # fmt: skip


def _joined(stacks: Sequence[Stack]) -> Stack:
    R = triangular(np.vstack([stack.R for stack in stacks]))
    first = stacks[0]
    return Stack(R, first.nu, first.ny, first.past, sum(stack.columns for stack in stacks))


def _log_power(model: StateSpace, data: Sequence[Spectrum], campaign: _Campaign) -> float:
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


def _best(tried: Sequence[Candidate]) -> Candidate:
    if not tried:
        return Candidate(order=0, past=0, pole=np.nan, regularisation=0.0, score=np.inf, error=0.0,
                         folds=())  # fmt: skip
    return min(tried, key=lambda c: c.score)


def _with_errors(tried: Sequence[Candidate]) -> list[Candidate]:
    """Standard error of each candidate's mean distance from the best, record by record."""
    best = np.array(_best(tried).folds)
    if len(best) < 2:
        return list(tried)
    spread = [np.std(np.array(c.folds) - best, ddof=1) / np.sqrt(len(best)) for c in tried]
    return [replace(c, error=float(e)) for c, e in zip(tried, spread, strict=True)]


def _parsimonious(tried: Sequence[Candidate]) -> Candidate:
    """Among those within one standard error of the best, the best of the lowest order."""
    best = _best(tried)
    fair = [c for c in tried if c.score - best.score <= c.error]
    lowest = min(c.order for c in fair)
    return min((c for c in fair if c.order == lowest), key=lambda c: c.score)


def _default_orders(ny: int, possible: int) -> list[int]:
    """Orders up to three states an output, in steps of two when there are many."""
    highest = min(max(3 * ny, 6), possible)
    return list(range(1, highest + 1)) if highest <= 8 else list(range(4, highest + 1, 2))


def usable_poles(records: Sequence[Record]) -> list[float]:
    """Laguerre poles [rad/s] worth trying: somewhat faster than the outputs move.

    Their kernels cost at most a quarter of the longest record, and their band is sampled.

    Raises
    ------
    ValueError
        Records too short for how slowly they are sampled.
    """
    longest = max(record.duration for record in records)
    slowest = support(1.0, min(PASTS)) / (COST * longest)
    fastest = 0.5 * np.pi / max(record.dt for record in records)
    if slowest > fastest:
        raise ValueError(
            f"records of {longest:.3g} s sampled every {records[0].dt:.3g} s suit no Laguerre "
            "pole: kernels short enough are not sampled; give longer records or faster sampling, "
            "or name the pole, past and order"
        )
    low, high = np.clip(np.array(SPAN) * output_bandwidth(records), slowest, fastest)
    ratio = SPAN[1] / SPAN[0]
    high = max(high, min(ratio * low, fastest))
    low = min(low, max(high / ratio, slowest))
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    grid = [float(f"{first}e{decade}") for decade in decades for first in POLES]
    return [a for a in grid if low <= a <= high] or [float(np.sqrt(low * high))]
