"""Match a structure to a black box and to frequency responses, in the quadratic or H-infinity norm.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3.3: min over λ of ‖Ĝ(s) − G(s; λ)‖ on the shifted line (8)-(10). The programmes are those
of `casid.matching.programme`, their order and the checks are those of `casid.matching.search`.
"""

import logging
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.checks import checked_fields
from casid.declaration import check_priors
from casid.display import listed
from casid.errors import ConvergenceError, warn
from casid.estimates import constraint_table, held_directions, parameter_table
from casid.fit import AnyFit, Fit
from casid.free import Free, free_parameters
from casid.matching.appraisal import MatchNotes
from casid.matching.comparison import Comparison
from casid.matching.conditions import fit_at_conditions
from casid.matching.lack_of_fit import misfit
from casid.matching.reachable_weights import reachable, stated_errors
from casid.matching.search import MatchResult, MatchSearch
from casid.matching.targets import REACHABLE, SIZE, Target, Weight, check_weight_name, comparison_of
from casid.matching.unidentifiable import untold
from casid.model import Bounds, M, Model, Priors
from casid.nlp import SolverOptions
from casid.nonlinear.conditions import Trim, by_condition
from casid.records import several
from casid.threads import one_thread

LOG = logging.getLogger("casid")

NORMS = ("quadratic", "hinf")


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class Match:
    """Match of a structure to targets, as an estimator.

    Parameters
    ----------
    norm : {"hinf", "quadratic"}
        The largest singular value of the weighted error over grid and band, or the mean over the
        grid of its squared Frobenius norm.
    omega : (K,) array
        Grid [rad/s]; 40 points over the black box's band unless given.
    shift : float
        σ >= 0 [1/s], right of all poles of the black box: frequencies below about σ are blurred.
        The default is the least that leaves a margin of a tenth of the rightmost pole's modulus.
    weight : "reachable", "relative", "size", array, None, or a sequence of one a target
        "reachable" divides every pair's error by what a first quadratic fit leaves of it, smoothed
        over ±0.35 nepers of frequency, at least its stated error (the root mean square of the
        complex one) and 5 % of its output's response. "relative" divides every output's error by
        the size of its response at that frequency, "size" (or None) by its standard deviation,
        times the input's; of a StateSpace, which has no records, by the root mean square of its
        responses over frequencies and inputs. An array multiplies that: it broadcasts to
        (K, ny, nu), zeros being masks, linear in ω between the grid's points.
    source_weight : sequence of float
        Factor on the error of each target, one unless given.
    stable_shift : bool
        Keep the structure's poles left of the line s = σ + jω.
    priors : mapping
        ``{parameter: (value, standard deviation)}``: being one deviation off weighs as an error of
        1 % of the response does in the mean square.
    solver : SolverOptions
        Limits of every solve. The tolerance is that of the H-infinity programme; quadratic ones,
        which are small, are solved to 1e-11.
    """

    norm: str = "hinf"
    omega: Array | None = None
    shift: float | None = None
    weight: Weight | Sequence[Weight] = "reachable"
    source_weight: Sequence[float] | None = None
    stable_shift: bool = True
    priors: Priors | None = None
    solver: SolverOptions = SolverOptions()

    def __post_init__(self) -> None:
        if self.norm not in NORMS:
            raise ValueError(f"norm={self.norm!r}: expected one of {', '.join(map(repr, NORMS))}")
        if self.shift is not None and not 0 <= self.shift < np.inf:
            raise ValueError(f"shift={self.shift} 1/s: expected a finite number, 0 or more")
        check_weight_name(self.weight)

    @one_thread
    def fit(
        self,
        model: M,
        data: Target | Sequence[Target] | Mapping[Trim, Target | Sequence[Target]],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,  # noqa: ARG002 - its model is the start already
    ) -> Fit[M, MatchNotes]:
        """The parameters with which a structure comes nearest to targets; see `match`."""
        if isinstance(data, Mapping):
            return fit_at_conditions(self, model, data, fixed, bounds, self._compare)
        begin = time.perf_counter()
        free = free_parameters(model, fixed, bounds, self.priors)
        search = self._search(free, several(data))
        fits = search.quadratic()
        best = search.hinf(fits) if self.norm == "hinf" else fits[0]
        fit = _result(search, best, self, model, time.perf_counter() - begin)
        told = fit.method, fit.cost, fit.iterations, fit.seconds
        LOG.info("%s: cost %.6g, %d iterations, %.2f s", *told)
        if not fit.success:
            raise ConvergenceError(f"match {self.norm}: {fit.status}", best=fit)
        active = np.array([fit.parameters[i].active for i in free.index], dtype=bool)
        found = replace(free, model=fit.model)
        if len(by_condition(model.outputs)) == 1 and (
            said := misfit(found, active, search.comparison, several(data))
        ):
            warn(f"match: {said}")
        if names := untold(free, search.comparison, best.values, active):
            warn(
                f"match: the targets do not determine {listed(names)}: their values are only "
                "where the search ended; fix or tie some of them, or add a target that tells "
                "them apart"
            )
        return fit

    def prepared(
        self,
        model: Model,
        data: Target | Sequence[Target],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
    ) -> "Match":
        """The same with its weights as arrays: many fits to the same targets share them."""
        if not isinstance(self.weight, str) or self.weight != REACHABLE:
            return self
        omega = None if self.omega is None else np.unique(self.omega)
        plain = replace(self, weight=SIZE, omega=omega)
        targets: tuple[Target, ...] = several(data)
        free = free_parameters(model, fixed, bounds, self.priors)
        size = plain._compare(model, targets).sources
        reach = self._search(free, targets).comparison.sources
        weights = [
            np.divide(own.W, unit.W, out=np.zeros_like(own.W), where=unit.W > 0)
            for own, unit in zip(reach, size, strict=True)
        ]
        return replace(plain, weight=weights)

    def _compare(self, model: Model, targets: Sequence[Target]) -> Comparison:
        """The targets in the model's channels; weights by reach begin as relative ones."""
        return comparison_of(
            model,
            targets,
            omega=self.omega,
            shift=self.shift,
            weight=self.weight,
            source_weight=self.source_weight,
        )

    def _search(self, free: Free, targets: Sequence[Target]) -> MatchSearch:
        """The solves, with the weights wanted."""
        comparison = self._compare(free.model, targets)
        search = MatchSearch(free, comparison, stable=self.stable_shift, options=self.solver)
        reach = isinstance(self.weight, str) and self.weight == REACHABLE
        return _reweighted(search, targets) if reach else search


