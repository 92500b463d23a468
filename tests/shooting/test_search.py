"""Rounds of solves."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths.closed_roll import NOISE, TRUTH, T, flown, noisy, off, with_response

from benchmarks.turbulence import cases, fly
from casid import Model, Record, Rows, Scalar, SolverOptions, bootstrap, parameter
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.output_error import OutputError, output_error
from casid.shooting.reduced import STATED
from casid.shooting.search import Search, _leads_back
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import starting_programme
from casid.shooting.warm_start import Iterate


@pytest.mark.second
@pytest.mark.parametrize("R", [None, np.diag([0.05, 0.005, 0.005]) ** 2])
def test_the_start_from_a_neighbour_changes_the_effort_only(R):
    records = [noisy(1), noisy(2)]
    wide = output_error(off(), records, R=R)
    bounds = {"Lp": (-1.9, 0.0), "Lv": (-1.0, -0.16)}
    cold = output_error(off(), records, R=R, bounds=bounds)
    warm = OutputError(R=R).fit(off(), records, bounds=bounds, near=wide)
    assert warm.iterations <= cold.iterations / 2
    # Each bound's share of the barrier is at most 1e-8 per observation.
    n = sum(record.y.size for record in records)
    assert warm.cost == pytest.approx(cold.cost, abs=2e-8 * n)
    for one, other in zip(warm.parameters, cold.parameters, strict=True):
        # Both stop with slopes per observation of 1e-8 at most, a fraction of 1e-4 of these prices.
        assert one.value == pytest.approx(other.value, rel=1e-6)
        assert one.multiplier == pytest.approx(other.multiplier, rel=1e-4, abs=1e-3)
        assert one.active == other.active == (one.name in bounds)


@pytest.mark.second
def test_a_neighbour_of_more_records_shortens_the_way_too():
    records = [noisy(1), noisy(2), noisy(3)]
    wide = output_error(off(), records)
    cold = OutputError().fit(wide.model, records[1:])
    warm = OutputError().fit(wide.model, records[1:], near=wide)
    assert warm.iterations <= cold.iterations / 2
    assert warm.cost == pytest.approx(cold.cost, abs=1e-5)
    for one, other in zip(warm.parameters, cold.parameters, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-3 * other.std_error)
    np.testing.assert_allclose(warm.biases, cold.biases, atol=1e-5)


def test_a_stretch_leads_back_by_its_own_delay_and_not_by_others_that_press_on_theirs():
    model, R = replace(TRUTH, tau=0.061), np.diag([0.05, 0.005, 0.005]) ** 2
    wide = free_parameters(model)
    programme, point = starting_programme(
        Evaluator(wide, lay_out([noisy(1)], 2.0)), wide, R, biases=True
    )
    x, upper = programme.pack(point), replace(wide, upper=wide.upper.copy())
    a, other = (wide.names.index(name) for name in ("tau", "Lp"))
    upper.upper[wide.index[[a, other]]] = 0.06, point.lam[other] - 0.01
    inside = programme.variant(free=upper)
    (low, high), _ = inside.limits()

    def leads_back(pressing):
        there, prices = x.copy(), np.zeros(len(x))
        there[[a, other]] = (low + high)[[a, other]] / 2
        there[pressing] = high[pressing]
        prices[pressing] = 10 / ((high - low)[pressing] * programme.n)
        return _leads_back(inside, x, Iterate(there, prices, np.zeros(0)), a)

    assert leads_back(a)
    assert not leads_back(other)


def jerky(model, seed):
    """A record whose sticks bend at every sample: likely most so on a whole sample of delay."""
    rng = np.random.default_rng(seed)
    record = flown(model, T[:300], seed)
    record = replace(record, u=record.u + 0.05 * rng.normal(size=record.u.shape))
    return with_response(record, model).with_noise(NOISE, rng)


@pytest.mark.second
def test_a_delay_that_a_kink_holds_costs_a_neighbour_no_endless_steps():
    truth, told = replace(TRUTH, tau=0.08), []
    near = OutputError(interval=2.0).fit(truth, jerky(truth, 100))
    assert abs(near.model.tau / 0.02 - 4) > 1e-3
    estimator = OutputError(interval=2.0, solver=SolverOptions(progress=told.append))
    warm = estimator.fit(truth, jerky(truth, 1), near=near)
    assert len(told) < 100
    assert warm.model.tau / 0.02 == pytest.approx(4, abs=1e-6)
    left, at, right = (
        OutputError(interval=2.0).fit(
            replace(truth, tau=tau), jerky(truth, 1), fixed={"tau"}, near=near
        )
        for tau in (0.0799, 0.08, 0.0801)
    )
    assert warm.cost == pytest.approx(at.cost, abs=1e-4)
    assert at.cost < min(left.cost, right.cost) - 1e-3


def test_rounds_end_where_the_covariance_is_that_of_its_residuals():
    free, records = free_parameters(off(share=0.1)), [noisy(1), noisy(2)]
    evaluator = Evaluator(free, lay_out(records, 2.0))
    programme, point = starting_programme(evaluator, free, None, True)
    outcome = Search(free, SolverOptions()).run(programme, point, "diagonal")
    assert outcome.settled
    assert outcome.rounds > 1
    end = outcome.programme.unpack(outcome.solution.x)
    r = evaluator.simulate(end).residuals
    R = outcome.programme.values(outcome.solution.x).R
    np.testing.assert_allclose(np.diag(R), np.mean(r**2, axis=0), rtol=1e-9)
    # The likelihood of residuals whose variance is their own: n/2 (1 + log R) a channel.
    cost = len(r) / 2 * np.sum(1 + np.log(np.diag(R)))
    assert outcome.cost == pytest.approx(cost, rel=1e-9)


def test_an_outcome_without_success_costs_everything():
    free = free_parameters(off())
    evaluator = Evaluator(free, lay_out([noisy()], 2.0))
    programme, point = starting_programme(evaluator, free, None, True)
    outcome = Search(free, SolverOptions(max_iterations=2)).run(programme, point, "diagonal")
    assert not outcome.settled
    assert outcome.cost == np.inf


@pytest.mark.campaign
def test_a_filter_that_stops_early_goes_on_over_the_parameters_alone(monkeypatch):
    case = cases()["2 states, 2 outputs"]
    record = fly(case, np.random.default_rng(8), "gusts").between(0.0, 12.0)
    whole = output_error(case.start(case.truth), record, process_noise=True)
    monkeypatch.setattr("casid.shooting.search.EARLIER", 3)
    stopped = output_error(case.start(case.truth), record, process_noise=True)
    assert stopped.success
    assert stopped.cost == pytest.approx(whole.cost, abs=2 * STATED)


class Pitch(Model):
    """An unstable short period."""

    states, inputs, outputs = ("q", "w"), ("lon",), ("q", "w")
    Mq: Scalar = parameter(default=-1.2, lower=-10.0, upper=5.0, unit="1/s")
    Mw: Scalar = parameter(default=0.5, lower=-3.0, upper=3.0, unit="rad/(m s)")
    Md: Scalar = parameter(default=2.5, lower=-10.0, upper=10.0, unit="rad/s^2")
    Zw: Scalar = parameter(default=-0.5, lower=-5.0, upper=2.0, unit="1/s")
    Zd: Scalar = parameter(default=0.4, lower=-5.0, upper=5.0, unit="m/s^2")

    def A(self) -> Rows:
        return [[self.Mq, self.Mw], [2.0, self.Zw]]

    def B(self) -> Rows:
        return [[self.Md], [self.Zd]]

    def C(self) -> Rows:
        return [[1, 0], [0, 1]]

    def D(self) -> Rows:
        return [[0], [0]]


def held_upright(N, rng, dt=0.05):
    """A flight of `Pitch` with q and w fed back, steps from a pilot, noise on what is recorded."""
    truth, K = Pitch().system(), np.array([0.5, 0.6])
    M = np.zeros((4, 4))
    M[:2, :2], M[:2, 2:3], M[2, 3] = truth.A * dt, truth.B * dt, 1.0
    E = scipy.linalg.expm(M)  # van Loan: straight lines between samples
    Ad, now, later = E[:2, :2], E[:2, 2] - E[:2, 3], E[:2, 3]
    pilot = np.repeat(0.15 * rng.choice([-1, 1], N // 20 + 1), 20)[:N]
    x, u = np.zeros((N, 2)), np.zeros(N)
    u[0] = pilot[0]
    for k in range(N - 1):
        free = Ad @ x[k] + now * u[k]
        u[k + 1] = (pilot[k + 1] - K @ free) / (1 + K @ later)
        x[k + 1] = free + later * u[k + 1]
    y = x + rng.standard_normal((N, 2)) * [0.02, 0.05]
    return Record(dt * np.arange(N), u[:, None], y, ("lon",), ("q", "w"), f"{N} samples")


@pytest.mark.campaign
@pytest.mark.parametrize(
    "seed",
    [pytest.param(8, marks=pytest.mark.campaign), pytest.param(18, marks=pytest.mark.campaign), 19],
)
def test_a_neighbour_that_leads_into_a_hollow_is_left(seed):
    # Steps from a fit of an unstable aircraft may end at a bound, and much less likely than it.
    rng = np.random.default_rng(seed)
    records = [held_upright(N, rng) for N in (200, 250, 330)]
    fit = output_error(Pitch(), records)
    drawn = bootstrap(fit, records, runs=12, block=0.5)
    assert not any(drawn.reasons)
    errors = np.array([fit[name].std_error for name in fit.free_names])
    values = np.array([fit[name].value for name in fit.free_names])
    assert (np.abs(drawn.values - values) < 6 * errors).all()
