"""What a check says of settings that do nothing, or that no record is long enough for."""

from click.testing import CliRunner
from truths.roll_study import write_study

from casid.cli import main
from casid.studies.study import read_flights
from casid.studies.studyfile import read_study


def checked(tmp_path, table):
    path = write_study(tmp_path)
    path.write_text(f"{path.read_text()}\n{table}\n")
    result = CliRunner().invoke(main, ["check", str(path)])
    return " ".join(result.output.split()), result.exit_code


def longest(tmp_path, role):
    return max(r.duration for r in read_flights(read_study(write_study(tmp_path)))[0][role])


def test_check_tells_of_intervals_longer_than_any_record(tmp_path):
    said, code = checked(tmp_path, "[output_error]\ninterval = 1e9")
    length = longest(tmp_path, "identification")
    assert f"interval = 1e+09 s is longer than any record ({length:g} s at most)" in said
    assert said.endswith("The study is in order.")
    assert code == 0
    assert "interval = " not in checked(tmp_path, "[output_error]\ninterval = 2.0")[0]


def test_check_refuses_horizons_that_leave_no_past(tmp_path):
    length = longest(tmp_path, "validation")
    for horizon in (1e9, 0.5 * length, 1e-6):
        said, code = checked(tmp_path, f"[validation]\nhorizon = {horizon}")
        assert f"less than {length / 3:.3g} s for record" in said
        assert said.endswith("Mend the horizon first.")
        assert code == 2
    for horizon in ("inf", 0.3 * length):
        said, code = checked(tmp_path, f"[validation]\nhorizon = {horizon}")
        assert "horizon" not in said
        assert code == 0
