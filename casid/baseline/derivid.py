"""Fit a structure to measured frequency responses in decibels and degrees.

Cost, coherence weighting, accuracy figures and guidelines are those of M. B. Tischler, R. K.
Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*), chapters 12 and 13.
"""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.baseline.accuracy import DerividNotes, PairCost, accuracy, accuracy_row
from casid.baseline.pairs import Pairs, left_out, missing_channels, select, thin
from casid.baseline.search import Minima, descents, pair_costs, solve
from casid.checks import checked_fields
from casid.declaration import check_priors
from casid.display import listed
from casid.errors import ConvergenceError, warn
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
from casid.free import free_parameters, violated
from casid.frequency.covariance import whitener
from casid.frequency.response import FrequencyResponse
from casid.matching.comparison import Comparison
from casid.matching.conditions import fit_at_conditions
from casid.matching.descent import Condensed, check_effects
from casid.matching.lack_of_fit import misfit, residuals
from casid.matching.mismatch import DB, GOOD, TURN, residual_slopes
from casid.matching.programme import Optimum
from casid.matching.targets import Target
from casid.model import Bounds, M, Model, Priors
from casid.nlp import SolverOptions
from casid.nonlinear.conditions import Trim, by_condition
from casid.records import several
from casid.threads import one_thread
from casid.truncated import OnBounds, beside_bounds

GROWN = (
    "and all bands treat residuals as noise, but what a structure misses is not noise: "
    "parameters can be off by more"
)


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class Derivid:
    """Fit of a structure to measured responses in dB and degrees, as an estimator.

    Parameters
    ----------
    pairs : sequence of (output, input), or mapping of these to (low, high) rad/s or None
        The pairs to fit, at all measured points of their range whatever the coherence, which still
        weighs them. Unless given: all pairs with five points of sufficient coherence, at those.
    coherence : float
        What is sufficient, in [0, 1).
    n_omega : int
        Number of frequencies: the measured ones nearest to this many log-spaced points.
    band : (float, float)
        Frequencies to fit [rad/s]; all that were measured unless given.
    starts : int
        Number of starting points: one computed from the measurement, the caller's guess, and
        random ones about the first. Beside a fit ``near`` the first two are enough.
    seed : int
        Of the random ones.
    priors : mapping
        ``{parameter: (value, standard deviation)}``: half the squared distance from each, in
        standard deviations, adds to J, whose Hessian is the information.
    solver : SolverOptions
        Limits of every solve; programmes this small are solved to 1e-11 whatever the tolerance.
    """

    pairs: Pairs | None = None
    coherence: float = 0.6
    n_omega: int = 20
    band: tuple[float, float] | None = None
    starts: int = 10
    seed: int = 0
    priors: Priors | None = None
    solver: SolverOptions = SolverOptions()

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise ValueError(f"starts={self.starts}: expected 1 or more")
        if self.n_omega < 2:
            raise ValueError(f"n_omega={self.n_omega}: expected 2 frequencies or more")
        if not 0 <= self.coherence < 1:
            raise ValueError(f"coherence={self.coherence}: expected 0 or more, below 1")

    @one_thread
    def fit(
        self,
        model: M,
        data: FrequencyResponse | Sequence[FrequencyResponse] | Mapping[Trim, FrequencyResponse],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, DerividNotes]:
        """The parameters with which a structure fits a measured response best; see `derivid`."""
        began = time.perf_counter()
        if isinstance(data, Mapping):
            return self._at_conditions(model, data, fixed, bounds)
        frf = _one_response(data)
        free = free_parameters(model, fixed, bounds, self.priors)
        measured = thin(frf if self.band is None else frf.between(*self.band), self.n_omega)
        problem = Condensed.of(free, self._compare(model, [measured]))
        check_effects(problem, missing_channels(model, measured))
        starts = self.starts if near is None else min(2, self.starts)
        minima = descents(problem, starts, self.seed)
        best = solve(problem, minima, self.solver)
        fit = _result(problem, model, measured, minima, best, time.perf_counter() - began)
        if not fit.success:
            broken = violated(free, best.values)
            why = f"{fit.status}: {broken}" if broken else fit.status
            raise ConvergenceError(
                f"derivid: none of {starts} starts converged ({why}); the best iterate, "
                f"with J = {fit.cost:.4g}, is in .best",
                fit,
            )
        if len(by_condition(measured.outputs)) == 1:  # several may contradict each other: see there
            found = replace(free, model=fit.model)
            active = np.array([fit.parameters[i].active for i in free.index], dtype=bool)
            if said := misfit(found, active, problem.comparison, [measured]):
                warn(f"derivid: {said}; std_error {GROWN}")
        if lost := [row.name for row in fit.parameters if np.isinf(row.cramer_rao)]:
            beside = listed(
                [f"{o} by {i}" for o, i in left_out(measured, problem.comparison, model)]
            )
            warn(
                f"derivid: the fitted pairs do not determine {listed(lost)} one by one: their "
                "errors are infinite, and their values are only where the search ended; fix or "
                "tie some of them, or add responses that tell them apart"
                + f" (measured, but with too little coherence: {beside})"
                * bool(beside)
            )
        return fit

    def _at_conditions(
        self,
        model: M,
        data: Mapping[Trim, FrequencyResponse],
        fixed: Collection[str],
        bounds: Bounds | None,
    ) -> Fit[M, DerividNotes]:
        """Fit at several flight conditions; each response is thinned on its own."""
        own = {
            trim: thin(one if self.band is None else one.between(*self.band), self.n_omega)
            for trim, one in ((trim, _one_response(each)) for trim, each in data.items())
        }
        everything = replace(self, n_omega=sum(len(each.omega) for each in own.values()) ** 2)
        return fit_at_conditions(everything, model, own, fixed, bounds, self._compare, merged=True)

    def _compare(self, model: Model, data: Sequence[Target]) -> Comparison:
        """The one response in the model's channels, weighted."""
        return select(model, _one_response(data), self.pairs, self.coherence)


