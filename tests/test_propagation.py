"""Errors carried on: what does not move, and what is drawn."""

import numpy as np
from truths.closed_roll import Roll as ClosedRoll
from truths.closed_roll import noisy

from casid import output_error, sample_models
from casid.propagation import spread


def test_what_a_bound_holds_does_not_move():
    fit = output_error(ClosedRoll(), noisy(seed=5), bounds={"Lp": (-1.8, 0.0)})
    assert fit["Lp"].active
    assert spread(fit, lambda model: np.array(float(model.Lp))) == 0
    drawn = [float(model.Lp) for model in sample_models(fit, 5)]
    np.testing.assert_allclose(drawn, fit["Lp"].value, atol=1e-6)  # rounding of a square root
