"""Delays about whole samples: kinks and jumps of the likelihood, and estimates free of them."""

import contextlib
import warnings
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown
from truths.felt import Felt, Slight, felt
from truths.felt import H as SAMPLE
from truths.heave import Heave, heaved
from truths.late_pair import Against, Alike, Longer, Pair, Twice, paired, scanned

from benchmarks.between_samples import BOUNDS, SIGMA, H, Roll, Smooth, flight
from casid import (
    Constraint,
    ConvergenceError,
    DataWarning,
    Model,
    Record,
    Scalar,
    SolverOptions,
    output_error,
    parameter,
)
from casid.free import free_parameters
from casid.shooting import search
from casid.shooting.delays import calm, neighbours, own_prices, stuck
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import starting_programme


def flights(structure, hold, delay, seed):
    """Two noisy records of a helicopter that hears its stick so many samples late."""
    rng = np.random.default_rng([5, seed])
    return [flight(structure(tau=delay * H), hold, delay, rng) for _ in range(2)]


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(
    ("structure", "hold", "delay", "off"),
    [
        (Roll, "foh", 1.0, 0.6),  # a kink of the output
        (Roll, "foh", 0.0, 0.6),
        (Smooth, "foh", 2.0, -0.7),  # smooth
        (Smooth, "zoh", 2.0, 0.6),  # kinks of the states
        (Roll, "zoh", 1.0, 0.6),  # jumps of the output
        (Roll, "zoh", 2.0, -0.7),
        (Roll, "zoh", 0.0, 0.6),
    ],
)
def test_a_free_delay_of_whole_samples_is_right_to_a_tenth_of_one(structure, hold, delay, off):
    truth = structure(tau=delay * H)
    fit = output_error(
        replace(truth, tau=(delay + off) * H), flights(structure, hold, delay, 0), bounds=BOUNDS
    )
    assert fit.success
    assert abs(fit.model.tau / H - delay) < 0.1


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("structure", [Felt, Slight])
@pytest.mark.parametrize("late", [pytest.param(0.0, marks=pytest.mark.campaign), 1.0])
@pytest.mark.parametrize("start", [0.0, pytest.param(0.6, marks=pytest.mark.campaign)])
def test_a_nonlinear_structure_s_delay_of_whole_samples_is_found(structure, late, start):
    # The information of the delay is that of q alone, on both ends of its stretch.
    fit = output_error(
        structure(tau=start * SAMPLE), felt(structure, late * SAMPLE, 0.01), biases=False
    )
    assert fit.success
    assert abs(fit.model.tau / SAMPLE - late) < 0.04
    np.testing.assert_allclose([fit.model.k, fit.model.g], [2.0, 1.5], rtol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.R)), 0.01, rtol=0.15)


def stretches(model, hold):
    """Bounds of τ in samples, and the delay within, that are to be tried about a model."""
    record = replace(flown(model, x0=(0.0, 0.0, 0.0)), hold=hold)
    free = free_parameters(model, bounds={"tau": (0.0, 0.25)})
    evaluator = Evaluator(free, lay_out([record], 2.0))
    programme, point = starting_programme(evaluator, free, np.diag(SIGMA**2), True)
    found = []
    for bounded, within, _ in neighbours(programme, point.lam, solved=True):
        assert np.isnan(within[1])  # the other stick's
        found.append((bounded.lower[-1] / 0.02, bounded.upper[-1] / 0.02, within[0] / 0.02))
    return np.round(found, 3).tolist()


def test_stretches_between_whole_samples_are_tried_where_the_likelihood_breaks_nearby():
    near, far = replace(TRUTH, tau=3.05 * 0.02), replace(TRUTH, tau=3.5 * 0.02)
    assert stretches(near, "foh") == [[2.0, 3.0, 2.5]]
    assert stretches(far, "foh") == []
    assert stretches(far, "zoh") == [[2.0, 3.0, 2.5], [4.0, 5.0, 4.5]]  # its output jumps
    smooth = replace(near, Ylat=0.0)
    assert stretches(replace(TRUTH, tau=0.03 * 0.02), "foh") == []  # nothing below zero
    assert stretches(smooth, "foh") == [[2.0, 3.0, 2.5]]  # Ylat may become a direct term


