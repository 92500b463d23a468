"""The report's section on the frequency-domain fit."""

import re
from dataclasses import replace

import numpy as np
import pytest
from truths import uh60

from casid import Fit, derivid, frequency_response
from casid.report.html import body
from casid.report.words import number
from casid.stages.baseline import BASELINE

# The quasi-steady structure misses the rotor.
pytestmark = pytest.mark.filterwarnings("ignore:derivid. measured responses are farther off")


@pytest.fixture(scope="module")
def fit():
    frf = frequency_response(uh60.sweeps(seed=0), omega=np.geomspace(0.4, 12, 20))
    return derivid(uh60.structure(), frf, starts=1)


def render(fit):
    (section,) = BASELINE.show(fit, None)
    return str(body(section, None))


@pytest.mark.second
def test_every_pair_and_parameter_stands_in_the_report(fit):
    page = render(fit)
    for row in fit.notes.table:
        assert f"<td>{row.name}</td>" in page
    for row in fit.notes.pairs:
        assert number(row.J, 3) in page
    missed = [row for row in fit.notes.table if row.misses]
    assert missed
    assert len(re.findall('class="left poor"', page)) == len(missed)


def test_a_fit_read_back_makes_the_same_section(fit, tmp_path):
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json", model=type(fit.model))
    assert re.sub('data-value="[^"]*"', "", render(again)) == re.sub(
        'data-value="[^"]*"', "", render(fit)
    )


def test_a_pair_without_enough_coherence_is_a_dash(fit):
    first, *rest = fit.notes.pairs
    page = render(replace(fit, notes=replace(fit.notes, pairs=tuple(rest))))
    assert page.count(">–</td>") == render(fit).count(">–</td>") + 1
    assert number(first.J, 3) not in re.findall("<td>([^<]*)</td>", page)
