import struct

import numpy as np
import pytest
import pyulog
from truths.logs import ulog

from casid.logs.topics import Bounded, DamagedLogError
from casid.logs.ulog import read_ulog


def topics(data):
    return {topic.name: topic for topic in read_ulog(data, pyulog)[0]}


def message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def header(*messages):
    return b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(messages)


def test_values_and_stamps_are_those_of_pyulog_in_seconds():
    data = ulog(2.0)
    own = pyulog.ULog(Bounded(data)).get_dataset("sensor_combined").data
    topic = topics(data)["sensor_combined"]
    np.testing.assert_array_equal(topic.t, own["timestamp"] * 1e-6)
    np.testing.assert_array_equal(topic.columns["gyro_rad[1]"], own["gyro_rad[1]"])
    assert "timestamp" not in topic.columns


def test_instances_are_topics_and_samples_have_an_age():
    body = b"imu:uint64_t timestamp;uint64_t timestamp_sample;float x;"
    subscribed = [message("A", struct.pack("<BH", k, k) + b"imu") for k in (0, 1)]
    rows = [
        message("D", struct.pack("<HQQf", k, 10_000 * n, 10_000 * n - 2500, n))
        for n in range(1, 9)
        for k in (0, 1)
    ]
    found = topics(header(message("F", body), *subscribed, *rows))
    assert set(found) == {"imu", "imu[1]"}
    assert found["imu[1]"].age == pytest.approx(2.5e-3)


def test_dropouts_are_told():
    data = ulog(2.0) + message("O", struct.pack("<H", 70))
    assert read_ulog(data, pyulog)[1] == (
        "the logger dropped out 1 time, 70 ms in all, 70 ms the longest",
    )


@pytest.mark.parametrize(
    ("formats", "said"),
    [
        ([b"a:uint64_t timestamp;a inner;"], "contains itself"),
        ([b"a:b x;", b"b:a y;"], "contains itself"),
        ([b"a:uint64_t timestamp;b[60000] x;", b"b:uint8_t[60000] y;"], "declare"),
    ],
)
def test_formats_that_would_fill_the_memory_are_refused(formats, said):
    asked = message("A", struct.pack("<BH", 0, 0) + b"a")
    with pytest.raises(DamagedLogError, match=said):
        read_ulog(header(*(message("F", each) for each in formats), asked), pyulog)


def test_a_header_that_never_ends_is_left():
    # Lengths that reach beyond the end lead pyulog back to where it was.
    with pytest.raises((DamagedLogError, OSError, ValueError)):
        read_ulog(header(b"\x10\x27\x00" * 3000), pyulog)
