"""Nonlinear structures simulated and predicted."""

from dataclasses import replace

import numpy as np
import pytest
from truths.swing import TRUTH, SmallSwing, WrittenOut, integrated, swung

from casid import ModelError, simulate, validate
from casid.prediction import outlook
from casid.shooting.simulation import predict_nonlinear


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_simulation_is_scipys(hold):
    record = swung(3, duration=6.0, hold=hold)
    exact = integrated(TRUTH, record.t, record.u, hold, [0.2, 0.5])
    found = simulate(TRUTH, record, {"q": 0.2, "theta": 0.5})
    np.testing.assert_allclose(found.y, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_a_simulation_that_runs_away_is_told():
    with pytest.raises(ModelError, match="Swing runs away: outputs are not finite from sample"):
        simulate(replace(TRUTH, Mq=80.0), swung(3), {"theta": 0.5})
    with pytest.raises(ValueError, match="start names 'u'; the states are q, theta"):
        simulate(TRUTH, swung(3), {"u": 0.5})


def test_validation_takes_a_nonlinear_structure_as_such():
    # Noise alone is left of the truth; its linearisation is worse by far.
    records = [swung(seed) for seed in (1, 2)]
    found = validate({"true": TRUTH, "linear": TRUTH.at({})}, records)
    np.testing.assert_allclose(found.rms["true"], 0.02, rtol=0.1)
    assert (found.rms["linear"] > 3 * found.rms["true"]).all()
    # Outputs are weighted by their spread over all records, which loses that between the means.
    shifted = validate({"true": TRUTH}, [record.detrend("mean") for record in records])
    np.testing.assert_allclose(shifted.rms["true"], found.rms["true"], rtol=1e-4)


@pytest.mark.parametrize("horizon", [np.inf, 1.0])
def test_a_linear_structure_written_as_a_nonlinear_one_is_judged_alike(horizon):
    small = SmallSwing(Mq=-0.8, M=6.0, Mlon=8.0, tau=0.073)
    record = swung(5, size=0.05)
    models = {"linear": small, "written": WrittenOut().with_values_of(small)}
    found = validate(models, record, horizon=horizon)
    for name in ("rms", "biases"):
        ours, theirs = (getattr(found, name)[each] for each in models)
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-5)


def test_only_the_past_tells_the_state_that_a_prediction_begins_with():
    record = swung(6)
    far, scale = outlook([TRUTH.system()], record, 1.0), np.ones(2)
    last = record.t > record.t[far.starts[-1]]
    spoilt = replace(record, y=record.y + 0.5 * last[:, None])
    first, other = (predict_nonlinear(TRUTH, each, scale, far).y for each in (record, spoilt))
    np.testing.assert_array_equal(first, other)
    assert np.isfinite(first[record.t > record.t[far.starts[0]]]).all()
