"""The report's section on the frequency-domain fit."""

import re
from dataclasses import replace

import numpy as np
import pytest
from truths import uh60
from truths.closed_roll import TRUTH, campaign

from casid import Derivid, Fit, ModelError, derivid, frequency_response
from casid.report.html import body
from casid.report.words import number
from casid.stages.baseline import BASELINE
from casid.stages.stage import Task

OMEGA = np.geomspace(2.5, 9.0, 8)

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


@pytest.mark.second
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


def test_parameters_of_an_input_that_no_sweep_moves_are_refused_all_at_once():
    still = tuple(replace(each, u=each.u * [1, 0]) for each in campaign(1))
    task = Task(model=TRUTH, roles={"frequency": still})
    with pytest.raises(ValueError, match="moves ped, and no response tells Lped: add a sweep"):
        BASELINE.examine(Derivid(), task)
    BASELINE.examine(Derivid(), replace(task, fixed=("Lped",)))
    BASELINE.examine(Derivid(priors={"Lped": (1.5, 0.1)}), task)
    BASELINE.examine(Derivid(), replace(task, roles={"frequency": campaign(1)}))
    one = frequency_response([each.select(inputs=["lat"]) for each in still], omega=OMEGA)
    with pytest.raises(ModelError, match="Lped has no effect on any weighted response"):
        derivid(TRUTH, one, starts=1)
