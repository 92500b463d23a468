"""Keeping the results of stages, going on where a study stopped."""

import importlib
import json
import logging
import os
import re
import sys
import time
import warnings
from contextlib import suppress
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from truths.closed_roll import campaign, off
from truths.roll_study import write_study

from casid import ConvergenceError, DataWarning, OutputError, output_error, read_study, run_study
from casid.stages.black_box import Pbsid
from casid.stages.choice import CHOICE, Choosing
from casid.stages.stage import Stage, run_stages
from casid.studies.keeping import Keeper, Watch
from casid.values import encode


def _kept(outcome):
    return [timing.stage for timing in outcome.timings if timing.kept]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_changed_option_computes_its_stage_and_those_after_it_again(copy):
    changed = run_study(read_study(write_study(copy, ("points = 20", "points = 21"))))
    assert _kept(changed) == ["pbsid"]
    (changed.report.parent / "written.json").unlink()
    again = run_study(read_study(write_study(copy, ("points = 20", "points = 21"))))
    assert _kept(again) == ["pbsid", "quadratic", "hinf", "output_error"]
    fresh = run_study(read_study(write_study(copy)), fresh=True)
    assert _kept(fresh) == []


@pytest.mark.slow
def test_what_is_stated_of_the_inputs_computes_again(copy):
    # Nothing else changes: that they are straight lines is taken where nothing is stated.
    place = "[records.identification]\n"
    stated = run_study(read_study(write_study(copy, (place, f'[channels]\nhold = "foh"\n{place}'))))
    assert _kept(stated) == []


