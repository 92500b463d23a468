"""Linear systems: closed forms of response and simulation, and properties of both."""

from dataclasses import replace

import control
import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.signal
from hypothesis import assume, given, settings

from casid import StateSpace
from casid.linear import foh_step, from_zoh, recursion

OMEGA = np.array([0.1, 0.5, 2.0, 10.0])

# Two inputs with different delays, an unstable oscillation, direct terms.
SYSTEM = StateSpace(
    [[0.1, 0.5, 0.0], [-0.5, 0.1, 1.0], [0.0, 0.0, -4.0]],
    [[1.0, 0.0], [0.0, 2.0], [3.0, 1.0]],
    [[1.0, 0.0, 0.0], [0.0, 1.0, 2.0]],
    [[0.0, 0.5], [-1.0, 0.0]],
    delay=np.array([0.083, 0.31]),
)


def lag(pole, delay=0.0):
    return StateSpace([[pole]], [[1.0]], [[1.0]], [[0.0]], delay=np.array([delay]))


@pytest.mark.parametrize("pole", [-0.1, -1.0, -30.0, 0.3])
@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_a_delayed_lag_has_its_textbook_response(pole, shift):
    s = shift + 1j * OMEGA
    G = lag(pole, 0.07).response(OMEGA, shift)
    np.testing.assert_allclose(G[:, 0, 0], np.exp(-0.07 * s) / (s - pole), rtol=1e-12)


def test_the_response_of_a_discrete_lag_is_taken_on_the_unit_circle():
    system = StateSpace([[0.9]], [[2.0]], [[1.0]], [[0.5]], dt=0.1)
    z = np.exp(0.1j * OMEGA)
    np.testing.assert_allclose(system.response(OMEGA)[:, 0, 0], 2 / (z - 0.9) + 0.5, rtol=1e-12)


@pytest.mark.second
@given(hnp.arrays(float, (3, 3), elements=st.floats(-1, 1)))
def test_response_and_poles_are_the_same_in_any_coordinates(noise):
    T = np.eye(3) + 0.3 * noise
    assume(np.linalg.cond(T) < 1e3)
    other = SYSTEM.transform(T)
    # Rounding 1e-16 times the condition of T (1e3) times that of the resolvent (1e2).
    np.testing.assert_allclose(other.response(OMEGA), SYSTEM.response(OMEGA), rtol=1e-9)
    np.testing.assert_allclose(other.poles(), SYSTEM.poles(), atol=1e-9)


def test_poles_come_fastest_growing_first():
    np.testing.assert_allclose(SYSTEM.poles(), [0.1 - 0.5j, 0.1 + 0.5j, -4.0], atol=1e-12)


@pytest.mark.parametrize("pole", [-30.0, -1.0, 0.0, 0.5])
@pytest.mark.parametrize("delay", [0.0, 0.4, 0.437])
def test_a_lag_follows_a_delayed_step_and_ramp_as_in_the_textbook(pole, delay):
    t = 0.1 * np.arange(60)
    late = np.maximum(t - 1.0 - delay, 0.0)  # the input starts at t = 1
    growth = late if pole == 0 else np.expm1(pole * late) / pole
    steps = lag(pole, delay).simulate(t, (t > 0.95)[:, None].astype(float), hold="zoh")
    np.testing.assert_allclose(steps[:, 0], growth, atol=1e-12)
    ramp = late**2 / 2 if pole == 0 else (growth - late) / pole
    ramps = lag(pole, delay).simulate(t, np.maximum(t - 1.0, 0.0)[:, None], hold="foh")
    np.testing.assert_allclose(ramps[:, 0], ramp, atol=1e-12 * max(1, ramp.max()))


def test_an_input_rests_at_its_first_value_before_the_first_sample():
    t = 0.1 * np.arange(50)
    still = lag(-2.0, 0.35).simulate(t, np.full((50, 1), 3.0), np.array([1.5]))
    np.testing.assert_allclose(still, 1.5, rtol=1e-13)


def test_the_free_response_is_the_exponential_on_any_instants():
    t = np.cumsum(np.random.default_rng(0).uniform(0.001, 0.3, 80))
    y = lag(-1.3).simulate(t, np.zeros((80, 1)), np.array([2.0]))
    np.testing.assert_allclose(y[:, 0], 2 * np.exp(-1.3 * (t - t[0])), rtol=1e-8)  # steps to 1e-9


