"""What is left unexplained: variances by hand, and noise that counts as none."""

import numpy as np
import pytest

from casid.unexplained_variance import spread_and_noise, told, unexplained

RNG = np.random.default_rng(2)
T = 0.02 * np.arange(2000)
WHITE = 0.1 * RNG.standard_normal((2000, 2))
SWING = np.sin(2 * T)  # of variance 1/2; its second differences are below a thousandth of the noise


def test_of_a_slow_motion_in_white_noise_both_variances_are_known():
    spread, noise = spread_and_noise([SWING + WHITE[:, 0], 5 + SWING + WHITE[:, 1]])
    assert spread == pytest.approx(0.5 + 0.01, rel=0.02)
    # Second differences of white noise, whose variances have the error sqrt(35 / 9 / 4000).
    assert noise == pytest.approx(0.01, rel=0.1)


def test_missing_samples_are_passed_over_and_few_tell_nothing():
    whole = SWING + WHITE[:, 0]
    holed = np.where(np.arange(2000) % 5 == 2, np.nan, whole)
    assert spread_and_noise([holed])[0] == pytest.approx(0.51, rel=0.03)
    assert np.isnan(spread_and_noise([np.full(2000, np.nan), whole[:9]])).all()
    assert unexplained(("p",), [np.full((2000, 1), np.nan)], np.array([np.nan])) == []


def test_only_residuals_as_large_as_the_motion_and_no_noise_are_told():
    y = [np.column_stack([SWING, 0 * SWING, SWING, SWING]) + np.tile(WHITE, 2)]
    names = ("flat", "rest", "half", "fair")
    (said,) = unexplained(names, y, np.array([0.6, 0.01, 0.5 * 0.51, 0.01]))
    assert said == "flat (residuals of 0.77; it moves by 0.72, its noise 0.1)"
    assert said in told([said])


def test_at_rest_an_offset_that_nothing_takes_up_is_told():
    (said,) = unexplained(("p",), [1 + WHITE[:, :1]], np.array([1.01]))
    assert said.startswith("p (residuals of 1;")