@pytest.mark.slow
def test_what_a_stage_warns_of_is_in_the_report_of_a_later_run_too(tmp_path, monkeypatch):
    study = read_study(write_study(tmp_path))
    honest = Pbsid.fit

    def worried(*arguments, **options):
        warnings.warn("the controller is stiff near the pole", DataWarning, stacklevel=1)
        return honest(*arguments, **options)

    monkeypatch.setattr(Pbsid, "fit", worried)
    for _ in range(2):
        report = run_study(study).report
        assert "the controller is stiff near the pole" in report.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_changed_module_that_the_model_imports_computes_again(tmp_path, monkeypatch):
    study = write_study(tmp_path)
    model = (tmp_path / "roll.py").read_text(encoding="utf-8")
    model = model.replace("from casid", "from damping_of_roll import damping\nfrom casid")
    model = model.replace("self.Lp, 0]", "damping(self.Lp), 0]")
    (tmp_path / "roll.py").write_text(model, encoding="utf-8")
    helper = tmp_path / "damping_of_roll.py"
    helper.write_text("def damping(Lp):\n    return Lp\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    run_study(read_study(study))
    assert "report" in _kept(run_study(read_study(study)))
    helper.write_text("def damping(Lp):\n    return 1.25 * Lp\n", encoding="utf-8")
    sys.modules.pop("damping_of_roll")
    importlib.invalidate_caches()
    assert _kept(run_study(read_study(study))) == ["pbsid"]
    sys.modules.pop("damping_of_roll")


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_changed_data_file_that_the_model_reads_computes_again(tmp_path):
    study = write_study(tmp_path)
    model = (tmp_path / "roll.py").read_text(encoding="utf-8")
    model = model.replace("from casid", "from pathlib import Path\n\nfrom casid", 1)
    read = 'float(Path(__file__).with_name("inertia.txt").read_text())'
    model = model.replace("[self.Llat]", f"[self.Llat / {read}]")
    (tmp_path / "roll.py").write_text(model, encoding="utf-8")
    (tmp_path / "inertia.txt").write_text("1.0", encoding="utf-8")
    before = run_study(read_study(study)).identification.results["output_error"]["Llat"].value
    assert "report" in _kept(run_study(read_study(study)))
    (tmp_path / "inertia.txt").write_text("1.25", encoding="utf-8")
    after = run_study(read_study(study))
    assert _kept(after) == ["pbsid"]
    found = after.identification.results["output_error"]["Llat"].value
    assert found == pytest.approx(1.25 * before, rel=1e-3)


def _first(*_):
    logging.getLogger("casid").info("first")
    return [os.getpid()]


def _second(*_):
    logging.getLogger("casid").info("second")
    warnings.warn("the second has doubts", DataWarning, stacklevel=1)
    return [os.getpid()]


def _failing(*_):
    raise ConvergenceError("the second stops early")


def _interrupted(*_):
    raise KeyboardInterrupt


def _slow(*_):
    time.sleep(600)


def _third(_, task):
    return [*task.results["first"], *task.results["second"]]


class Lines(Watch):
    def __init__(self):
        self.said = []

    def begin(self, stage):
        self.said.append(f"{stage} begins")

    def end(self, timing):
        self.said.append(f"{timing.stage} ends")


def _run(tmp_path, *stages, **options):
    study = read_study(write_study(tmp_path))
    keeper = Keeper(study, watch := Lines(), [], fresh=False, command="", **options)
    task = study.task({}, {})
    with keeper.processes:
        return run_stages(replace(task, stages=stages), keep=keeper, begin=keeper.begin), watch


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("processors", [1, 2])
def test_what_ran_ahead_is_told_in_its_turn(tmp_path, monkeypatch, caplog, kept, processors):
    monkeypatch.setattr("casid.studies.keeping.cores", lambda: processors)
    caplog.set_level(logging.INFO, logger="casid")
    stages = (
        Stage(name="first", does="", run=_first, kept=False),
        Stage(name="second", does="", run=_second, kept=kept, ahead=True),
        Stage(name="third", does="", run=_third, needs=("first", "second"), kept=False, ahead=True),
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found, watch = _run(tmp_path, *stages)
    here, there = found.results["third"]
    assert here == os.getpid()
    assert (there != here) == (processors > 1 and len(os.sched_getaffinity(0)) > 1)
    assert watch.said == [f"{n} {v}" for n in found.results for v in ("begins", "ends")]
    assert caplog.messages == ["first", "second"]
    assert [str(each.message) for each in caught] == ["the second has doubts"] * (not kept)
    if kept:  # so is its result, and nothing begins again
        monkeypatch.setattr("casid.studies.keeping.beside", None)
        assert _run(tmp_path, *stages)[0].results["second"] == [there]
        assert caplog.messages == ["first", "second", "first"]


@pytest.mark.filterwarnings("ignore:the second has doubts:casid.DataWarning")
@pytest.mark.parametrize("kept", [True, False])
def test_what_any_stage_warns_of_is_for_the_report(tmp_path, kept):
    study = read_study(write_study(tmp_path))
    keeper = Keeper(study, Lines(), [], fresh=False, command="")
    keeper(Stage(name="second", does="", run=_second, kept=kept), None, study.task({}, {}))
    assert keeper.warnings == ["the second has doubts"]


def _others(*_):
    for said in ("case 'a': the second has doubts", "case 'a': off by 3 of 4", "new by 2"):
        warnings.warn(said, DataWarning, stacklevel=1)


def test_what_a_study_has_told_its_comparison_does_not_tell_again(tmp_path):
    study = read_study(write_study(tmp_path))
    keeper = Keeper(study, Lines(), [], fresh=False, command="bounds")
    keeper.warnings = ["the second has doubts", "off by 7 of 9"]
    keeper(Stage(name="x", does="", run=_others, command="bounds"), None, study.task({}, {}))
    assert keeper.warnings[2:] == ["new by 2"]


@cache
def _made():
    records = tuple(each.decimate(2) for each in campaign(1, 3))
    return records, output_error(off(share=0.1), records[0], interval=2.0)


def _choose(folder, monkeypatch, *, at=None, fresh=False):
    """Fits made by a choice, which is interrupted in one of them if so said, and its result."""
    study = replace(read_study(write_study(folder)), model=off(share=0.1))
    (records, made), fits = _made(), []
    task = replace(
        study.task({"identification": records}, {}),
        records=records, results={"quadratic": SimpleNamespace(model=study.model)},
    )  # fmt: skip

    def fit(_, model, data, **__):
        fits.append(data)
        if len(fits) == at:
            raise KeyboardInterrupt
        Lp = model.Lp * (1 + 0.01 * sum(float(np.std(each.y)) for each in data))
        return replace(made, model=replace(model, Lp=Lp))

    keeper = Keeper(study, Lines(), [], fresh=fresh, command="")
    with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
        patch.setattr(OutputError, "fit", fit)
        found = keeper(CHOICE, Choosing(candidates=("time",)), task)
        return len(fits), re.sub(r'"seconds": [^,]*,', "", json.dumps(encode(found)))
    return len(fits), None


@pytest.mark.second
def test_an_interrupted_choice_goes_on_with_the_fits_it_has(tmp_path, monkeypatch):
    whole, here = tmp_path / "whole", tmp_path / "here"
    whole.mkdir()
    here.mkdir()
    count, expected = _choose(whole, monkeypatch)
    assert count == 4  # of all, and without each of three
    assert _choose(here, monkeypatch, at=3) == (3, None)
    assert _choose(here, monkeypatch) == (2, expected)
    assert _choose(here, monkeypatch)[0] == 0
    (here / "out/stages/choice.json").unlink()
    assert _choose(here, monkeypatch, at=2, fresh=True) == (2, None)
    assert _choose(here, monkeypatch) == (3, expected)


def test_fits_of_a_stage_of_an_outsider_rest_on_its_own_code_and_are_not_kept(tmp_path):
    folders = []
    stage = Stage(name="own", does="", run=lambda _, task: folders.append(task.execution.folder))
    _run(tmp_path, stage)
    assert folders == [None]


@pytest.mark.parametrize("part", ["source_digest", "structure_digest", "equations_digest"])
def test_a_result_rests_on_code_libraries_model_file_and_equations(
    tmp_path, monkeypatch, caplog, part
):
    caplog.set_level(logging.INFO, logger="casid")
    for digest in ("one", "one", "another", "another", "one"):
        monkeypatch.setattr(f"casid.studies.keeping.{part}", lambda *_, now=digest: now)
        _run(tmp_path, Stage(name="first", does="", run=_first, structured=True))
    assert caplog.messages == ["first"] * 3


def test_what_fails_ahead_fails_in_its_turn_without_a_word_before(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr("casid.studies.keeping.cores", lambda: 2)
    first = Stage(name="first", does="", run=_first)
    with pytest.raises(ConvergenceError, match="the second stops early"):
        _run(tmp_path, first, Stage(name="second", does="", run=_failing, ahead=True))
    assert (tmp_path / "out" / "stages" / "first.json").exists()
    assert capfd.readouterr().err == ""


def test_nobody_waits_for_what_runs_ahead_of_an_interrupted_stage(tmp_path, monkeypatch):
    monkeypatch.setattr("casid.studies.keeping.cores", lambda: 2)
    first = Stage(name="first", does="", run=_interrupted)
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path, first, Stage(name="second", does="", run=_slow, ahead=True))
    assert time.monotonic() < begin + 300
