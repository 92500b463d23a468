"""Records as a study has them: units, trim, noise."""

import numpy as np
import pytest
from truths.roll_study import TRIM, write_study

from casid import read_study
from casid.studies.study import read_flights, read_records


def test_sticks_in_percent_become_fractions_and_trim_is_removed(tmp_path):
    records = read_records(read_study(write_study(tmp_path)))
    steps = records["identification"][0]
    assert np.max(np.abs(steps.u)) == pytest.approx(0.05)  # of the truth, in fractions of travel
    assert steps.trim["lat"] == pytest.approx(TRIM["lat"])


def test_validation_takes_the_trim_of_the_identification_records(tmp_path):
    records = read_records(read_study(write_study(tmp_path)))
    means = np.mean([record.trim["phi"] for record in records["identification"]])
    assert records["validation"][0].trim["phi"] == means
    # At least 50 quiet samples a record with noise of 0.002: the mean is good to 0.0002.
    assert means == pytest.approx(TRIM["phi"], abs=0.001)


def test_noise_comes_from_the_seed_and_goes_to_the_roles_that_ask_for_it(tmp_path):
    quiet = ("noise = true", "noise = false")
    first = read_records(read_study(write_study(tmp_path)))
    again = read_records(read_study(write_study(tmp_path)))
    other = read_records(read_study(write_study(tmp_path, ("seed = 1", "seed = 2"))))
    clean = read_records(read_study(write_study(tmp_path, quiet)))
    y, y_again, y_other, y_clean = (
        run["identification"][0].y for run in (first, again, other, clean)
    )
    np.testing.assert_array_equal(y, y_again)
    assert not np.array_equal(y, y_other)
    # 750 samples: the standard deviation of 0.002 is estimated to 2.6 %, four sigma 10 %.
    np.testing.assert_allclose(np.std(y - y_clean, axis=0), 0.002, rtol=0.1)
    totals = [
        record.y + np.array([record.trim[name] for name in record.outputs])
        for record in (first["validation"][0], clean["validation"][0])
    ]
    np.testing.assert_allclose(*totals, atol=1e-12)


def test_a_record_in_two_roles_is_the_same_flight_in_both(tmp_path):
    both = "[records.refinement]\nfiles = ['3211.csv']\nnoise = true\n\n[records.validation]"
    study = read_study(write_study(tmp_path, ("[records.validation]", both)))
    records = read_records(study)
    np.testing.assert_array_equal(records["identification"][0].y, records["refinement"][0].y)


def test_results_that_the_pattern_of_the_flights_would_take_are_refused_at_once(tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside/flight.csv").touch()
    files = ('["random.csv"]', '["random.csv", "out*/*.csv"]')
    study = read_study(write_study(tmp_path, files))
    study.spare("report.html")
    with pytest.raises(ValueError, match=r"parameters.csv, .* would be read as a flight by .*out"):
        study.spare("report.html", "parameters.csv")


def test_what_records_cannot_give_a_stage_is_refused_as_they_are_read(tmp_path):
    # Any command reads them, `casid check` among these; of one manoeuvre none can be left out.
    three = ('"sweep.csv"]', '"sweep.csv", "random.csv"]')
    table = "[choice]\n[records.refinement]\nfiles = ['3211.csv']\n[records.validation]"
    study = read_study(write_study(tmp_path, three, ("[records.validation]", table)))
    with pytest.raises(ValueError, match=r"study.toml: \[choice\] leaves .*there are fewer; fly"):
        read_records(study)


def test_what_is_in_no_estimate_may_rest_and_what_is_may_not(tmp_path):
    checked = '[channels]\ncheck = ["psi"]\n[channels.units]'
    path = write_study(tmp_path, ("[channels.units]", checked), ("noise = true", "noise = false"))
    for file in tmp_path.glob("*.csv"):
        head, *rows = file.read_text(encoding="utf-8").splitlines()
        own = [f"{head},psi", *(f"{row},1.5" for row in rows)]
        file.write_text("\n".join(own) + "\n", encoding="utf-8")
    assert read_records(read_study(path))["identification"][0].outputs == ("p", "phi")
    text = path.read_text(encoding="utf-8")
    text = text.replace(checked, "[channels]\ncolumns = { phi = 'psi' }\n[channels.units]")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="output 'phi' is constant"):
        read_records(read_study(path))


@pytest.mark.filterwarnings("ignore:.*an input moves 0.00")  # as short as all of it is
def test_time_counted_at_too_small_an_interval_is_to_be_corrected_there(tmp_path):
    path = write_study(tmp_path, ("[channels.units]", "[channels]\ndt = 4e-5\n\n[channels.units]"))
    for file in tmp_path.glob("*.csv"):
        rows = [row.partition(",")[2] for row in file.read_text().splitlines()]
        file.write_text("\n".join(rows) + "\n")
    with pytest.raises(ValueError, match=r"time advances 4e-05 s a sample.*; correct dt, in sec"):
        read_flights(read_study(path))