def derivid(
    model: M,
    target: FrequencyResponse | Sequence[FrequencyResponse] | Mapping[Trim, FrequencyResponse],
    *,
    pairs: Pairs | None = None,
    n_omega: int = 20,
    band: tuple[float, float] | None = None,
    starts: int = 10,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    solver: SolverOptions = SolverOptions(),
) -> Fit[M, DerividNotes]:
    """The parameters with which a structure fits measured responses best in dB and degrees.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`; channels are found in the response by name. Delays are kept at >= 0.
    target : FrequencyResponse
        What to fit; one, so put several together with `merge_responses`. Of a `NonlinearModel`
        responses at flight conditions, ``{Trim(...): response, ...}``.
    pairs, n_omega, band, starts, priors, solver
        As in `Derivid`, which has the rarer settings too.

    Returns
    -------
    Fit
        ``cost`` is the sum of J over pairs. ``std_error`` and ``covariance`` are what the stated
        errors of the responses cause, 4 H⁻¹ SᵀW C W S H⁻¹ with their covariance C, the slopes S of
        the residuals and H = 2 SᵀW S; residuals that
        exceed these surely, smoothed over frequency, stand for them, and a `DataWarning` names
        pairs most of whose points do. ``cramer_rao`` is √(H⁻¹)ᵢᵢ and ``insensitivity`` 1/√Hᵢᵢ, H
        the Gauss-Newton Hessian of the cost: T&R's figures, in which the noise is not. Where
        responses state no errors ``std_error`` is √(H⁻¹)ᵢᵢ too, and a `DataWarning` says so.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        A pair that was not measured, an empty band, bad arguments; a parameter on which no pair
        depends, wrong bounds; no start that converged (``best`` is the best iterate).
    """
    estimator = Derivid(
        pairs=pairs, n_omega=n_omega, band=band, starts=starts, priors=priors, solver=solver
    )
    check_priors(model, priors, fixed, bounds)
    return estimator.fit(model, target, fixed=fixed, bounds=bounds)


def _one_response(data: Target | Sequence[Target]) -> FrequencyResponse:
    """The one response of the data; ValueError for several, or something else."""
    given = several(data)
    if len(given) != 1:
        raise ValueError(
            f"derivid fits one frequency response, not {len(given)}; combine them with "
            "merge_responses([...])"
        )
    if not isinstance(given[0], FrequencyResponse):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"the target is a {type(given[0]).__name__}: derivid fits a measured "
            "FrequencyResponse; use `match` for a black box"
        )
    return given[0]


def _result(
    problem: Condensed, model: M, frf: FrequencyResponse, found: Minima, best: Optimum, took: float
) -> Fit[M, DerividNotes]:
    free = problem.free
    held_by_none = np.zeros(len(free.index), dtype=bool)

    def felt() -> Array:
        return accuracy(_residual_slopes(problem, best.values), held_by_none)[1]

    values = on_bounds(free, best.values, best.multipliers, felt)
    solved = model.with_vector(free.full(values))
    jacobian = _residual_slopes(problem, values)
    active = at_bounds(free, values, accuracy(jacobian, held_by_none)[1])
    held = holding(free, values, held_by_none)
    cr, insensitivity, bound = accuracy(jacobian, active, held)
    covariance = _scatter(problem, frf, values, jacobian, bound)
    scatter = np.full(len(cr), np.nan) if covariance is None else np.sqrt(np.diag(covariance))
    open_, rigid = within(free, values, active, best.multipliers, best.prices)
    noise = bound if covariance is None else covariance
    total = _beside_bounds(jacobian, open_, rigid, bound, noise)
    std = np.sqrt(np.diag(total))
    parameters = parameter_table(free, values, best.multipliers, std, insensitivity, cr, model)
    pairs = _pair_rows(problem, values)
    figures = zip(free.names, values, cr, insensitivity, scatter, strict=True)
    ended = {name: getattr(best, name) for name in ("cost", "status", "success", "iterations")}
    return Fit(
        **ended,
        model=solved,
        parameters=parameters,
        seconds=took,
        method="derivid",
        notes=DerividNotes(
            pairs=pairs,
            average=float(np.mean([row.J for row in pairs])),
            table=tuple(accuracy_row(*row) for row in figures),
            starts=tuple(row for row, _ in found),
        ),
        constraints=constraint_table(solved, best.prices, free.constraint_sizes),
        held=held_directions(free, values, parameters),
        covariance=total,
        free_names=free.names,
    )