def test_a_solve_is_held_by_kinks_near_its_end_but_not_by_those_at_its_bounds():
    def held(tau, bounds=(0.0, 0.25), hold="foh"):
        model = replace(TRUTH, tau=tau * 0.02)
        free = free_parameters(model, bounds={"tau": bounds})
        evaluator = Evaluator(free, lay_out([replace(flown(TRUTH), hold=hold)], 2.0))
        programme, point = starting_programme(evaluator, free, np.diag(SIGMA**2), True)
        return stuck(programme, point.lam)

    assert held(3.05)
    assert held(2.95)
    assert not held(3.5)
    assert not held(3.05, (0.06, 0.08))  # where its stretch begins
    assert not held(2.95, (0.04, 0.06))
    assert held(3.05, (0.05, 0.08))


def test_one_delay_is_tried_while_those_on_kinks_stay_in_their_stretch():
    model = Heave(tlon=2.04 * 0.02, tcol=3.02 * 0.02)
    free = free_parameters(model)
    evaluator = Evaluator(free, lay_out(heaved(), 2.0))
    programme, point = starting_programme(evaluator, free, np.diag([0.3, 0.01]) ** 2, True)
    at = [free.names.index(name) for name in ("tlon", "tcol")]

    def limits(bounded):
        ends = np.array([bounded.lower, bounded.upper])[:, free.index[at]].T
        return np.round(ends / 0.02, 3).tolist()

    bounded, within = calm(programme, point.lam)
    assert limits(bounded) == [[2, 3], [3, 4]]
    np.testing.assert_allclose(within / 0.02, [2.5, 3.5])
    assert limits(calm(programme, point.lam, but=at[0])[0]) == [[0, 15], [3, 4]]
    tried = [limits(each) for each, *_ in neighbours(programme, point.lam, solved=True)]
    assert tried == [[[1, 2], [3, 4]], [[2, 3], [2, 3]], [[2, 3], [4, 5]]]


def test_within_a_stretch_the_estimator_is_analytic_in_the_delay():
    # Steps passing samples bend the residuals; held within a stretch they do not, beyond its ends.
    model, late = replace(TRUTH, tau=0.06), 0.02 * np.array([2.5, 0.0])
    record = replace(flown(model, x0=(0.0, 0.0, 0.0)), hold="zoh")
    free = free_parameters(model)
    evaluator = Evaluator(free, lay_out([record], 1e9))
    _, point = starting_programme(evaluator, free, np.diag(SIGMA**2), True)

    def second_difference(e, step=1e-4):
        moved = []
        for k in (-1, 0, 1):
            lam = point.lam.copy()
            lam[-1] += k * step
            moved.append(e.simulate(replace(point, lam=lam)).residuals)
        return np.abs(moved[0] - 2 * moved[1] + moved[2]).max() / step

    # A second difference over the step falls with it where all is smooth, and stays at a kink.
    assert second_difference(evaluator.within(late)) < 0.05
    assert second_difference(evaluator) > 5.0


