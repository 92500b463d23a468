"""The commands about studies and structures: what they print, what they leave behind."""

import signal

import click.testing
import pytest
from click.testing import CliRunner
from truths.roll_study import write_study

from casid import Fit, write_csv
from casid.cli import main
from casid.structure.modelfile import load_model
from casid.structure.overview import one_3211_each
from models.short_period import ShortPeriod


def run(*arguments):
    return click.testing.CliRunner().invoke(main, ["check", *map(str, arguments)])


def test_check_prints_the_structure_of_a_model_file():
    result = run("models/short_period.py:ShortPeriod", "--fixed", "Zq")
    assert result.exit_code == 0
    for text in ("A at the guess", "Zq+41.15", "damping +0.80", "rank 6 of 6"):
        assert text in result.output


def test_check_judges_a_flight(tmp_path):
    (record,) = one_3211_each(ShortPeriod().system())
    write_csv(tmp_path / "flight.csv", record)
    result = run("models/short_period.py:ShortPeriod", "--record", tmp_path / "flight.csv")
    assert result.exit_code == 0
    assert "identifiability from flight" in result.output
    missing = run("models/six_dof.py:SixDof", "--record", tmp_path / "flight.csv")
    assert missing.exit_code == 2


GOOD = """
from casid import Model, Rows, Scalar, parameter

class Lag(Model):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=-1.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.a]]

    def B(self) -> Rows:
        return [[1]]
"""


@pytest.mark.parametrize(
    ("good", "bad", "message"),
    [
        ("[[self.a]]", "[[self.aa]]", "Lag.A uses 'aa', which Lag does not declare; did you mean"),
        ("[[self.a]]", "[[self.a], [1, 2]]", "Lag.A: row 1 has 2 entries, the others have 1"),
        ("[[self.a]]", "[[0]]\n    def B(self): return [[0]]", "state 'x' has no dynamics"),
        ('outputs = ("x",), ("u",), ("x",)', 'outputs = ("x",), ("u",), ("y",)', "'y' is no state"),
        ("    def A", "    def C(self): return [[0]]\n    def A", "output 'x' is always zero"),
        (', unit="1/s"', "", "Lag.a has no unit"),
        (
            "    def A",
            '    def delays(self): return {"v": 1}\n    def A',
            "no input is called 'v'",
        ),
        ("(default=-1.0", "(default=-1.0, lower=2, upper=1", "Lag.a: lower bound 2.0 > upper"),
        ("import Model, Rows", "import Modell, Rows", "does not import: ImportError"),
    ],
)
def test_check_tells_what_is_wrong_with_a_model_file(tmp_path, good, bad, message):
    file = tmp_path / "lag.py"
    file.write_text(GOOD.replace("    def B", "    def B0") if "def B" in bad else GOOD)
    assert good in file.read_text()
    file.write_text(file.read_text().replace(good, bad, 1))
    result = run(f"{file}:Lag")
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())


