from pathlib import Path

import numpy as np
from truths.systems import campaign
from truths.uh60 import sweeps

from casid import Record, pbsid
from casid.subspace.trust import data_doubts

FLIGHT = Path(__file__).parents[1] / "data" / "trex550.npz"


def trex():
    """The flight's velocities, rates and attitudes."""
    found = np.load(FLIGHT)
    outputs = ("u", "v", "p", "q", "phi", "theta", "a", "b", "w", "r")
    record = Record(found["t"] - found["t"][0], found["u"], found["y"],
                    ("lat", "lon", "col", "ped"), outputs, "T-Rex 550")  # fmt: skip
    names = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    return record.detrend("mean").select(outputs=names)


def test_a_flight_that_does_not_support_a_model_is_said_to():
    box = pbsid([trex()], order=10, past=10, pole=10.0, feedthrough=False)
    (said,) = box.doubts()
    assert said.startswith("These data do not support a model")
    for name in ("u", "v", "w", "p", "r", "phi"):
        assert f"{name} " in said
    assert "vibration" in said


def test_records_made_for_identification_are_not_doubted():
    box = pbsid(sweeps(seed=1), order=14, past=8, pole=8.0, feedthrough=["ax", "ay", "az"])
    assert box.doubts() == ()
    assert box.explained[:5].min() > 0.6  # attitudes hardly move above 5 rad/s


def test_noise_free_records_are_explained_fully():
    box = pbsid(campaign(), order=5, past=10, pole=6.0, feedthrough=["z"])
    np.testing.assert_allclose(box.explained, 1.0, atol=1e-6)


def test_pure_noise_is_not_explained():
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(4000)
    u, y = rng.standard_normal((4000, 2)), rng.standard_normal((4000, 2))
    box = pbsid([Record(t, u, y, ("a", "b"), ("c", "d"))], order=2, past=8, pole=6.0)
    assert box.explained.max() < 0.2
    assert len(box.doubts()) == 1


def test_most_outputs_condemn_the_data_and_a_few_do_not():
    names = ("p", "q", "r")
    assert data_doubts(np.array([0.9, 0.9, 0.3]), names) == ()
    (said,) = data_doubts(np.array([0.9, 0.3, -0.1]), names)
    assert "q 30%, r 0%" in said
    assert "p 90%" not in said
