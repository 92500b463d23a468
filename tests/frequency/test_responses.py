"""Frequency responses of other tools."""

import numpy as np
import pytest

from casid import FrequencyResponse
from casid.frequency.covariance import whitener
from casid.frequency.responses import merge_responses, read_frequency_csv, side_by_side

OMEGA = np.array([0.5, 1.0, 2.0])
G = np.array([1 - 1j, -0.5j, -0.2 + 0.1j])


def write(path, columns):
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(
    ("form", "first", "second"),
    [
        ("dB deg", 20 * np.log10(np.abs(G)), np.degrees(np.angle(G)) - 360),
        ("dB rad", 20 * np.log10(np.abs(G)), np.angle(G)),
        ("abs deg", np.abs(G), np.degrees(np.angle(G))),
        ("abs rad", np.abs(G), np.angle(G)),
        ("re im", G.real, G.imag),
    ],
)
def test_every_form_reads_as_the_same_response(tmp_path, form, first, second):
    path = write(tmp_path / "p_lat.csv", {"w": OMEGA, "a": first, "b": second})
    found = read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")}, omega="w", form=form)
    np.testing.assert_allclose(found.G[:, 0, 0], G, rtol=1e-12)
    assert (found.coherence == 1).all()
    assert np.isnan(found.random_error).all()
    assert (found.outputs, found.inputs, found.records) == (("p",), ("lat",), ("p_lat",))


def test_hertz_become_radians_and_quality_is_read(tmp_path):
    path = write(tmp_path / "r.csv", {"f": OMEGA / (2 * np.pi), "a": G.real, "b": G.imag,
                                      "c": [0.9, 0.8, 0.7], "e": [0.1, 0.2, 0.3]})  # fmt: skip
    found = read_frequency_csv(
        path, pairs={("p", "lat"): ("a", "b", "c", "e")}, omega="f", form="re im", hertz=True,
        input_std={"lat": 0.02}, output_std={"p": 0.1},
    )  # fmt: skip
    np.testing.assert_allclose(found.omega, OMEGA)
    np.testing.assert_array_equal(found.coherence[:, 0, 0], [0.9, 0.8, 0.7])
    np.testing.assert_array_equal(found.random_error[:, 0, 0], [0.1, 0.2, 0.3])
    assert (found.input_std.item(), found.output_std.item()) == (0.02, 0.1)


def test_pairs_from_several_files_are_put_together(tmp_path):
    one = write(tmp_path / "one.csv", {"omega": OMEGA, "a": G.real, "b": G.imag})
    two = write(tmp_path / "two.csv", {"omega": OMEGA, "a": [1.0, np.nan, 3.0], "b": [0.0] * 3})
    parts = [
        read_frequency_csv(one, pairs={("p", "lat"): ("a", "b")}, form="re im"),
        read_frequency_csv(two, pairs={("q", "lon"): ("a", "b")}, form="re im",
                           input_std={"lon": 0.5}),
    ]  # fmt: skip
    both = merge_responses(parts)
    assert (both.outputs, both.inputs) == (("p", "q"), ("lat", "lon"))
    np.testing.assert_array_equal(both.G[:, 0, 0], G)
    assert np.isnan(both.G[:, 0, 1]).all()
    np.testing.assert_array_equal(np.isnan(both.G[:, 1, 1]), [False, True, False])
    np.testing.assert_array_equal(np.isnan(both.coherence), np.isnan(both.G))
    np.testing.assert_array_equal(both.input_std, [1.0, 0.5])
    again = merge_responses([parts[0], both])
    np.testing.assert_array_equal(again.G, both.G)


def test_responses_put_together_are_as_uncertain_as_they_were():
    rng = np.random.default_rng(4)
    omega, shape = np.geomspace(1, 8, 12), (12, 2, 1)
    size = rng.uniform(0.1, 0.3, shape)
    parts = [
        FrequencyResponse(
            omega=omega, G=rng.standard_normal(shape) + 1j, coherence=np.ones(shape),
            random_error=size, inputs=(name,), outputs=("p", "r"), input_std=np.ones(1),
            output_std=np.ones(2), resolution=np.full(shape, 0.6), flags={"leaks": (3,)},
            output_correlation=np.tile([[1, 0.7j], [-0.7j, 1]], (12, 1, 1)),
        )
        for name in ("lat", "ped")
    ]  # fmt: skip
    both = merge_responses(parts)
    gains = rng.standard_normal((12, 2, 2, 3)) + 0j
    told = whitener(both, np.ones((2, 2), bool)).spread(gains)
    each = [
        whitener(part, np.ones((2, 1), bool)).spread(gains[:, :, [k]])
        for k, part in enumerate(parts)
    ]
    np.testing.assert_allclose(told, sum(each), rtol=1e-10)  # of independent flights
    assert both.flags == {"leaks": (3,)}


