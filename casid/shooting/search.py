"""Rounds of solves that end in the most likely parameters.

The first holds R as the start's residuals have it, the others maximise the likelihood with R
concentrated out, in new units each, until R has settled.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.errors import warn
from casid.fit import AnyFit
from casid.free import Free
from casid.nlp import Solution, SolverOptions, solve
from casid.shooting import frequency
from casid.shooting.delays import Side, calm, held, neighbours, own_prices, stuck
from casid.shooting.integration import SHIFT, factor_wanted, integration, still_coarse
from casid.shooting.likelihood import CovarianceKind
from casid.shooting.newton import Newton
from casid.shooting.nonlinear import Integration, NonlinearEvaluator
from casid.shooting.programme import Programme
from casid.shooting.reduced import LAST, Reduced, completed
from casid.shooting.sensitivity import Evaluator, Point
from casid.shooting.starting import neighbouring_programme, noise_of
from casid.shooting.warm_start import Iterate, followed, predicted

LOG = logging.getLogger("casid")

ROUNDS = 12  # of solves
PREDICTIONS = 2  # of the solution beside another: mostly it is settled then which bounds hold
ROUGH = 1e-4  # tolerance of the first, whose R is that of the start
ROUGHLY = 0.1  # of log-likelihood that a step may still gain there
EARLIER = 40  # of IPOPT's iterations at most, before the parameters alone go on
SOON = 8  # likewise where it starts with a prediction: it needs more only on a kink
MOVES = 50  # of delays across whole samples, at most; each makes the records likelier
GAIN = 1e-4  # of log-likelihood, that makes another stretch better
MARGIN = 0.02  # of a stretch between whole samples, from its ends to a start in it
SETTLED = 4.0  # factor by which a variance may fall in the last round: the scales still fit

NEAR: dict[str, float | str] = {
    "bound_push": 1e-9,
    "bound_frac": 1e-9,
    "bound_mult_init_val": 1e-2,  # the cost is a mean over samples: so are prices
    "compl_inf_tol": 1e-10,  # and cheap bounds are to be reached too
}
WARM = frequency.WARM | dict.fromkeys(
    ("warm_start_slack_bound_push", "warm_start_slack_bound_frac"), 1e-9
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Where the rounds of solves ended."""

    programme: Programme
    solution: Solution
    iterations: int
    rounds: int
    settled: bool

    @property
    def cost(self) -> float:
        """Negative log-likelihood; infinite without success."""
        programme, solution = self.programme, self.solution
        return programme.n * programme.values(solution.x).cost if solution.success else np.inf

    def failed(self, status: str) -> "Outcome":
        """The same, no solution."""
        return replace(self, solution=replace(self.solution, success=False, status=status))


