"""The black box and what is known about it."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from truths.systems import known_black_box, sampled_plant, unstable_plant

from casid import BlackBox, StateSpace


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
    box = known_black_box(unstable_plant())
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