def test_bad_files_are_refused(tmp_path):
    path = write(tmp_path / "r.csv", {"omega": OMEGA, "a": G.real, "b": G.imag, "c": [1, 2, 0]})
    with pytest.raises(ValueError, match="c is 2 in row 2; coherence is in"):
        read_frequency_csv(path, pairs={("p", "lat"): ("a", "b", "c")})
    with pytest.raises(ValueError, match="no column 'gain'"):
        read_frequency_csv(path, pairs={("p", "lat"): ("gain", "b")})
    with pytest.raises(ValueError, match="form='polar'"):
        read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")}, form="polar")
    with pytest.raises(ValueError, match="names 1 columns"):
        read_frequency_csv(path, pairs={("p", "lat"): ("a",)})
    with pytest.raises(ValueError, match="pairs is empty"):
        read_frequency_csv(path, pairs={})
    with pytest.raises(ValueError, match="increasing frequencies"):
        read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")}, omega="c")
    with pytest.raises(ValueError, match="no responses given"):
        merge_responses([])
    good = read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")})
    with pytest.raises(ValueError, match="one grid"):
        merge_responses([good, good.between(0.4, 1.1)])


def measured(output, omega, leak):
    """A response of one output to one stick."""
    shape = (len(omega), 1, 1)
    names = {"inputs": ("lat",), "outputs": (output,), "input_std": [1.0], "output_std": [1.0]}
    quality = {"coherence": 0.9, "random_error": 0.03, "leakage": leak}
    parts = {name: np.full(shape, value) for name, value in quality.items()}
    return FrequencyResponse(omega=omega, G=np.full(shape, 1 + 2j), **parts, **names)


def test_responses_of_other_frequencies_stand_side_by_side_with_all_their_errors():
    first, second = measured("p", OMEGA, 0.04), measured("r", OMEGA[1:] + 0.5, 0.0)
    found = side_by_side([first, second])
    np.testing.assert_array_equal(found.omega, [0.5, 1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(found.error[[0, 1, 3], 0, 0], 0.05)  # noise and leakage
    np.testing.assert_allclose(found.error[[2, 4], 1, 0], 0.03)
    assert np.isnan(found.G[[2, 4], 0, 0]).all()
    assert np.isnan(found.G[[0, 1, 3], 1, 0]).all()


def test_a_size_of_a_channel_that_no_pair_has_is_refused(tmp_path):
    path = write(tmp_path / "p.csv", {"omega": [1.0, 2.0], "dB": [0.0, -1.0], "deg": [0.0, -9.0]})
    kept = {"omega": "omega", "pairs": {("p", "lat"): ("dB", "deg")}, "form": "dB deg"}
    assert read_frequency_csv(path, **kept, input_std={"lat": 2.0}).input_std == 2.0
    with pytest.raises(ValueError, match="input_std: no pair has 'latt'"):
        read_frequency_csv(path, **kept, input_std={"latt": 2.0})
    with pytest.raises(ValueError, match="output_std: no pair has 'lat'"):
        read_frequency_csv(path, **kept, output_std={"lat": 2.0})


@pytest.mark.parametrize(
    ("gain", "form", "told"),
    [(4000, "dB deg", "4000 in row 2, a gain of 1e\\+200"), (1e-30, "abs deg", "a gain of 1e-30")],
)
def test_gains_that_no_response_has_are_named(tmp_path, gain, form, told):
    path = tmp_path / "wild.csv"
    path.write_text(f"w,a,b\n1,-6,0\n2,{gain},0\n".replace("-6", "0.5"))
    with pytest.raises(ValueError, match=rf"wild.csv: a is .*{told}, which no response has: leave"):
        read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")}, omega="w", form=form)


def test_a_column_that_a_response_lacks_is_told_by_its_own_arguments(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("w,a,b\n1,0,0\n")
    with pytest.raises(
        ValueError, match=r"no column 'omega'.*omega = NAME, or the columns of pairs"
    ):
        read_frequency_csv(path, pairs={("p", "lat"): ("a", "b")})


def test_a_stated_error_of_zero_is_refused(tmp_path):
    path = tmp_path / "exact.csv"
    path.write_text("omega,g,ph,c,e\n1,0,-45,1,0.1\n2,-3,-63,1,0\n")
    with pytest.raises(ValueError, match=r"exact.csv: e is 0 in row 2: .* leave the cell empty"):
        read_frequency_csv(path, pairs={("p", "lat"): ("g", "ph", "c", "e")})
