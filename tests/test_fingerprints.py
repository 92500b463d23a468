"""Records recognised by their samples."""

from dataclasses import replace

import numpy as np
from truths.closed_roll import campaign, flown

from casid.fingerprints import fingerprint, same_flight


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


def test_a_record_that_lacks_channels_is_not_judged():
    (record,) = campaign(1, 1)
    prints = fingerprint(record)
    assert not same_flight(prints, record.inputs, ("q",), record)
    assert not same_flight((), record.inputs, record.outputs, record)
    lost = np.where(record.t[:, None] < 1, np.nan, record.y)
    assert same_flight(prints, record.inputs, record.outputs, replace(record, y=lost))
