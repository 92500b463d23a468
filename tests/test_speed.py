"""Ratios of processor times within one process; no time itself is tested."""

import pytest

from benchmarks import speed

pytestmark = pytest.mark.slow


def test_a_black_box_grows_hardly_faster_than_its_samples():
    # Linear growth is 4, some of the work does not grow at all: measured 2.5.
    assert speed.growth_of_black_box() < 5


def test_judging_the_excitation_grows_with_the_samples():
    # Linear growth is 4, measured 3.4; the whole record looked at in every window made 20.
    assert speed.growth_of_excitation() < 6


def test_output_error_is_faster_than_the_textbook_even_where_there_is_little_to_do():
    # Measured: 6; with longer records far more (docs/benchmarks-output-error.md).
    assert speed.textbook_in_short() > 3
