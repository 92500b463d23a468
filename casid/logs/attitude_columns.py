"""Columns called roll, pitch and yaw that are attitudes: they go as a rate turns."""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, DEGREE, RATES
from casid.consistency.lags import correlations
from casid.logs.sources import Source, bare, moves, source_of
from casid.logs.topics import Log, Topic
from casid.samples import unwrapped

AXES = ("roll", "pitch", "yaw")
SPELT = {  # as recorders call them
    "rollen": "roll",
    **dict.fromkeys(("nick", "nicken"), "pitch"),
    **dict.fromkeys(("gier", "gieren"), "yaw"),
}
ANGLES = re.compile(  # topics of attitudes
    r"attitude|^att$|ahr|euler|^angles?$|orient|[xn]kf|ekf|^imu|^ins$|^sim$|^cam$", re.IGNORECASE
)
SPAN = 1.0  # s, of which turns are compared with what a rate turns in it
LATE = 0.2  # s, by which an attitude and a rate may be apart
TURNS, ABOUT = 0.9, 0.25  # correlation of an attitude with its rate, and off by how much of it
WANTED = re.compile("setpoint|desired|target|demand", re.IGNORECASE)  # topics of none flown


def attitudes(log: Log, outputs: Mapping[str, Source]) -> dict[str, Source]:
    """Attitudes that outputs lack, of columns that turn in size as a rate does."""
    found: dict[str, Source] = {}
    for topic in log.topics.values():
        for name, source, gain in () if WANTED.search(topic.name) else turning(log, topic, outputs):
            if name not in outputs and abs(gain - 1) < ABOUT:
                found.setdefault(name, source)
    return found


def attitude_topics(log: Log, outputs: Mapping[str, Source]) -> set[str]:
    """Topics in which roll, pitch and yaw are attitudes: so called, or turning as rates say."""
    return {
        topic.name
        for topic in log.topics.values()
        if ANGLES.search(topic.name) or any(turning(log, topic, outputs))
    }


def turning(
    log: Log, topic: Topic, outputs: Mapping[str, Source]
) -> Iterator[tuple[str, Source, float]]:
    """Columns of a topic called roll, pitch, yaw that go as a rate turns: attitude, source, gain.

    The gain is 1 where both are in the same unit of angle.
    """
    for name, rate, angle in zip(AXES, RATES, ATTITUDES, strict=True):
        for column in topic.columns if rate in outputs else ():
            if axis_of(column) != name:
                continue
            found = source_of(log, f"{topic.name}.{column}")
            if found is not None and moves(found) and (gain := _gain(found, outputs[rate])):
                yield angle, found, gain


def _gain(angle: Source, rate: Source) -> float | None:
    """The size of an angle's turns beside those of a rate; None where it does not go with it.

    Turns over a second are compared: noise of an angle hides its derivative.
    """
    step = max(angle.topic.interval, rate.topic.interval)
    at, own = angle.topic.taken, rate.topic.taken
    t = np.arange(max(at[0], own[0]), min(at[-1], own[-1]), step)
    n, lags = max(1, round(SPAN / step)), max(1, round(LATE / step))
    if len(t) < n + 8 * lags:
        return None
    turned = unwrapped(angle.values)
    x, (at, r) = _known(angle, angle.values if turned is None else turned), _known(rate)
    area = np.append(0.0, np.cumsum((r[1:] + r[:-1]) / 2 * np.diff(at)))
    a, b = (each[n:] - each[:-n] for each in (np.interp(t, *x), np.interp(t, at, area)))
    a, b = a - a.mean(), b - b.mean()
    if not b.any() or correlations(a, b, lags).max() < TURNS:
        return None
    gain = float(np.linalg.norm(a) / np.linalg.norm(b))
    alike = any(abs(gain * unit - 1) < ABOUT for unit in (1, DEGREE, 1 / DEGREE))
    return gain if alike else None


def _known(source: Source, values: Array | None = None) -> tuple[Array, Array]:
    x = source.values if values is None else values
    known = np.isfinite(x)
    return source.topic.taken[known], x[known]


def axis_of(column: str) -> str:
    """The axis a column is called by, if it bears no other word: ``"Roll [deg]"`` is roll."""
    name = bare(column)
    return SPELT.get(name, name)
