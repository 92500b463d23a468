"""What the page says first."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from truths.pages import changed

from casid.report.answer import doubted, not_believed, predictions_told, ranked, theil_place
from casid.report.evidence import comparable, differences
from casid.report.verdicts import Verdict


def verdict(output, theil, advantage=1.0, rms=1.0):
    return Verdict(output=output, unit="-", rms=rms, fit=0.0, theil=theil, noise=0.1,
                   residual=0.1, records=(theil,), advantage=advantage)  # fmt: skip


SIMULATED = SimpleNamespace(predicted="", models=("black box", "output error"))
ALONE = SimpleNamespace(predicted="", models=("output error",))


def test_the_worst_output_stands_first_and_what_is_not_judged_last():
    judged = [verdict("p", 0.05), verdict("q", np.nan), verdict("r", 0.4)]
    assert [each.output for each in ranked(judged)] == ["r", "p", "q"]


def test_it_says_where_the_model_is_not_good_and_that_the_structure_is_why():
    judged = [verdict("p", 0.05), verdict("r", 0.4, 3.0), verdict("q", 0.2)]
    said = predictions_told(judged, SIMULATED, enough=False)
    assert "good on 1, fair on 1, poor on 1" in said
    assert "worst on r 0.40, q 0.20" in said
    assert "structure is at fault: the black box of the same records predicts r 3.0 times" in said
    assert "The estimate is at fault" in predictions_told(judged, SIMULATED, enough=True)
    assert "Structure or estimate is at fault" in predictions_told(judged, SIMULATED)


def test_a_black_box_that_does_no_better_does_not_blame_the_structure():
    said = predictions_told([verdict("r", 0.4, 1.5)], SIMULATED)
    assert "structure" not in said
    assert "not twice as good on any" in said
    assert "black box" not in predictions_told([verdict("r", 0.4)], ALONE)
    assert predictions_told([], SIMULATED) == ""


def test_a_black_box_that_knows_the_controller_does_not_blame_the_structure():
    judged = [dataclasses.replace(verdict("r", 0.7, 3.0), fed_back=True), verdict("q", 0.2)]
    said = predictions_told(judged, SIMULATED, enough=False)
    assert "at fault" not in said
    assert said.endswith("is not twice as good on any but r, whose controller it knows.")
    assert judged[0].reason == "the black box knows the controller"


def test_an_advantage_that_ends_at_the_noise_says_so():
    # An RMS error of 0.3 is three times the noise of 0.1, whatever the black box leaves below.
    at_noise = verdict("r", 0.4, 3.0, rms=0.3)
    assert at_noise.reason == "the black box is 3.0 times (down to its noise) better"
    assert verdict("r", 0.4, 3.0).reason == "the black box is 3.0 times better"


def test_a_good_model_has_no_worst_output():
    assert predictions_told([verdict("p", 0.05)], SIMULATED).endswith("the model is good on 1.")


def test_an_error_of_the_noise_is_called_so_and_no_other_reason_given():
    assert verdict("p", 0.9, rms=0.1).reason == "hardly more than its noise"
    assert verdict("p", 0.05).reason == ""


def test_what_hardly_moves_is_counted_as_not_judged_and_is_no_worst_output():
    said = predictions_told([verdict("q", 0.2), verdict("p", 0.9, rms=0.1)], ALONE)
    assert "fair on 1, not judged on 1" in said
    assert "worst on q 0.20 (" in said


def test_the_picture_ends_at_one_half():
    assert (theil_place(0.0), theil_place(0.25), theil_place(2.0)) == (0.0, 50.0, 100.0)


def estimate(error):
    return {"Lp": SimpleNamespace(name="Lp", std_error=error)}


class Estimates(dict):
    parameters = property(dict.values)


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [(0.1, 0.2, True), (0.1, 0.0, True), (0.0, 0.0, False), (0.1, np.nan, False),
     (0.1, np.inf, False)],
)  # fmt: skip
def test_estimates_can_be_compared_where_both_have_errors(one, other, told):
    assert comparable(Estimates(estimate(one)), Estimates(estimate(other))) is told


@pytest.mark.slow
def test_every_parameter_in_doubt_is_named_with_its_reasons(content, monkeypatch):
    fit = content.results["output_error"]
    rows = [dataclasses.replace(row, std_error=1e3) for row in fit.parameters]
    rows[0] = dataclasses.replace(rows[0], active=True)
    worried = dataclasses.replace(fit, parameters=tuple(rows))
    page = changed(content, output_error=worried)
    found = doubted(page, worried)
    assert found[rows[0].name][0] == "held"
    assert all("unsure" in found[row.name] for row in rows[1:])
    said = not_believed(page, worried)
    assert f"{len(rows)} of {len(rows)} parameters: 1 held by a bound ({rows[0].name})" in said
    assert said.endswith("of all other parameters and of modes assume that these bounds are right.")
    sure = [dataclasses.replace(row, std_error=1e-9 * abs(row.value)) for row in fit.parameters]
    alone = dataclasses.replace(content, models={})
    certain = dataclasses.replace(fit, parameters=tuple(sure))
    assert not_believed(alone, certain) == "No parameter is on a bound or of unknown sign."
    agreeing = dataclasses.replace(content, models={"one": certain, "other": certain})
    assert "no other estimate disagrees" in not_believed(agreeing, certain)
    none = [dataclasses.replace(row, std_error=np.nan) for row in sure]
    without = dataclasses.replace(certain, parameters=tuple(none))  # a match states no errors
    untold = dataclasses.replace(content, models={"one": certain, "other": without})
    assert "disagrees" not in not_believed(untold, certain)
    monkeypatch.setattr("casid.report.answer.scattered", lambda _: {rows[1].name: 2.0})
    assert doubted(alone, certain) == {rows[1].name: ("scattered",)}
    said = not_believed(alone, certain)
    assert "1 whose estimates scatter from record to record by more than their errors" in said


@pytest.mark.slow
def test_every_parameter_of_a_caution_about_estimates_is_found_by_it_whatever_else_it_is(content):
    fit = content.results["output_error"]
    vague = tuple(dataclasses.replace(row, std_error=2 * abs(row.value)) for row in fit.parameters)
    far = tuple(dataclasses.replace(row, value=99 * row.value) for row in vague)
    pair = {"one": dataclasses.replace(fit, parameters=vague)}
    pair["other"] = dataclasses.replace(fit, parameters=far)
    page = dataclasses.replace(content, models=pair)
    (caution,) = differences(page)
    found = doubted(page, pair["one"])
    differing = [name for name, reasons in found.items() if "apart" in reasons]
    assert f"on {len(differing)} of {len(vague)} parameters" in caution.text
    assert len(differing) == len(vague)
    assert all("unsure" in reasons for reasons in found.values())
