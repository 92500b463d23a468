"""A study of a nonlinear structure at several flight conditions."""

import numpy as np
import pytest
from truths.swing import SmallSwing

from casid import (
    DataWarning,
    ModelError,
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    parameter,
    read_records,
    read_study,
    run_study,
    simulate,
    write_csv,
)
from casid.bands import mode_bands
from casid.envelope import flight_condition, linear_fit
from casid.stages.conditions import CONDITIONS, OverSpeed, flight_conditions
from casid.stages.listing import STAGES
from casid.stages.stage import Task, fitting
from casid.structure.modelfile import load_model

MODEL = '''
from casid import NonlinearModel, Scalar, parameter


class Faster(NonlinearModel):
    """q' = (Mq + Mq_V (u - 30) / 10) q + off / 2 + Mlon lon; no output shows v itself."""

    states, inputs, outputs = ("u", "v", "q"), ("lon", "push"), ("u", "q")

    Mq: Scalar = parameter(default=-1.0, lower=-5.0, upper=0.0, unit="1/s")
    Mq_V: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="1/s")
    Mlon: Scalar = parameter(default=4.0, lower=0.0, upper=20.0, unit="rad/s^2")

    def derivatives(self, x, u):
        damping = self.Mq + self.Mq_V * (x.u - 30.0) / 10.0
        off = x.v - (x.u / 20.0 - 0.5)
        return [u.push, -off, damping * x.q + off / 2 + self.Mlon * u.lon]

    def reference(self):
        return {"u": 30.0, "v": 1.0}
'''
STUDY = """
[model]
file = "faster.py:Faster"
[records.identification]
files = ["at_*.csv"]
[records.identification.trim]
"at_20*" = { v = 0.5 }
"at_40*" = { v = 1.5 }
[records.validation]
files = ["unseen.csv"]
trim = { v = 1.0 }
[output_error]
biases = false
[envelope]
entries = ["q by q", "q by lon"]
held = ["*_V"]
"""


def flown(truth, speed, v, name, seed):
    t = 0.1 * np.arange(120)
    after = 1.0 * (t > 1)
    sticks = 0.1 * np.sign(np.sin(1.7 * t + seed)), 0.3 * np.sin(0.9 * t + seed)
    u = np.column_stack([after * each for each in sticks])
    still = Record(t, u, np.zeros((120, 2)), truth.inputs, truth.outputs, name)
    noise, rng = {"u": 0.05, "q": 0.01}, np.random.default_rng(seed)
    return simulate(truth, still, {"u": speed, "v": v}).with_noise(noise, rng)


@pytest.fixture
def study(tmp_path):
    (tmp_path / "faster.py").write_text(MODEL, encoding="utf-8")
    structure = load_model("faster.py:Faster", tmp_path)
    truth = structure(Mq=-1.5, Mq_V=-0.4, Mlon=6.0)
    named = (("at_20_a", 20, 0.5), ("at_20_b", 20.3, 0.5), ("at_40", 40, 1.5), ("unseen", 30, 1))
    for seed, (name, speed, v) in enumerate(named):
        write_csv(tmp_path / f"{name}.csv", flown(truth, speed, v, name, seed))

    def write(*changes):
        text = STUDY
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


class Cruise(NonlinearModel):
    """Speed alone."""

    states, inputs, outputs = ("u", "w"), ("push",), ("u",)

    Xu: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.Xu * x.u + u.push, -x.w]


def still(name, u, trim):
    t = 0.1 * np.arange(50)
    return Record(t, np.full((50, 1), 2.0), np.full((50, 1), u), ("push",), ("u",), name, trim=trim)


def test_a_condition_is_what_was_subtracted_told_and_measured():
    record = still("a", 21.0, {"w": 1.5}).detrend("mean")
    trim = flight_condition(Cruise(), record)
    assert trim.values == pytest.approx({"u": 21.0, "w": 1.5, "push": 2.0})
    assert trim.speed == pytest.approx(21.0)


def test_records_of_like_speeds_share_a_condition():
    named = (("a", 41.0, {"w": 3.0}), ("b", 20.0, {}), ("c", 39.5, {"w": 1.0}))
    slow, fast = flight_conditions(Cruise(), [still(*each) for each in named])
    assert [r.name for r in slow[1]] == ["b"]
    assert [r.name for r in fast[1]] == ["c", "a"]
    assert fast[0].values == pytest.approx({"u": 40.25, "w": 2.0, "push": 2.0})