class Search:
    """Rounds of solves for the free parameters of a model.

    ``steps`` are those of a nonlinear structure's integration, a sampling interval, if given.
    """

    def __init__(self, free: Free, options: SolverOptions, steps: int | None = None) -> None:
        self.free, self.options, self.steps = free, options, steps

    def beside(
        self, near: AnyFit, evaluator: Evaluator, R: Array | CovarianceKind, biases: bool
    ) -> Outcome | None:
        """The best about where a fit nearby leads; None if that does not succeed."""
        begun = neighbouring_programme(evaluator, self.free, R, biases, near)
        if evaluator.filtering or begun is None:
            return None
        first, point = begun
        first = _calmed(first, point)
        quiet = replace(self.options, progress=None)
        guess = predicted(first, Iterate.of(first, first.pack(point)), PREDICTIONS, quiet)
        if guess is None:
            return None
        ipopt = NEAR | {"mu_init": self.options.tolerance / 1000} | dict(self.options.ipopt)
        options = replace(self.options, ipopt=ipopt)
        solution = self._near(first, guess, 1, options, close=True)
        found = Outcome(first, solution, solution.iterations, 1, True)
        outcome = self.around(self._released(found))
        if outcome.cost > _begun_at(first, point) + GAIN:  # infinite without success
            LOG.info("output error: the fit nearby leads to a hollow, or to no solution")
            return None
        return outcome if outcome.solution.success else None

    def run(
        self, programme: Programme, point: Point, R: Array | CovarianceKind, *, near: bool = False
    ) -> Outcome:
        """Estimate; R is held if it is an array. A point ``near`` a solution is not moved away."""
        kalman = programme.evaluator.kalman
        if isinstance(R, np.ndarray) and not kalman:
            solution = self._solve(programme, point, None, 1, self.options)
            return Outcome(programme, solution, solution.iterations, 1, True)
        rough = replace(self.options, tolerance=max(ROUGH, self.options.tolerance))
        if near:
            rough = replace(rough, ipopt=NEAR | {"mu_init": ROUGH} | dict(rough.ipopt))
        solution = self._solve(programme, point, None, 1, rough)
        iterations, noise = solution.iterations, programme.noise
        if not kalman and isinstance(R, str):
            noise = noise_of(programme.evaluator, None, R)
        for rounds in range(2, ROUNDS + 1):
            if not solution.success:
                return Outcome(programme, solution, iterations, rounds - 1, False)
            last, point = programme, programme.unpack(solution.x)
            loose = last.variant(noise=noise)
            programme = _calmed(loose.balanced(point), point)
            before = programme.values(programme.pack(point)).R
            warm = _carried(solution, last, programme)
            solution = self._solve(programme, point, warm, rounds, self.options)
            iterations += solution.iterations
            now = programme.values(solution.x).R
            kept = np.diag(now) > np.diag(before) / SETTLED
            if solution.success and (kalman or noise.exact(now) or kept.all()):
                return Outcome(programme, solution, iterations, rounds, True)
        return Outcome(programme, solution, iterations, ROUNDS, False)

    def integrated(self, outcome: Outcome) -> tuple[Outcome, Integration | None]:
        """The outcome with integration steps short enough, and what shorter ones would change."""
        while isinstance(evaluator := outcome.programme.evaluator, NonlinearEvaluator):
            if not outcome.solution.success:
                return _jumping(outcome, evaluator), None
            found = integration(outcome.programme, outcome.solution.x)
            factor = 1 if self.steps else factor_wanted(found, len(evaluator.lengths))
            if factor == 1:
                point = outcome.programme.unpack(outcome.solution.x)
                coarse = still_coarse(found, evaluator, point.lam)
                said = evaluator.jumps(point) or coarse  # where steps do not settle for a jump
                if coarse and found.widened > SHIFT and not self.steps:
                    return outcome.failed(said), found
                if said:
                    warn(f"{type(evaluator.model).__name__}: {said}")
                return outcome, found
            last, solution = outcome.programme, outcome.solution
            programme = last.variant(evaluator=evaluator.finer(factor))
            warm, rounds = (solution.multipliers_x, solution.multipliers_g), outcome.rounds + 1
            new = self._solve(programme, last.unpack(solution.x), warm, rounds, self.options)
            outcome = replace(
                outcome,
                programme=programme,
                solution=new,
                rounds=rounds,
                iterations=outcome.iterations + new.iterations,
            )
        return outcome, None

    def begun(
        self, programme: Programme, point: Point, R: Array | CovarianceKind, *, near: bool = False
    ) -> Outcome:
        """The best about the start; where outputs jump, of the delays held in its stretch first.

        And of those free from the start, unless that is ``near`` a solution: far from one, a poor R
        may lead them many samples away, and seldom far enough back.
        """
        free, within = held(programme, point.lam)
        if np.isnan(within).all():
            return self.around(self._released(self.run(programme, point, R, near=near)))
        inside = programme.variant(free=free, evaluator=programme.evaluator.within(within))
        best = self.around(self._released(self.run(inside, point, R, near=near)))
        if near and best.solution.success:
            return best
        other = self._released(self.run(programme, point, R, near=near))
        if not abs(other.cost - best.cost) < GAIN:  # an end whose sides have not been tried
            other = self.around(other)
        LOG.info(
            "output error, delays held in their samples, and free: %s", (best.cost, other.cost)
        )
        return min(best, other, key=lambda end: end.cost)

    def around(self, outcome: Outcome) -> Outcome:
        """The outcome, or a better one beyond the whole samples next to its delays."""
        left: list[Array] = []
        for _ in range(MOVES):
            best, solution = outcome, outcome.solution
            lam = outcome.programme.unpack(solution.x).lam
            own = outcome.programme.variant(free=self.free)
            for side in neighbours(own, lam, solution.success):
                if any(side.free.allows(each) for each in left):
                    continue
                other = self._inside(outcome, side)
                if other.solution.success and other.cost < best.cost - GAIN:
                    best = other
            if best is outcome:
                break
            LOG.info("output error, delays across whole samples: %.6g, better", best.cost)
            if solution.success:
                left.append(lam[: len(self.free.index)])
            outcome = best
        return outcome

    def begun_inside(self, outcome: Outcome) -> Outcome:
        """The outcome, or a better one of records that begin within what their states do then.

        A state that enters the equations evenly, such as a rotor's speed, may be fitted from its
        mirror image, through zero: a local minimum, in which lags are wrong.
        """
        programme = outcome.programme
        if not isinstance(programme.evaluator, NonlinearEvaluator):
            return outcome
        if (point := _begun_inside(outcome)) is None:
            return outcome
        rounds = outcome.rounds + 1
        solution = self._solve(programme, point, None, rounds, self.options)
        iterations = outcome.iterations + solution.iterations
        other = replace(outcome, solution=solution, rounds=rounds, iterations=iterations)
        better = solution.success and not other.cost >= outcome.cost - GAIN
        return other if better else replace(outcome, rounds=rounds, iterations=iterations)

    def _inside(self, outcome: Outcome, side: Side) -> Outcome:
        """The best within a stretch between whole samples, from an outcome without."""
        last, free, n = outcome.programme, side.free, len(side.free.index)
        point, noise = last.unpack(outcome.solution.x), last.noise
        if not outcome.settled and noise.given is not None:
            noise = replace(noise, given=None)
        low, high = free.lower[free.index], free.upper[free.index]
        margin = MARGIN * np.minimum(high - low, free.scale[free.index])
        lam = point.lam.copy()
        lam[:n] = np.clip(lam[:n], low + margin, high - margin)
        point = replace(point, lam=lam)
        evaluator = last.evaluator.within(side.delays)
        loose = last.variant(noise=noise, evaluator=evaluator, free=free)
        guess = self._across(loose, outcome.solution) if outcome.solution.success else None
        if guess is not None and _leads_back(loose, outcome.solution.x, guess, side.a):
            return outcome.failed("it is best where the outcome's own stretch begins")
        programme = loose.balanced(point if guess is None else loose.unpack(guess.x))
        rounds, there = outcome.rounds + 1, programme.pack(point)
        if guess is not None:
            solution = self._near(programme, guess.carried(loose, programme), rounds, self.options)
        elif Reduced(programme, self.options, "").least(there) > outcome.cost + GAIN:
            return outcome.failed("all of its stretch is less likely")
        else:
            warm = _carried(outcome.solution, last, programme)
            solution = self._solve(programme, point, warm, rounds, self.options)
        iterations = outcome.iterations + solution.iterations
        return self._released(Outcome(programme, solution, iterations, rounds, True))

    def _across(self, programme: Programme, solution: Solution) -> Iterate | None:
        """Where a solution leads in the stretch next to its own; None where outputs jump between.

        And where a quadratic model is not known to tell.
        """
        jumps = not np.isnan(held(programme, programme.unpack(solution.x).lam)[1]).all()
        if jumps or programme.evaluator.filtering:
            return None
        at = Iterate(solution.x, solution.multipliers_x, solution.multipliers_g)
        return predicted(programme, at, 1, replace(self.options, progress=None))

    def _released(self, outcome: Outcome) -> Outcome:
        """The outcome under its own bounds; the ends of a stretch have no price."""
        programme, solution = outcome.programme, outcome.solution
        lam, nf = programme.unpack(solution.x).lam, len(self.free.index)
        prices, ties = solution.multipliers_x.copy(), solution.multipliers_g.copy()
        first = len(ties) - len(self.free.constraint_sizes)
        own, scales = (prices[:nf], ties[first:]), programme.scales.lam[:nf]
        prices[:nf], ties[first:] = own_prices(own, programme.free, self.free, lam, scales)
        solution = replace(solution, multipliers_x=prices, multipliers_g=ties)
        return replace(
            outcome, programme=outcome.programme.variant(free=self.free), solution=solution
        )

    def _near(
        self,
        programme: Programme,
        guess: Iterate,
        number: int,
        options: SolverOptions,
        *,
        close: bool = False,
    ) -> Solution:
        """By quadratic models alone, as long as they lead to the solution; else by IPOPT."""
        if programme.evaluator.curved:
            solution = followed(programme, guess, options, f"output error, round {number}")
            if solution is not None:
                return solution
        warm, point = (guess.bounds, guess.constraints), programme.unpack(guess.x)
        return self._solve(programme, point, warm, number, options, close=close)

    @staticmethod
    def _solve(
        programme: Programme,
        point: Point,
        warm: tuple[Array, Array] | None,
        number: int,
        options: SolverOptions,
        *,
        close: bool = False,
    ) -> Solution:
        if warm is not None:
            options = replace(options, ipopt=WARM | dict(options.ipopt))
        newton = Newton(programme, close=close)
        warm = None if warm is None else newton.extended(warm)
        start, stage = programme.pack(point), f"output error, round {number}"
        limit = min(SOON if close else EARLIER, options.max_iterations)
        first = replace(options, max_iterations=limit)
        solution = newton.stripped(solve(newton.problem(start), first, stage=stage, warm=warm))
        if solution.success and options.tolerance >= ROUGH:
            return solution
        lam = programme.unpack(solution.x).lam
        begun = number == 1 and not close  # a poor start may be anywhere after its steps
        if not solution.success and not begun and stuck(programme, lam):
            return solution  # on a kink no steps end, but those on either side
        enough = ROUGHLY if number == 1 and options.tolerance >= ROUGH else LAST
        return completed(programme, start, solution, options, stage, enough)