@pytest.mark.parametrize("short", [0.1, 1e-5, 1e-9, 0.0])
def test_what_is_known_of_a_delay_stays_as_it_nears_the_end_of_its_stretch(short):
    # There the rests of all steps are as short as the roundings of their instants.
    model = replace(TRUTH, tau=(4 - short) * 0.02)
    record = replace(flown(model), hold="zoh")
    free, R = free_parameters(model), np.diag(SIGMA**2)
    evaluator = Evaluator(free, lay_out([record], 2.0)).within(0.02 * np.array([3.5, np.nan]))
    programme, point = starting_programme(evaluator, free, R, True)
    step = 1e-7 * np.eye(len(point.lam))[-1]
    ends = [evaluator.simulate(replace(point, lam=point.lam + d)).residuals for d in (-step, step)]
    slope = (ends[1] - ends[0]) / 2e-7
    found = programme.blocks(programme.pack(point)).Hll[-1, -1] / programme.scales.lam[-1] ** 2
    assert found == pytest.approx(np.sum(slope**2 / np.diag(R)), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "start"),
    [((0.02,), 0.11), pytest.param((0.02, 0.04), 0.11, marks=pytest.mark.campaign)],
)
def test_no_fit_is_less_likely_than_with_a_jumping_delay_held_at_its_truth(steps, start):
    truth, records = Heave(), heaved(steps=steps)
    held = output_error(truth, records, fixed=("tcol",))
    fit = output_error(replace(truth, tlon=0.05, Zcol=-60.0, Mlon=6.0, tcol=start), records)
    assert fit.success
    assert fit.cost <= held.cost + 1e-6
    assert 0.1 <= fit.model.tcol <= 0.12  # what samples every 20 ms tell of 0.117 s


@pytest.mark.slow
def test_a_stretch_that_is_passed_over_has_nothing_better(monkeypatch):
    judged, ends = [], []
    honest, solved = search._leads_back, search.Search._inside

    def both(*where):
        judged.append(honest(*where))
        return False  # solved all the same

    def inside(own, outcome, side):
        before = len(judged)
        end = solved(own, outcome, side)
        ends.append((judged[before:] == [True], end.cost - outcome.cost))
        return end

    monkeypatch.setattr(search, "_leads_back", both)
    monkeypatch.setattr(search.Search, "_inside", inside)
    for structure, hold in ((Roll, "foh"), (Smooth, "zoh")):
        for seed in range(3):
            truth = structure(tau=1.0 * H)
            output_error(truth, flights(structure, hold, 1.0, seed), bounds=BOUNDS)
    passed, more = (np.array(each) for each in zip(*ends, strict=True))
    assert (passed & np.isfinite(more)).sum() > 2  # infinite where the solve has no success
    assert more[passed].min() > 0.0
    assert len(ends) > passed.sum()


@pytest.mark.campaign
def test_a_stretch_beyond_a_jump_that_is_passed_over_has_nothing_better(monkeypatch):
    told, ends = [], []
    honest, solved = search.Reduced.least, search.Search._inside

    def least(own, x):
        told.append(honest(own, x))
        return -np.inf  # solved all the same

    def inside(own, outcome, side):
        before = len(told)
        end = solved(own, outcome, side)
        ends.extend((value, end.cost, outcome.cost) for value in told[before:])
        return end

    monkeypatch.setattr(search.Reduced, "least", least)
    monkeypatch.setattr(search.Search, "_inside", inside)
    for seed in range(2):
        output_error(Roll(tau=2.6 * H), flights(Roll, "zoh", 1.0, seed), bounds=BOUNDS)
    value, end, best = np.array(ends).T
    assert (value < end).all()
    assert (value > best).sum() > 1


@pytest.mark.slow
def test_jumps_of_an_uneven_record_are_told_and_the_cost_is_that_of_the_model():
    rng, records = np.random.default_rng(5), []
    for name, steps in (("even", np.full(400, H)), ("uneven", rng.uniform(0.5, 1.5, 400) * H)):
        t = np.cumsum(steps)
        u = 0.1 * np.sign(np.sin(np.outer(t, [1.1, 0.7]))) + 0.02 * rng.standard_normal((400, 2))
        y = TRUTH.system().simulate(t, u, hold="zoh") + SIGMA * rng.standard_normal((400, 3))
        records.append(Record(t, u, y, Roll.inputs, Roll.outputs, name, hold="zoh"))
    with pytest.warns(DataWarning, match="'uneven' is sampled unevenly and outputs feel lat"):
        fit = output_error(TRUTH, records)
    held = output_error(fit.model, records, fixed=("tau",))
    assert fit.cost == pytest.approx(held.cost, abs=0.01)


