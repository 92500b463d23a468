"""Steps of the parameters alone: where they end, and when an end is one."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, noisy
from truths.mixture import Mixture, least_squares
from truths.mixture import record as steps

from casid import NonlinearModel, Record, Scalar, SolverOptions, parameter
from casid.free import free_parameters
from casid.nlp import solve
from casid.shooting.intervals import lay_out
from casid.shooting.newton import Newton
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.reduced import IDLE, STATED, Reduced, completed
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import noise_of, starting_programme
from casid.shooting.uncertainty import bound

OPTIONS = SolverOptions()
ONE = np.eye(3)
OFF = replace(TRUTH, Lp=-3.5, Lv=-0.1, Llat=14.0)


def begun(model, records, **given):
    """A programme that estimates R, and its start."""
    free = free_parameters(model, **given)
    evaluator = Evaluator(free, lay_out(records, 2.0))
    first, point = starting_programme(evaluator, free, "diagonal", True)
    programme = first.variant(noise=noise_of(evaluator, None, "diagonal"))
    return programme, programme.pack(point)


def by_ipopt(programme, x):
    newton = Newton(programme)
    tight = replace(OPTIONS, tolerance=1e-10, ipopt={"nlp_scaling_method": "none"})
    return newton.stripped(solve(newton.problem(x), tight, stage="test"))


@pytest.mark.second
@pytest.mark.parametrize("bounds", [{}, {"Lp": (-20.0, -2.6)}])
def test_steps_of_the_parameters_alone_end_where_those_of_all_variables_do(bounds):
    programme, x = begun(OFF, [noisy(seed=3)], bounds=bounds)
    found, all_of_them = Reduced(programme, OPTIONS, "").run(x), by_ipopt(programme, x)
    assert found.success
    assert all_of_them.success
    assert programme.n * abs(found.f - all_of_them.f) < 1e-4
    # Multipliers are the slopes of the cost: those of the bound that holds, and of the continuity.
    prices, others = found.multipliers_x, all_of_them.multipliers_x
    np.testing.assert_allclose(prices, others, atol=1e-3 * max(np.abs(others).max(), 1e-3))
    scale = np.abs(all_of_them.multipliers_g).max()
    np.testing.assert_allclose(
        found.multipliers_g, all_of_them.multipliers_g, atol=2e-3 * max(scale, 1e-3)
    )
    assert (np.abs(prices).max() > 1e-4) == bool(bounds)


@pytest.mark.second
def test_no_steps_lead_below_what_is_told_to_be_the_least():
    programme, x = begun(OFF, [noisy(seed=3)])
    best = Reduced(programme, OPTIONS, "").run(x)
    near = Reduced(programme, OPTIONS, "")
    assert near.least(best.x) == pytest.approx(programme.n * best.f, abs=1e-5)
    told, rng = [], np.random.default_rng(1)
    for spread in np.repeat([0.005, 0.02, 0.1, 3.0], 3):
        away = best.x.copy()
        away[: programme.evaluator.nf] += spread * rng.standard_normal(programme.evaluator.nf)
        told.append((spread, near.least(away)))
    spreads, least = np.array(told).T
    assert (least < programme.n * best.f).all()
    assert np.isfinite(least[spreads < 0.01]).all()
    assert (least > -np.inf).sum() < len(least)  # far away nothing is sure
    # Of a gain with R given the model is the cost itself, of which half more is taken.
    others = [name for name in OFF.parameter_names() if name != "Llat"]
    linear, start = begun(OFF, [noisy(seed=3)], fixed=others)
    held = linear.variant(noise=replace(linear.noise, given=ONE))
    end = Reduced(held, OPTIONS, "").run(start)
    start_cost, end_cost = held.n * held.values(start).cost, held.n * end.f
    expected = start_cost - 1.5 * (start_cost - end_cost)
    assert Reduced(held, OPTIONS, "").least(start) == pytest.approx(expected, rel=1e-6)
    full = programme.variant(noise=replace(programme.noise, kind="full"))
    assert Reduced(full, OPTIONS, "").least(best.x) == -np.inf


@pytest.mark.second
def test_a_tenth_of_a_standard_error_is_worth_half_a_hundredth_of_log_likelihood():
    programme, x = begun(OFF, [noisy(seed=3)])
    reduced = Reduced(programme, OPTIONS, "")
    end = reduced.run(x).x
    assert reduced.gain(end) < 1e-6
    place = reduced._settled(end)
    C = bound(place.gauss.form[:-1, :-1], np.zeros((0, programme.evaluator.nf)))
    d = 0.1 * C[:, 2] / np.sqrt(C[2, 2])
    assert reduced.gain(reduced._moved(end, d, place.gauss)) == pytest.approx(0.005, rel=0.05)


def beyond_nothing():
    """A gain just below zero, whose mode has a huge initial state: slopes by all are tiny."""
    programme, x = begun(replace(Mixture(), a=-1e-4), [steps()])
    reduced = Reduced(programme, OPTIONS, "")
    return programme, reduced._settled(x).x, reduced


@pytest.mark.second
def test_an_end_that_scales_of_the_variables_feign_is_none():
    programme, x, reduced = beyond_nothing()
    assert reduced.gain(x) > 100
    values = programme.values(x)
    feigned = replace(reduced.run(x), x=x, f=values.cost, success=True, iterations=1)
    found = completed(programme, x, feigned, OPTIONS, "")
    assert found.success
    X, y = least_squares()
    best, *_ = np.linalg.lstsq(X, y, rcond=None)
    errors = np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    np.testing.assert_array_less(
        np.abs(programme.unpack(found.x).lam - best[:3]), 3e-3 * errors[:3]
    )


@pytest.mark.second
def test_an_end_is_left_as_it_is_and_limits_are_kept():
    programme, x = begun(OFF, [noisy(seed=3)])
    end = by_ipopt(programme, x)
    assert completed(programme, x, end, OPTIONS, "") is end
    reduced = Reduced(programme, OPTIONS, "")
    x = reduced._settled(x).x
    early = replace(end, x=x, f=programme.values(x).cost, success=False, iterations=2)
    assert completed(programme, x, early, replace(OPTIONS, max_iterations=2), "") is early
    hurried = completed(programme, x, early, replace(OPTIONS, max_iterations=7), "")
    assert not hurried.success
    assert hurried.iterations <= 7
    assert hurried.f < early.f
    assert "max_iterations" in hurried.status
    whole = completed(programme, x, early, OPTIONS, "")
    assert whole.success
    assert programme.n * (whole.f - end.f) < STATED


@pytest.mark.second
@pytest.mark.parametrize("open_by", [0.0, 0.3])
def test_what_was_better_at_the_start_goes_on_from_there(open_by):
    programme, x = begun(OFF, [noisy(seed=3)])
    end = by_ipopt(programme, x)
    reduced = Reduced(programme, OPTIONS, "")
    away, start = reduced._settled(x).x, end.x.copy()
    others = start[programme.evaluator.nf :]  # biases and nodes
    others += open_by * np.cos(np.arange(len(others)))
    lost = replace(end, x=away, f=programme.values(away).cost, success=False, iterations=7)
    assert reduced.meet(start) == (open_by == 0)
    found = completed(programme, start, lost, OPTIONS, "")
    assert found.success
    assert found.iterations <= 7 + 2


@pytest.mark.second
def test_rough_steps_end_earlier_and_idle_ones_do_not_go_on():
    programme, x = begun(OFF, [noisy(seed=3)])
    rough, exact, idle = (Reduced(programme, OPTIONS, "", e).run(x) for e in (10.0, 1e-6, -1.0))
    assert rough.success
    assert rough.iterations < exact.iterations
    assert Reduced(programme, OPTIONS, "").gain(rough.x) < 10.0
    assert idle.success
    assert idle.iterations <= exact.iterations + IDLE


def test_an_end_about_which_nothing_can_be_told_is_none(monkeypatch):
    programme, x = begun(OFF, [noisy(seed=3)])
    end = by_ipopt(programme, x)
    assert end.success

    def singular(*_):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr("casid.shooting.reduced.quadratic_model", singular)
    assert Reduced(programme, OPTIONS, "").gain(end.x) == np.inf
    found = completed(programme, x, end, OPTIONS, "")
    assert not found.success
    assert "do not determine Yv, Lv" in found.status
    np.testing.assert_array_equal(found.x, end.x)  # the best there is


def test_steps_do_not_begin_where_a_covariance_is_none(monkeypatch):
    programme, x = begun(OFF, [noisy(seed=3)])

    def overflown(_):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(programme, "hessian_matrix", overflown)
    assert Reduced(programme, OPTIONS, "").run(x) is None


class Bent(NonlinearModel):
    """A state measured by itself, by its square and by a scale of its own."""

    states, inputs, outputs = ("x",), ("u",), ("x", "square", "scaled")

    scale: Scalar = parameter(default=1.0, lower=-9.0, upper=9.0, unit="-")

    def derivatives(self, _x, u):
        return [u.u]

    def measurements(self, x, _u):
        return [x.x, x.x**2, self.scale * x.x]

    def reference(self):
        return {"x": 1.0}


def test_states_settle_where_gauss_newton_passes_over_the_minimum_and_back_for_ever():
    # (x - 1)² + (x² + 1)² is least where 2x³ + 3x = 1; the curvature there is 2.6 of Gauss-Newton's
    t = np.arange(40) / 10
    y = np.tile([1.0, -1.0, 2.0], (len(t), 1))
    record = Record(t=t, u=np.zeros((len(t), 1)), y=y, inputs=("u",), outputs=Bent.outputs)
    free = free_parameters(Bent())
    evaluator = NonlinearEvaluator(free, lay_out([record], 2.0))
    programme, point = starting_programme(evaluator, free, ONE, False)
    found = Reduced(programme, OPTIONS, "").run(programme.pack(point))
    x = np.roots([2, 0, 3, -1])[-1].real
    end = programme.unpack(found.x)
    assert found.success
    np.testing.assert_allclose(end.nodes, x, atol=1e-4)
    np.testing.assert_allclose(end.lam, 2 / x, atol=1e-3)