def match(
    model: M,
    target: Target | Sequence[Target] | Mapping[Trim, Target | Sequence[Target]],
    *,
    norm: str = "hinf",
    omega: Array | None = None,
    shift: float | None = None,
    weight: Weight | Sequence[Weight] = "reachable",
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    solver: SolverOptions = SolverOptions(),
) -> Fit[M, MatchNotes]:
    """The parameters with which a structure comes nearest to a target's response.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`; the model's channels are found in the target by name.
    target : BlackBox, FrequencyResponse, StateSpace, or several of them
        What to match. A state-space model counts as a black box that means something everywhere.
        Measured responses enter at their own points of s = jω, weighted by coherence (pairs below
        0.6 are left out), black boxes on s = σ + jω. Of a `NonlinearModel` targets at flight
        conditions, ``{Trim(...): target, ...}``; the fit's model is the structure itself.
    norm, omega, shift, weight, priors, solver
        As in `Match`, which has the rarer settings too.

    Returns
    -------
    Fit
        ``cost`` is the norm (H-infinity) or the mean square (quadratic). ``certificate`` bounds
        the norm over the band. ``notes`` holds singular values over the band, the frequency and
        channels of the optimum, and what each target contributes.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        A channel no target has, a grid outside the band, a shift left of a pole, wrong bounds; no
        solution that passes the checks (``best`` is the best iterate as a `Fit`).
    """
    matching = Match(
        norm=norm, omega=omega, shift=shift, weight=weight, priors=priors, solver=solver
    )
    check_priors(model, priors, fixed, bounds)
    return matching.fit(model, target, fixed=fixed, bounds=bounds)


def _reweighted(search: MatchSearch, targets: Sequence[Target]) -> MatchSearch:
    """The solves with weights by what the quadratic fit reaches, from there."""
    first, model = search.quadratic()[0].values, search.free.model
    sources = search.comparison.sources
    stated = [stated_errors(model, *pair) for pair in zip(targets, sources, strict=True)]
    comparison = reachable(search.comparison, search.system(first), stated)
    free = replace(search.free, model=model.with_vector(search.free.full(first)))
    again = MatchSearch(free, comparison, stable=search.stable, options=search.options)
    again.iterations = search.iterations
    return again


def _named(weight: Weight | Sequence[Weight]) -> str:
    """Name of weights."""
    if weight is None:
        return SIZE
    return weight if isinstance(weight, str) else "given"


def _result(
    search: MatchSearch, found: MatchResult, settings: Match, guess: M, took: float
) -> Fit[M, MatchNotes]:
    """The result, its certificate and its tables."""
    free, values = search.free, found.values
    model = guess.with_vector(free.full(values))
    parameters = parameter_table(free, values, found.multipliers, guess=guess)
    return Fit(
        model=model, parameters=parameters, cost=found.cost, status=found.status,
        success=found.success, iterations=search.iterations, seconds=took,
        method=f"match {settings.norm}",
        notes=replace(found.appraisal.notes(found.start), weight=_named(settings.weight)),
        constraints=constraint_table(model, found.prices, free.constraint_sizes),
        held=held_directions(free, values, parameters), certificate=found.appraisal.certificate(),
        free_names=free.names,
    )  # fmt: skip
