"""The chart beside the table of parameters."""

import dataclasses

import numpy as np
import pytest

from casid.fit import ParameterEstimate
from casid.report.intervals import bar, sigma_place

ROW = ParameterEstimate(
    name="Lp", unit="1/s", guess=0.0, value=-2.0, std_error=0.5, cramer_rao=0.4, insensitivity=0.1,
    lower=-4.0, upper=0.0, active=False, multiplier=0.0, fixed=False,
)  # fmt: skip


def other(value):
    class Other:
        def __getitem__(self, name):
            return dataclasses.replace(ROW, name=name, value=value)

    return Other()


def test_the_chart_is_symmetric_and_ends_at_a_hundred_standard_errors():
    assert sigma_place(0.0) == pytest.approx(50.0)
    assert sigma_place(3.0) + sigma_place(-3.0) == pytest.approx(100.0)
    assert sigma_place(1e6) == sigma_place(100.0) == pytest.approx(100.0)


def test_bounds_zero_and_other_estimates_stand_in_standard_errors_of_the_value():
    found = bar(ROW, {"match": other(-1.0)})
    assert found.lower == pytest.approx(sigma_place(-4.0))
    assert found.upper == found.zero == pytest.approx(sigma_place(4.0))
    assert found.marks == (("match", "◇", pytest.approx(sigma_place(2.0))),)
    assert "match at 2σ" in found.text


def test_zero_lies_within_the_bar_when_the_sign_is_not_determined():
    sure, unsure = bar(ROW, {}), bar(dataclasses.replace(ROW, std_error=1.5), {})
    assert not sure.low <= sure.zero <= sure.high
    assert unsure.low <= unsure.zero <= unsure.high


@pytest.mark.parametrize("change", [{"fixed": True}, {"std_error": np.nan}, {"std_error": 0.0}])
def test_a_parameter_without_a_standard_error_has_no_bar(change):
    assert bar(dataclasses.replace(ROW, **change), {}) is None
