"""Output-error (maximum-likelihood) estimation by multiple shooting.

    y_k = C x_k + D u(t_k - τ) + b + v_k,   v_k ~ N(0, R) white

Every record is cut into intervals whose initial states are variables tied by continuity
constraints, so an unstable model and a poor start do no harm (Bock 1987); IPOPT with the
generalised Gauss-Newton Hessian minimises ½ Σ rᵀR⁻¹r, and R is re-estimated between solves until
it settles (relaxed maximum likelihood: Jategaonkar, Flight Vehicle System Identification, ch. 4).
Bergamasco & Lovera, section 3.4, use output error as the last step of the chain.
"""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from casid.arrays import Array
from casid.checks import checked_fields
from casid.declaration import check_priors
from casid.errors import ConvergenceError, asked
from casid.estimates import constraint_table, held_directions, parameter_table
from casid.fit import AnyFit, Fit
from casid.free import Free, free_parameters, violated
from casid.frequency.response import FrequencyResponse
from casid.model import Bounds, Initial, M, Model, Priors
from casid.nlp import SolverOptions
from casid.nonlinear.coverage import warn_beyond
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import common_hold, common_units, several
from casid.shooting import uncertainty
from casid.shooting.frequency import IPOPT
from casid.shooting.homogeneity import warn_of_contradiction
from casid.shooting.initial_state_check import warn_of_beginnings
from casid.shooting.innovation import ProcessNoise, check_gain
from casid.shooting.likelihood import CovarianceKind
from casid.shooting.measured_responses import MeasuredResponses, check_responses, reweighed
from casid.shooting.nonlinear import Integration
from casid.shooting.outlying_records import Discord
from casid.shooting.pade_error import warn_rounded
from casid.shooting.precision import OutputErrorNotes, Precision, known_apart, precision
from casid.shooting.priors import warn_contradicted, with_knowledge
from casid.shooting.search import ROUGH, Outcome, Search
from casid.shooting.selection import checked_covariance, select_records
from casid.shooting.solutions import run_away, verdict
from casid.shooting.stiffness import MOST
from casid.shooting.strategies import Ways, exact_outputs, warn_of_missed
from casid.shooting.transformed_fit import estimate
from casid.shooting.whiteness import warn_of_followed, warn_of_innovations
from casid.threads import one_thread

