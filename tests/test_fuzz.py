"""Damaged files, studies, models and results: a value or a ValueError, never anything else."""

import json
import logging
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from truths import fuzzing
from truths.fuzzing import altered, damaged
from truths.roll_study import write_study

from casid import FrequencyResponse, limits, match
from casid.studies.study import read_records
from casid.studies.studyfile import read_study
from casid.values import encode

SLOW = 600.0  # s, of the long run

JOBS = {  # name: (what reads it, kind of input, examples in CI)
    "csv": (fuzzing.check_csv, "csv", 200),
    "mat": (fuzzing.check_mat, "mat", 200),
    "mat compressed": (fuzzing.check_mat, "mat compressed", 100),
    "mat 4": (fuzzing.check_mat, "mat 4", 100),
    "mat 7.3": (fuzzing.check_mat, "mat 7.3", 150),
    "response": (fuzzing.check_response, "response", 100),
    "study": (fuzzing.check_study, "study", 150),
    "model": (fuzzing.check_model, "model", 200),
    "json": (fuzzing.check_json, None, 100),
    "fit": (fuzzing.check_fit, None, 100),
    "stage": (fuzzing.check_stage, None, 100),
    "parquet": (fuzzing.check_parquet, "parquet", 100),
    "table": (fuzzing.check_table, "csv", 100),
    "convert fit": (fuzzing.check_convert, None, 50),
    "simulate": (fuzzing.check_simulate, None, 50),
    "convert response": (fuzzing.check_convert, None, 50),
    "convert stage": (fuzzing.check_convert, None, 50),
}


def saved(fit, path):
    fit.save(path)
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def strategies(tmp_path_factory):
    """What every job is fed with; results to damage come from a study that is run."""
    study = read_study(write_study(tmp_path_factory.mktemp("results")))
    black_box = study.settings["pbsid"].fit(read_records(study)["identification"])
    fit = saved(match(study.model, black_box, norm="quadratic"), study.path.with_name("fit.json"))
    rest = {"key": "k", "reason": "", "seconds": 1.0, "warnings": encode(()), "source": ""}
    stage = {"casid": "result", **rest, "result": encode(black_box)}
    measured = FrequencyResponse(
        omega=np.array([1.0, 2.0]), G=np.ones((2, 2, 1)), coherence=np.ones((2, 2, 1)),
        random_error=np.zeros((2, 2, 1)), inputs=("lat",), outputs=("p", "phi"),
        input_std=np.ones(1), output_std=np.ones(2),
    )  # fmt: skip
    response = saved(measured, study.path.with_name("response.json"))
    fuzzing.SOUND["json"] = json.dumps(fit["parameters"]["tuple"][0]).encode()
    made = {name: damaged(kind) for name, (_, kind, _) in JOBS.items() if kind}
    return made | {
        "json": damaged("json") | st.binary(max_size=50),
        "fit": altered(fit),
        "stage": altered(stage) | fuzzing.trees,
        "convert fit": altered(fit),
        "simulate": altered(fit),
        "convert response": altered(response),
        "convert stage": altered({"casid": "result", **rest, "result": encode(measured)}),
    }


@pytest.fixture(autouse=True)
def _short_patience(monkeypatch):
    monkeypatch.setattr(limits, "USER_SECONDS", 0.5)


def run(check, strategy, examples, number):
    """So many examples of a property, the same for the same number."""
    quiet = settings(
        max_examples=examples, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck), derandomize=False,
    )  # fmt: skip
    seed(number)(quiet(given(strategy)(check)))()


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
@pytest.mark.filterwarnings("ignore")
def test_whatever_is_damaged_is_read_or_refused(name, strategies):
    check, _, examples = JOBS[name]
    run(check, strategies[name], examples, 0)


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["csv", "mat", "mat 4", "mat 7.3", "response"])
def test_a_minute_of_atheris_finds_nothing_in_a_reader(kind, tmp_path):
    pytest.importorskip("atheris")
    harness = Path(__file__).with_name("atheris_readers.py")
    run = [sys.executable, harness, kind, "-max_total_time=60", f"-artifact_prefix={tmp_path}/"]
    done = subprocess.run(run, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.campaign
@pytest.mark.filterwarnings("ignore")
def test_ten_minutes_of_damage_find_nothing(strategies):
    end, number, count = time.monotonic() + SLOW, 1, dict.fromkeys(JOBS, 0)
    while time.monotonic() < end:
        for name, (check, _, _) in JOBS.items():
            run(check, strategies[name], 100, number)
            count[name] += 100
        number += 1
    logging.getLogger("casid").warning("examples: %s", count)
    assert min(count.values()) >= 100
