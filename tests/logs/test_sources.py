from pathlib import Path

import numpy as np
import pytest

from casid.logs.sources import bare, moves, moving, source_of, with_unit
from casid.logs.topics import Log, Topic

T = np.arange(10.0)


def log(columns, units=None):
    topic = Topic(name="g", t=T, columns=columns, units=units or {})
    return Log(path=Path("x"), kind="TDMS", topics={"g": topic})


@pytest.mark.parametrize(
    ("column", "name", "unit"),
    [("p [deg/s]", "p", "deg/s"), ("p(rad/s)", "p", "rad/s"), ("q[0]", "q[0]", ""),
     ("q (filtered)", "q (filtered)", ""), ("r", "r", ""), ("Lat [%]", "Lat", "%"),
     ("q[1]", "q[1]", "")],
)  # fmt: skip
def test_a_unit_behind_a_name_is_told_from_an_index(column, name, unit):
    assert with_unit(column) == (name, unit)
    assert bare(column) == name.lower()


def test_a_unit_in_the_name_counts_where_none_is_stated():
    found = log({"p [deg/s]": T, "q [deg/s]": T}, {"p [deg/s]": "", "q [deg/s]": "rad/s"})
    p, q = (source_of(found, f"g.{name} [deg/s]") for name in "pq")
    np.testing.assert_allclose(p.values, np.radians(T))
    assert (p.unit, q.unit) == ("deg/s", "rad/s")
    np.testing.assert_array_equal(q.values, T)
    np.testing.assert_allclose(source_of(found, "-g.p [deg/s]").values, -np.radians(T))


def test_what_measures_nothing_or_rests_is_passed_over():
    found = log({"a": T, "b": 0 * T, "c": np.where(T < 6, np.nan, T), "d": 1e7 + T})
    assert [each.place for each in moving(found, lambda _, column: column != "x")] == ["g.a"]
    assert source_of(found, "g.c") is None
    assert source_of(found, "g.d") is None
    assert not moves(source_of(found, "g.b"))