Domain: TypeAlias = Literal["time", "frequency"]


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class OutputError:
    """Output error and filter error, as an estimator.

    Parameters
    ----------
    interval : float
        Length of the shooting intervals [s]; from the model's fastest growing mode unless given.
    R : (ny, ny) array, "diagonal" or "full"
        Covariance of the measurement noise, or the structure in which it is estimated; None is
        "diagonal".
    biases : bool, or collection of str
        Whether every record has a bias on each output, or the outputs that have one.
    state_biases : collection of str
        States whose equations have a constant, another in every record: trim that is not quite
        trim. They come out in ``Fit.state_biases``.
    initial : mapping
        ``{state: (value, standard deviation)}``: what is known of every record's initial state in
        SI; a small deviation holds it. Of linear structures perturbations of the trim, of nonlinear
        ones total values, "trim" being what each record's ``trim`` says.
    priors : mapping
        ``{parameter: (value, standard deviation)}``: what is known from elsewhere, a normal
        distribution that multiplies the likelihood.
    process_noise : bool, "gain", (nx, ny) array or BlackBox
        For flight in turbulence: True estimates the filter-error model, white noise driving every
        state, independently; its densities [state²/s] come out in ``Fit.notes.process_noise``, the
        Kalman filter's gain in ``Fit.notes.K``, and R is of the measurement noise alone. "gain"
        estimates the gain K instead, all nx ny entries freely, R being the innovations', "full"
        where one gust drives several states; a black box gives the gain to start that from, in the
        model's states; an array holds it. K [1/s times state per output] acts on an innovation held
        over the sampling interval.
    steps : int
        Of a nonlinear structure: Runge-Kutta steps a sampling interval, as many as needed unless
        given. ``Fit.notes.integration`` says what shorter ones would change.
    domain : {"time", "frequency"}
        Where residuals are weighed: sample by sample by their covariance, or on the lines of the
        records' transforms by their spectrum, which is estimated, so that what the structure misses
        at some frequencies counts less there. In the frequency domain nothing is shot: no
        ``interval``, no process noise, biases always, R diagonal, records sampled evenly.
        An ``R`` that is given weighs all lines alike, and noise under way when a record begins is
        not eliminated; errors are those of the spectrum that the residuals have.
        Errors allow for how few lines the spectrum comes from, a `DataWarning` tells where that may
        not be enough; and for records that differ by more than noise makes them, which is told.
    responses : sequence of FrequencyResponse
        Measured responses, or another tool's, that enter the same likelihood in either domain: each
        point by its stated error and bias, correlated with its neighbours as the response states;
        flagged points do not count. Of other flights than the records: no datum counts twice.
    solver : SolverOptions
        Limits and tolerance of each solve.
    """

    interval: float | None = None
    R: Array | CovarianceKind | None = None
    biases: bool | Collection[str] = True
    state_biases: Collection[str] = ()
    initial: Initial | None = None
    priors: Priors | None = None
    process_noise: ProcessNoise = False
    steps: int | None = None
    domain: Domain = "time"
    responses: Sequence[FrequencyResponse] = ()
    solver: SolverOptions = SolverOptions()

    @one_thread
    def fit(
        self,
        model: M,
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, OutputErrorNotes]:
        """Maximum-likelihood estimate from records; see `output_error`.

        The noise covariance and biases of a fit ``near`` make the first rounds unnecessary; if that
        fails, all rounds follow. In the frequency domain its spectra are held, so that the costs of
        fits to the same records compare.
        """
        check_responses(model, self.responses, several(data))
        free = self.free(model, fixed, bounds)
        chosen = select_records(free, data, bool(self.biases))
        fit = reweighed(lambda f, rough: self._fitted(model, f, rough, chosen, near), free, near)
        if isinstance(fit.model, NonlinearModel):
            warn_beyond(fit.model, "along the records of the fit", fit.notes.covered)
        warn_contradicted(free, fit)
        warn_rounded(fit, chosen)
        return fit

    def _fitted(
        self, model: M, free: Free, rough: bool, chosen: list[Record], near: AnyFit | None
    ) -> Fit[M, OutputErrorNotes]:
        """The estimate from selected records."""
        begin = time.perf_counter()
        solver = replace(self.solver, tolerance=max(ROUGH * rough, self.solver.tolerance))
        options = replace(solver, ipopt=IPOPT | dict(solver.ipopt))
        if self.domain != "time":
            white = self._checked_for_lines(model)
            return estimate(model, free, chosen, solver, R=white, near=near)
        R = checked_covariance(self.R, len(model.outputs))
        ways = Ways(free, chosen, options, R, bool(self.biases), self.interval, self.steps)
        try:
            if self.process_noise is False:
                outcome = ways.output_error(near)
            else:
                outcome = ways.filtered(self.process_noise)
        except ConvergenceError as error:  # at the start
            best = _unmoved(free, str(error))
            raise ConvergenceError(f"output error: {error}", best) from error
        outcome, steps = Search(free, options, self.steps).integrated(outcome)
        seconds = time.perf_counter() - begin
        fit, discord = _result(model, free, outcome, seconds, known_apart(near), steps)
        if not rough:
            warn_of_missed(outcome, self.interval)
            end = outcome.programme, outcome.solution.x
            warn_of_beginnings(*end)
            if outcome.programme.evaluator.filtering:
                warn_of_innovations(*end)
            elif asked():
                fed_back = warn_of_followed(*end)
                flown = outcome.programme.evaluator.layout.records
                warn_of_contradiction(discord, flown, free.names, fed_back=fed_back)
        return fit

    def free(self, model: M, fixed: Collection[str] = (), bounds: Bounds | None = None) -> Free:
        """What is free of a model; ValueError, ModelError for settings that do not go with it."""
        free = free_parameters(model, fixed, bounds, self.priors)
        _check_nonlinear(model, self.process_noise, self.steps, self.responses)
        check_gain(model, self.process_noise)
        checked_covariance(self.R, len(model.outputs))
        if self.domain != "time":
            self._checked_for_lines(model)
        elif self.interval is not None and not 0 < self.interval < np.inf:
            raise ValueError(
                f"interval={self.interval}: expected seconds above 0, or None to have it chosen"
            )
        if self.responses:
            free = replace(free, evidence=MeasuredResponses(free, several(self.responses)))
        return with_knowledge(free, self.initial, self.biases, self.state_biases)

    def _checked_for_lines(self, model: Model) -> Array | None:
        """R (ny, ny) for the frequency domain, if given; ValueError for what it does not know."""
        if self.domain != "frequency":
            raise ValueError(f'domain={self.domain!r}: expected "time" or "frequency"')
        R = checked_covariance(self.R, len(model.outputs))
        given = None if isinstance(R, str) else R
        wrong = {
            type(model).__name__: isinstance(model, NonlinearModel),
            "interval": self.interval is not None,
            "process_noise": self.process_noise is not False,
            "initial": bool(self.initial),
            "state_biases": bool(self.state_biases),
            "biases": self.biases is not True,
            "R": R == "full" if given is None else bool((np.diag(np.diag(given)) != given).any()),
        }
        for name in (name for name, unknown in wrong.items() if unknown):
            raise ValueError(
                f'{name} does not go with domain="frequency": there what is linear is '
                "transformed and not simulated, constants and initial states are eliminated, and "
                "R is diagonal"
            )
        return given


