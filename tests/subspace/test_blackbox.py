"""The black box and what is known about it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from truths.systems import known_black_box, sampled_plant, unstable_plant

from casid import BlackBox, StateSpace
from casid.subspace.trust import Missed


def test_doubts_are_those_of_the_data_then_of_growth():
    box = known_black_box(unstable_plant())
    assert box.doubts() == ()
    grown = replace(box, doubtful=np.array([0.2 + 1j, 0.2 - 1j]))
    assert len(grown.doubts()) == 1
    weak = replace(grown, explained=np.array([0.99, 0.05, 0.04]))
    assert len(weak.doubts()) == 2
    assert weak.doubts()[-1] == grown.doubts()[0]
    assert "y 5%, z 4%" in weak.doubts()[0]


def test_errors_of_a_response_need_a_refined_black_box():
    with pytest.raises(ValueError, match=r"\(unrefined\) has no uncertainty.*refine=True"):
        known_black_box(unstable_plant()).response_std(np.ones(1))


def test_the_continuous_equivalent_has_the_predictor_of_the_samples():
    # As many outputs as states: any predictor has a gain.
    plant = sampled_plant()
    system = StateSpace(plant.A, plant.B, np.eye(3), np.zeros((3, 1)), 1.0)
    K = np.array([[0.3, 0.0, 0.1], [0.1, 0.2, 0.0], [0.0, 0.1, 0.2]])
    box = replace(known_black_box(system), K=K, transform="none")
    found = box.continuous()
    assert found.order == 3
    assert found.system.dt is None
    np.testing.assert_allclose(scipy.linalg.expm(found.system.A), system.A, atol=1e-12)
    predictor = scipy.linalg.expm(found.system.A - found.K @ found.system.C)
    np.testing.assert_allclose(predictor, system.A - K @ system.C, atol=1e-9)
    assert found.continuous() is found


def test_a_pole_on_the_negative_axis_has_no_continuous_equivalent():
    system = StateSpace([[-0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    with pytest.raises(ValueError, match=r"pole at -0\.5: it has no continuous equivalent"):
        known_black_box(system).continuous()


def test_a_saved_black_box_is_read_back_as_it_was(tmp_path):
    box = replace(known_black_box(unstable_plant()), pole=2.0)
    box.save(tmp_path / "box.json")
    back = BlackBox.load(tmp_path / "box.json")
    assert repr(back) == repr(box)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(getattr(back.system, name), getattr(box.system, name))
    np.testing.assert_array_equal(back.K, box.K)
    back.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "box.json").read_bytes()
    for text in ("{}", '{"result": {"tuple": []}}', "[]", "{"):
        (tmp_path / "box.json").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=r"box\.json"):
            BlackBox.load(tmp_path / "box.json")


DAMAGE = {
    "system": lambda box: box.update(system=None),
    "band =": lambda box: box.update(band=None),
    r"band = \(10": lambda box: box["band"]["tuple"].reverse(),
    "explained": lambda box: box.update(explained=-1),
    "explained of": lambda box: box.update(explained={"array": [0.9], "kind": "f", "shape": [1]}),
    "output_std = ": lambda box: box["output_std"]["array"].__setitem__(0, -1.0),
    "shape": lambda box: box["output_std"].update(array=[1.0]),
    r"expected \[.*\]": lambda box: box["K"].update(array=0.0),
    "K of shape": lambda box: box.update(K={"array": [1.0], "kind": "f", "shape": [1]}),
    "pole": lambda box: box.update(pole={"float": "nan"}),
    "system: A": lambda box: box["system"]["fields"]["A"]["array"][0].__setitem__(0, None),
    "an array of shape": lambda box: box["system"]["fields"]["D"].update(array=-1),
    "too large": lambda box: box["feedthrough"].update(array=[[1e308]] * 3, kind="i"),
    "past": lambda box: box.update(past=1.5),
}


@pytest.mark.parametrize("field", DAMAGE)
def test_a_damaged_black_box_is_refused_by_the_name_of_its_field(field, tmp_path):
    replace(known_black_box(unstable_plant()), pole=2.0).save(tmp_path / "box.json")
    content = json.loads((tmp_path / "box.json").read_text("utf-8"))
    del content["digest"]  # which tells any change, and which older files have not
    DAMAGE[field](content["result"]["fields"])
    (tmp_path / "box.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"box\.json.*{field}"):
        BlackBox.load(tmp_path / "box.json")


def test_a_black_box_that_was_changed_is_told(tmp_path):
    replace(known_black_box(unstable_plant()), pole=2.0).save(tmp_path / "box.json")
    text = (tmp_path / "box.json").read_text("utf-8")
    (tmp_path / "box.json").write_text(text.replace('"past": ', '"past": 1'), encoding="utf-8")
    with pytest.raises(ValueError, match=r"box\.json: changed after casid wrote it"):
        BlackBox.load(tmp_path / "box.json")


def test_a_black_box_of_samples_has_no_pole_and_is_read(tmp_path):
    replace(known_black_box(sampled_plant()), transform="none").save(tmp_path / "box.json")
    assert np.isnan(BlackBox.load(tmp_path / "box.json").pole)


def lagged(hold, dt=0.1, a=4.0):
    """y' = -a y + u in samples, by hand for either hold."""
    E = np.exp(-a * dt)
    if hold == "zoh":
        return StateSpace([[E]], [[(1 - E) / a]], [[1.0]], [[0.0]], dt)
    ahead = (a * dt - 1 + E) / (a * a * dt)  # of the next input, in straight lines to it
    now = (1 - E) / a - ahead
    return StateSpace([[E]], [[now + E * ahead]], [[1.0]], [[ahead]], dt)