@pytest.mark.parametrize("N", [0, 1, 2, 3, 16, 17, 99])
def test_a_recursion_in_blocks_is_the_one_step_by_step(N):
    rng = np.random.default_rng(N)
    E, x = SYSTEM.A / 4, rng.standard_normal((3, 2))
    forcing, found = rng.standard_normal((N, 3, 2)), [x]
    for each in forcing:
        found.append(E @ found[-1] + each)
    np.testing.assert_allclose(recursion(E, forcing, x), found, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("uneven", [False, True])
def test_delays_between_samples_agree_with_a_fine_grid_that_needs_none(hold, uneven):
    # All instants and delays are multiples of 1 ms, so on that grid delays are shifts of samples.
    rng = np.random.default_rng(2)
    steps = rng.integers(15, 60, 80) if uneven else np.full(80, 40)
    coarse = np.concatenate([[0], np.cumsum(steps)])
    u = rng.standard_normal((81, 2))
    x0 = np.array([0.2, -0.4, 0.1])
    fine = np.arange(coarse[-1] + 1)
    if hold == "foh":
        held = np.column_stack([np.interp(fine, coarse, column) for column in u.T])
    else:
        held = u[np.searchsorted(coarse, fine, side="right") - 1]
    lags = np.rint(SYSTEM.delay * 1000).astype(int)
    shifted = np.column_stack([held[np.maximum(fine - lag, 0), j] for j, lag in enumerate(lags)])
    prompt = replace(SYSTEM, delay=np.zeros(2))
    reference = prompt.simulate(fine / 1000, shifted, x0, hold)[coarse]
    y = SYSTEM.simulate(coarse / 1000, u, x0, hold)
    # 3000 fine steps whose widths are kept to 1e-9, on signals of size ten.
    np.testing.assert_allclose(y, reference, atol=1e-7)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_undelayed_simulation_agrees_with_scipy(hold):
    rng = np.random.default_rng(4)
    t, u = 0.05 * np.arange(100), rng.standard_normal((100, 2))
    prompt = replace(SYSTEM, delay=np.zeros(2))
    matrices = prompt.A, prompt.B, prompt.C, prompt.D
    _, y, _ = scipy.signal.lsim(matrices, u, t, X0=[1.0, 0.0, -1.0], interp=hold == "foh")
    np.testing.assert_allclose(prompt.simulate(t, u, [1.0, 0.0, -1.0], hold), y, atol=1e-10)


@given(hnp.arrays(float, (2, 12, 2), elements=st.floats(-5, 5)), st.sampled_from(["foh", "zoh"]))
@settings(max_examples=15)
def test_simulation_is_linear_in_the_input(inputs, hold):
    t = np.array([0, 0.1, 0.15, 0.3, 0.5, 0.52, 0.6, 0.9, 1.0, 1.3, 1.4, 1.45])
    a, b = (SYSTEM.simulate(t, u, hold=hold) for u in inputs)
    both = SYSTEM.simulate(t, 2 * inputs[0] - inputs[1], hold=hold)
    np.testing.assert_allclose(both, 2 * a - b, atol=1e-11)


def test_time_may_start_anywhere():
    t, u = 0.05 * np.arange(40), np.sin(np.arange(80.0)).reshape(40, 2)
    shifted = SYSTEM.simulate(t + 100.0, u)
    np.testing.assert_allclose(shifted, SYSTEM.simulate(t, u), atol=1e-9)  # t to 1e-14


def test_a_discrete_system_is_its_recursion_delays_shift_samples():
    system = StateSpace([[0.5]], [[1.0, 2.0]], [[1.0]], [[0.0, 1.0]], 0.1, delay=[0.2, 0.0])
    u = np.array([[1, 0], [2, 0], [3, 1], [4, 0], [5, 0.0]])
    y = system.simulate(0.1 * np.arange(5), u, np.array([8.0]))
    # x: 8, then x/2 + u1(k-2) + 2 u2(k), the first input resting at 1 before the record.
    np.testing.assert_allclose(y[:, 0], [8, 5, 3.5 + 1, 4.75, 4.375])


@pytest.mark.parametrize("width", [1e-4, 0.02, 1.0])
def test_one_step_is_that_of_the_matrix_exponential(width):
    Ad, B0, B1 = foh_step(np.array([[-2.0]]), np.array([[3.0]]), width)
    z = -2 * width
    assert Ad[0, 0] == pytest.approx(np.exp(z), rel=1e-13)
    assert B0[0, 0] + B1[0, 0] == pytest.approx(3 * width * np.expm1(z) / z, rel=1e-12)
    first = 3 * width * (np.expm1(z) - z) / z**2 if width > 1e-3 else 1.5 * width * (1 + z / 3)
    assert B1[0, 0] == pytest.approx(first, rel=1e-7)


@pytest.mark.second
@given(hnp.arrays(float, (3, 3), elements=st.floats(-3, 3)))
def test_zero_order_hold_is_undone(A):
    # The principal logarithm is the right one while |Im λ| dt < π.
    assume(np.abs(np.linalg.eigvals(A).imag).max() * 0.1 < 3)
    B = np.array([[1.0, 0.0], [0.5, -1.0], [0.0, 2.0]])
    Ad, B0, B1 = foh_step(A, B, 0.1)
    again, B_again = from_zoh(Ad, B0 + B1, 0.1)
    np.testing.assert_allclose(again, A, atol=1e-7)
    np.testing.assert_allclose(B_again, B, atol=1e-7)


def test_an_integrator_survives_the_way_to_discrete_time_and_back():
    Ad, B0, B1 = foh_step(np.zeros((1, 1)), np.ones((1, 1)), 0.05)
    A, B = from_zoh(Ad, B0 + B1, 0.05)
    np.testing.assert_allclose([A[0, 0], B[0, 0]], [0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("pole", [-0.2, 0.0])
def test_a_discrete_pole_without_continuous_equivalent_is_told(pole):
    with pytest.raises(ValueError, match=r"pole at .*no continuous equivalent .*sample faster"):
        from_zoh(np.diag([0.9, pole]), np.ones((2, 1)), 0.1)


def test_the_response_agrees_with_python_control():
    prompt = replace(SYSTEM, delay=np.zeros(2))
    other = control.ss(prompt.A, prompt.B, prompt.C, prompt.D)
    expected = np.moveaxis(other(1j * OMEGA), 2, 0)
    np.testing.assert_allclose(prompt.response(OMEGA), expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"B": [[1.0]]}, r"B has shape \(1, 1\), expected \(3, 2\)"),
        ({"A": np.ones((3, 2))}, r"A has shape \(3, 2\), expected \(3, 3\)"),
        ({"C": np.ones((2, 2))}, r"C has shape \(2, 2\), expected \(2, 3\)"),
        ({"inputs": ("a",)}, "1 names for 2 inputs: a"),
        ({"states": tuple("abcd")}, "4 names for 3 states"),
        ({"delay": np.array([-0.1, 0.0])}, "expected 2 values >= 0 s"),
        ({"delay": np.array([0.1])}, "expected 2 values"),
        ({"delay": np.array([np.nan, 0.0])}, "expected 2 values >= 0 s"),
        ({"dt": 0.0}, "dt=0.0: expected a positive interval"),
    ],
)
def test_what_is_no_system_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(SYSTEM, **changes)