def _check_nonlinear(
    model: Model, process_noise: ProcessNoise, steps: int | None, responses: object
) -> None:
    """Refuse settings that the structure's kind does not have."""
    if responses and isinstance(model, NonlinearModel):
        raise ValueError(
            f"responses: {type(model).__name__} is nonlinear and has none of its own; match() and "
            "derivid() take responses at flight conditions"
        )
    if not isinstance(model, NonlinearModel):
        if steps is not None:
            raise ValueError(f"steps={steps}: a linear structure is integrated exactly; leave it")
    elif process_noise is not False:
        raise ValueError(
            "process_noise: a nonlinear structure has no filter error; estimate a filter-error "
            f"model of {type(model).__name__}().at(trim), or leave it out"
        )
    elif steps is not None and not 1 <= steps <= MOST:
        raise ValueError(f"steps={steps}: expected 1 to {MOST} a sampling interval")


def output_error(
    model: M,
    records: Record | Sequence[Record],
    *,
    interval: float | None = None,
    R: Array | CovarianceKind | None = None,
    biases: bool | Collection[str] = True,
    process_noise: ProcessNoise = False,
    priors: Priors | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    domain: Domain = "time",
    responses: FrequencyResponse | Sequence[FrequencyResponse] = (),
    solver: SolverOptions = SolverOptions(),
) -> Fit[M, OutputErrorNotes]:
    """Maximum-likelihood estimate of a model from time histories.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`; the start is, for example, ``match(...).model``.
    records : Record or sequence of Record
        With at least the model's channels, by name; NaN in y and any sampling are welcome.
    interval, R, biases, process_noise, priors, domain, responses, solver
        As in `OutputError`, which has the rarer settings too.

    Returns
    -------
    Fit
        ``cost`` is the negative logarithm of the likelihood, ½ Σ (rᵀR⁻¹r + log det R), less its
        constant ½ n log 2π; ``std_error`` allows for residuals correlated in time and across
        outputs, ``cramer_rao`` does not. Without process noise a `DataWarning` names the record, or
        the few, by which estimates move and without which the others agree: one of a wrong trim,
        unit or gain. Where the others contradict each other, too, it is told if residuals follow no
        input, as of a response that depends on amplitude and not of a structure that misses
        something. Errors are then no less than those by which estimates scatter from record to
        record.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        No records, a missing channel, a record too short, an R that is no covariance; IPOPT stopped
        early (``best`` is the `Fit` so far).
    """
    estimator = OutputError(
        interval=interval,
        R=R,
        biases=biases,
        process_noise=process_noise,
        priors=priors,
        domain=domain,
        responses=several(responses),
        solver=solver,
    )
    check_priors(model, priors, fixed, bounds)
    return estimator.fit(model, records, fixed=fixed, bounds=bounds)