def test_conditions_are_no_chain_of_like_speeds():
    speeds = np.arange(20.0, 40.0, 1.5)
    found = flight_conditions(Cruise(), [still(f"{V:g}", V, {}) for V in speeds])
    assert len(found) > 4
    for _, records in found:
        flown = [r.y[0, 0] for r in records]
        assert max(flown) - min(flown) <= 0.05 * 40


def test_records_of_a_hover_that_drifts_back_share_a_condition():
    found = flight_conditions(Cruise(), [still("a", -0.050, {}), still("b", -0.049, {})])
    assert [r.name for _, some in found for r in some] == ["a", "b"]
    assert len(found) == 1


def test_a_record_without_a_speed_is_named():
    blind = still("blind", 20.0, {}).rename({"u": "x"})
    with pytest.raises(ModelError, match="'blind' has no airspeed, u or V"):
        flight_conditions(Cruise(), [blind])


def test_linear_stages_are_left_to_linear_structures_unless_asked_for():
    names = {stage.name for stage in fitting(Cruise(), STAGES, ("output_error",))}
    assert not names & {"pbsid", "quadratic", "hinf", "derivid", "choice"}
    assert {"output_error", "validation", "envelope"} <= names
    assert fitting(Cruise(), STAGES, ("match",)) == STAGES


def test_linear_structures_keep_all_stages():
    assert fitting(SmallSwing(), STAGES, ()) == STAGES


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"at_40*" =', '"at_60*" ='), "no record is called 'at_60\\*'"),
        (("{ v = 0.5 }", "{ vv = 0.5 }"), "unknown key 'vv'; did you mean 'v'"),
        (("{ v = 1.0 }", "{ v = nan }"), "v = nan, expected a finite number"),
        (('["*_V"]', '["*"]'), "leaves local fits nothing to estimate"),
        (('"q by q"', '"q q"'), "'q q', expected such as"),
        (('"q by q"', '"q by r"'), "no derivative of 'q' by 'r'"),
        (('["*_V"]', '["Z*"]'), "no parameter is called 'Z\\*'"),
        (('entries = ["q by q", "q by lon"]', ""), "entries are missing"),
    ],
)
def test_bad_tables_are_named(study, change, words):
    with pytest.raises(ValueError, match=words):
        read_study(study(change))


@pytest.mark.second
def test_a_speed_whose_records_tell_too_little_is_left_out_alone(study):
    told = read_study(study())
    records = read_records(told)["identification"]
    usual = OutputError(biases=False)
    fit = usual.fit(told.model, records)

    class OneSpeed:
        def fit(self, model, records, **own):
            if records[0].name == "at_40":
                raise ModelError("the records do not determine Mq")
            return usual.fit(model, records, **own)

    task = Task(
        model=told.model, records=records, results={"output_error": fit},
        settings={"output_error": OneSpeed()},
    )  # fmt: skip
    with pytest.warns(DataWarning, match=r"local fit at 40.02 m/s is left out: .*determine Mq"):
        found = CONDITIONS.run(OverSpeed(entries=("q by q",), held=("*_V",)), task)
    assert found.local.speed == pytest.approx([20.15], abs=0.1)
    assert len(found.speed) > 2


def test_entries_are_pairs():
    assert OverSpeed(entries=("q by lon",)).pairs() == [("q", "lon")]


@pytest.mark.slow
def test_a_study_of_two_speeds_runs_from_records_to_the_figure(study):
    told = read_study(study())
    trims = [record.trim["v"] for record in read_records(told)["identification"]]
    assert trims == [0.5, 0.5, 1.5]
    outcome = run_study(told)
    results = outcome.identification.results
    assert "pbsid" not in results
    found = results["envelope"]
    np.testing.assert_allclose(found.speed[[0, -1]], [20.15, 40.0], atol=0.1)
    truth = np.column_stack([-1.5 - 0.4 * (found.speed - 30) / 10, np.full(12, 6.0)])
    assert (np.abs(found.values - truth) < 4 * found.std_error).all()
    assert found.local.values.shape == (2, 2)
    assert (np.abs(found.local.values - truth[[0, -1]]) < 4 * found.local.std_error).all()
    page = outcome.report.read_text(encoding="utf-8")
    assert "were left out" in page
    assert page.count("linearised at the trim of record unseen: u 30") == 2
    fitted = results["output_error"]
    at = linear_fit(
        fitted, flight_condition(fitted.model, read_records(told)["identification"][-1])
    )
    slope = (truth[-1, 0] - truth[0, 0]) / (found.speed[-1] - found.speed[0])
    assert at.model.system().poles().real.min() == pytest.approx(-1.5 + 10 * slope, abs=0.1)
    assert max(each.real_std for each in mode_bands(at)) > 0
    assert list(outcome.report.parent.glob("figures/envelope_derivatives.*"))
