"""Units of a log's channels, stated by the log, by the user, or by nobody."""

from pathlib import Path

import numpy as np
import pytest

from casid.logs.conventions import Source
from casid.logs.topics import Topic
from casid.logs.units import check_units, with_units

PATH = Path("flight.tdms")


def source(unit, values=(1.0, 2.0)):
    topic = Topic(name="flight", t=np.array([0.0, 0.1]), columns={})
    return Source(place="flight.p", topic=topic, values=np.array(values), unit=unit)


def test_what_the_user_states_is_taken_for_what_the_log_says():
    found = with_units({"p": source(""), "q": source("deg/s")}, {"p": "deg/s", "q": "rad/s"})
    np.testing.assert_allclose(found["p"].values, np.radians([1.0, 2.0]))
    np.testing.assert_allclose(found["q"].values, np.degrees([1.0, 2.0]))  # as it stood there


def test_a_unit_that_nobody_states_is_told():
    assert check_units(PATH, {"p": source("")}) == ["unit of p not stated: taken as rad/s"]
    assert check_units(PATH, {"lat": source("V")}) == [
        "unit of lat, 'V', is not known: taken as it is"
    ]
    assert check_units(PATH, {"p": source("deg/s"), "q": source(None)}) == []


@pytest.mark.parametrize("unit", ["Grad/sec", "m/s"])
def test_an_output_in_a_unit_of_another_kind_is_refused(unit):
    with pytest.raises(ValueError, match=r"flight\.p, of p, is in .* --unit p=UNIT"):
        check_units(PATH, {"p": source(unit)})