def _verdict(outcome: Outcome, found: Precision, broken: str | None) -> tuple[bool, str]:
    """Whether this is a solution, and in words."""
    reasons = []
    if exact := exact_outputs(outcome):
        reasons.append(
            f"the likelihood degenerates: {', '.join(exact)} can be predicted exactly, as without "
            "measurement noise; use output error, or give R"
        )
    lost = len(found.undetermined)
    if away := run_away(outcome.programme, outcome.solution.x, lost):
        reasons.append(away)
    elif lost and (outcome.solution.success or lost < outcome.programme.evaluator.nf):
        reasons.append(uncertainty.singular(found.undetermined, outcome.programme.free.model))
    unsettled = f"R has not settled after {outcome.rounds} rounds; give R"
    return verdict(outcome.solution, outcome.settled, unsettled, reasons, broken)


def _unmoved(free: Free, status: str) -> Fit[Model, None]:
    """The start as a failed fit."""
    return Fit(
        model=free.model.with_vector(free.full(free.guess)),
        parameters=parameter_table(free, free.guess, np.zeros(len(free.index))),
        cost=np.nan, status=status, success=False, iterations=0, seconds=0.0,
        method="output error", notes=None, free_names=free.names,
    )  # fmt: skip


def _result(
    start: M,
    free: Free,
    outcome: Outcome,
    seconds: float,
    apart: bool | None,
    steps: Integration | None = None,
) -> tuple[Fit[M, OutputErrorNotes], Discord | None]:
    """The fit, and what is to be told of its records."""
    programme, solution = outcome.programme, outcome.solution
    evaluator = programme.evaluator
    point, final = programme.unpack(solution.x), programme.values(solution.x)
    n = len(free.index)
    multipliers = -programme.n * solution.multipliers_x[:n] / programme.scales.lam[:n]
    ties = programme.ties
    prices = -programme.n * solution.multipliers_g[len(solution.g) - len(ties) :] / ties
    lam, found = precision(programme, solution.x, multipliers, prices, apart)
    model = start.with_vector(free.full(lam))
    std, white = (np.sqrt(np.diag(part)) for part in (found.covariance, found.cramer_rao))
    success, status = _verdict(outcome, found, violated(programme.free, lam))
    K, Q = evaluator.held_gain(point.lam), evaluator.densities(point.lam)
    firsts = np.searchsorted(programme.record, np.arange(programme.records))
    constant = np.isin(free.model.states, free.model.constant_states)
    own = np.isin(free.model.states, start.states)
    biased = ~np.isin(free.model.outputs, free.unbiased)  # others have none, but for rounding
    parameters = parameter_table(free, lam, multipliers, std, found.insensitivity, white)
    fit = Fit(
        model=model, parameters=parameters, cost=programme.n * final.cost, status=status,
        success=success, iterations=outcome.iterations, seconds=seconds,
        method="filter error" if evaluator.filtering else "output error",
        notes=replace(
            found.notes(outcome.rounds, programme.J, programme.nuisances, K, Q), integration=steps,
            covered=evaluator.covered(point), hold=common_hold(evaluator.layout.records),
        ),
        constraints=constraint_table(model, prices, ties),
        held=held_directions(free, lam, parameters),
        covariance=found.covariance, free_names=free.names, R=final.R,
        initial_states=point.nodes[firsts][:, own], biases=point.bias * biased,
        interval=evaluator.layout.interval, units=common_units(evaluator.layout.records),
        state_biases=point.nodes[firsts][:, constant] if constant.any() else None,
    )  # fmt: skip
    if not success:
        raise ConvergenceError(f"output error: {status}", fit)
    return fit, found.discord
