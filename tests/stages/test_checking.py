"""States measured beside the outputs: what the report shows of them, and what stays untouched."""

from types import SimpleNamespace

import numpy as np
import pytest
from truths.roll_study import Truth, write_study
from truths.swing import Swing

from casid import (
    Model,
    Record,
    Rows,
    Scalar,
    output_error,
    parameter,
    read_records,
    read_study,
    run_study,
    simulate,
    validate,
)
from casid.prediction import PredictionPlan
from casid.stages.checking import _compared, _simulated
from casid.studies.study import read_flights

SWEEPS = (
    "[records.validation]",
    "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n[records.validation]",
)
LINES = ("[match]", "[frequency]\nomega = {from=0.6, to=5, points=20}\n\n[match]")
CHECK = ("[channels.units]", '[channels]\ncheck = ["v"]\n\n[channels.units]')


def test_estimators_see_the_same_records_with_check_channels_and_without(tmp_path):
    (tmp_path / "plain").mkdir()
    plain = read_records(read_study(write_study(tmp_path / "plain")))
    asked = read_study(write_study(tmp_path, CHECK, v=True))
    found = read_records(asked)
    for role, records in plain.items():
        for one, other in zip(records, found[role], strict=True):
            assert other.outputs == ("p", "phi")
            np.testing.assert_array_equal(one.y, other.y)  # noise included
    flights = read_flights(asked)[0]["validation"][0]
    assert flights.outputs == ("p", "phi", "v")
    u = flights.u[:, 0]
    v = Truth().system().simulate(flights.t, u[:, None])  # p, phi
    assert np.isfinite(flights.channel("v")).all()
    assert len(v) == flights.N


@pytest.mark.parametrize("name", ["p", "lat"])
def test_a_check_channel_is_none_of_the_structure(tmp_path, name):
    wrong = (CHECK[0], CHECK[1].replace("v", name))
    with pytest.raises(ValueError, match=f"check: '{name}' is an input or output"):
        read_study(write_study(tmp_path, wrong))


@pytest.mark.slow
def test_a_measured_state_stands_beside_the_models(tmp_path):
    outcome = run_study(read_study(write_study(tmp_path, CHECK, SWEEPS, LINES, v=True)))
    found = outcome.identification.results["states"]
    assert found.states == ("v",)
    rms, fit, theil = found.table["v", "output error"]
    assert fit > 90  # the truth is in the structure, noise 0.002 rad/s and rad
    assert theil < 0.1
    (record,), y = found.shown.measured, found.shown.simulated["output error"][0]
    assert rms == pytest.approx(np.sqrt(np.mean((record.channel("v") - y[:, 0]) ** 2)))
    assert outcome.identification.results["checked"].outputs == ("v",)
    page = outcome.report.read_text("utf-8")
    assert "Measured states" in page
    assert (outcome.report.parent / "figures/history_random_v.svg").exists()
    response = (outcome.report.parent / "figures/response_v_from_lat.svg").read_text("utf-8")
    assert "measured" in response


@pytest.mark.slow
def test_without_check_channels_nothing_is_shown_of_states(finished):
    assert not {"states", "checked"} & set(finished.identification.results)


class Blind(Swing):
    """The pendulum of which the rate alone is measured."""

    outputs = ("q",)


@pytest.mark.parametrize(
    "far",
    [PredictionPlan(np.inf), PredictionPlan(1.0, (20, 40, 60, 80), 20)],
    ids=["simulated", "predicted"],
)
def test_states_of_a_nonlinear_structure_are_those_it_moved_through(far):
    t, start = 0.05 * np.arange(100), {"q": 0.2, "theta": 0.9}
    still = Record(t, 0.8 * np.sin(t)[:, None], np.zeros((100, 0)), Swing.inputs, ())
    both, record = simulate(Swing(), still, start), simulate(Blind(), still, start)
    off = both.select(outputs=["theta"])
    flight = Record(t, off.u, off.y + 0.3, off.inputs, off.outputs)  # a sensor's bias
    y = _simulated(SimpleNamespace(model=Blind()), record, flight, np.array([record.y.std()]), far)
    known = np.isfinite(y[:, 0])
    assert known[21:].all()
    np.testing.assert_allclose(y[known], flight.y[known], atol=2e-3)  # from q alone, to 1e-5 rad/s


class Sum(Model):
    """Two rates, of which one is measured alone and the other in their sum."""

    states, inputs, outputs = ("v", "p"), ("lat",), ("both", "p")

    Yv: Scalar = parameter(default=-0.3, lower=-5.0, upper=0.0, unit="1/s")
    Lp: Scalar = parameter(default=-2.0, lower=-25.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.Yv, 1], [0.1, self.Lp]]

    def B(self) -> Rows:
        return [[0], [5]]

    def C(self) -> Rows:
        return [[1, 1], [0, 1]]


def test_states_are_those_of_the_outputs_beside_them_in_every_record():
    rng, t = np.random.default_rng(3), np.arange(0, 8, 0.04)
    flights = []
    for size in (0.1, 1.0):  # what weighs outputs alike in one record does not in both
        u = size * np.sign(np.sin(1.3 * t))[:, None]
        y = Sum().system().simulate(t, u) + [0.5 / size, 0.02] * rng.standard_normal((len(t), 2))
        y = np.column_stack([y, y[:, 0] - y[:, 1]])
        flights.append(Record(t, u, y, ("lat",), ("both", "p", "v"), f"size {size}"))
    records = [each.select(outputs=Sum.outputs) for each in flights]
    models = {"fit": output_error(Sum(), records)}
    results = {"validation": validate(models, records)}
    task = SimpleNamespace(
        model=Sum(), models=models, results=results, checks={"validation": flights}
    )
    found = _compared(None, task).shown
    pairs = zip(results["validation"].simulated["fit"], found.simulated["fit"], strict=True)
    for y, states in pairs:
        v = y[:, 0] - y[:, 1]  # but for the biases
        np.testing.assert_allclose(states[:, 0] - states.mean(), v - v.mean(), atol=1e-9)
