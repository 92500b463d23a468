"""The same flight is recognised by what was measured, not by its name."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import Roll

from casid import DataWarning, Record, identify
from casid.consistency.reused_flights import repeats

T = 0.02 * np.arange(1000)


def flown(seed=0, name="flight"):
    """Steps of one stick and a response to them, at rest before."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-0.05, 0.0, 0.05], 20), 50)[:, None]
    u[:100] = 0.0
    y = np.cumsum(np.hstack([u, -u]), axis=0) * 0.02 + 0.001 * rng.standard_normal((1000, 2))
    y[:100] = 0.0
    return Record(T, u, y, ("lat",), ("p", "phi"), name)


def pieces():
    """What is still the same flight."""
    record = flown()
    coarse = replace(record, u=np.round(record.u, 8), y=np.round(record.y, 8), name="b")
    later = replace(record, t=record.t + 100.0, name="b")
    trimmed = replace(record.detrend("mean"), name="b")
    cut = replace(record.between(5.0, 12.0), name="b")
    return {
        "copy": replace(record, name="b"),
        "precision": coarse,
        "clock": later,
        "trim": trimmed,
        "piece": cut,
        "mean removed": replace(
            record, u=record.u - record.u.mean(0), y=record.y - record.y.mean(0), name="b"
        ),
        "decimated": replace(record.take(slice(None, None, 3)), name="b"),
    }


@pytest.mark.parametrize(
    "how", ["copy", "precision", "clock", "trim", "piece", "decimated", "mean removed"]
)
def test_a_copy_a_piece_and_another_precision_are_the_same_flight(how):
    other = pieces()[how]
    assert repeats({"identification": [flown(), other]}).twice == (("flight", "b"),)
    found = repeats({"identification": [flown()], "validation": [other]})
    assert dict(found.seen) == {"b": "flight"}
    (said,) = found.told()
    assert "Record b is for validation, but an estimation has seen it (as flight)" in said


def test_the_same_manoeuvre_flown_again_is_another_flight():
    """Same stick, other measurements; and the rest before, alike in all of them."""
    record, rng = flown(), np.random.default_rng(9)
    again = replace(record, y=record.y + 0.001 * rng.standard_normal(record.y.shape), name="b")
    for other in (again, flown(1, "c")):
        found = repeats({"identification": [record], "validation": [other]})
        assert (dict(found.seen), found.twice) == ({}, ())
    assert repeats({"identification": [record], "refinement": [record]}).told() == []


def test_records_at_rest_of_different_trims_are_different_flights():
    rest = Record(T, np.zeros((1000, 1)), np.zeros((1000, 2)), ("lat",), ("p", "phi"), "rest")
    other = replace(rest, y=rest.y + 0.1, name="b")
    assert repeats({"identification": [rest, other]}).twice == ()


def test_missing_samples_do_not_hide_a_flight():
    y = flown().y.copy()
    y[200:260, 0] = np.nan
    other = replace(flown(), y=y, name="b")
    assert repeats({"identification": [flown(), other]}).twice == (("flight", "b"),)


def test_identify_tells_of_a_flight_that_serves_twice():
    record = flown()
    with pytest.warns(DataWarning, match="Records flight and b are the same flight: it counts tw"):
        identify(Roll(), [record, replace(record, name="b")], stages=())


def test_seven_copies_of_a_flight_are_one_sentence():
    records = [replace(flown(), name=f"copy {k}") for k in range(7)]
    (said,) = repeats({"identification": [*records, flown(seed=1, name="other")]}).told()
    assert said.startswith("Records copy 0, copy 1, copy 2, copy 3, copy 4, copy 5 and copy 6 are")
    assert "counts 7 times, and standard errors come out too small by up to √7" in said
