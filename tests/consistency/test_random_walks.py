"""Walks of integrated noise, against closed forms, another transform and simulated truths."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy
from truths.hovering import G, hover

from casid.consistency.innovations import integral
from casid.consistency.kinematics import kinematic_check
from casid.consistency.measured import Flight, signals
from casid.consistency.random_walks import (
    cosine_powers,
    noise_floor,
    step_variance,
    walk_powers,
    walked,
)

DT = 0.04


@dataclass
class Found:
    """Gains of specific forces, as a reconstruction finds them."""

    channels: tuple[str, ...] = ("ax",)
    unknowns: np.ndarray = None


@pytest.mark.parametrize("n", [20, 21])
def test_cosine_powers_are_those_of_another_transform(n):
    x = np.random.default_rng(0).standard_normal(n)
    expected = scipy.fft.dct(x, norm="ortho")[1:] ** 2
    np.testing.assert_allclose(cosine_powers(x), expected, rtol=1e-10)


def test_powers_of_a_walk_are_the_diagonal_of_its_transformed_covariance():
    n = 40
    walk = scipy.fft.dct(np.tril(np.ones((n, n))), norm="ortho", axis=0)  # of each single step
    C = (walk @ walk.T)[1:, 1:]  # but for the mean
    np.testing.assert_allclose(np.diag(C), walk_powers(n), rtol=1e-10)
    np.testing.assert_allclose(C - np.diag(np.diag(C)), 0.0, atol=1e-9)  # independent


@pytest.mark.parametrize("dt", [0.02, 0.2])
def test_noise_is_seen_beside_flight_and_vibration(dt):
    rng, t = np.random.default_rng(1), dt * np.arange(20_000)
    sigma = 0.1
    flown = np.sin(0.5 * t) + 0.3 * sigma * t / t[-1]
    line = 0.3 * np.sin(2 * np.pi * 0.4 / dt * t)
    # The median of n chi-squares of one degree is known to 2.3/sqrt(n) of it: 2.3 % of 10 000.
    found = noise_floor(flown + line + sigma * rng.standard_normal(len(t)), dt)
    assert found == pytest.approx(sigma**2, rel=0.06)


def resting(sizes, n=4000):
    """A level flight at rest but for white noise of these channels."""
    rng = np.random.default_rng(2)
    names = ("p", "q", "r", "ax", "ay", "az", "phi", "theta", "u", "v", "w")
    level = {"u": 30.0, "az": -G}
    noise = {name: sizes.get(name, 0.0) * rng.standard_normal(n) for name in names}
    return Flight(DT, n, {name: level.get(name, 0.0) + noise[name] for name in names})


@pytest.mark.parametrize(
    ("equation", "sizes", "gains", "size"),
    [
        ("u", {"ax": 0.1}, {}, 0.1),
        ("u", {"ax": 0.1}, {"ax": -0.5}, 0.05),
        ("u", {"theta": 0.01}, {}, 0.01 * G),
        ("w", {"q": 0.01, "az": 0.4}, {}, 0.5),  # 30 m/s times 0.01 rad/s
        ("phi", {"p": 0.01}, {}, 0.01),
        ("theta", {"p": 0.01}, {}, 0.0),
    ],
)
def test_steps_are_as_large_as_what_noise_adds_to_a_derivative(equation, sizes, gains, size):
    found = step_variance(equation, resting(sizes), gains)
    # 2700 coefficients above 4 Hz: their median is known to 4.5 %.
    assert found == pytest.approx((size * DT) ** 2, rel=0.1, abs=1e-12)


def test_a_slower_channel_walks_as_far_as_its_own_samples_let_it():
    whole = resting({"ax": 0.1})
    rows = np.arange(0, 4000, 4)
    values = whole.values | {"ax": np.repeat(whole.values["ax"][::4], 4)}
    slower = Flight(DT, 4000, values, {"ax": rows, "u": rows})
    # Each sample stands for four instants, and moves the integral by the whole of them.
    assert step_variance("u", slower, {}) == pytest.approx((4 * DT * 0.1) ** 2, rel=0.3)


def test_a_walk_is_explained_and_what_moves_as_aircraft_do_is_not():
    sizes = {"ax": 0.15}
    flight, one = resting(sizes), Found(unknowns=np.ones((1, 2)))
    walk = integral(flight.values["ax"][:, None], DT)[:, 0]
    walk -= walk.mean()
    assert walked("u", walk, flight, one) > 0.99 * np.mean(walk**2) > 0.0
    wave = 0.1 * np.sin(2 * np.pi * 0.2 * flight.t)
    assert walked("u", wave, flight, one) < 0.15 * np.mean(wave**2)
    exact = resting({})
    assert walked("u", walk, exact, one) == 0.0


@pytest.mark.second
@pytest.mark.parametrize("still", [(), ("u",)], ids=["moves", "u rests"])
def test_noise_of_accelerometers_that_walks_as_far_as_a_hover_moves_is_no_mistake(still):
    # 0.2 m/s^2 a sample: a walk of sqrt(0.05 · 80) · 0.2 = 0.4 m/s at the end, u moves by 0.1 m/s.
    assert kinematic_check(hover(0, 0.2, dt=0.05, still=still)).remarks == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["u", pytest.param("theta", marks=pytest.mark.campaign)])
def test_signs_are_told_among_walks(name):
    record = hover(1, 0.2, dt=0.05)
    y = record.y * np.where(np.array(record.outputs) == name, -1.0, 1.0)
    (said,) = kinematic_check(type(record)(record.t, record.u, y, (), record.outputs, "h")).remarks
    assert said.startswith(name)
    assert "opposite sign" in said


def test_noise_of_a_record_is_that_of_its_flight():
    flight = signals(hover(3, 0.15), {})
    found = [noise_floor(flight.values[name], flight.dt) for name in ("ax", "p", "u")]
    # 1360 coefficients: their median is known to 6 %, its root to 3 %.
    np.testing.assert_allclose(np.sqrt(found), [0.15, 0.003, 0.03], rtol=0.15)