@pytest.mark.repeats(2)
@pytest.mark.second
@pytest.mark.parametrize(
    ("structure", "tau", "start", "domain"),
    [
        (Twice, 0.083, 0.083, "time"),
        (Twice, 0.0753, 0.185, "frequency"),
        pytest.param(Twice, 0.077, 0.05, "time", marks=pytest.mark.campaign),
        pytest.param(Longer, 0.087, 0.05, "time", marks=pytest.mark.slow),
        pytest.param(Against, 0.071, 0.11, "time", marks=pytest.mark.campaign),
    ],
)
def test_a_parameter_of_several_delays_is_found_between_the_whole_samples_of_all(
    structure, tau, start, domain
):
    records = paired(structure, tau)
    poor = structure(Llat=2.0, Ylat=-1.0, Yped=3.0, tau=start)
    fit = output_error(poor, records, fixed=("Lp",), domain=domain)
    assert fit.success
    grid = np.arange(0.0002, 0.2, 0.001)
    found = scanned(structure, fit.model.tau, records)
    assert found <= min(scanned(structure, each, records) for each in grid) + 0.01
    if domain == "time":  # Σ (y - ŷ)² / σ², a half of it, is that of the estimated noise
        size = sum(record.y.size for record in records) / 2
        assert fit.cost == pytest.approx(found + size, abs=0.01)


@pytest.mark.second
@pytest.mark.parametrize(("structure", "spare"), [(Alike, 0.005), (Longer, 0.012)])
def test_beyond_a_bound_that_is_no_whole_sample_no_stretch_is_tried(structure, spare):
    records = paired(structure, 0.0, (0.02,))
    bounds = {"tau": (spare, 0.2)}
    fit = output_error(structure(tau=0.03), records, fixed=("Lp",), bounds=bounds)
    assert fit.model.tau == pytest.approx(spare, abs=1e-6)
    cost = scanned(structure, fit.model.tau, records) + records[0].y.size / 2
    assert fit.cost == pytest.approx(cost, abs=0.01)


class Earlier(Pair):
    """Heard at once where its parameter is on its upper bound."""

    def delays(self):
        return {"lat": 0.2 - self.tau, "ped": 0.2 - self.tau}


@pytest.mark.second
def test_no_delay_is_found_where_a_parameter_that_shortens_it_is_on_its_bound():
    records = paired(Alike, 0.0, (0.02,))
    fit = output_error(Earlier(tau=0.17), records, fixed=("Lp",))
    assert fit.model.tau == pytest.approx(0.2, abs=1e-6)
    cost = scanned(Alike, 0.0, records) + records[0].y.size / 2
    assert fit.cost == pytest.approx(cost, abs=0.01)


class Straight(Twice):
    """The accelerometer hears the pedals alone."""

    def D(self):
        return [[0, 0], [0, self.Yped]]


def tried(structure, tau, hold):
    """Stretches [ms] that are tried about a model, and the delays within."""
    model = structure(tau=tau)
    records = [replace(record, hold=hold) for record in paired(structure, tau)]
    free = free_parameters(model)
    evaluator = Evaluator(free, lay_out(records, 2.0))
    programme, point = starting_programme(evaluator, free, np.diag([0.02, 0.05]) ** 2, True)
    sides, i = list(neighbours(programme, point.lam, solved=True)), free.names.index("tau")
    ends = [[1e3 * each.free.lower[i], 1e3 * each.free.upper[i]] for each in sides]
    return np.round(ends, 6).tolist(), [1e3 * each.delays for each in sides]


