"""Values that show themselves: short, true, and without loading what draws."""

import io
import subprocess
import sys

import numpy as np
import pytest
from truths.shown import record, values

from casid import CampaignProgress, Progress, ProgressLine
from casid.display import counted, digits_beside_one, in_a_row, instant, listed, percent_above


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


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.12345, "0.12"), (1.0, "1"), (1.004, "1.004"), (1.2, "1.2"), (np.inf, "inf")],
)
def test_a_number_beside_one_shows_its_side(value, text):
    assert f"{value:.{digits_beside_one(value, 2)}g}" == text


def test_nouns_follow_their_numbers():
    assert [counted(n, "gap") for n in (0, 1, 2)] == ["0 gaps", "1 gap", "2 gaps"]
    assert counted(2, "axis", "axes") == "2 axes"


@pytest.mark.parametrize(
    ("t", "said"),
    [
        (0.0, "0"),
        (-0.5, "-0.5"),
        (131.4571, "131.5"),
        (20000.0, "20000"),
        (1780358573.447, "1780358573.45"),
    ],
)
def test_instants_of_a_clock_since_1970_are_told_apart_in_words(t, said):
    assert instant(t) == said
    assert in_a_row([(t, t, 5)]) == f"; in a row 5 from {said} to {said} s"


def test_a_logarithm_and_its_error_are_percents_of_a_ratio():
    # Twice as large; 1 % more of the logarithm is 2 % more of the ratio.
    assert percent_above(np.log(2), 0.01) == pytest.approx((100.0, 2.0))
    draws = 100 * np.expm1(np.random.default_rng(0).normal(0.5, 0.02, 100000))
    assert percent_above(0.5, 0.02) == pytest.approx((draws.mean(), draws.std()), rel=0.01)


def test_progress_is_a_line_of_iterations_and_lines_of_what_has_ended():
    out = io.StringIO()
    line = ProgressLine(out)
    line(Progress(stage="match", iteration=0, cost=float("nan"), seconds=0.0))
    line(Progress(stage="match", iteration=7, cost=0.25, seconds=1.5))
    line(
        CampaignProgress(name="free", done=1, total=2, failed=0, seconds=1, elapsed=1, remaining=1)
    )
    line("the end")
    _, *passing, ended, last = out.getvalue().split("\r")
    assert passing == ["match: ...", "match: iteration 7, cost 0.25, 1.5 s"]
    assert ended.startswith("1 of 2: free in 1.0 s")
    assert len(ended.rstrip("\n")) >= len(passing[1])  # nothing of the iterations is left
    assert last == "the end\n"
