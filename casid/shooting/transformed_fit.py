"""Output error in the frequency domain, from records to a fit."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from casid.arrays import Array
from casid.errors import ConvergenceError, asked, warn
from casid.estimates import (
    at_bounds,
    constraint_table,
    held_directions,
    holding,
    on_bounds,
    parameter_table,
    within,
)
from casid.fit import AnyFit, Fit
from casid.free import Free, violated
from casid.model import M
from casid.nlp import SolverOptions
from casid.prediction import PredictionPlan, predict
from casid.record import Record
from casid.records import common_hold, common_units
from casid.shooting import uncertainty
from casid.shooting.delays import warn_of_jumps
from casid.shooting.frequency import (
    SpectralOutcome,
    SpectralProgramme,
    State,
    close,
    white,
)
from casid.shooting.homogeneity import tell
from casid.shooting.independence import warn_of_missed
from casid.shooting.line_residuals import Residual
from casid.shooting.lines import Lines, transformed
from casid.shooting.precision import OutputErrorNotes, Precision, known_apart
from casid.shooting.solutions import verdict
from casid.shooting.spectral_delays import done, heard, searched
from casid.shooting.spectral_homogeneity import Opposed, opposed
from casid.shooting.spectrum import (
    NoiseSpectrum,
    coherent,
    contrast,
    degrees,
    leftover,
    noise_spectra,
    powers,
    scatter_of_lines,
    weighed_apart,
)

METHOD = "output error in the frequency domain"
FEW = 10.0  # degrees of freedom of a variance: of fewer, errors are less sure than of many
FEWEST = 4.0  # that count, lest a factor be infinite
COLOURED = 3.0  # rise of a spectrum from which smoothing over few lines misses its shape


def estimate(
    model: M,
    free: Free,
    records: Sequence[Record],
    options: SolverOptions,
    *,
    R: Array | None = None,
    near: AnyFit | None = None,
) -> Fit[M, OutputErrorNotes]:
    """Maximum-likelihood estimate on the transforms of whole records; see `OutputError`."""
    begin = time.perf_counter()
    lines = transformed(records)
    warn_of_jumps(records, heard(free, lines, free.guess))
    held = _spectra_of(near, lines) if R is None else white(lines, np.diag(R))
    beside = held is not None and near is not None
    outcome = searched(free, lines, close(options) if beside else options, held)
    if beside and not done(outcome):  # not so close after all
        outcome = searched(free, lines, options, held)
    fit = _fit(model, outcome, begin, known_apart(near), estimated=R is None)
    if not fit.success:
        raise ConvergenceError(f"{METHOD}: {fit.status}", fit)
    return fit


def _spectra_of(near: AnyFit | None, lines: list[Lines]) -> tuple[NoiseSpectrum, ...] | None:
    """Spectra of a fit nearby, held so that costs compare; None if of other records."""
    spectra = getattr(near.notes, "spectra", ()) if near is not None else ()
    kinds = 1 + max(each.kind for each in lines)
    if len(spectra) != kinds or any(
        each.record.name not in spectra[each.kind].records
        or not np.isfinite(spectra[each.kind].power[0, each.seen]).all()
        for each in lines
    ):
        return None
    return tuple(spectra)


def _fit(
    start: M, outcome: SpectralOutcome, begin: float, apart: bool | None, *, estimated: bool
) -> Fit[M, OutputErrorNotes]:
    programme, solution = outcome.programme, outcome.solution
    free, lines = programme.residuals.free, programme.residuals.lines
    multipliers = -programme.n * solution.multipliers_x / programme.scales

    def felt() -> Array:
        state = programme.state(solution.x)
        return np.full(len(free.index), np.inf) if state is None else _insensitivity(state)

    lam = on_bounds(free, solution.x * programme.scales, multipliers, felt)
    model, ties = start.with_vector(free.full(lam)), programme.ties
    prices = -programme.n * solution.multipliers_g[: len(ties)] / ties
    slopes = multipliers, prices
    found, own = _precision(programme, solution.x, lam, slopes, apart, estimated=estimated)
    std, white_std = (np.sqrt(np.diag(part)) for part in (found.covariance, found.cramer_rao))
    parameters = parameter_table(free, lam, multipliers, std, found.insensitivity, white_std)
    unsettled = (
        f"the noise spectra have not settled after {outcome.rounds} rounds, as where much is left "
        'unexplained: add what the structure misses, estimate with domain="time", or give R, which '
        "holds them white"
    )
    more = [uncertainty.singular(lost)] if (lost := found.undetermined) else []
    success, status = verdict(solution, outcome.settled, unsettled, more, violated(free, lam))
    if success and (state := programme.state(solution.x)) is not None:
        missed = warn_of_missed(METHOD, lines, state.residuals, state.taken, programme.spectra)
        if own is not None and asked():
            opposing = own.discord(lines, programme.spectra)
            if opposing and not (missed and opposing.any is None):  # it may set all apart
                tell(opposing, [each.record for each in lines], free.names)
    R = _variances(programme, solution.x)
    system = model.system()
    begun = [predict(system, each.record, np.sqrt(R), PredictionPlan(np.inf)) for each in lines]
    nuisances = len(lines) * (len(model.states) + len(model.outputs))
    notes = found.notes(outcome.rounds, 0, nuisances, None)
    held = common_hold([each.record for each in lines])
    return Fit(
        model=model, parameters=parameters, cost=programme.likelihood(solution.x), status=status,
        success=success, iterations=outcome.iterations, seconds=time.perf_counter() - begin,
        method=METHOD, notes=replace(notes, spectra=programme.spectra, hold=held),
        constraints=constraint_table(model, prices, ties),
        held=held_directions(free, lam, parameters),
        covariance=found.covariance, free_names=free.names, R=np.diag(R),
        initial_states=np.array([each.x0 for each in begun]),
        biases=np.array([each.b for each in begun]),
        units=common_units([each.record for each in lines]),
    )  # fmt: skip


def _variances(programme: SpectralProgramme, x: Array) -> Array:
    """Mean square of the residuals of every output over all lines, (ny,)."""
    lines, state = programme.residuals.lines, programme.state(x)
    if state is None:
        return np.ones(len(lines[0].seen))
    pairs = list(zip(lines, state.residuals, strict=True))
    power = sum(each.weight @ np.abs(found.E) ** 2 for each, found in pairs)
    count = sum(each.weight.sum() * each.seen for each in lines)
    return np.asarray(np.maximum(power / np.maximum(count, 1.0), 1e-300))


def _insensitivity(state: State) -> Array:
    """What each free parameter (nf,) may move with the others known."""
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(np.maximum(np.diag(state.F), 0.0)))


def _precision(
    programme: SpectralProgramme,
    x: Array,
    lam: Array,
    slopes: tuple[Array, Array],
    apart: bool | None,
    *,
    estimated: bool,
) -> tuple[Precision, Opposed | None]:
    """Precision of the free parameters; the robust one allows for correlated outputs.

    And for spectra that are estimated, of few lines: those held if ``estimated``, else those of the
    residuals that a given R leaves; and for records that differ by more than noise makes them,
    which come with it.
    """
    free, state, n = programme.residuals.free, programme.state(x), len(lam)
    if state is None:
        nothing = np.where(np.eye(n, dtype=bool), np.inf, np.nan)
        return Precision(nothing, nothing, np.full(n, np.inf), (), free.names), None
    span = free.scale[free.index]
    insensitivity = _insensitivity(state)
    active = at_bounds(free, lam, insensitivity)
    ties = holding(free, lam, active) * span
    unit = np.outer(span, span)
    alone = state.alone * span**2
    F = state.F * unit
    scaled = uncertainty.bound(F, ties, alone)
    unknown = np.isinf(np.diag(scaled))
    known = uncertainty.determined(F, ties, alone)  # scores keep clear of what is confounded
    lines, taken, P = programme.residuals.lines, state.taken, known * unit
    spectra = programme.spectra if estimated else noise_spectra(lines, state.residuals, taken)
    left = leftover(lines, state.residuals, taken)
    noise = _Noise(spectra, left, estimated)
    middle = _scatter(programme, state, lam, noise) * unit
    robust = np.where(np.isfinite(scaled), known @ middle @ known, scaled)
    found = Precision(
        cramer_rao=scaled * unit,
        covariance=robust * unit,
        insensitivity=insensitivity,
        collinear=uncertainty.collinearities(F, ties, free.names, alone),
        undetermined=tuple(np.array(free.names)[unknown].tolist()),
    )
    found = _allowing(found, P, programme, state, lam, noise)
    found, own = _between_records(found, P, programme, state, apart)
    bounded, rigid = within(free, lam, active, *slopes)
    if not len(bounded.slope):
        return found, own
    both = known, np.where(np.isfinite(scaled), found.covariance / unit, 0.0)
    scaled_bounds = bounded._replace(rows=bounded.rows * span)
    more = unit * uncertainty.beside_bounds(F, rigid * span, alone, scaled_bounds, both)
    return replace(found, covariance=found.covariance + more, beside_bounds=more), own


def _between_records(
    found: Precision, P: Array, programme: SpectralProgramme, state: State, apart: bool | None
) -> tuple[Precision, Opposed | None]:
    """The precision with errors no less than records scatter, and these against each other.

    By the inverse information P (nf, nf); ``apart`` is as `known_apart` has it. Records are not
    asked where what is known beside them pulls at all.
    """
    free, lines = programme.residuals.free, programme.residuals.lines
    if len(lines) < (3 if free.priors else 2) or free.evidence is not None or not P.any():
        return found, None
    if apart is False:
        return found, None
    own = opposed(lines, state.residuals, programme.powers, P, state.g)
    if not (apart or own.scatter):
        return found, None
    if free.priors:
        return found, own
    covariance = own.widened(found.covariance)
    before, after = (np.diag(each) for each in (found.covariance, covariance))
    told = np.isfinite(before) & (before > 0)
    wider = np.sqrt(np.divide(after, before, out=np.ones_like(before), where=told))
    between = np.where(np.isfinite(covariance), covariance - found.covariance, 0.0)
    wide = replace(found, covariance=covariance, records=own.scores, between_records=between)
    return wide, own._replace(wider=wider)


class _Noise(NamedTuple):
    """What residuals are taken to be of."""

    spectra: tuple[NoiseSpectrum, ...]
    left: list[Array]  # degrees of freedom, by `leftover`
    weighs: bool  # whether lines are weighed by it


def _allowing(
    found: Precision,
    known: Array,
    programme: SpectralProgramme,
    state: State,
    lam: Array,
    noise: _Noise,
) -> Precision:
    """The precision with errors widened for a spectrum that is estimated, from few lines.

    By what the lines' own residuals tell beyond the smoothed ones, and as Student's t of their
    degrees of freedom is wider than the normal distribution, and for kinds weighed by their own;
    warns where those are few. ``known`` is the covariance of what is determined.
    """
    told = np.isfinite(np.diag(found.cramer_rao)) & (np.diag(known) > 0)
    if not told.any():
        return found
    lines = programme.residuals.lines
    parts = lines, state.residuals, programme.powers, noise.left
    own, shares = scatter_of_lines(*parts, known)
    own += known @ programme.residuals.free.prior_scatter(lam) @ known
    smooth = np.where(told, np.diag(found.covariance), 1.0)
    more = np.where(told, np.maximum(np.diag(own) / smooth, 1.0), 1.0)
    ratios = _powers_ratio(programme, noise.spectra)
    unit = [(w[:, None] @ c)[:, 0] for w, c in zip(ratios, shares, strict=True)]
    freedom = np.where(told, degrees(lines, unit), np.inf)
    if freedom.min() < FEW and contrast(noise.spectra) > COLOURED:
        few = ", ".join(np.array(programme.residuals.free.names)[freedom < FEW])
        warn(
            f"{METHOD}: the spectrum of the residuals rests on few lines where the records "
            f"determine {few} ({freedom.min():.0f} degrees of freedom): errors may be 2 times "
            'too small; give more records, or estimate with domain="time" (process_noise=True in '
            "turbulence)"
        )
    bounded = np.maximum(freedom, FEWEST)
    if noise.weighs:
        more = more * np.where(told, weighed_apart(lines, unit, FEWEST), 1.0)
    wider = np.sqrt(more / (1 - 2 / bounded))
    return replace(found, covariance=found.covariance * np.outer(wider, wider))


def _scatter(programme: SpectralProgramme, state: State, lam: Array, noise: _Noise) -> Array:
    """Covariance (nf, nf) of the cost's gradient, residuals correlated across outputs."""
    lines = programme.residuals.lines
    across = coherent(lines, state.residuals, powers(noise.spectra, lines), noise.left)
    if noise.spectra is not programme.spectra:
        sizes = [np.sqrt(ratio) for ratio in _powers_ratio(programme, noise.spectra)]
        across = [
            size[:, :, None] * S * size[:, None] for size, S in zip(sizes, across, strict=True)
        ]
    total = Residual.scatter(state.residuals, across)
    return (total + total.T) / 2 + programme.residuals.free.prior_scatter(lam)


def _powers_ratio(programme: SpectralProgramme, spectra: tuple[NoiseSpectrum, ...]) -> list[Array]:
    """Power of weighed residuals of noise of the spectra on lines of every record, (K, ny)."""
    own = powers(spectra, programme.residuals.lines)
    return [mine / held for mine, held in zip(own, programme.powers, strict=True)]
