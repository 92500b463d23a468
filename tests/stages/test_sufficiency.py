"""The stage that asks whether the structure is enough."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from truths.roll_study import write_study

from casid import DataWarning, Distance, Distances, read_study, run_study
from casid.stages.stage import LeftOutError
from casid.stages.sufficiency import SUFFICIENCY, Sufficiency


def found(*rows):
    named = [
        Distance(
            output=o, input="lat", band=(1.0, 2.0), structure=d, structure_level=3.0, share=0.2
        )
        for o, d in rows
    ]
    return Distances(structure="Roll", rows=tuple(named), level=0.01)


def test_a_structure_that_is_not_enough_is_the_first_caution():
    (shown,) = SUFFICIENCY.show(found(("p", 9.0), ("r", 12.0), ("q", 1.0)), None)
    (caution,) = shown.cautions
    assert caution.rank == 1
    assert caution.text.startswith("The structure is not enough: r after lat, 1-2 rad/s: ")
    assert "12σ, 20% of its response" in caution.text
    assert caution.text.endswith("; something of p too.")
    (one,) = SUFFICIENCY.show(found(("p", 9.0)), None)
    assert one.cautions[0].text.endswith("20% of its response.")
    (near,) = SUFFICIENCY.show(dataclasses.replace(found(("p", 9.0)), held=("Lp", "tau")), None)
    assert near.cautions[0].text.endswith("; Lp, tau are on bounds there, which may be the reason.")
    (silent,) = SUFFICIENCY.show(found(("p", 1.0)), None)
    assert silent.cautions == ()


def test_an_input_that_is_fed_back_is_told_of_instead_of_the_structure():
    back = found(("r", 98.0), ("q", 1.0))
    rows = tuple(dataclasses.replace(row, fed_back=True) for row in back.rows)
    (shown,) = SUFFICIENCY.show(dataclasses.replace(back, rows=rows), None)
    (caution,) = shown.cautions
    assert caution.text.startswith("For r the black box cannot judge the structure")
    assert "feed an input back, lat at 1-2 rad/s" in caution.text
    assert shown.lead.endswith("Left out is what outputs feed back: lat at 1-2 rad/s.")
    assert [row.cell for row in (*rows, *back.rows)] == ["(98σ)", "(1σ)", "98σ!", "1σ"]


def test_a_black_box_without_errors_is_no_measure():
    results = {"pbsid": SimpleNamespace(measures=False), "output_error": None}
    with pytest.raises(LeftOutError):
        SUFFICIENCY.run(Sufficiency(), SimpleNamespace(results=results))


def test_in_turbulence_a_black_box_of_transforms_is_no_measure(monkeypatch):
    fit = SimpleNamespace(model=None, notes=SimpleNamespace(K=np.zeros((2, 2))))
    box = SimpleNamespace(measures=True, refinement="fourier")
    task = SimpleNamespace(results={"pbsid": box, "output_error": fit})
    with pytest.warns(DataWarning, match="turbulence"), pytest.raises(LeftOutError):
        SUFFICIENCY.run(Sufficiency(), task)
    box.refinement, box.band, task.settings = "prediction", (0.5, 5.0), {}
    monkeypatch.setattr("casid.stages.sufficiency.distances", lambda *_, **__: "asked")
    assert SUFFICIENCY.run(Sufficiency(), task) == "asked"


@pytest.mark.slow
def test_a_study_of_the_true_structure_raises_no_alarm(copy):
    text = "[sufficiency]\nband = [0.6, 6.0]\n\n[match]"
    outcome = run_study(read_study(write_study(copy, ("[match]", text))))
    distances = outcome.identification.results["sufficiency"]
    assert distances.enough
    assert distances.bands[0][0] == pytest.approx(0.6)
    assert "Is the structure enough?" in outcome.report.read_text("utf-8")
