"""Ways to a solution: shorter intervals for output error, several starts for a filter.

Whatever way is taken, the best end of all is what is told.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.errors import ConvergenceError, warn
from casid.fit import AnyFit
from casid.free import Free
from casid.nlp import SolverOptions
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.shooting.delays import heard, warn_of_jumps
from casid.shooting.innovation import ProcessNoise, filter_unknowns, tell_of_lost_samples
from casid.shooting.intervals import lay_out
from casid.shooting.likelihood import CovarianceKind
from casid.shooting.newton import MEET
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.programme import Programme
from casid.shooting.reduced import Reduced
from casid.shooting.search import GAIN, Outcome, Search
from casid.shooting.sensitivity import Evaluator, Point
from casid.shooting.starting import (
    continued_programme,
    neighbouring_programme,
    starting_programme,
)
from casid.shooting.stiffness import MOST, REACH, fastest_flown
from casid.shooting.unknowns import GainUnknowns, NoiseUnknowns
from casid.subspace.pbsid import BlackBox
from casid.unexplained_variance import told, unexplained

LOG = logging.getLogger("casid")

GROWTH = 1.0  # e-folds the fastest unstable mode may grow over an interval
SHORTEN = 2.5  # factor between intervals tried one after the other
LONGEST, SHORTEST = 5.0, 0.5  # of intervals chosen here [s]
RISES = (10.0, 300.0, 1e4, 3e5)  # process noises to start from, in units of what is noticed
FINER = 4  # times the steps of the integration, where they were too few
EXACT = 4.0  # times the least variance believed: an output predicted exactly
PATIENCE = 100  # iterations of a solve, where there is another way


@dataclass(frozen=True, eq=False)
class Ways:
    """Ways to the parameters of one model from its records."""

    free: Free
    records: list[Record]
    options: SolverOptions
    R: Array | CovarianceKind
    biases: bool
    interval: float | None
    steps: int | None = None

    def output_error(self, near: AnyFit | None = None, *, again: bool = True) -> Outcome:
        """Where output error ends, from a fit nearby if there is one.

        Intervals chosen here become shorter as long as nothing is found, or, ``again``, an end that
        explains nothing of an output. Where shorter ones are left to try, a solve that has not
        ended in a hundred steps is given up.
        """
        lengths, ends = list(self._lengths()), list[Outcome]()
        for length in lengths:
            some = any(end.solution.success for end in ends)
            options = self._limited() if some or length != lengths[-1] else self.options
            search = Search(self.free, options, self.steps)
            ends.append(self._searched(search, self._unfiltered(length), near))
            lost = missed(ends[-1]) if again and near is None else []
            if ends[-1].solution.success and not lost:
                break
            status = f"nothing explained of {', '.join(lost)}" if lost else ends[-1].solution.status
            LOG.info("output error, intervals of %.3g s: %s", length, status)
        found = min(ends, key=lambda end: end.cost)  # infinite without success
        if found.solution.success:
            return found
        best = min(ends, key=_merit)
        return best if self.steps else self._in_shorter_steps(best, near)

    def _in_shorter_steps(self, failed: Outcome, near: AnyFit | None) -> Outcome:
        """Where output error ends if modes became too fast on the way for the steps of the start.

        These follow the start's modes; where an estimate's are faster the method diverges, and no
        way leads past that.
        """
        ends = [failed]
        while (steps := _steps_missing(ends[-1])) > 1:
            LOG.info("output error, %d integration steps a sample", steps)
            ends.append(replace(self, steps=steps).output_error(near))
            if ends[-1].solution.success:
                return ends[-1]
        return min(ends, key=_merit)

    def cost_beside(self, near: AnyFit) -> float:
        """Negative log-likelihood at a fit's λ where free, the model's where held.

        Initial states, biases and R follow; infinite where they are not found.
        """
        evaluator = self._unfiltered(self.interval or LONGEST)
        begun = neighbouring_programme(evaluator, self.free, self.R, self.biases, near)
        if begun is None:
            return np.inf
        programme, point = begun
        reduced = Reduced(programme, self.options, "output error, beside")
        return reduced.cost(programme.pack(point), GAIN)

    def filtered(self, process_noise: ProcessNoise) -> Outcome:
        """Where a filter ends, from output error and, unless that is as good, the model given."""
        more = filter_unknowns(self.free, self.records, process_noise, self.R)
        if more is None:
            return self.output_error()
        if isinstance(more, GainUnknowns):
            tell_of_lost_samples(self.records)
        if isinstance(more, GainUnknowns) and not more.free:
            return self._searched(
                Search(self.free, self.options, self.steps), self._evaluator(more)
            )
        limited = replace(self, options=self._limited())
        plain = limited.output_error(again=False)  # a start, and what to beat
        if isinstance(more, NoiseUnknowns):
            ends = self._noise_ends(more, plain)
        else:
            ends = self._gain_ends(more, plain, known=isinstance(process_noise, BlackBox))
        best = min(ends, key=lambda end: end.cost)
        if plain.cost < best.cost - GAIN:
            why = ends[-1].solution.status
            return plain.failed(
                f"no filter makes the records more likely than this output error: {why}"
            )
        return best if best.solution.success else min(ends, key=_merit)

    def _noise_ends(self, more: NoiseUnknowns, plain: Outcome) -> list[Outcome]:
        """Ends of a Kalman filter from output error in still air and from the guess in turbulence.

        And output error as an end, if none is as good. Each start may lead into a hollow of its
        own: one where turbulence is feedback, another where it drives another state.
        """
        ends = []
        if plain.solution.success:
            calm = more.calm(plain.programme.values(plain.solution.x).R)
            ends.append(self._continued(plain, calm))
        levels = self._levels(more, lambda e: starting_programme(e, self.free, self.R, self.biases))
        _, rough = min(levels, key=lambda level: level[0])
        ends.append(self._searched(Search(self.free, self.options), self._evaluator(rough)))
        if plain.cost < min(end.cost for end in ends) - GAIN:
            ends.append(self._still(more, plain))
        return ends

    def _still(self, more: NoiseUnknowns, plain: Outcome) -> Outcome:
        """Output error as the filter's end, if no process noise makes the records likelier.

        Over a growing mode the least noise is felt, however small beside its unit: the likelihood
        falls with its logarithm, and steps from any noise hardly come down to none.
        """
        more = more.calm(plain.programme.values(plain.solution.x).R)
        end = self._continued(plain, replace(more.raised(0.0), q0=np.zeros_like(more.q0)))
        noisy = end.programme.variant(evaluator=self._evaluator(more))
        first = len(self.free.index)
        slopes = noisy.gradient(end.solution.x)[first : first + len(more.q0)]
        last = end.programme, end.solution.x
        levels = self._levels(more, lambda e: continued_programme(e, self.free, self.R, *last))
        much = noisy.n * min(cost for cost, _ in levels) < end.cost - GAIN
        likelier = much or (noisy.n * slopes < -GAIN).any()
        return end.failed("some process noise makes the records likelier") if likelier else end

    def _gain_ends(self, more: GainUnknowns, plain: Outcome, known: bool) -> list[Outcome]:
        """Ends of a filter with a free gain, from one ``known`` or where a Kalman filter ends."""
        search, ends = Search(self.free, self._limited()), []
        if known:
            ends.append(self._searched(search, self._evaluator(more)))
        if not ends or not ends[0].cost <= plain.cost + GAIN:
            noises = filter_unknowns(self.free, self.records, process_noise=True, R="diagonal")
            assert isinstance(noises, NoiseUnknowns)
            first = min(self._noise_ends(noises, plain), key=_merit)
            lam = first.programme.unpack(first.solution.x).lam
            K = first.programme.evaluator.held_gain(lam)
            patient = replace(self, options=search.options) if plain.solution.success else self
            ends.append(patient._continued(first, more if K is None else replace(more, K=K)))
        return ends

    def _unfiltered(self, length: float) -> Evaluator:
        layout = lay_out(self.records, length)
        if isinstance(self.free.model, NonlinearModel):
            return NonlinearEvaluator(self.free, layout, self.steps)
        return Evaluator(self.free, layout)

    def _evaluator(self, more: GainUnknowns | NoiseUnknowns) -> Evaluator:
        length = self.interval or max(LONGEST, self._shortest)
        return Evaluator(self.free, lay_out(self.records, length), more)

    def _continued(self, last: Outcome, more: GainUnknowns | NoiseUnknowns) -> Outcome:
        """Where a filter ends from another's end, or output error's."""
        search, evaluator = Search(self.free, self.options, self.steps), self._evaluator(more)
        begun = continued_programme(evaluator, self.free, self.R, last.programme, last.solution.x)
        return search.begun(*begun, self.R, near=True)

    def _limited(self) -> SolverOptions:
        limit = min(PATIENCE, self.options.max_iterations)
        return replace(self.options, max_iterations=limit)

    def _levels(
        self, more: NoiseUnknowns, begun: Callable[[Evaluator], tuple[Programme, Point]]
    ) -> list[tuple[float, NoiseUnknowns]]:
        """Costs per observation of levels of process noise, all noises to scale."""
        found = []
        for start in map(more.raised, RISES):
            try:
                found.append(self._level(start, *begun(self._evaluator(start))))
            except ConvergenceError:
                found.append((np.inf, start))
        return found

    def _level(
        self, start: NoiseUnknowns, programme: Programme, point: Point
    ) -> tuple[float, NoiseUnknowns]:
        """Cost per observation at noises to start from, all to the scale that suits them best."""
        values, gains = (
            programme.values(programme.pack(point)),
            programme.evaluator.gains(point.lam),
        )
        if gains is None or not np.isfinite(values.cost):
            return np.inf, start
        size = float(np.sum(gains.whitened(values.motion.residuals) ** 2)) / programme.n
        factor = 1.0 if start.given is not None else size
        cost = values.cost + (size / factor - size + np.log(factor)) / 2
        return float(cost), start.scaled(factor)

    def _searched(
        self, search: Search, evaluator: Evaluator, near: AnyFit | None = None
    ) -> Outcome:
        """Where the rounds of solves end."""
        if evaluator.more is None:  # a filter starts from output error, which has told
            warn_of_jumps(self.records, heard(evaluator, self.free.guess))
        outcome = None if near is None else search.beside(near, evaluator, self.R, self.biases)
        if outcome is not None:
            return outcome
        begun = starting_programme(evaluator, search.free, self.R, self.biases)
        return search.begun_inside(search.begun(*begun, self.R))

    @property
    def _shortest(self) -> float:
        return max(SHORTEST, 4 * max(record.dt for record in self.records))

    def _lengths(self) -> Iterator[float]:
        """Intervals to try one after the other [s]: the one given, or shorter and shorter ones."""
        length = (
            choose_interval(self.free, self.records) if self.interval is None else self.interval
        )
        yield length
        longest = max(record.duration for record in self.records)
        while self.interval is None and self._shortest <= length / SHORTEN < longest:
            length /= SHORTEN
            yield length


def exact_outputs(outcome: Outcome) -> list[str]:
    """Outputs whose innovations a filter has shrunk to the least there is."""
    programme, more = outcome.programme, outcome.programme.evaluator.more
    if not isinstance(more, NoiseUnknowns) or more.given is not None:
        return []
    gains = programme.evaluator.gains(programme.unpack(outcome.solution.x).lam)
    size = np.full(len(more.least), np.inf) if gains is None else np.diag(gains.S[-1])
    names = programme.free.model.outputs
    return [names[i] for i in np.flatnonzero(size <= EXACT * more.least)]


def missed(outcome: Outcome) -> list[str]:
    """Outputs that a solution explains no better than their means do, in words."""
    programme, solution = outcome.programme, outcome.solution
    if not solution.success:
        return []
    layout = programme.evaluator.layout
    seen = layout.patterns[layout.pattern].sum(axis=0)
    squares = np.sum(programme.values(solution.x).motion.residuals ** 2, axis=0)
    y = [record.y for record in layout.records]
    return unexplained(programme.free.model.outputs, y, squares / np.maximum(seen, 1))


def warn_of_missed(outcome: Outcome, interval: float | None) -> None:
    """Warn of outputs that a fit explains no better than their means, ``interval`` being given."""
    if names := missed(outcome):
        shorter = "shorter intervals, " if interval else ""
        warn(f"{told(names)}: try {shorter}other starts and compare their costs")


def choose_interval(free: Free, records: Sequence[Record]) -> float:
    """Length of the shooting intervals of output error [s].

    As long as the starting model's fastest growing mode grows no more than e-fold over it, within
    0.5 s and 5 s: fewer nodes are quicker, shorter intervals forgive a worse start. (A filter has
    the longest: its predictor is stable, and short intervals would let nodes fit the noise that its
    unknowns are estimated from.)
    """
    shortest = max(SHORTEST, 4 * max(record.dt for record in records))
    growth = float(free.model.with_vector(free.full(free.guess)).system().poles()[0].real)
    length = LONGEST if growth <= 0 else GROWTH / growth
    return float(np.clip(length, shortest, max(LONGEST, shortest)))


def _steps_missing(outcome: Outcome) -> int:
    """How many steps a sample follow the modes of an end that was none; 1 if there are enough."""
    evaluator = outcome.programme.evaluator
    if not isinstance(evaluator, NonlinearEvaluator):
        return 1
    lam, now = outcome.programme.unpack(outcome.solution.x).lam, evaluator.substeps
    rate, _ = fastest_flown(evaluator, lam)
    needed = rate * float(evaluator.layout.classes.max()) / REACH
    return min(MOST, max(FINER * now, int(np.ceil(needed)))) if now < min(needed, MOST) else 1


def _merit(outcome: Outcome) -> tuple[bool, float]:
    """What an end without success is worth: intervals that meet, then the likelihood."""
    programme, x = outcome.programme, outcome.solution.x
    values = programme.values(x)
    gaps = values.g[: len(programme.links) * programme.evaluator.nx]
    cost = programme.n * values.cost
    return not np.abs(gaps).max(initial=0.0) < MEET, cost if np.isfinite(cost) else np.inf