@pytest.mark.parametrize(
    ("hold", "most"), [("zoh", (1e-3, 0.01, 0.07)), ("foh", (1e-6, 1e-4, 4e-3))]
)
def test_a_response_of_samples_is_that_to_inputs_that_are_not_held(hold, most):
    strict = {"feedthrough": np.zeros((1, 1), dtype=bool)}
    box = replace(known_black_box(lagged(hold)), hold=hold, interval=0.1, **strict)
    omega = np.array([0.1, 1.0, 5.0, 20.0])
    G = 1 / (1j * omega + 4)
    off, left = np.abs(box.response(omega)[:, 0, 0] - G), box.images(omega)[:, 0, 0]
    assert (off[:3] <= left[:3]).all(), "what goes on between samples was told too small"
    assert (left[:3] < np.array(most) * np.abs(G[:3])).all()
    assert not replace(box, interval=None).images(omega).any()


FAST = StateSpace([[-40.0]], [[80.0]], [[1.0]], [[-1.0]], None, ("u",), ("y",))  # (40 - s)/(40 + s)
LATE = StateSpace([[0.0, 0.0], [1.0, 0.0]], [[1.0], [0.0]], [[0.0, 1.0]], [[0.0]], 0.02)  # z^-2


@pytest.mark.parametrize("system", [FAST, LATE], ids=["continuous", "discrete"])
def test_what_whole_samples_of_delay_and_a_direct_term_make_of_a_staircase_is_left_open(system):
    # Direct terms, each delayed by whole samples, can make the same samples as any model: then the
    # response is that of the samples, here summed over those of a pulse.
    h, omega = 0.02, np.array([0.5, 2.0, 5.0, 12.0])
    u = np.eye(1, 400)[0]
    pulse = system.simulate(h * np.arange(400), u[:, None], hold="zoh")[:, 0]
    G = np.exp(-1j * h * np.outer(omega, np.arange(400))) @ pulse
    box = replace(known_black_box(system), hold="zoh", interval=h)
    off, left = np.abs(box.response(omega)[:, 0, 0] - G), box.images(omega)[:, 0, 0]
    assert (off < 1.5 * left).all(), "what goes on between samples was told too small"
    assert (left < omega * h).all()  # a sample of delay
    strict = replace(box, feedthrough=np.zeros((1, 1), dtype=bool)).images(omega)[:, 0, 0]
    assert (strict < off / 1.5).all()


def test_a_black_box_measures_unless_its_errors_do_not_hold():
    plain = known_black_box(unstable_plant())
    known = replace(plain, uncertainty=SimpleNamespace())
    missed = Missed(output="p", omega=2.0, ratio=3.0, order=4)
    found = [plain, known, replace(known, biased=True), replace(known, missed=missed)]
    assert [box.measures for box in found] == [False, True, False, False]
