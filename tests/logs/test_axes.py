from dataclasses import replace

import numpy as np
import pytest
from truths.logs import DAMPING, GAIN, RATES, STEP, STICKS, flight

from casid import Record, load_model
from casid.logs.axes import axes_structure


def flown(inputs=STICKS, outputs=(*RATES, "phi", "theta")):
    t, x = flight(20.0)
    u, y = (np.column_stack([x[name] for name in names]) for names in (inputs, outputs))
    return Record(t, u, y, inputs, outputs, "flight")


def loaded(tmp_path, *records):
    (tmp_path / "axes.py").write_text(axes_structure(records, "flight.ulg"), encoding="utf-8")
    return load_model("axes.py:Axes", tmp_path)()


def test_the_structure_is_that_of_every_axis_by_itself(tmp_path):
    model = replace(
        loaded(tmp_path, flown()), Lp=-3.0, Mq=-2.0, Nr=-1.0, Lroll=40.0, Mpitch=30.0, Nyaw=8.0
    )
    system = model.system()
    assert model.outputs == (*RATES, "phi", "theta")
    s = 2j
    G = system.C @ np.linalg.solve(s * np.eye(5) - system.A, system.B) + system.D
    np.testing.assert_allclose(np.diag(G[:3]), GAIN / (s - DAMPING), rtol=1e-12)
    np.testing.assert_allclose(G[3:, :2], np.diag(GAIN[:2] / (s - DAMPING[:2]) / s), rtol=1e-12)
    assert model.delays() == dict.fromkeys(STICKS, 0.05)


def test_guesses_are_near_and_inside_their_bounds(tmp_path):
    model = loaded(tmp_path, flown())
    for name, wanted in zip(("Lroll", "Mpitch", "Nyaw"), GAIN, strict=True):
        assert getattr(model, name) == pytest.approx(wanted, rel=0.3)  # without the delay
    for name, info in type(model).infos().items():
        assert info.lower <= getattr(model, name) <= info.upper


def test_what_rests_or_moves_no_rate_is_left_out(tmp_path):
    record = flown()
    filtered = 0.4 + 5e-17 * np.random.default_rng(1).integers(-1, 2, record.N)
    for rest in (np.zeros(record.N), filtered):
        still = replace(record, u=np.column_stack([record.u[:, 0], rest, record.u[:, 2]]))
        assert loaded(tmp_path, still).inputs == ("roll", "yaw")
    with pytest.raises(ValueError, match="none is known to move a rate"):
        axes_structure([flown(inputs=("yaw",), outputs=("p",))], "flight.ulg")


def test_thrust_moves_the_specific_force(tmp_path):
    t = STEP * np.arange(2000)
    u = np.sin(t)[:, None]
    record = Record(t, u, -10 * u, ("thrust",), ("az",), "hover")
    model = loaded(tmp_path, record)
    assert model.Zthrust == pytest.approx(-10, rel=0.02)
    system = replace(model, Zw=-0.5, Zthrust=-10.0).system()
    s = 3j  # az = w' and w' = Zw w + Zthrust thrust
    G = system.C @ np.linalg.solve(s * np.eye(1) - system.A, system.B) + system.D
    np.testing.assert_allclose(G, [[-10 * s / (s + 0.5)]], rtol=1e-12)
