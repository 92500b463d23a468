"""Classes found by file and name, and what is said where there is none."""

import pytest

from casid import Model, ModelError
from casid.structure.modelfile import load_model

GOOD = """
from casid import Model, parameter
class Lag(Model):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = 1.0
    def A(self): return [[-self.a]]
    def B(self): return [[1.0]]
"""


def test_two_files_of_one_stem_are_two_classes(tmp_path):
    for name, value in (("one", "1.0"), ("two", "2.0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "lag.py").write_text(GOOD.replace("a = 1.0", f"a = {value}"))
    one, two = (load_model(f"{name}/lag.py:Lag", tmp_path) for name in ("one", "two"))
    assert issubclass(one, Model)
    assert (one.a, two.a) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("text", "reference", "message"),
    [
        (GOOD, "lag.py", 'expected "path/to/file.py:ClassName"'),
        (GOOD, "other.py:Lag", "there is no file 'other.py'"),
        (GOOD, "lag.py:Leg", "has no model class 'Leg'; it has Lag"),
        ("x = 1", "lag.py:Lag", "has no model class 'Lag'; it has none"),
        ("x = \n", "lag.py:Lag", "lag.py, line 1 does not import: SyntaxError"),
        ("\nraise KeyError('no')", "lag.py:Lag", "lag.py, line 2 does not import: KeyError: 'no'"),
        ("import sys\nsys.exit(3)", "lag.py:Lag", "line 2 does not import: SystemExit: 3"),
    ],
)
def test_a_file_without_the_structure_says_what_is_wrong(tmp_path, text, reference, message):
    (tmp_path / "lag.py").write_text(text)
    with pytest.raises(ModelError, match=message):
        load_model(reference, tmp_path)
