"""Measured frequency responses as values and files."""

import dataclasses
import json

import numpy as np
import pytest
from truths import uh60
from truths.systems import LAG, white

from casid import DataWarning, FrequencyResponse, frequency_response


@pytest.fixture(scope="module")
def measured():
    return frequency_response(uh60.sweeps(seed=1), omega=np.geomspace(0.5, 12, 30))


@pytest.mark.second
def test_a_saved_response_reads_back_the_same(measured, tmp_path):
    path = tmp_path / "response.json"
    G = measured.G.copy()
    G[0, 0, 0] = np.nan
    measured = dataclasses.replace(measured, G=G)
    measured.save(path)
    again = FrequencyResponse.load(path)
    for name in measured.__dataclass_fields__:
        was, now = getattr(measured, name), getattr(again, name)
        if isinstance(was, np.ndarray):
            np.testing.assert_array_equal(now, was)
        else:
            assert now == was
    content = json.loads(path.read_text())
    content["coherence"][0][0][0] = 0.5
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="changed after casid wrote it"):
        FrequencyResponse.load(path)
    path.write_text(json.dumps({"casid": "fit"}))
    with pytest.raises(ValueError, match="not a frequency response"):
        FrequencyResponse.load(path)


@pytest.mark.second
def test_python_control_reads_the_response(measured):
    there = measured.to_control()
    assert there.input_labels == list(measured.inputs)
    np.testing.assert_array_equal(there.omega, measured.omega)
    np.testing.assert_array_equal(np.moveaxis(there.frdata, 2, 0)[1:], measured.G[1:])


def test_a_band_keeps_its_flags_in_place():
    record = white(LAG, np.random.default_rng(23))
    with pytest.warns(DataWarning):
        found = frequency_response([record], omega=np.array([0.2, 0.5, 2.0, 3.0]), windows=[20.0])
    part = found.between(0.5, 2.0)
    np.testing.assert_array_equal(part.G, found.G[1:3])
    assert list(part.flags.values()) == [(0,)]
    with pytest.raises(ValueError, match="no point between 5 and 6"):
        found.between(5, 6)


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("G", complex(np.inf), "a finite number"), ("coherence", 1.5, "0 to 1"),
        ("coherence", -0.1, "0 to 1"), ("random_error", -0.1, "0 to inf"),
        ("leakage", -0.1, "0 to inf"), ("resolution", -0.1, "0 to inf"),
    ],
)  # fmt: skip
def test_values_that_cannot_be_are_refused(measured, name, value, wanted):
    values = getattr(measured, name).copy()
    values[2, 1, 0] = value
    at = f"{name} is .* for {measured.outputs[1]} from col at 0.6.* rad/s, expected {wanted}"
    with pytest.raises(ValueError, match=at):
        dataclasses.replace(measured, **{name: values})
    with pytest.raises(ValueError, match="expected increasing frequencies"):
        dataclasses.replace(measured, omega=[*measured.omega[:-1], np.inf])


def test_shapes_are_checked(measured):
    with pytest.raises(ValueError, match=r"coherence has shape \(2,\)"):
        FrequencyResponse(
            omega=[1.0], G=np.ones((1, 1, 1)), coherence=np.ones(2),
            random_error=np.ones((1, 1, 1)),
            inputs=("u",), outputs=("y",), input_std=np.ones(1), output_std=np.ones(1),
        )  # fmt: skip
    with pytest.raises(ValueError, match="no pair"):
        measured.index("ax", "nothing")
