"""Sensors at their limits, on flights of which it is known, and in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from truths.flights import ERRORS, FORCES, NOISE, RATES, STATES, flight

from casid.consistency.clipping import cut_off, standing
from casid.consistency.kinematics import kinematic_check
from casid.consistency.measured import Flight

ANGLES = (*RATES, "phi", "theta")
WHOLE = (*RATES, *FORCES, *STATES)


def limited(name, share, sides, outputs, seed=80):
    """A flight whose sensor goes up to a share of what was flown, noise after; what it cut off."""
    clean = flight(seed, outputs=outputs)
    i, y = clean.outputs.index(name), clean.y.copy()
    x = y[:, i] - np.median(y[:, i])
    most = share * np.abs(x).max()
    y[:, i] -= x - np.clip(x, -most if sides == 2 else -np.inf, most)
    noisy = replace(clean, y=y).with_noise(
        {each: NOISE[each] for each in outputs}, np.random.default_rng(seed)
    )
    over = x[x > most] - most
    return noisy, float(over.mean())


@pytest.mark.second
@pytest.mark.parametrize(
    ("name", "share", "sides", "outputs"),
    [("p", 0.5, 2, ANGLES), ("p", 0.3, 1, ANGLES), ("q", 0.6, 2, ANGLES), ("ax", 0.6, 2, WHOLE)],
)
def test_a_sensor_at_its_limit_is_named_and_no_scale_of_it_told(name, share, sides, outputs):
    record, beyond = limited(name, share, sides, outputs)
    check = kinematic_check(record)
    (said,) = [each for each in check.remarks if each.startswith(f"{name} ")]
    assert "its sensor was at its limit" in said
    (own,) = (each for each in check.channels if each.channel == name)
    assert not own.determined
    assert not any("does not follow" in each for each in check.remarks)
    more = float(said.split("implies ")[1].split(" ")[0])
    assert more == pytest.approx(beyond, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [81, *(pytest.param(s, marks=pytest.mark.campaign) for s in range(82, 87))]
)
@pytest.mark.parametrize(
    "errors", [None, pytest.param(ERRORS, marks=pytest.mark.campaign)], ids=["right", "wrong"]
)
def test_a_sensor_within_its_limits_is_none_of_these(errors, seed):
    for outputs in (ANGLES, WHOLE):
        check = kinematic_check(flight(seed, errors, NOISE, outputs))
        assert not any("limit" in each for each in check.remarks)
        assert all(each.determined for each in check.channels)


def test_what_is_cut_off_is_the_coefficient_of_a_regression_of_all():
    rng = np.random.default_rng(3)
    parts, more, every, left = [], [], [], []
    for n in (300, 500):
        X, z = rng.standard_normal((3, n)), rng.standard_normal((2, n))
        z += X[:2]
        e = np.array([0.3, -0.2]) @ z + rng.standard_normal(3) @ X + 0.1 * rng.standard_normal(n)
        parts.append((e, X, np.arange(n) // 5))
        more.append(z)
        every.append((X, z))
        left.append(e)
    rows = [np.vstack([z, (i == 0) * X, (i == 1) * X]) for i, (X, z) in enumerate(every)]
    A, b = np.hstack(rows).T, np.concatenate(left)
    whole, (square,), *_ = np.linalg.lstsq(A, b)
    value, error = cut_off(parts, more)
    np.testing.assert_allclose(value, whole[:2], rtol=1e-5)
    # Of white residuals: the diagonal of the inverse, known from 160 stretches to a tenth or so,
    # and Student's quantile is 3 % larger.
    std = np.sqrt(square / len(b) * np.diag(np.linalg.inv(A.T @ A))[:2])
    np.testing.assert_allclose(error, std, rtol=0.3)


def test_one_stretch_alone_tells_of_no_limit():
    rng = np.random.default_rng(4)
    z = np.zeros((1, 400))
    z[0, 100:105] = 1.0
    e = z[0] + 0.01 * rng.standard_normal(400)
    _, (error,) = cut_off([(e, rng.standard_normal((2, 400)), np.arange(400) // 5)], [z])
    assert error == np.inf


def test_extremes_stand_off_by_six_deviations_of_noise():
    x = np.clip(np.sin(0.02 * np.arange(4000)), -0.5, 0.7)
    x += 0.01 * np.random.default_rng(5).standard_normal(4000)
    for threshold, extreme, reach in standing([Flight(0.02, 0, {"p": x})], "p"):
        assert abs(extreme - threshold) == pytest.approx(0.06, rel=0.1)
        assert np.sign(reach) == np.sign(extreme)
        assert np.mean(np.sign(extreme) * (x - threshold) > 0) > 0.2
