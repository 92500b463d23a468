"""Verdicts and what to be careful about."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from truths.pages import cautions, changed

from casid.report import (
    OUTPUT_ERROR,
)
from casid.report.answer import predictions_told
from casid.report.content import BLACK_BOX, CHOSEN
from casid.report.evidence import noise_levels
from casid.report.verdicts import Verdict, uncertain, verdicts, word
from casid.stages.judgement import VALIDATION


@pytest.mark.parametrize(
    ("theil", "said"), [(0.05, "good"), (0.2, "fair"), (0.7, "poor"), (np.nan, "not judged")]
)
def test_verdicts_follow_theils_coefficient(theil, said):
    assert word(theil) == said


def test_a_model_that_runs_out_of_numbers_is_poor_and_no_worse_black_box_excuses_it():
    figures = {"rms": np.inf, "fit": -np.inf, "theil": 1.0, "noise": 0.1, "residual": 0.1}
    lost = Verdict(output="p", unit="rad/s", records=(1.0,), advantage=np.inf, **figures)
    assert (lost.word, lost.structural, lost.noisy) == ("poor", True, False)
    assert lost.reason == "the simulation of the model diverges"
    assert lost.caution.endswith(f"poorly (Theil's coefficient 1.00): {lost.reason}.")


@pytest.mark.parametrize(
    ("rms", "theil", "said"),
    [(1.1, 0.9, "not judged"), (1.3, 0.9, "poor"), (1.1, 0.2, "fair"), (1.1, 0.05, "good")],
)
def test_what_hardly_moves_beyond_its_noise_is_not_called_poor(rms, theil, said):
    figures = {"fit": 0.0, "noise": 1.0, "residual": 1.0, "records": (theil,)}
    found = Verdict(output="q", unit="rad/s", rms=rms, theil=theil, **figures)
    assert found.word == said
    assert ("hardly moves beyond its noise" in found.caution) == (said == "not judged")
    assert ("poorly" in found.caution) == (said != "not judged")
    told = predictions_told([found], SimpleNamespace(predicted="", models=()))
    assert f"the model is {said} on 1" in told
    assert ("does worst on q" in told) == (said in ("poor", "fair"))


def test_what_constants_predict_as_well_is_poor_however_far_from_the_trim():
    figures = {"fit": 1.0, "noise": 0.1, "residual": 1.0, "records": (0.2,), "theil": 0.2}
    found = Verdict(output="phi", unit="rad", rms=1.0, flat=True, **figures)
    assert (found.word, found.reason) == ("poor", "no better than by a constant of each record")
    assert found.caution.endswith(f"poorly (Theil's coefficient 0.20): {found.reason}.")
    assert Verdict(output="phi", unit="rad", rms=1.0, **figures).word == "fair"


@pytest.mark.slow
def test_an_offset_from_the_trim_is_nothing_that_a_model_explains(content):
    validation, words = content.results["validation"], []
    (record,) = validation.measured
    away = record.y - record.y.mean(axis=0) + 2 * record.y.std(axis=0)
    flown = dataclasses.replace(record, y=away, trim=dict.fromkeys(record.outputs, 0.0))
    still = np.broadcast_to(away.mean(axis=0), away.shape)
    for share in (0.0, 1.0):  # of its motion that a model has
        simulated = dict.fromkeys(validation.models, (still + 0.97 * share * (away - still),))
        found = dataclasses.replace(validation, measured=(flown,), simulated=simulated)
        judged = verdicts(found, content)
        words.append([each.word for each in judged])
        assert all(each.theil < 0.3 for each in judged)  # 1 / (2 + √5) without
    assert words == [["poor", "poor"], ["good", "good"]]


@pytest.mark.slow
def test_the_summary_warns_of_bounds_and_signs(content):
    fit = content.results["output_error"]
    rows = [dataclasses.replace(row, std_error=1e3) for row in fit.parameters]
    rows[0] = dataclasses.replace(rows[0], active=True)
    worried = changed(
        dataclasses.replace(content, warnings=("a record was short",)),
        output_error=dataclasses.replace(fit, parameters=tuple(rows)),
    )
    said = " ".join(cautions(worried))
    for words in (
        "1 parameter lies on a bound: Yv", "sign of 3 parameters is not determined",
        "a record was short",
    ):  # fmt: skip
        assert words in said


@pytest.mark.slow
def test_the_summary_goes_by_standard_errors_and_says_if_residuals_are_coloured(content):
    fit = content.results["output_error"]

    def said(ratio):
        rows = [
            dataclasses.replace(row, value=3.0, std_error=ratio, cramer_rao=1.0)
            for row in fit.parameters
        ]
        judged = dataclasses.replace(fit, parameters=tuple(rows))
        return " ".join(cautions(changed(content, output_error=judged)))

    assert "correlated" not in said(1.2)
    assert "typically 2.0 times the Cramér-Rao bound" in said(2.0)
    assert "sign of" not in said(2.0)  # 3 ± 2
    assert f"sign of {len(fit.parameters)} parameters is not determined" in said(4.0)


@pytest.mark.parametrize(("gain", "told"), [(None, True), (np.eye(2), False)])
def test_errors_of_coloured_residuals_do_not_allow_for_answers_to_gusts_but_a_filter_does(
    gain, told
):
    row = {"name": "Lp", "value": 3.0, "fixed": False, "active": False, "multiplier": 0.0}
    rows = (SimpleNamespace(**row, std_error=0.2, cramer_rao=0.1),)
    (said,) = uncertain(SimpleNamespace(parameters=rows, notes=SimpleNamespace(K=gain)))
    assert "typically 2.0 times the Cramér-Rao bound." in said.text
    assert ("compare with process_noise" in said.text) is told


@pytest.mark.slow
def test_a_verdict_is_of_all_unseen_records_together(content):
    validation = content.results["validation"]
    twice = dataclasses.replace(
        validation,
        records=validation.records * 2,
        measured=validation.measured * 2,
        begins=validation.begins * 2,
        simulated={name: ys * 2 for name, ys in validation.simulated.items()},
        theil={name: np.vstack([values, values]) for name, values in validation.theil.items()},
    )
    for found in (verdicts(validation, content), verdicts(twice, content)):
        assert [verdict.output for verdict in found] == ["p", "phi"]
        for name in ("rms", "fit", "theil"):  # the same record twice is no news
            np.testing.assert_allclose(
                [getattr(verdict, name) for verdict in found],
                getattr(validation, name)[OUTPUT_ERROR][0],
            )
    assert all(len(set(verdict.records)) == 1 < len(verdict.records) for verdict in found)


@pytest.mark.slow
def test_an_error_of_the_size_of_the_noise_is_not_held_against_the_model(content):
    fit = content.results["output_error"]
    validation = content.results["validation"]
    found = verdicts(validation, content)
    np.testing.assert_allclose([v.residual for v in found], np.sqrt(np.diag(fit.R)))
    np.testing.assert_allclose([v.noise for v in found], noise_levels(validation.measured))
    loud = [
        dataclasses.replace(v, noise=v.rms / size) for v, size in zip(found, [1, 1.5], strict=True)
    ]
    assert [v.noisy for v in loud] == [True, False]
    poor = [dataclasses.replace(v, theil=0.9) for v in loud]
    assert [(v.word, v.noisy) for v in poor] == [("not judged", True), ("poor", False)]
    unknown = verdicts(validation, changed(content, output_error=dataclasses.replace(fit, R=None)))
    assert np.isnan([v.residual for v in unknown]).all()


@pytest.mark.slow
def test_verdicts_are_of_the_step_that_was_chosen(content):
    fit, validation = content.results["output_error"], content.results["validation"]
    worse = [2 * y for y in validation.simulated[OUTPUT_ERROR]]

    def also(by_model, value):
        return {**by_model, CHOSEN: value}

    judged = dataclasses.replace(
        validation,
        models=(*validation.models, CHOSEN),
        simulated=also(validation.simulated, worse),
        known=also(validation.known, validation.outputs),
        rms=also(validation.rms, validation.rms[OUTPUT_ERROR]),
        biases=also(validation.biases, validation.biases[OUTPUT_ERROR]),
        theil=also(validation.theil, 2 * validation.theil[OUTPUT_ERROR]),
    )
    plain = verdicts(validation, content)
    chosen = dataclasses.replace(content, models={**content.models, CHOSEN: fit})
    found = verdicts(judged, chosen)
    assert all(own.rms > 3 * usual.rms for own, usual in zip(found, plain, strict=True))
    assert chosen.delivered == CHOSEN
    (page,) = [each for each in VALIDATION.show(judged, chosen) if each.name == "answer"]
    assert page.values["model"] == CHOSEN


@pytest.mark.slow
def test_a_constant_that_hides_an_offset_is_told_and_every_one_shown(content):
    validation, model = content.results["validation"], content.delivered
    assert not any("Fitted constants" in each for each in cautions(content))
    biases = validation.biases[model].copy()
    biases[0, 0] = 10 * np.ptp(validation.measured[0].y[:, 0])
    moved = dataclasses.replace(validation, biases={**validation.biases, model: biases})
    told = f"{validation.outputs[0]} of {validation.records[0]} ({biases[0, 0]:.2g} "
    said = [each for each in cautions(changed(content, validation=moved)) if told in each]
    assert [each.startswith("Fitted constants hide an offset") for each in said] == [True]
    loose = dataclasses.replace(moved, rms={**moved.rms, model: moved.rms[model] + biases[0, 0]})
    assert not any("Fitted constants" in x for x in cautions(changed(content, validation=loose)))
    (page,) = [each for each in VALIDATION.show(moved, content) if each.name == "verdicts"]
    assert page.values["constants"][validation.outputs[0]][0] == biases[0, 0]
    none = dataclasses.replace(validation, unbiased=validation.outputs)
    (page,) = [each for each in VALIDATION.show(none, content) if each.name == "verdicts"]
    assert (page.values["constants"], "no constant" in page.values["fitted"]) == ({}, True)


def _without(validation, output, model=None):
    """The validation as it were had nobody measured an output, or a model lacked it."""
    i, told = validation.outputs.index(output), {}
    lost = [model] if model else validation.models
    for kind in ("rms", "fit", "theil", "normalised", "whiteness"):
        each = {name: values.copy() for name, values in getattr(validation, kind).items()}
        for name in lost:
            each[name][:, i] = np.nan
        told[kind] = each
    if model:
        ys = [np.where(np.arange(y.shape[1]) == i, np.nan, y) for y in validation.simulated[model]]
        told["simulated"] = {**validation.simulated, model: tuple(ys)}
        has = tuple(name for name in validation.known[model] if name != output)
        return dataclasses.replace(validation, known={**validation.known, model: has}, **told)
    unseen = [r.mask(np.arange(r.ny)[None] == np.full((r.N, 1), i)) for r in validation.measured]
    return dataclasses.replace(validation, measured=tuple(unseen), **told)


@pytest.mark.slow
def test_what_nobody_measured_or_the_black_box_lacks_is_no_fault_of_the_model(content):
    validation = content.results["validation"]
    unseen = changed(content, validation=_without(validation, "phi"))
    assert any("Output phi of the validation records is not judged" in x for x in cautions(unseen))
    rms = {**validation.rms, OUTPUT_ERROR: 100 * validation.rms[OUTPUT_ERROR]}
    poor = {name: tuple(100 * y for y in ys) for name, ys in validation.simulated.items()}
    quiet = dataclasses.replace(validation, rms=rms, simulated=poor)
    lacking = _without(quiet, "p", BLACK_BOX)
    found = {v.output: v for v in verdicts(lacking, content)}
    assert not found["p"].structural
    told = " ".join(cautions(changed(content, validation=lacking)))
    assert "predicts the validation records better, phi" in told
    assert "nan" not in told
