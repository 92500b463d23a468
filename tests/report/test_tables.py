"""Tables of values: every kind has one, cells say what the value holds, names are escaped."""

import re
from dataclasses import replace

import pytest
from truths.shown import record, values

from casid import summary
from casid.report.tables import cells, html


@pytest.mark.parametrize("name", list(values()))
def test_every_value_has_a_table_whose_rows_are_as_wide_as_its_heading(name):
    heading, rows = cells(values()[name])
    assert rows
    assert {len(row) for row in rows} == {len(heading)}
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
