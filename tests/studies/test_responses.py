"""Measured responses in a study's refinement, against the likelihood of it in Python."""

import shutil

import numpy as np
import pytest
from truths.roll_study import Truth, write_study

from casid import FrequencyResponse, OutputError, read_records, read_study, run_study
from casid.exchange.formats import write_frequency
from casid.shooting.measured_responses import MeasuredResponses
from casid.textfile import write_json
from casid.values import content_digest

SPLIT = (
    "[records.validation]",
    "[records.refinement]\nfiles = ['3211.csv']\nnoise = true\n\n"
    "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n[records.validation]",
)
GRID = "[frequency]\nomega = {from = 2.2, to = 6, points = 8}\n\n"


def asked(value, before=GRID):
    return ("[match]", f"{before}[output_error]\nresponses = {value}\n\n[match]")


@pytest.mark.slow
def test_the_response_of_other_flights_counts_beside_time_histories(tmp_path):
    study = read_study(write_study(tmp_path, SPLIT, asked('"frequency"')))
    found = run_study(study).identification
    records = read_records(study)
    measured = study.settings["frequency"].fit(records["frequency"])
    own = OutputError(responses=(measured,)).fit(found.hinf.model, records["refinement"])
    alone = OutputError().fit(found.hinf.model, records["refinement"])
    fit = found.output_error
    np.testing.assert_allclose(fit.model.vector(), own.model.vector(), rtol=1e-6)
    std, less = (np.array([p.std_error for p in f.parameters]) for f in (fit, alone))
    assert (std < less).all()  # the sweep tells more
    z = (fit.model.vector() - Truth().vector()) / std
    assert np.abs(z).max() < 4
    page = (study.output / "report.html").read_text(encoding="utf-8")
    assert "output_error.responses" in page
    assert all(timing.kept for timing in run_study(study).timings if timing.stage == "output_error")
    # a kept stage, a saved response and a table say the same
    other = tmp_path / "other"
    other.mkdir()
    shutil.copy(study.output / "stages/frequency.json", other / "kept.json")
    measured.save(other / "saved.json")
    write_frequency(other / "table.csv", measured)
    for name in ("kept.json", "saved.json", "table.csv"):
        again = read_study(write_study(other, SPLIT, asked(f'["{name}"]')))
        (read,) = again.settings["output_error"].responses
        np.testing.assert_allclose(read.G, measured.G, rtol=1e-9)
        np.testing.assert_allclose(read.error, measured.error, rtol=1e-9)
        free = again.settings["output_error"].free(again.model)
        assert isinstance(free.evidence, MeasuredResponses)


def test_a_copy_of_a_flight_is_refused_before_any_stage(tmp_path):
    path = write_study(
        tmp_path, (SPLIT[0], SPLIT[1].replace("sweep", "copy")), asked('"frequency"')
    )
    shutil.copy(tmp_path / "3211.csv", tmp_path / "copy.csv")
    path.write_text(path.read_text().replace("noise = true", "noise = false"))
    with pytest.raises(
        ValueError, match=r"\[output_error\] record '3211' enters as a time history"
    ):
        run_study(read_study(path))
    assert not (tmp_path / "out/stages").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([asked('"frequency"', "")], r"needs records: write \[records.frequency\]"),
        (
            [(SPLIT[0], SPLIT[1].replace("3211", "sweep")), asked('"frequency"')],
            r"'sweep' would count twice, as a time history of \[records.refinement\]",
        ),
        (
            [
                ("[records.validation]", SPLIT[1][SPLIT[1].index("[records.freq") :]),
                asked('"frequency"'),
            ],
            r"'sweep' would count twice, as a time history of \[records.identification\]",
        ),
        ([SPLIT, asked('"frequency"', f"{GRID}[choice]\n\n")], r"does not go with \[choice\]"),
        ([asked('["none.json"]', "")], r"there is no file .*none.json"),
        ([asked('["3211.csv"]', "")], "no column omega, p_lat_dB"),
        ([asked('["roll.py"]', "")], "names of .json or .csv files"),
        ([asked("3", "")], "responses = 3, expected list or str"),
    ],
)
def test_what_cannot_count_is_refused_when_the_study_is_read(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        read_study(write_study(tmp_path, *changes))


def test_a_table_that_lacks_a_column_is_told_which(tmp_path):
    kinds = ("dB", "deg", "coherence", "error")
    columns = ["Hz", *(f"phi_lat_{kind}" for kind in kinds)]
    (tmp_path / "own.csv").write_text(",".join(columns) + "\n" + "1.0,1.0,1.0,1.0,1.0\n" * 3)
    told = (
        r"own.csv has no column omega \(omega is in rad/s\), .* it has Hz, phi_lat_dB, phi_lat_deg"
    )
    with pytest.raises(ValueError, match=told):
        read_study(write_study(tmp_path, asked('["own.csv"]', "")))


def test_responses_of_other_channels_and_no_responses_are_refused(tmp_path):
    alien = FrequencyResponse(
        omega=[1.0], G=[[[1.0]]], coherence=[[[0.9]]], random_error=[[[0.1]]], inputs=("ped",),
        outputs=("r",), input_std=[1.0], output_std=[1.0],
    )  # fmt: skip
    alien.save(tmp_path / "alien.json")
    with pytest.raises(ValueError, match=r"\[output_error\].*alien|no pair of r and ped|states no"):
        read_study(write_study(tmp_path, asked('["alien.json"]', "")))
    other = {"casid": "result", "result": {"tuple": []}}
    write_json(tmp_path / "alien.json", other | {"digest": content_digest(other)})
    with pytest.raises(ValueError, match="no frequency response; a study leaves that"):
        read_study(write_study(tmp_path, asked('["alien.json"]', "")))
