"""Settings from tables: by the types of the fields, what does not fit is named."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
from truths.roll_study import write_study

from casid import SolverOptions, read_study
from casid.arrays import Array
from casid.studies.settings import MOST_POINTS, read_settings
from casid.tables import Table


@dataclass(frozen=True, kw_only=True)
class Every:
    """A field of every kind."""

    count: int = 1
    size: float | None = None
    name: str = "a"
    way: Literal["near", "far"] = "near"
    sure: bool | Literal["half"] = False
    band: tuple[float, float] | None = None
    names: tuple[str, ...] = ()
    weight: Array | Literal["relative"] | Sequence[Array] | None = None
    omega: Array | None = None
    more: Mapping[str, float] = field(default_factory=dict)
    solver: SolverOptions = SolverOptions()  # noqa: RUF009 - frozen


def read(**content):
    return read_settings(Table(content, "study.toml [every]:"), Every())


def test_each_key_becomes_its_field_and_the_rest_keep_their_defaults():
    found = read(count=3, size=2, way="far", sure="half", band=[1, 2.5], names=["p", "q"])
    assert (found.count, found.size, found.way, found.sure) == (3, 2, "far", "half")
    assert (found.band, found.names, found.name) == ((1, 2.5), ("p", "q"), "a")
    assert read(solver={"tolerance": 1e-6}).solver == SolverOptions(tolerance=1e-6)
    assert read(weight="relative").weight == "relative"
    np.testing.assert_array_equal(read(weight=[[1, 2], [3, 4]]).weight, [[1.0, 2.0], [3.0, 4.0]])


def test_a_grid_is_a_list_or_spaced_logarithmically():
    np.testing.assert_array_equal(read(omega=[1, 2.5]).omega, [1, 2.5])
    grid = read(omega={"from": 0.5, "to": 8, "points": 5}).omega
    np.testing.assert_allclose(grid, [0.5, 1, 2, 4, 8])


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ({"cuont": 3}, r"unknown key 'cuont'; did you mean 'count'\? Known are count, size"),
        ({"count": 3.5}, "count = 3.5, expected a whole number"),
        ({"count": True}, "count = True, expected a whole number"),
        ({"size": "big"}, "size = 'big', expected a number"),
        ({"way": "nearby"}, """way = 'nearby', expected "near" or "far\""""),
        ({"sure": "whole"}, """sure = 'whole', expected True or False or "half\""""),
        ({"band": [1]}, r"band = \[1\], expected \(a number, a number\)"),
        ({"band": [1, "2"]}, r"expected \(a number, a number\)"),
        ({"names": [1]}, "names = .1., expected texts"),
        ({"names": "p"}, "names = 'p', expected texts"),
        ({"more": 3}, "more = 3, expected a mapping"),
        ({"omega": []}, "expected frequencies > 0 in a list"),
        ({"omega": {"from": 5, "to": 1}}, "expected 0 < from < to"),
        ({"omega": {"from": 1, "to": 5, "points": MOST_POINTS + 1}}, "points = 10001"),
        ({"solver": {"tolerence": 1}}, r"\[solver\]: unknown key 'tolerence'; did you mean"),
        ({"solver": {"progress": 1}}, "unknown key 'progress'"),
        ({"solver": {"tolerance": -1.0}}, "tolerance = -1.0, expected at least 1e-15"),
        ({"solver": {"max_iterations": 0}}, "max_iterations = 0, expected at least 1"),
        ({"solver": {"max_seconds": float("nan")}}, "max_seconds = nan, expected"),
    ],
)
def test_what_does_not_fit_is_named_with_its_table(content, told):
    with pytest.raises(ValueError, match=told) as caught:
        read(**content)
    assert str(caught.value).startswith("study.toml [every]")


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("[bounds]\nnorm = 'hinf'\ncases = { free = {} }", "output_error has no norm"),
        ("[bounds]\ncases = { free = 3 }", "free = 3, expected a table, relations or text"),
        ("[bounds]\nestimator = 'derivid'\ncases = { free = {} }",
         r"by derivid: it needs records; write \[records.frequency\]"),
        ("[output_error]\nprocess_noise = 'yes'", "'yes', expected .*BlackBox"),
        ("[output_error]\nR = 'odd'", 'R = .odd., expected .*"diagonal" or "full"'),
    ],
)  # fmt: skip
def test_a_study_refuses_at_once_what_a_stage_would_stumble_over(table, told, tmp_path):
    with pytest.raises(ValueError, match=told):
        read_study(write_study(tmp_path, ("[match]", f"{table}\n\n[match]")))
