"""Records recognised by their samples."""

from dataclasses import replace

import numpy as np
from truths.closed_roll import campaign, flown

from casid.fingerprints import digests, fingerprint, same_flight, same_prints


def test_a_flight_is_known_again_decimated_cut_and_detrended():
    (record, other) = campaign(1, 2)
    prints, channels = fingerprint(record), (record.inputs, record.outputs)
    for same in (record.decimate(2), record.take(slice(100, 350)), record.detrend("mean")):
        assert same_flight(prints, *channels, same)
    assert same_flight(fingerprint(record.decimate(2)), *channels, record)
    assert not same_flight(prints, *channels, other)
    # Without noise all records rest alike before they move.
    still, moved = (flown(seed=k, x0=(0.0, 0.0, 0.0)) for k in (0, 1))
    assert not same_flight(fingerprint(still), *channels, moved)
    begin = still.take(slice(40))  # few samples, all in the fingerprint: that of the rest, too
    assert set(fingerprint(begin)) & set(fingerprint(moved.take(slice(40))))
    assert not same_flight(fingerprint(begin), *channels, moved)


def test_a_flight_is_known_again_less_its_means():
    record, other = campaign(1, 2)
    prints, channels = fingerprint(record), (record.inputs, record.outputs)
    less = replace(record, u=record.u - record.u.mean(axis=0), y=record.y - record.y.mean(axis=0))
    for same in (less, less.cut(2.0, 9.0), replace(record, y=record.y + 0.1)):
        assert same_flight(prints, *channels, same)
        assert same_prints(prints, fingerprint(same))
        assert not same_flight(fingerprint(same), *channels, other)
        assert not same_prints(fingerprint(same), fingerprint(other))


def test_steps_of_coarse_sensors_tell_no_flights_apart():
    one, other = (
        replace(each, u=np.round(each.u, 2), y=np.round(each.y, 1)) for each in campaign(1, 2)
    )
    steps = digests(one, one.inputs, one.outputs)[1]
    assert not steps
    assert not same_prints(fingerprint(one), fingerprint(other))
    assert not same_flight(fingerprint(one), one.inputs, one.outputs, other)


def test_a_record_that_lacks_channels_is_not_judged():
    (record,) = campaign(1, 1)
    prints = fingerprint(record)
    assert not same_flight(prints, record.inputs, ("q",), record)
    assert not same_flight((), record.inputs, record.outputs, record)
    lost = np.where(record.t[:, None] < 1, np.nan, record.y)
    assert same_flight(prints, record.inputs, record.outputs, replace(record, y=lost))
