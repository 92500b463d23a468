"""Failures are typed and carry the evidence."""

import numpy as np
import pytest
from truths.systems import LAG, white

from casid import (
    ConvergenceError,
    DataWarning,
    ModelError,
    SpectralAnalysis,
    frequency_response,
)
from casid.errors import asked, unasked


def test_a_model_error_is_a_value_error():
    with pytest.raises(ValueError, match="no such state"):
        raise ModelError("no such state")


def test_a_convergence_error_keeps_the_best_iterate():
    error = ConvergenceError("stopped", best=[1.0])
    assert str(error) == "stopped"
    assert error.best == [1.0]
    assert ConvergenceError("stopped").best is None
    assert not isinstance(error, ValueError)  # the input was fine


def test_a_data_warning_can_be_silenced_alone():
    assert issubclass(DataWarning, UserWarning)


def test_a_data_warning_points_at_the_line_of_the_caller_however_deep_it_arises():
    record = white(LAG, np.random.default_rng(0), duration=30.0)
    fine = np.linspace(5.0, 6.0, 30)
    with pytest.warns(DataWarning, match="finer than a record") as door:
        frequency_response(record, omega=fine)
    with pytest.warns(DataWarning, match="finer than a record") as value:
        SpectralAnalysis(omega=fine).fit(record)
    assert {each.filename for each in (*door, *value)} == {__file__}


def test_data_are_asked_but_within_and_stay_unasked_further_within():
    assert asked()
    with unasked(when=False):
        assert asked()
    with unasked(), unasked(when=False):
        assert not asked()
    assert asked()