def _residual_slopes(problem: Condensed, x: Array) -> Array:
    """dr/dλ of the cost Σ r² at free values: gains, phases, priors."""
    c, weight = problem.comparison, problem.comparison.decibel_weight
    G, slope = problem.matrices(x).response_slopes(c.s)
    rows = residual_slopes(G, slope, c.G, weight)[:, :, weight > 0]
    known = c.prior_weight("decibel") * problem.free.prior_residuals(x)[1]
    return np.vstack([rows.reshape(len(rows), -1).T, known])


def _scatter(
    problem: Condensed, frf: FrequencyResponse, values: Array, jacobian: Array, bound: Array
) -> Array | None:
    """Covariance (nf, nf) of λ that errors of the response cause, correlated as they are.

    Residuals at free values (nf,) that surely exceed the stated errors stand for these.
    ``bound`` is H⁻¹; what it has no finite number for keeps that. None, with a warning, where a
    point that is fitted has no stated error.
    """
    c, model = problem.comparison, problem.free.model
    weight, used = c.decibel_weight, c.W > 0
    known = np.nan_to_num(bound, nan=0.0, posinf=0.0)
    gain = 2 * known @ jacobian.T  # dλ = H⁻¹ 2Jᵀ dr
    n = int(used.sum())
    root = np.sqrt(weight[used])
    own = np.zeros((*used.shape, len(gain)), dtype=complex)
    # dr = √w (DB Re, TURN Im) of ΔG/G
    own[used] = ((DB * gain[:, :n] - 1j * TURN * gain[:, n : 2 * n]) * root / c.G[used]).T
    rows = [model.outputs.index(name) if name in model.outputs else -1 for name in frf.outputs]
    columns = [model.inputs.index(name) if name in model.inputs else -1 for name in frf.inputs]
    place = np.ix_(range(len(own)), rows, columns)
    there = np.outer(np.array(rows) >= 0, np.array(columns) >= 0) & used[place]
    if not np.isfinite(frf.error[there]).all():
        warn(
            "derivid: the response states no errors at some of the fitted points; std_error and "
            "all bands are √(H⁻¹) of the cost, which does not know the noise: give random_error"
        )
        return None
    white = whitener(_grown(problem, replace(frf, flags={}), values), there)
    total = white.spread(np.where(there[..., None], own[place], 0.0))
    priors = gain[:, 2 * n :] * c.prior_weight("decibel")
    return np.where(np.isfinite(bound), total + priors @ priors.T, bound)


def _beside_bounds(
    jacobian: Array, bounded: OnBounds, ties: Array, bound: Array, covariance: Array
) -> Array:
    """A covariance (nf, nf) with what parameters leave open within the bounds that they are on.

    ``bound`` is H⁻¹ with these known.
    """
    if not len(bounded.slope):
        return covariance
    anywhere = bounded.rows * (np.sqrt(6.0) / bounded.room)[:, None]  # H = 2 JᵀJ
    nowhere = np.zeros(len(bound), dtype=bool)
    K = accuracy(np.vstack([jacobian, anywhere]), nowhere, ties)[2]
    known = np.where(np.isnan(covariance), 0.0, covariance)  # on their bounds
    return known + beside_bounds(K, bounded, (bound, covariance))


def _grown(problem: Condensed, frf: FrequencyResponse, values: Array) -> FrequencyResponse:
    """The response with errors as large as its residuals at free values, where that is sure."""
    c = problem.comparison
    found = residuals(problem.free.model, problem.matrices(values), frf, c.sources[0])
    if found is None:
        return frf
    factors = np.ones(frf.G.shape)
    excess = found.white.excess(np.abs(found.r) ** 2 / 2)
    for pair, at, own in found.white.runs():
        i, j = divmod(pair, len(frf.inputs))
        factors[at, i, j] = excess[own]
    return replace(frf, random_error=factors * frf.error, leakage=np.zeros(frf.G.shape))


def _pair_rows(problem: Condensed, values: Array) -> tuple[PairCost, ...]:
    """J, points and band of every pair that is fitted."""
    costs, c, model = pair_costs(problem, values), problem.comparison, problem.free.model
    rows = []
    for i, j in np.argwhere((c.W > 0).any(axis=0)):
        pair = {"output": model.outputs[i], "input": model.inputs[j]}
        omega, J = c.s.imag[c.W[:, i, j] > 0], float(costs[i, j])
        band, misses = (float(omega[0]), float(omega[-1])), ("J",) if J > GOOD else ()
        rows.append(PairCost(**pair, J=J, points=len(omega), band=band, misses=misses))
    return tuple(rows)
