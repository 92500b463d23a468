"""Tables of values: every kind has one, cells say what the value holds, names are escaped."""

import re
from dataclasses import replace

import numpy as np
import pytest
from truths.shown import record, values

from casid import summary
from casid.report.tables import cells, html, shares


@pytest.mark.parametrize("name", list(values()))
def test_every_value_has_a_table_whose_rows_are_as_wide_as_its_heading(name):
    heading, rows = cells(values()[name])
    assert rows or name == "KinematicCheck"  # of a record without attitudes
    assert all(len(row) == len(heading) for row in rows)
    assert summary(values()[name]).startswith(f"{name}(")


def test_a_fit_s_table_has_its_numbers():
    fit = values()["Fit"]
    row = next(row for row in cells(fit)[1] if row[0] == "Lp")
    assert float(row[1].replace("−", "-")) == pytest.approx(fit["Lp"].value, rel=1e-3)
    assert float(row[3]) == pytest.approx(fit["Lp"].std_error, rel=1e-3)
    assert float(row[4]) == pytest.approx(100 * fit["Lp"].std_error / -fit["Lp"].value, abs=0.06)


def test_coherent_frequencies_are_the_longest_run():
    found = values()["FrequencyResponse"]
    coherence = found.coherence.copy()
    coherence[:], coherence[2:5], coherence[7:9] = 0.1, 0.9, 0.9
    row = cells(replace(found, coherence=coherence))[1][0]
    assert row == ["p", f"{found.omega[2]:.3g} to {found.omega[4]:.3g}"]


def test_names_of_users_are_escaped_in_html():
    page = html(replace(record(), name="<script>alert(1)</script>"))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert re.search(r"<td>lat</td>", page)


def test_what_is_no_result_is_refused():
    with pytest.raises(TypeError, match="a list has no table"):
        cells([1, 2])


def test_readings_and_bands_show_each_number_with_its_error():
    band, system = values()["HandlingBand"], values()["TransferFunction"]
    assert cells(band)[1] == [
        ["bandwidth [rad/s]", "3", "0.1"],
        ["phase delay [s]", "0.05", "0.01"],
    ]
    rows = {row[0]: row[1:] for row in cells(system)[1]}
    assert list(rows) == ["numerator s^0", "denominator s^0", "delay [s]"]
    assert float(rows["denominator s^0"][0]) == pytest.approx(system.denominator[1], rel=1e-3)
    assert float(rows["denominator s^0"][1]) == pytest.approx(system.std_error[1], rel=1e-3)
    mode = values()["ModeBand"]
    (real, *_) = cells(mode)[1]
    assert float(real[1].replace("−", "-")) == pytest.approx(mode.mode.pole.real, rel=1e-3)
    assert float(real[2]) == pytest.approx(mode.real_std, rel=1e-2)


def test_shares_of_an_excitation_are_read_within_its_band():
    found = values()["Excitation"]
    (row,) = shares(found)
    inside = found.lower[found.within[:, 0], 0]
    assert (row.share, row.least) == (np.median(inside), inside.min())
    assert found.lower[found.omega == row.at, 0] == row.least
    assert found.omega[found.within[:, 0]][[0, -1]].tolist() == [row.low, row.high]


def test_stages_starts_amplitudes_and_topics_have_a_row_each():
    value, fit = values(), values()["Fit"]
    assert cells(value["Identification"])[1][1] == ["output_error", fit.headline()]
    first, second = cells(value["Multistart"])[1]
    assert (first[-1], second) == (f"{fit.cost:.8g}", ["-9", "2", "failed: no way down"])
    assert cells(value["Distortion"])[1] == [["p", "20 %, noise 2 %"]]
    assert cells(value["Log"])[1] == [["gyro", "9", "20", "0", "p"]]
