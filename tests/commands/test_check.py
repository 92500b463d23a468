"""The command that prints a structure laid open."""

import click.testing
import pytest

from casid import write_csv
from casid.cli import main
from casid.structure.overview import excitation
from models.short_period import ShortPeriod


def run(*arguments):
    return click.testing.CliRunner().invoke(main, ["check", *map(str, arguments)])


def test_check_prints_the_structure_of_a_model_file():
    result = run("models/short_period.py:ShortPeriod", "--fixed", "Zq")
    assert result.exit_code == 0
    for text in ("A at the guess", "Zq+41.15", "damping +0.80", "rank 6 of 6"):
        assert text in result.output


def test_check_judges_a_flight(tmp_path):
    (record,) = excitation(ShortPeriod().system())
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
            "names 'v', which is no in",
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
