"""Values that show themselves: short, true, and without loading what draws."""

import subprocess
import sys

import pytest
from truths.shown import record, values

from casid.display import counted, listed


@pytest.mark.parametrize("name", list(values()))
def test_a_value_is_one_short_line(name):
    text = repr(values()[name])
    assert text.startswith(f"{name}(")
    assert "\n" not in text
    assert len(text) < 300


def test_a_line_says_what_matters():
    found = {name: repr(value) for name, value in values().items()}
    assert "39.95 s, 800 samples at 20 Hz, inputs lat, outputs p" in found["Record"]
    assert "Roll by output error: solved" in found["Fit"]
    assert "order 1, continuous" in found["BlackBox"]
    assert "held +" in found["BoundsComparison"]
    assert "missing" not in found["Record"]
    y = record().y.copy()
    y[:80] = float("nan")
    assert "10 % of the outputs missing" in repr(record().__class__(
        record().t, record().u, y, ("lat",), ("p",), "roll"))  # fmt: skip


def test_long_lists_are_cut():
    assert listed(tuple("abcdefgh")) == "a, b, c, d, e, f and 2 more"
    assert listed(("a", "b")) == "a, b"


def test_neither_a_value_nor_its_line_loads_matplotlib():
    code = (
        "import sys; from casid import Record; import numpy as np; t = np.arange(20.0)\n"
        "repr(Record(t, t[:, None], t[:, None], ('a',), ('b',)))\n"
        "print('matplotlib' in sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"


def test_nouns_follow_their_numbers():
    assert [counted(n, "gap") for n in (0, 1, 2)] == ["0 gaps", "1 gap", "2 gaps"]
    assert counted(2, "axis", "axes") == "2 axes"
