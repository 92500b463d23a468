"""What a result rests on: the model file, whatever of the user's it imports, casid, libraries."""

import pytest

from casid.jobs import digests
from casid.jobs.digests import (
    equations_digest,
    source_digest,
)
from casid.structure.modelfile import load_model


def test_a_library_of_another_version_makes_other_results(monkeypatch):
    digests.source_digest.cache_clear()
    before = source_digest()
    real = digests.version
    for library in ("numpy", "scipy", "casadi"):
        with monkeypatch.context() as patch:
            patch.setattr(digests, "version", lambda n, one=library: real(n) + "x" * (n == one))
            digests.source_digest.cache_clear()
            assert source_digest() != before
    digests.source_digest.cache_clear()
    assert source_digest() == before


READS = {
    "A": "return [[self.Lp * factor()]]",
    "B": "return [[factor()]]",
    "D": "return [[factor() - 1]]",
    "delays": 'return {"lat": 0.1 * factor()}',
    "constraints": 'return [Constraint("Lp", self.Lp * factor(), -5.0, 0.0)]',
    "sensors": 'return {"p": Sensor(scale=factor())}',
    "derivatives": "return [self.Lp * x.p * factor() + u.lat]",
    "measurements": "return [x.p * factor()]",
    "reference": 'return {"p": factor() - 1.0}',
}
LINEAR = {"A": "return [[self.Lp]]", "B": "return [[1.0]]"}
NONLINEAR = {"derivatives": "return [self.Lp * x.p + u.lat]", "measurements": "return [x.p]"}


@pytest.mark.parametrize("method", READS)
def test_a_number_read_from_elsewhere_changes_the_equations_digest(method, tmp_path):
    nonlinear = method in {"derivatives", "measurements", "reference"}
    body = (NONLINEAR if nonlinear else LINEAR) | {method: READS[method]}
    lines = [
        "from pathlib import Path",
        "from casid import Constraint, Model, NonlinearModel, Sensor, parameter",
        'def factor(): return float(Path(__file__).with_name("k.txt").read_text())',
        f"class Roll({'Nonlinear' * nonlinear}Model):",
        '    states, inputs, outputs = ("p",), ("lat",), ("p",)',
        '    Lp: float = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")',
    ]
    for name, text in body.items():
        arguments = "self, x, u" if name in NONLINEAR else "self"
        lines.append(f"    def {name}({arguments}): {text}")
    (tmp_path / "roll.py").write_text("\n".join(lines), encoding="utf-8")

    def found(text):
        (tmp_path / "k.txt").write_text(text, encoding="utf-8")
        return equations_digest(load_model("roll.py:Roll", tmp_path)())

    assert found("1.0") == found("1.0") != found("1.0000001")


@pytest.mark.parametrize(
    "line",
    [
        'Lp: float = parameter(default=-2.0, lower=-factor(), upper=0.0, unit="1/s")',
        'def constraints(self): return [Constraint("slow", self.Lp, lower=-factor())]',
        'outputs = ("p",) if factor() < 4 else ("roll rate",)',
    ],
)
def test_a_bound_or_name_read_from_elsewhere_changes_the_equations_digest(line, tmp_path):
    lines = [
        "from pathlib import Path",
        "from casid import Constraint, Model, parameter",
        'def factor(): return float(Path(__file__).with_name("k.txt").read_text())',
        "class Roll(Model):",
        '    states, inputs, outputs = ("p",), ("lat",), ("p",)',
        '    Lp: float = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")',
        "    def A(self): return [[self.Lp]]",
        "    def B(self): return [[1.0]]",
        "    def C(self): return [[1.0]]",
        f"    {line}",
    ]
    (tmp_path / "roll.py").write_text("\n".join(lines), encoding="utf-8")

    def found(text):
        (tmp_path / "k.txt").write_text(text, encoding="utf-8")
        model = load_model("roll.py:Roll", tmp_path)
        return equations_digest(model(Lp=-3.0))

    assert found("3.5") == found("3.5") != found("4.5")
