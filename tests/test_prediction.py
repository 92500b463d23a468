"""Predictions of unstable models: from the past alone, over a stated horizon."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Record, StateSpace, validate
from casid.prediction import AHEAD, FOLDS, growth_rate

DT = 0.02
T = DT * np.arange(1500)
STABLE = StateSpace([[-1.0, 2.0], [-2.0, -1.0]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1)),
                    inputs=("u",), outputs=("a", "b"))  # fmt: skip


def with_spurious(rate, size=0.02):
    """The stable system with a growing pair that the data do not have."""
    A = np.block([[STABLE.A, np.zeros((2, 2))],
                  [np.zeros((2, 2)), np.array([[rate, 5.7], [-5.7, rate]])]])  # fmt: skip
    B = np.vstack([STABLE.B, [[size], [size]]])
    C = np.hstack([STABLE.C, np.eye(2)])
    return StateSpace(A, B, C, np.zeros((2, 1)), inputs=("u",), outputs=("a", "b"))


def steps():
    return np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 30), 50)[:, None]


def flown(system=STABLE, noise=0.02):
    y = system.simulate(T, steps()) + noise * np.random.default_rng(3).standard_normal((len(T), 2))
    return Record(T, steps(), y, ("u",), ("a", "b"), "steps")


def test_a_prediction_knows_nothing_of_what_was_measured_after_its_start():
    record = flown()
    (horizon,) = validate({"m": with_spurious(1.0)}, [record]).horizon
    piece = int(horizon / DT + 1e-9)
    cut = 900
    y = record.y.copy()
    y[cut:] = 2 * y[cut] - y[cut:]  # of its second differences, the size of noise, one changes
    before, after = (
        validate({"m": with_spurious(1.0)}, [each]).simulated["m"][0]
        for each in (record, replace(record, y=y))
    )
    np.testing.assert_allclose(after[:cut], before[:cut], atol=1e-3)
    assert np.abs(after - before)[cut + 2 * piece :].max() > 0.1


def test_a_growing_pair_that_is_not_there_is_not_excused():
    record = flown()
    result = validate({"sound": STABLE, "spurious": with_spurious(4.2)}, [record])
    assert result.growth == {"sound": 0.0, "spurious": pytest.approx(4.2)}
    assert result.horizon[0] == pytest.approx(FOLDS / 4.2)
    sound, spurious = (result.rms[name][0] for name in ("sound", "spurious"))
    # Noise of 0.02 alone for the sound one; the other's grows e^3 = 20 times from what is left of
    # the estimate of its state.
    np.testing.assert_allclose(sound, 0.02, rtol=0.25)
    assert (spurious > 2 * sound).all()
    assert "Predicted up to 0.714 s ahead" in result.predicted
    assert "spurious e-fold in 0.24 s" in result.predicted
    assert "sound e-fold" not in result.predicted


def test_slow_growth_and_stable_models_are_simulated_over_the_whole_record():
    slow = replace(STABLE, A=[[0.1, 2.0], [-2.0, 0.1]])
    result = validate({"m": slow, "n": STABLE}, [flown(slow)])
    assert result.horizon == (np.inf,)
    assert result.predicted == ""
    assert np.isfinite(result.simulated["m"][0]).all()
    np.testing.assert_allclose(result.rms["m"][0], 0.02, rtol=0.1)


def test_the_least_unstable_of_those_that_grow_sets_the_horizon_of_all():
    record = flown()
    both = validate({"m": with_spurious(1.0), "n": with_spurious(4.2)}, [record])
    assert both.horizon == (pytest.approx(min(FOLDS, AHEAD * record.duration)),)
    asked = validate({"m": STABLE}, [record], horizon=0.5)
    assert asked.horizon == (0.5,)
    assert asked.predicted.startswith("Predicted up to 0.5 s ahead")
    assert "unstable" not in asked.predicted
    with pytest.raises(ValueError, match="too short to predict 20 s ahead"):
        validate({"m": STABLE}, [record], horizon=20.0)
    with pytest.raises(ValueError, match="give another horizon"):
        validate({"m": STABLE}, [record], horizon=0.001)


def test_growth_of_a_discrete_system_is_that_of_the_continuous_one():
    z = np.exp((0.7 + 2j) * 0.1)
    discrete = StateSpace([[z.real, z.imag], [-z.imag, z.real]], [[0.0], [1.0]], np.eye(2),
                          np.zeros((2, 1)), 0.1)  # fmt: skip
    assert growth_rate(discrete) == pytest.approx(0.7)
    assert growth_rate(STABLE) == 0.0
