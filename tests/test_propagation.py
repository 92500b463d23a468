"""Errors carried on: what does not move, and what is drawn."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import Roll as ClosedRoll
from truths.closed_roll import noisy

from casid import DataWarning, output_error, sample_models
from casid.propagation import known_by_bounds, spread


def test_what_a_bound_holds_does_not_move():
    fit = output_error(ClosedRoll(), noisy(seed=5), bounds={"Lp": (-1.8, 0.0)})
    assert fit["Lp"].active
    assert spread(fit, lambda model: np.array(float(model.Lp))) == 0
    drawn = [float(model.Lp) for model in sample_models(fit, 5)]
    np.testing.assert_allclose(drawn, fit["Lp"].value, atol=1e-6)  # rounding of a square root


def test_only_what_bounds_of_the_structure_hold_is_told():
    asked = output_error(ClosedRoll(), noisy(seed=5), bounds={"Lp": (-1.8, 0.0)})
    assert not known_by_bounds(asked)  # a hypothesis, under which it is known
    (row,) = (row for row in asked.parameters if row.name == "Lp")
    own = type(asked.model).infos()["Lp"]
    rows = {
        "on": replace(row, value=own.lower, lower=own.lower, upper=own.upper),
        "held by a tie": replace(row, value=-2.0, guess=-2.0, lower=own.lower, upper=own.upper),
    }
    for where, each in rows.items():
        others = [each if other.name == "Lp" else other for other in asked.parameters]
        fit = replace(asked, parameters=tuple(others))
        assert known_by_bounds(fit).startswith("Lp = ") is (where == "on")
        if where == "on":
            with pytest.warns(DataWarning, match="on a bound of the structure, counts as known"):
                sample_models(fit, 1)
