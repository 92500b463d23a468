"""Ways to a solution: how long intervals are, when they become shorter, which end is told."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, Roll, noisy

from casid import (
    DataWarning,
    Model,
    NonlinearModel,
    Record,
    Scalar,
    SolverOptions,
    output_error,
    parameter,
)
from casid.free import free_parameters
from casid.shooting.strategies import GAIN, Ways, choose_interval, missed


def ways(model=TRUTH, **more):
    records = [noisy(seed=3)]
    given = {"R": "full", "biases": True, "interval": None, "options": SolverOptions()}
    return Ways(free=free_parameters(model), records=records, **(given | more))


def test_intervals_are_as_long_as_the_fastest_growing_mode_e_folds():
    growth = TRUTH.system().poles()[0].real
    records = [noisy(seed=3)]
    expected = min(1 / growth, 5.0)
    assert choose_interval(free_parameters(TRUTH), records) == pytest.approx(expected)
    fast = replace(TRUTH, Lv=-0.9)
    growth = fast.system().poles()[0].real
    assert choose_interval(free_parameters(fast), records) == pytest.approx(1 / growth)
    calm = replace(TRUTH, Lv=-1e-4, Lp=-15.0)  # e-folds in minutes
    assert choose_interval(free_parameters(calm), records) == 5.0


def test_intervals_become_shorter_as_long_as_a_record_has_several():
    lengths = list(ways()._lengths())
    assert len(lengths) > 1
    np.testing.assert_allclose(np.array(lengths[:-1]) / lengths[1:], 2.5)
    assert lengths[-1] >= 0.5
    assert list(ways(interval=1.5)._lengths()) == [1.5]  # a given one is not changed


@pytest.mark.second
def test_where_no_way_ends_the_best_is_told():
    hurried = ways(Roll(Lp=-6.0), options=SolverOptions(max_iterations=2)).output_error()
    assert not hurried.solution.success
    patient = ways(Roll(Lp=-6.0)).output_error()
    assert patient.solution.success
    assert patient.cost <= hurried.cost + 1e-6


def test_the_way_taken_does_not_matter():
    one, other = (output_error(TRUTH, noisy(seed=3), interval=length) for length in (0.7, 3.0))
    apart = (one.model.vector() - other.model.vector()) / [row.std_error for row in one.parameters]
    assert np.abs(apart).max() < 1e-3


@pytest.mark.second
def test_a_fit_nearby_is_where_it_begins():
    near = output_error(TRUTH, noisy(seed=3), R="full")
    far, warm = ways(Roll(Lp=-6.0)).output_error(), ways().output_error(near)
    assert warm.cost == pytest.approx(far.cost, rel=1e-9)
    assert warm.iterations < far.iterations / 2


@pytest.mark.campaign
def test_a_filter_is_no_less_likely_than_the_output_error_it_begins_with():
    plain, filtered = ways(R="diagonal").output_error(), ways(R="diagonal").filtered(True)
    assert filtered.solution.success
    assert filtered.cost < plain.cost + GAIN


@pytest.mark.second
def test_the_likelihood_beside_a_fit_has_initial_states_biases_and_covariance_follow():
    names = [name for name in TRUTH.parameter_names() if name != "Lp"]
    fit = output_error(replace(TRUTH, Llat=9.0), noisy(seed=3), R="full", fixed=names)
    free = free_parameters(fit.model, names)
    poor = replace(fit, R=4 * fit.R, biases=0 * fit.biases)
    assert replace(ways(), free=free).cost_beside(poor) == pytest.approx(fit.cost, abs=1e-3)
    farther = free_parameters(replace(fit.model, Llat=9.5), names)  # nearer to the truth's 10
    assert replace(ways(), free=farther).cost_beside(poor) < fit.cost - 10


@pytest.mark.second
def test_the_likelihood_beside_a_fit_of_more_records_is_that_of_its_own():
    fit = output_error(TRUTH, [noisy(seed=3), noisy(seed=4)], R="full")
    names = [name for name in TRUTH.parameter_names() if name != "Lp"]
    narrow = {"Lp": (fit.model.Lp - 1e-9, fit.model.Lp + 1e-9)}
    alone = output_error(fit.model, noisy(seed=3), R="full", fixed=names, bounds=narrow)
    assert ways().cost_beside(fit) == pytest.approx(alone.cost, abs=1e-3)


def test_the_likelihood_beside_what_is_no_output_error_is_not_known():
    fit = output_error(TRUTH, noisy(seed=3))
    assert ways().cost_beside(replace(fit, R=None)) == np.inf


class Thrust(NonlinearModel):
    """Thrust follows the square of a command by a lag; quadratic drag."""

    states, inputs, outputs = ("T", "V"), ("c",), ("T", "V")

    k: Scalar = parameter(default=6.0, lower=0.0, upper=40.0, unit="m/s^2")
    d: Scalar = parameter(default=0.03, lower=0.0, upper=1.0, unit="1/m")
    lag: Scalar = parameter(default=0.1, lower=0.001, upper=1.0, unit="s")

    def derivatives(self, x, u):
        return [(self.k * u.c**2 - x.T) / self.lag, x.T - self.d * x.V**2]

    def reference(self):
        return {"T": 2.0, "V": 10.0, "c": 0.5}


def thrusted(seed, lag, k=8.0, d=0.02):
    """Records at 25 Hz, commands held: thrust exact, speed by short steps of Runge-Kutta."""
    rng = np.random.default_rng(9)
    c = 0.5 + np.repeat(rng.uniform(-0.2, 0.2, 50), 10)
    x = np.array([k * c[0] ** 2, 10.0])
    found, h = [x], 0.04 / 16
    for value in c[:-1]:
        level, (T, V) = k * value**2, found[-1]
        for j in range(16):
            a, b, e = (level + (T - level) * np.exp(-(j * h + s) / lag) for s in (0.0, h / 2, h))
            k1 = a - d * V**2
            k2 = b - d * (V + h / 2 * k1) ** 2
            k3 = b - d * (V + h / 2 * k2) ** 2
            V += h / 6 * (k1 + 2 * k2 + 2 * k3 + e - d * (V + h * k3) ** 2)
        found.append(np.array([level + (T - level) * np.exp(-0.04 / lag), V]))
    y = np.array(found) + [0.1, 0.05] * np.random.default_rng(seed).standard_normal((500, 2))
    return Record(0.04 * np.arange(500), c[:, None], y, ("c",), ("T", "V"), "thrust", hold="zoh")


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("seed", "lag"),
    [(1, 0.012), (2, 0.012), (4, 0.008)],
)
def test_a_lag_far_shorter_than_the_guess_is_found(seed, lag):
    # One step a sample follows the guess's lag; on the way to the true one it diverges.
    fit = output_error(Thrust(), thrusted(seed, lag), biases=False)
    assert abs(fit["lag"].value - lag) < 4 * fit["lag"].std_error
    assert fit["lag"].std_error < lag / 3
    assert abs(fit["k"].value - 8.0) < 4 * fit["k"].std_error


# ---- ends that explain nothing ------------------------------------------------------------------


class Swing(Model):
    """An oscillator, whose likelihood has hollows beside the true frequency, 5 rad/s."""

    states = ("w", "phi")
    inputs = ("de",)
    outputs = ("phi",)
    k: Scalar = parameter(default=2.0, lower=0.1, upper=200.0, unit="1/s^2")
    c: Scalar = parameter(default=0.1, lower=0.0, upper=5.0, unit="1/s")
    b: Scalar = parameter(default=1.0, lower=-20.0, upper=20.0, unit="rad/s^2")

    def A(self):
        return [[-self.c, -self.k], [1, 0]]

    def B(self):
        return [[self.b], [0]]

    def C(self):
        return [[0, 1]]


def swung(sign=1):
    """Twenty seconds of it under a stick in steps, with noise of 0.01."""
    rng, t = np.random.default_rng(0), 0.05 * np.arange(400)
    u = np.repeat(rng.choice([-1, 0, 1], 40), 10).astype(float)[:, None]
    y = Swing(k=25.0, c=0.3, b=4.0).system().simulate(t, u) + 0.01 * rng.standard_normal((400, 1))
    return Record(t, u, sign * y, ("de",), ("phi",), "swing")


def test_where_an_end_explains_nothing_shorter_intervals_find_the_truth():
    fit = output_error(Swing(), swung(), biases=False)
    assert fit.interval == pytest.approx(2.0)
    assert fit["k"].value == pytest.approx(25.0, abs=4 * fit["k"].std_error)
    assert np.sqrt(fit.R[0, 0]) == pytest.approx(0.01, rel=0.1)


@pytest.mark.second
def test_a_fit_that_explains_nothing_of_an_output_says_so():
    said = "nothing of phi .* is explained.*: try shorter intervals, other starts and compare their"
    with pytest.warns(DataWarning, match=said):
        lost = output_error(Swing(), swung(), biases=False, interval=5.0)
    assert lost.cost > output_error(Swing(k=20.0), swung(), biases=False).cost + 1000
    with pytest.warns(DataWarning, match=r"nothing of phi .* is explained.*: try other starts"):
        output_error(Swing(k=25.0, b=4.0), swung(-1), fixed=("k", "b"), biases=False)


@pytest.mark.second
def test_the_start_of_a_filter_and_what_lies_beside_a_fit_nearby_are_not_sought_again():
    free, options = free_parameters(Swing()), SolverOptions()
    own = Ways(free, [swung()], options, R="diagonal", biases=False, interval=None)
    lost = own.output_error(again=False)
    assert lost.programme.evaluator.layout.interval == 5.0
    assert missed(lost)
    assert missed(lost.failed("for some reason")) == []
    assert not missed(own.output_error())
    with pytest.warns(DataWarning, match="nothing of phi .* is explained"):
        near = output_error(Swing(), swung(), biases=False, interval=5.0)
    assert own.output_error(near).cost == pytest.approx(near.cost)
