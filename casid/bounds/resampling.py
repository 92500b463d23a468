"""The same fit many times: with other noise, with the residuals shuffled."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any, cast

import numpy as np
import scipy

from casid.arrays import Array
from casid.bounds.draws import BlockDraw, KnownInitial, NoiseDraw
from casid.bounds.leverage import leverages
from casid.bounds.pooled_warnings import heard, tell_of_draws
from casid.bounds.trials import Draw, Fits
from casid.checks import check_known, check_level
from casid.display import Shown, counted, listed
from casid.errors import warn
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.free import free_parameters
from casid.jobs.campaigns import Execution
from casid.model import Bounds, Initial, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import several, stretches
from casid.shooting.likelihood import Noise, moments_of
from casid.shooting.output_error import OutputError
from casid.shooting.priors import bias_states, wider
from casid.shooting.simulation import fitting_start, simulate
from casid.shooting.transformed_fit import METHOD
from casid.tabulation import csv_text, markdown_table

SAME_COST = 1e-3  # of log-likelihood a sample, between a fit and its own records
SAME_POWER = 0.2  # difference of logarithms of variances that makes residuals another fit's
COVERED = 1.96  # standard errors of a 95 % interval
PRIORS = 1  # seed of what priors are drawn by, beside that of the residuals


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Ensemble(Shown):
    """Estimates from many draws of the data.

    Parameters
    ----------
    names : tuple of str
        Free parameters.
    reference : (nf,) array
        The values the data were made with.
    values, std_errors : (n, nf) array
        Of every draw; NaN where the fit failed.
    reasons : tuple of str
        Why, empty otherwise.
    """

    names: tuple[str, ...]
    reference: Array
    values: Array
    std_errors: Array
    reasons: tuple[str, ...]

    def headline(self) -> str:
        """How many draws of how many parameters."""
        failed = sum(bool(reason) for reason in self.reasons)
        draws = counted(len(self.values), "draw") + (f", {failed} failed" if failed else "")
        return f"{draws}, of {counted(len(self.names), 'parameter')}: {listed(self.names)}"

    @property
    def bias(self) -> Array:
        """Mean of the estimates less the reference, (nf,)."""
        return np.asarray(np.nanmean(self.values, axis=0) - self.reference)

    @property
    def scatter(self) -> Array:
        """Standard deviation of the estimates, (nf,)."""
        return np.asarray(np.nanstd(self.values, axis=0, ddof=1))

    @property
    def coverage(self) -> Array:
        """Share of 95 % intervals of the draws that hold the reference, (nf,).

        Estimates on a bound have no interval; NaN where none has.
        """
        inside = np.abs(self.values - self.reference) <= COVERED * self.std_errors
        stated = ~np.isnan(self.values + self.std_errors)
        held, count = (inside & stated).sum(axis=0), stated.sum(axis=0)
        return np.asarray(np.where(count > 0, held / np.maximum(count, 1), np.nan))

    def interval(self, level: float = 0.95) -> Array:
        """Interval that holds one more draw with this probability, (nf, 2).

        Between order statistics of the n estimates, at n + 1 times each tail's probability
        (S. S. Wilks, Ann. Math. Stat. 12(1), 1941): percentiles of few are too close together.
        Where both tails together are less than 2 / (n + 1), beyond all n, Student's t about their
        mean, for estimates that are normal; NaN of fewer than two.
        """
        check_level(level, "share")
        tail, done = (1 - level) / 2, self.values[[not reason for reason in self.reasons]]
        n = len(done)
        if n < 2:
            return np.full((len(self.names), 2), np.nan)
        if tail * (n + 1) >= 1:
            return np.asarray(np.quantile(done, [tail, 1 - tail], axis=0, method="weibull").T)
        reach = scipy.special.stdtrit(n - 1, 1 - tail) * np.sqrt(1 + 1 / n) * self.scatter
        return np.asarray(done.mean(axis=0) + np.multiply.outer([-1, 1], reach)).T

    def to_csv(self) -> str:
        """One row a draw."""
        columns = [*self.names, *(f"std_{name}" for name in self.names), "reason"]
        rows = [
            [*values, *errors, reason]
            for values, errors, reason in zip(
                self.values.tolist(), self.std_errors.tolist(), self.reasons, strict=True
            )
        ]
        return csv_text(columns, rows)

    def to_markdown(self) -> str:
        """One row a parameter."""
        claimed = np.ma.masked_invalid(self.std_errors).mean(axis=0).filled(np.nan)
        columns = (self.reference, self.bias, self.scatter, claimed, self.coverage)
        rows = [[name, *(f"{c[k]:.4g}" for c in columns)] for k, name in enumerate(self.names)]
        heading = ("parameter", "reference", "bias", "scatter", "mean std. error", "coverage")
        return markdown_table(heading, rows)


def monte_carlo(
    model: Model,
    records: Record | Sequence[Record],
    *,
    noise: Mapping[str, float],
    runs: int = 50,
    seed: int = 0,
    estimator: Estimator = OutputError(),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Ensemble:
    """Simulate a model on the inputs of records, add noise, estimate; many times.

    Parameters
    ----------
    model : Model
        The truth; every fit starts from it.
    records : Record or sequence of Record
        Inputs; of the outputs only which samples are missing. A nonlinear structure is simulated as
        such, from the state that fits each record best, which its outputs tell if they move.
    noise : mapping
        Standard deviation of every output's white noise.
    runs, seed : int
        Run k draws its noise from seed and k alone; two runs at least.
    estimator, fixed, bounds, execution
        As in `compare_bounds`; an estimator from records. Its priors are the same in every run: the
        estimates scatter by what the records' noise makes of them, less than they are known to.

    Raises
    ------
    ValueError
        Too few runs, noise on what is no output, an output without noise.
    """
    _check_runs(runs, estimator)
    check_known("noise names", noise, model.outputs)
    quiet = [name for name in model.outputs if not noise.get(name, 0.0) > 0]
    if quiet:
        raise ValueError(
            f"noise lacks {', '.join(quiet)}: every output needs a standard deviation, as is "
            "estimated for measured ones; give a very small one, or a structure without that "
            "output"
        )
    flown = [piece for record in several(records) for piece in record.stretches()]
    clean = [_simulated(model, record) for record in flown]
    draws: list[Draw] = [NoiseDraw(dict(noise), (seed, run)) for run in range(runs)]
    return _ensemble(Fits(model, clean, estimator, fixed, bounds, execution), draws, None)


def bootstrap(
    fit: AnyFit,
    records: Record | Sequence[Record],
    *,
    runs: int = 50,
    block: float = 1.0,
    seed: int = 0,
    estimator: Estimator = OutputError(),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Ensemble:
    """Put the residuals of an output-error fit back in blocks and estimate again; many times.

    Blocks keep the residuals' correlation in time, which the Cramér-Rao bound leaves out (H. R.
    Künsch, Ann. Statist. 17(3), 1989). What parameters, initial states and biases took out of them
    is put back block by block, as if the noise were white there (R. M. Bell and D. F. McCaffrey,
    Survey Methodology 28(2), 2002). ``scatter`` is that of the estimates; `Ensemble.interval` is
    for the truth where estimates scatter about it as draws do about the estimates.

    Parameters
    ----------
    fit : Fit
        Of these records, by `output_error`.
    records : Record or sequence of Record
        In the same order.
    runs, seed : int
        Run k draws its blocks from seed and k alone; two runs at least.
    block : float
        Length of the blocks [s]: several times longer than the residuals are correlated, as no
        correlation is left across blocks, and at most a third of the longest record.
    estimator, execution
        As in `compare_bounds`; an estimator from records, with the fit's ``biases`` and
        ``state_biases``. Values of its priors are drawn too, about the estimates, being
        measurements like others, and initial states about what is known of them, of a linear
        structure.
    fixed, bounds
        Beside those of the fit: what it held is held, within its bounds unless there are others.

    Raises
    ------
    ValueError
        A fit that is not one of these records; too few runs, no length of blocks.
    """
    _check_runs(runs, estimator)
    if not block > 0:
        raise ValueError(f"block={block}: expected seconds above 0, longer than the correlation")
    with heard() as told:
        flown = stretches(records)
    if (most := max((each.N * each.dt for each in flown), default=np.inf) / 3) < block:
        raise ValueError(
            f"block={block}: expected {most:.3g} s at most, a third of the longest record; there "
            "are too few longer blocks to draw from"
        )
    model, nonlinear = fit.model, isinstance(fit.model, NonlinearModel)
    flying, x0 = _flying(fit, len(flown), tuple(getattr(estimator, "state_biases", ())))
    _check_biases(fit, estimator)
    simulated = [
        _simulated(flying, record, *known)
        for record, *known in zip(flown, x0, np.asarray(fit.biases), strict=True)
    ]
    residuals = tuple(
        (record.total() if nonlinear else record).select(model.inputs, model.outputs).y - clean.y
        for record, clean in zip(flown, simulated, strict=True)
    )
    known = any(getattr(estimator, each, None) for each in ("priors", "initial"))
    _check_residuals(fit, residuals, known=known)
    initial = _initial(estimator, flying, x0)
    again = [_redrawn(estimator, model, (seed, run)) for run in range(runs)]
    held = (*fixed, *(row.name for row in fit.parameters if row.fixed and row.name not in fixed))
    own = {row.name: (row.lower, row.upper) for row in fit.parameters if row.name not in held}
    taken = leverages(fit, flying, estimator, simulated, x0)
    draws: list[Draw] = [
        BlockDraw(residuals, block, (seed, run), initial, taken) for run in range(runs)
    ]
    many = Fits(model, simulated, estimator, held, own | dict(bounds or {}), execution)
    return _ensemble(many, draws, fit, again, told)


def _flying(fit: AnyFit, records: int, state_biases: tuple[str, ...]) -> tuple[Model, Array]:
    """The model with the fit's constants as states, and the initial states of each record.

    ValueError unless the fit is one of so many records and of these constants.
    """
    known = fit.method in {"output error", METHOD}
    if not known or fit.initial_states is None or fit.biases is None:
        raise ValueError(f"bootstrap needs an output-error fit; this is one by {fit.method}")
    if len(fit.biases) != records:
        raise ValueError(
            f"the fit is one of {counted(len(fit.biases), 'record')}; bootstrap was given {records}"
        )
    constants = np.zeros((records, 0)) if fit.state_biases is None else fit.state_biases
    if constants.shape[1] != len(state_biases):
        raise ValueError(
            f"the fit has {counted(constants.shape[1], 'state bias')}, the estimator "
            f"{len(state_biases)}: give the estimator of the fit"
        )
    flying = wider(fit.model, state_biases)
    names = (*fit.model.states, *bias_states(state_biases))
    order = [names.index(state) for state in flying.states]
    return flying, np.hstack([fit.initial_states, constants])[:, order]


def _initial(estimator: Estimator, flying: Model, x0: Array) -> KnownInitial | None:
    """What is known of the initial states (records, nx); None where that is nothing."""
    told: Initial = getattr(estimator, "initial", None) or {}
    if not told:
        return None
    if isinstance(flying, NonlinearModel):
        warn(
            "bootstrap: known initial states of a nonlinear structure are the same in all draws; "
            "the scatter lacks what their errors add"
        )
        return None
    away, std = np.zeros_like(x0), np.zeros(len(flying.states))
    for name, (mean, error) in told.items():
        i = flying.states.index(name)
        away[:, i], std[i] = float(mean) - x0[:, i], error
    return KnownInitial(flying.system(), tuple(away), std)


def _check_biases(fit: AnyFit, estimator: Estimator) -> None:
    """ValueError unless the estimator has biases where the fit has, which are zero without."""
    has, wanted = bool(np.any(fit.biases)), bool(getattr(estimator, "biases", True))
    if fit.method != METHOD and has != wanted:  # of transforms, whose mean is left out, all
        raise ValueError(
            f"the fit has {'' if has else 'no '}biases of outputs, the estimator "
            f"{'has' if wanted else 'none'}: give that of the fit, "
            f"estimator=OutputError(biases={has})"
        )


def _redrawn(estimator: Estimator, model: Model, seed: tuple[int, ...]) -> Estimator | None:
    """The estimator with its priors measured again where the model is true; None without any."""
    priors = getattr(estimator, "priors", None)
    if not priors:
        return None
    rng, told = np.random.default_rng((*seed, PRIORS)), dict(priors)
    again = {
        name: (float(rng.normal(getattr(model, name), std)), std) for name, (_, std) in told.items()
    }
    changed: Any = estimator
    return cast(Estimator, replace(changed, priors=again))


def _check_runs(runs: int, estimator: Estimator) -> None:
    if getattr(estimator, "responses", ()):
        raise ValueError("estimator: its responses are the same in every draw; give one without")
    if runs < 2:
        raise ValueError(f"runs={runs}: expected 2 or more; a scatter takes at least two fits")


def _check_residuals(fit: AnyFit, residuals: Sequence[Array], *, known: bool) -> None:
    """ValueError unless these residuals are as likely as those that the fit ended with."""
    every = np.concatenate(residuals)
    if fit.method == METHOD:  # its cost is that of transforms: what is left has their power
        ratio = np.nanvar(every, axis=0) / np.diag(np.asarray(fit.R))
        if not (np.abs(np.log(ratio)) < SAME_POWER).all():
            raise ValueError(
                "the fit was not estimated from these records: they leave residuals of "
                f"{ratio.max():.3g} times its variances; give the records it was estimated from"
            )
        return
    patterns, kind = np.unique(np.isfinite(every), axis=0, return_inverse=True)
    pattern, R = kind.ravel(), np.asarray(fit.R)
    noise = Noise(patterns, np.bincount(pattern), np.zeros(len(R)), given=R)
    cost = noise.cost(R, moments_of(np.nan_to_num(every), pattern, len(patterns)))
    room, more = SAME_COST * len(every), cost - fit.cost
    if not (abs(more) <= room or (known and more < 0)):  # the fit's has what is known before
        raise ValueError(
            "the fit was not estimated from these records: it ended with a cost of "
            f"{fit.cost:.6g}, but with these it has {cost:.6g}; give the records it was "
            "estimated from, in their order"
        )


def _simulated(
    model: Model, record: Record, x0: Array | None = None, bias: Array | float = 0.0
) -> Record:
    """The record with a model's outputs, missing where the record's are."""
    own = record.select(model.inputs, model.outputs)
    if isinstance(model, NonlinearModel):
        own = own.total()
        known = fitting_start(model, own) if x0 is None else zip(model.states, x0, strict=True)
        y = simulate(model, own, dict(known)).y + bias
    else:
        y = model.system().simulate(own.t, own.u, x0, own.hold) + bias
    return replace(own, y=np.where(np.isfinite(own.y), y, np.nan))


def _ensemble(
    many: Fits,
    draws: Sequence[Draw],
    start: AnyFit | None,
    estimators: Sequence[Estimator | None] = (),
    known: Sequence[str] = (),
) -> Ensemble:
    """Fits to all draws, in order, each by an estimator of its own if given."""
    (case,) = many.cases({"draw": {}})
    jobs = [
        many.job(case, start, draw=draw, estimator=own, name=f"run {k}", asked=False)
        for k, (draw, own) in enumerate(zip_longest(draws, estimators))
    ]
    done = list(many.run(jobs).values())
    tell_of_draws([each.warnings for each in done], known)
    names = free_parameters(many.model, many.fixed, many.bounds).names

    def column(attribute: str) -> Array:
        unknown = [np.nan] * len(names)
        rows = [
            unknown if each.reason else [getattr(each.result[name], attribute) for name in names]
            for each in done
        ]
        return np.array(rows).reshape(-1, len(names))

    return Ensemble(
        names=names,
        reference=np.array([float(getattr(many.model, name)) for name in names]),
        values=column("value"),
        std_errors=column("std_error"),
        reasons=tuple(each.reason for each in done),
    )
