"""Numbers as readers want them."""

import dataclasses

import numpy as np
import pytest

from casid.fit import ParameterEstimate
from casid.report.words import TWO_LINES, brief, number, percent


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1234"), (-0.5, "−0.5"), (1e-7, "1e−7"), (np.nan, "–"), (-np.inf, "−∞"), (None, "–")],
)
def test_numbers_are_written_for_readers(value, text):
    assert number(value) == text


def test_a_caution_is_brief_by_its_first_sentence():
    assert brief("J is 1.5 on average. Try a richer structure.") == "J is 1.5 on average."
    long = brief("Few data: " + "much too little of it, " * 20 + "fly more.")
    assert long.endswith(" …")
    assert TWO_LINES - 30 < len(long) <= TWO_LINES


def test_a_whole_hundred_needs_no_exponent():
    assert [number(100 * share, 2) for share in (1.0, 0.99, 100.0)] == ["100", "99", "1e4"]


def test_a_standard_error_far_above_the_value_is_not_spelt_out():
    row = ParameterEstimate(
        name="Xu", value=1e-9, guess=0.0, lower=-1.0, upper=0.0, active=False, multiplier=0.0,
        std_error=0.1, insensitivity=0.1, unit="1/s",
    )  # fmt: skip
    assert percent(row) == "> 999"
    assert percent(dataclasses.replace(row, value=0.0)) == "–"