def casid(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("roll")
    return folder, casid("identify", write_study(folder))


@pytest.mark.slow
def test_a_study_ends_with_verdicts_report_and_code_zero(identified):
    folder, result = identified
    assert result.exit_code == 0, result.output
    for file in ("report.html", "fit.json", "parameters.csv", "figures/rms.svg"):
        assert (folder / "out" / file).stat().st_size > 0
    *_, table, last = result.output.partition("verdict")
    assert "Llat" not in result.output
    assert all(f"\n{output} " in last for output in ("p", "phi"))
    assert table
    assert result.output.splitlines()[-1] == f"Report: {folder / 'out' / 'report.html'}"
    shown = casid("identify", folder / "study.toml", "--parameters", "--png").output
    assert (folder / "out" / "figures" / "rms.png").stat().st_size > 0
    assert all(f"\n{name} " in shown for name in ("Yv", "Lv", "Lp", "Llat"))


@pytest.mark.slow
def test_each_stage_leaves_a_line_of_iterations_cost_and_seconds(identified):
    _, result = identified
    line = next(line for line in result.output.splitlines() if line.startswith("hinf"))
    stage, iterations, cost, seconds = line.split()
    assert (stage, int(iterations) > 0, float(cost) > 0, float(seconds) > 0) == (
        "hinf", True, True, True,
    )  # fmt: skip


@pytest.mark.slow
def test_the_saved_fit_is_the_truth_within_its_standard_errors(identified):
    folder, _ = identified
    fit = Fit.load(folder / "out" / "fit.json", model=load_model("roll.py:Roll", folder))
    truth = {"Yv": -0.12, "Lv": -0.06, "Lp": -2.2, "Llat": 10.0}
    for name, value in truth.items():  # four sigma: one false alarm in 4000 studies
        assert abs(fit[name].value - value) < 4 * fit[name].std_error


@pytest.mark.slow
def test_a_second_run_takes_what_was_kept(identified):
    folder, _ = identified
    stamp = (folder / "out/stages/output_error.json").stat().st_mtime_ns
    result = casid("identify", folder / "study.toml")
    assert result.exit_code == 0
    kept = [line.split()[0] for line in result.output.splitlines() if line.endswith("kept")]
    assert {"pbsid", "quadratic", "hinf", "output_error"} <= {*kept}
    assert (folder / "out/stages/output_error.json").stat().st_mtime_ns == stamp


def test_check_lists_the_records_and_computes_nothing(tmp_path):
    result = casid("check", write_study(tmp_path))
    assert result.exit_code == 0
    for name in ("3211", "sweep", "random"):
        assert name in result.output
    assert not (tmp_path / "out").exists()


def test_a_record_of_two_roles_is_no_flight_that_counts_twice(tmp_path):
    refined = '[records.refinement]\nfiles = ["3211.csv"]\nnoise = true\n\n[records.validation]'
    path = write_study(tmp_path, ("[records.validation]", refined))
    result = casid("check", path)
    assert result.exit_code == 0
    assert "twice" not in result.output


def test_check_tells_what_the_records_cannot_tell_of_the_structure(tmp_path):
    path = write_study(tmp_path)
    said = " ".join(casid("check", path).output.split())
    assert said.endswith("The study is in order.")
    file = tmp_path / path.read_text().split('file = "')[1].split(":")[0]
    text = file.read_text()
    idle = 'idle: Scalar = parameter(default=1.0, lower=-5.0, upper=5.0, unit="1/s")\n\n    def A('
    file.write_text(text.replace("def A(", idle, 1))
    result = casid("check", path)
    assert result.exit_code == 2
    said = " ".join(result.output.split())
    assert "no output depends on idle: fix or drop" in said
    assert said.endswith("Mend the structure first.")


def test_check_names_channels_that_are_one_column(tmp_path):
    twin = '[channels]\ncheck = ["p2"]\n[channels.columns]\np2 = "p"\n[channels.units]'
    path = write_study(tmp_path, ("[channels.units]", twin), ("noise = true\n", ""))
    result = casid("check", path)
    said = " ".join(result.output.split())
    assert "p2 and p are the same samples: one column read twice?" in said
    assert said.endswith("Mend the records first.")
    assert result.exit_code == 2


def test_check_tells_of_noise_that_no_record_gets(tmp_path):
    said = " ".join(casid("check", write_study(tmp_path, ("noise = true\n", ""))).output.split())
    assert (
        "[noise] is added to no record, and only casid design reads it: write noise = true" in said
    )
    assert "[noise]" not in casid("check", write_study(tmp_path)).output


def test_check_tells_of_tolerances_of_no_output(tmp_path):
    path = write_study(tmp_path)
    table = '[qualification.tolerances]\np = "10 % or 3 deg/s"\n'
    path.write_text(f"{path.read_text()}\n{table}")
    assert "tolerances" not in casid("check", path).output
    path.write_text(f'{path.read_text()}q = "10 % or 3 deg/s"\n')
    result = casid("check", path)
    said = " ".join(result.output.split())
    assert "[qualification.tolerances] q judges nothing: outputs are p, phi." in said
    assert result.exit_code == 0


@pytest.mark.slow
def test_bounds_prints_the_cautions_of_its_identification(tmp_path):
    prior = "[output_error.priors]\nLp = [-9.0, 0.01]\n\n[bounds.cases]\nfree = []\n\n[match]"
    result = casid("bounds", write_study(tmp_path, ("[match]", prior)))
    assert result.exit_code == 0, result.output
    assert "the records contradict the prior Lp = -9" in " ".join(result.output.split())


@pytest.mark.filterwarnings("always:.*times as far as")
@pytest.mark.parametrize("name", ["3211", "random"])
def test_check_of_records_in_units_unlike_is_not_in_order(tmp_path, name):
    path, file = write_study(tmp_path), tmp_path / f"{name}.csv"
    header, *rows = file.read_text().splitlines()
    at = [cell.split()[0] for cell in header.split(",")].index("p")
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[at] = str(float(row[at]) * 3.14159265 / 180)
    file.write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    result = casid("check", path)
    said = " ".join(result.output.split())
    assert result.exit_code == 2
    assert said.count("or 'p' declared deg/s and in rad/s?") == 1
    assert said.endswith("Mend the records first.")


def slowed(path, every=5):
    """The study, its records logged ``every`` times faster than their sensors measure."""
    path.write_text(path.read_text().replace("noise = true", ""))
    for name in ("3211", "sweep", "random"):
        file = path.parent / f"{name}.csv"
        header, *rows = file.read_text().splitlines()
        inputs = len([cell for cell in header.split(",") if cell.split()[0] in ("t", "lat")])
        cells = [row.split(",") for row in rows]
        held = [row[:inputs] + cells[k // every * every][inputs:] for k, row in enumerate(cells)]
        file.write_text("\n".join([header, *map(",".join, held)]) + "\n")
    return path


HELD = "p, phi repeat samples of a source slower than the logger"


@pytest.mark.filterwarnings("always:.* repeat samples")
def test_check_of_records_with_repeated_outputs_is_not_in_order(tmp_path):
    path = slowed(write_study(tmp_path))
    said = " ".join(casid("check", path).output.split())
    assert said.count(HELD) == 1
    assert said.endswith("Mend the records first.")
    moved = path.read_text().replace(
        "[channels.units]", "[channels]\nshift = { phi = -0.01 }\n[channels.units]"
    )
    path.write_text(moved)
    assert " ".join(casid("check", path).output.split()).count(HELD) == 1
    path.write_text(moved.replace("shift =", 'repeats = "mask"\nshift ='))
    assert HELD not in " ".join(casid("check", path).output.split())


@pytest.mark.slow
@pytest.mark.filterwarnings("always:.* repeat samples")
def test_a_study_tells_of_repeated_outputs_as_it_reads_and_in_its_report(tmp_path):
    path = slowed(write_study(tmp_path))
    result = casid("identify", path)
    assert result.exit_code == 0, result.output
    assert " ".join(result.output.split()).count(HELD) == 2  # at once, and among the cautions
    assert (tmp_path / "out" / "report.html").read_text().count(HELD) == 1


def test_check_tells_that_losses_leave_no_frequency_response(tmp_path):
    path = write_study(tmp_path)
    sweeps = '[records.frequency]\nfiles = ["sweep.csv"]'
    path.write_text(f"{path.read_text()}\n{sweeps}\n[frequency]\nomega = [7, 8, 9]\nwindows = [8]")
    assert " ".join(casid("check", path).output.split()).endswith("The study is in order.")
    file = tmp_path / "sweep.csv"
    header, *rows = file.read_text().splitlines()
    # A second lost of every two: a window lacks samples for longer than a period of 0.9 s.
    for k, row in enumerate(rows):
        if float(row.split(",")[0]) % 2 > 1:
            rows[k] = row.rsplit(",", 2)[0] + ",,"
    file.write_text("\n".join([header, *rows]) + "\n")
    said = " ".join(casid("check", path).output.split())
    assert "No frequency response can be estimated: missing samples (NaN) in 'p' leave" in said
    assert said.endswith("Mend the records first.")


def copied(folder):
    """The study with a copy of a record of the identification among those of the validation."""
    path = write_study(folder, ('["random.csv"]', '["random.csv", "copy.csv"]'))
    (folder / "copy.csv").write_bytes((folder / "sweep.csv").read_bytes())
    return path


def test_check_tells_of_a_copy_before_anything_is_computed(tmp_path):
    result = casid("check", copied(tmp_path))
    said = " ".join(result.output.split())
    assert result.exit_code == 2
    assert "Record copy is for validation, but an estimation has seen it (as sweep)" in said
    assert "in order" not in said


@pytest.mark.slow
def test_what_is_judged_on_a_copy_is_not_headed_unseen(tmp_path):
    path = copied(tmp_path)
    for _ in range(2):  # computed, and as it was written
        said = " ".join(casid("identify", path).output.split())
        assert "On validation records (an estimation has seen copy)" in said
        assert "On unseen records" not in said
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    told = "estimations had seen (copy) and on records that no estimation had seen"
    assert f"judged on records that {told}, as far as casid recognises copies (random)" in page


@pytest.mark.slow
def test_an_interrupted_study_says_that_the_same_command_goes_on(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("casid.matching.match.Match.fit", interrupted)
    before = signal.getsignal(signal.SIGINT)
    result = casid("identify", write_study(tmp_path))
    assert signal.getsignal(signal.SIGINT) is before  # of the process that called the command
    assert result.exit_code == 130
    assert "the same command goes on" in result.stderr
    assert (tmp_path / "out/stages/pbsid.json").exists()


@pytest.mark.slow
def test_parameters_csv_has_a_row_for_each_parameter(identified):
    folder, _ = identified
    header, *rows = (folder / "out" / "parameters.csv").read_text().splitlines()
    assert header.startswith("name,value,guess,lower,upper,active,multiplier,std_error")
    assert [row.split(",")[0] for row in rows] == ["Yv", "Lv", "Lp", "Llat"]
