"""Failures are typed and carry the evidence."""

import pytest

from casid import ConvergenceError, DataWarning, ModelError


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