def _jumping(outcome: Outcome, evaluator: NonlinearEvaluator) -> Outcome:
    """An outcome without success, with the jumps that its simulation passes among the reasons."""
    with np.errstate(all="ignore"):  # it may have ended anywhere
        said = evaluator.jumps(outcome.programme.unpack(outcome.solution.x))
    return outcome.failed(f"{outcome.solution.status}; {said}") if said else outcome


def _leads_back(programme: Programme, x: Array, guess: Iterate, a: int) -> bool:
    """Whether a stretch of parameter ``a`` next to a solution's is best at the common end.

    There the solution, which is the best of its own, is at least as good.
    """
    (lower, upper), _ = programme.limits()
    width, there, price = upper[a] - lower[a], guess.x[a], guess.bounds[a]
    at_end = min(there - lower[a], upper[a] - there) < ROUGH * width
    dear = abs(price) * width * programme.n > 1  # in units of log-likelihood
    return bool(at_end and dear and (x[a] - there) * price > 0)


def _begun_at(programme: Programme, point: Point) -> float:
    """Negative log-likelihood at a start; infinite where that breaks bounds or constraints."""
    x = programme.pack(point)
    values = programme.values(x)
    start = Iterate(x, np.zeros_like(x), np.zeros_like(values.g))
    fair = np.isfinite(values.cost) and start.broken(programme) < ROUGH
    return programme.n * values.cost if fair else np.inf


