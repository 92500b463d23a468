"""The solver's door: known optima, multipliers, limits and what IPOPT says of them."""

import os
import pickle
import signal

import casadi as ca
import numpy as np
import pytest

from casid import Progress, SolverOptions
from casid.nlp import Problem, solve

INF = np.inf


def rosenbrock(**changes):
    """Minimum at (1, 1) on 3x + y = 4, started from afar."""
    x = ca.SX.sym("x", 2)
    parts = {
        "x": x, "f": (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, "g": 3 * x[0] + x[1],
        "x0": np.array([-1.2, 1.0]), "lower_x": np.full(2, -INF), "upper_x": np.full(2, INF),
        "lower_g": np.array([-INF]), "upper_g": np.array([INF]),
    }  # fmt: skip
    return Problem(**(parts | changes))


def test_a_known_minimum_is_found():
    found = solve(rosenbrock(), SolverOptions(), stage="test")
    assert found.success
    assert found.status == "solved"
    np.testing.assert_allclose(found.x, [1, 1], atol=1e-7)
    np.testing.assert_allclose(found.g, [4], atol=1e-6)
    np.testing.assert_array_equal(found.multipliers_x, 0)
    assert found.iterations > 5
    assert found.seconds > 0


def test_multipliers_press_on_their_bounds_with_the_sign_promised():
    x = ca.SX.sym("x", 2)
    problem = rosenbrock(
        x=x, f=(x[0] - 3) ** 2 + (x[1] + 2) ** 2, g=x[0] + x[1], x0=np.array([0.5, 0.5]),
        lower_x=np.array([-1.0, -1.0]), upper_x=np.array([2.0, 2.0]),
    )  # fmt: skip
    found = solve(problem, SolverOptions(tolerance=1e-10), stage="test")
    np.testing.assert_allclose(found.x, [2, -1], atol=1e-6)
    # df/dx = (2 (2 - 3), 2 (-1 + 2)) = (-2, 2) is balanced by the bounds' multipliers.
    np.testing.assert_allclose(found.multipliers_x, [2, -2], atol=1e-5)


def test_constraints_hold_and_their_multipliers_balance_the_gradient():
    problem = rosenbrock(upper_g=np.array([2.0]))
    found = solve(problem, SolverOptions(tolerance=1e-10), stage="test")
    assert found.g[0] <= 2 + 1e-7
    a, b = found.x
    gradient = np.array([-2 * (1 - a) - 400 * a * (b - a**2), 200 * (b - a**2)])
    np.testing.assert_allclose(gradient + found.multipliers_g * [3, 1], 0, atol=1e-5)


def test_a_warm_start_at_the_solution_takes_few_iterations():
    problem = rosenbrock(upper_g=np.array([2.0]))
    cold = solve(problem, SolverOptions(), stage="cold")
    near = rosenbrock(upper_g=np.array([2.0]), x0=cold.x)
    warm = solve(near, SolverOptions(), stage="warm", warm=(cold.multipliers_x, cold.multipliers_g))
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-6)
    assert warm.iterations < cold.iterations


def test_an_iteration_limit_is_no_success_and_keeps_the_iterate():
    found = solve(rosenbrock(), SolverOptions(max_iterations=3), stage="test")
    assert not found.success
    assert "raise max_iterations" in found.status
    assert found.iterations == 3
    assert found.f < 24.2  # the start's cost: the last iterate is better


def test_what_cannot_be_solved_is_told():
    x = ca.SX.sym("x", 2)
    impossible = rosenbrock(g=x[0] ** 2 + x[1] ** 2, x=x, f=x[0], upper_g=np.array([-1.0]))
    found = solve(impossible, SolverOptions(), stage="test")
    assert not found.success
    assert "no feasible point" in found.status or "no feasible step" in found.status
    lost = rosenbrock(f=ca.sqrt(-1 - x[0] ** 2), x=x, g=x[0])
    found = solve(lost, SolverOptions(), stage="test")
    assert not found.success
    assert "NaN" in found.status


def test_progress_is_told_after_every_iteration():
    lines: list[Progress] = []
    found = solve(rosenbrock(), SolverOptions(progress=lines.append), stage="climb")
    assert [line.iteration for line in lines] == list(range(found.iterations + 1))
    assert {line.stage for line in lines} == {"climb"}
    assert lines[0].cost == pytest.approx(24.2)  # Rosenbrock's value at his start
    assert lines[-1].cost == pytest.approx(found.f, abs=1e-9)
    assert sorted(line.seconds for line in lines) == [line.seconds for line in lines]


def test_options_for_ipopt_pass_through():
    found = solve(rosenbrock(), SolverOptions(ipopt={"max_iter": 2}), stage="test")
    assert found.iterations == 2


def test_a_hessian_of_the_callers_replaces_the_exact_one():
    x = ca.SX.sym("x", 2)
    r = ca.vertcat(1 - x[0], 10 * (x[1] - x[0] ** 2))
    J = ca.jacobian(r, x)
    sigma, lam = ca.SX.sym("sigma"), ca.SX.sym("lam")
    gauss = ca.Function("gauss", [x, ca.SX(0, 0), sigma, lam], [ca.triu(2 * sigma * J.T @ J)])
    found = solve(
        rosenbrock(x=x, f=ca.sumsqr(r), g=x[0], hessian=gauss), SolverOptions(), stage="t"
    )
    assert found.success
    np.testing.assert_allclose(found.x, [1, 1], atol=1e-6)
    exact = solve(rosenbrock(), SolverOptions(), stage="exact")
    assert found.iterations < exact.iterations  # no residual: Gauss-Newton is the better model


def test_the_time_limit_stops_it_with_the_last_iterate():
    found = solve(rosenbrock(), SolverOptions(max_seconds=1e-9), stage="test")
    assert not found.success
    assert found.status == "time limit reached; raise max_seconds"
    assert np.isfinite(found.x).all()


def test_an_interrupt_during_a_solve_is_no_failure_of_the_model():
    def interrupt(progress):
        if progress.iteration == 2:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        solve(rosenbrock(), SolverOptions(progress=interrupt), stage="test")
    assert signal.getsignal(signal.SIGINT) is before


def test_a_handler_that_only_notes_the_interrupt_lets_the_solve_go_on():
    noted = []
    before = signal.signal(signal.SIGINT, lambda *_: noted.append("interrupt"))
    try:
        send = SolverOptions(progress=lambda _: os.kill(os.getpid(), signal.SIGINT))
        assert solve(rosenbrock(), send, stage="test").success
    finally:
        signal.signal(signal.SIGINT, before)
    assert noted


def test_solver_options_travel_without_their_progress():
    back = pickle.loads(pickle.dumps(SolverOptions(tolerance=1e-5, progress=print)))
    assert back == SolverOptions(tolerance=1e-5)
    assert back.progress is None