def test_names_are_numbered_unless_given():
    assert SYSTEM.inputs == ("u1", "u2")
    assert SYSTEM.outputs == ("y1", "y2")
    assert SYSTEM.states == ("x1", "x2", "x3")
    assert (SYSTEM.nx, SYSTEM.nu, SYSTEM.ny) == (3, 2, 2)


def test_simulation_refuses_what_does_not_fit():
    t, u = 0.1 * np.arange(5), np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"u has shape \(5, 1\), expected \(N, nu\) = \(5, 2\)"):
        SYSTEM.simulate(t, u[:, :1])
    with pytest.raises(ValueError, match=r"x0 has shape \(2,\), expected \(3,\)"):
        SYSTEM.simulate(t, u, np.zeros(2))
    with pytest.raises(ValueError, match=r"interval 0\.2 s cannot follow samples 0\.1"):
        replace(SYSTEM, dt=0.2, delay=np.zeros(2)).simulate(t, u)
    with pytest.raises(ValueError, match=r"no multiples of the interval 0\.1 s"):
        replace(SYSTEM, dt=0.1).simulate(t, u)


def test_a_discrete_model_follows_its_own_interval_only():
    system = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], 0.02)
    t = 0.02 * np.arange(50)
    late = t + np.where(np.arange(50) >= 20, 0.01, 0.0)  # one interval of 0.03 s
    with pytest.raises(ValueError, match="cannot follow samples"):
        system.simulate(late, np.zeros((50, 1)))
    decay = system.simulate(t, np.zeros((50, 1)), np.array([1.0]))[:, 0]
    np.testing.assert_allclose(decay, 0.9 ** np.arange(50), rtol=1e-12)


@pytest.mark.parametrize("t", [[0.0, 0.1, 0.1], [0.2, 0.1, 0.0], [0.0, 0.2, 0.1], [0.0, np.nan, 1]])
def test_instants_that_do_not_increase_are_refused(t):
    with pytest.raises(ValueError, match="t: expected increasing instants"):
        lag(-1.0).simulate(np.array(t), np.zeros((3, 1)))


@pytest.mark.parametrize("hold", ["FOH", "linear"])
def test_an_unknown_hold_is_refused(hold):
    with pytest.raises(ValueError, match=f"hold='{hold}', expected"):
        lag(-1.0).simulate(np.arange(3.0), np.zeros((3, 1)), hold=hold)