def _calmed(programme: Programme, point: Point) -> Programme:
    """The same with delays near a kink in their stretch, if there are any."""
    free, within = calm(programme, point.lam)
    if np.isnan(within).all():
        return programme
    return programme.variant(free=free, evaluator=programme.evaluator.within(within))


def _begun_inside(outcome: Outcome) -> Point | None:
    """The end, every record's first states brought into its others' span; None if none stuck out.

    What sticks out does so by more than that span.
    """
    programme = outcome.programme
    point, layout = programme.unpack(outcome.solution.x), programme.evaluator.layout
    states, nodes = programme.values(outcome.solution.x).motion.states, point.nodes.copy()
    first = 0
    for number, record in enumerate(layout.records):
        own = states[first + record.N // 10 + 1 : first + record.N]
        low, high = own.min(axis=0), own.max(axis=0)
        node = int(layout.node[layout.record == number].min())
        out = np.maximum(nodes[node] - high, low - nodes[node]) > high - low
        nodes[node, out] = np.clip(nodes[node], low, high)[out]
        first += record.N
    return replace(point, nodes=nodes) if np.any(nodes != point.nodes) else None


def _carried(solution: Solution, last: Programme, programme: Programme) -> tuple[Array, Array]:
    """Multipliers of one programme in the units of another."""
    at = Iterate(solution.x, solution.multipliers_x, solution.multipliers_g)
    moved = at.carried(last, programme)
    return moved.bounds, moved.constraints