def test_stretches_end_at_whole_samples_of_every_input_and_record():
    # 20 and 50 ms of τ and of 2 τ: 0, 10, 20, 25, 30, 40, 50, ...
    ends, within = tried(Twice, 0.0285, "zoh")
    assert ends == [[20, 25], [30, 40]]
    np.testing.assert_allclose(within, [[22.5, 45], [35, 70]])
    assert tried(Twice, 0.0285, "foh")[0] == []
    ends, within = tried(Twice, 0.0258, "foh")  # near 50 ms of the pedals' 51.6
    assert ends == [[20, 25]]
    # Straight lines that only states feel pass their samples smoothly.
    ends, within = tried(Straight, 0.0258, "foh")
    assert ends == [[20, 25]]
    np.testing.assert_allclose(within, [[np.nan, 45]])
    # 20 and 50 ms of τ and of 213 ms - τ: 0, 13, 20, 33, 40, 50, 53, 60, 63, ...
    ends, within = tried(Against, 0.045, "zoh")
    assert ends == [[33, 40], [50, 53]]
    np.testing.assert_allclose(within, [[36.5, 176.5], [51.5, 161.5]])


class Shared(Pair):
    """The pedals' way is as much longer as another parameter has it."""

    more: Scalar = parameter(default=0.02, lower=0.0, upper=0.1, unit="s")

    def delays(self):
        return {"lat": self.tau, "ped": self.tau + self.more}


class Bent(Pair):
    """The pedals' delay is a square."""

    def delays(self):
        return {"lat": self.tau, "ped": 10 * self.tau**2}


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
@pytest.mark.parametrize("structure", [Shared, Bent])
def test_jumps_in_a_delay_that_no_parameter_holds_are_told(structure, domain):
    limit = SolverOptions(max_iterations=2)
    fixed = ("Lp", "Llat", "Lped", "Ylat", "Yped")
    with (
        pytest.warns(DataWarning, match="outputs feel ped, held in steps, at once, after a delay"),
        contextlib.suppress(ConvergenceError),
    ):
        output_error(structure(), paired(Alike, 0.05), fixed=fixed, solver=limit, domain=domain)


@pytest.mark.campaign
def test_a_delay_of_a_fixed_parameter_and_a_free_one_is_that_ones():
    records = paired(Longer, 0.087)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        fit = output_error(Shared(more=0.015), records, fixed=("Lp", "more"))
    grid = np.arange(0.0802, 0.1, 0.0005)
    least = min(scanned(Longer, each, records) for each in grid)
    assert scanned(Longer, fit.model.tau, records) <= least + 0.01


class Tied(Model):
    """x' = a x + b u(t - tau) with one relation between its parameters."""

    states, inputs, outputs = ("x",), ("u",), ("x",)

    a: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    b: Scalar = parameter(default=3.0, lower=-9.0, upper=9.0, unit="-")
    tau: Scalar = parameter(default=0.08, lower=0.0, upper=0.25, unit="s")
    relation: ClassVar[tuple[str, float]] = ("tau", 0.08)

    def A(self):
        return [[self.a]]

    def B(self):
        return [[self.b]]

    def delays(self):
        return {"u": self.tau}

    def constraints(self):
        name, value = self.relation
        return [Constraint(name, 5.0 * getattr(self, name), 5.0 * value, 5.0 * value)]


class TiedElsewhere(Tied):
    """The same, and the relation is of another parameter."""

    relation = ("b", 3.0)


@pytest.mark.parametrize(("model", "ties"), [(Tied(), 0.0), (TiedElsewhere(), 0.7)])
def test_what_the_end_of_a_stretch_bears_beside_a_tie_is_the_ties(model, ties):
    # A whole sample holds tau twice: -1 and 0.7 of units of its own balance nothing but each other.
    free, scales = free_parameters(model), np.array([2.0, 3.0, 0.01])
    lower = free.lower.copy()
    lower[2] = 0.08
    unit = 5.0 * scales[2] / free.constraint_sizes[0]
    prices = np.array([0.0, 0.0, -0.7 * unit if ties == 0.0 else -0.7]), np.array([0.7])
    own, found = own_prices(prices, replace(free, lower=lower), free, free.guess, scales)
    np.testing.assert_array_equal(own, 0.0)
    np.testing.assert_allclose(found, [ties], atol=1e-12)
