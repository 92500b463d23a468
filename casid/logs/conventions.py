"""Where logs keep channels of an aircraft, by PX4, ArduPilot or plain name, and in which units."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from casid.arrays import Array
from casid.channels import (
    AIR,
    ATTITUDES,
    FORCES,
    MEASURES,
    PULSES,
    RATES,
    SI,
    UNITS,
    VELOCITIES,
    factor_of,
    in_si,
    spelt,
)
from casid.logs.attitude_columns import attitudes
from casid.logs.commands import find_inputs
from casid.logs.sources import Source, bare, moves, moving, source_of
from casid.logs.topics import Log, Topic
from casid.samples import at_instants

BODY = "body velocity"  # a topic of casid's own
OUTPUTS: Mapping[str, tuple[str, ...]] = {  # first the best: measured, not estimated
    **{
        name: (
            f"vehicle_angular_velocity.xyz[{k}]",
            f"sensor_combined.gyro_rad[{k}]",
            f"vehicle_attitude.{('rollspeed', 'pitchspeed', 'yawspeed')[k]}",
            f"control_state.{('roll_rate', 'pitch_rate', 'yaw_rate')[k]}",
            *(f"{imu}.Gyr{'XYZ'[k]}" for imu in ("IMU[0]", "IMU", "IMU[1]", "IMU2")),
            f"RATE.{'RPY'[k]}",
        )
        for k, name in enumerate(RATES)
    },
    **{
        name: (
            f"vehicle_attitude.{name}",
            f"control_state.{name}",
            f"ATT.{('Roll', 'Pitch', 'Yaw')[k]}",
            f"XKF1[0].{('Roll', 'Pitch', 'Yaw')[k]}",
            f"NKF1.{('Roll', 'Pitch', 'Yaw')[k]}",
        )
        for k, name in enumerate(ATTITUDES)
    },
    **{
        name: (
            f"sensor_combined.accelerometer_m_s2[{k}]",
            f"vehicle_acceleration.xyz[{k}]",
            f"IMU[0].Acc{'XYZ'[k]}",
            f"IMU.Acc{'XYZ'[k]}",
        )
        for k, name in enumerate(FORCES)
    },
    **{name: (f"{BODY}.{name}",) for name in VELOCITIES},
}
MEASURED = {  # names of what drives nothing, and what each is in
    **{name: UNITS[name] for name in (*OUTPUTS, *AIR)},
    **dict.fromkeys(("h", "alt", "altitude", "height"), "m"),
}
NED = (  # velocities north, east, down, and the attitude that goes with them
    (("vehicle_local_position", "vx", "vy", "vz"), "vehicle_attitude"),
    (("XKF1[0]", "VN", "VE", "VD"), "ATT"),
    (("NKF1", "VN", "VE", "VD"), "ATT"),
)


def find_channels(
    log: Log,
    asked: Mapping[str, str] | None = None,
    own: tuple[Collection[str], Collection[str]] = ((), ()),
) -> tuple[dict[str, Source], dict[str, Source]]:
    """Inputs and outputs by name of a log with `derived` topics.

    ``asked`` are columns for channels, ``{"lat": "RCOU.C1"}``, a sign before one that runs the
    other way. Names of what is measured, ``V`` and ``beta`` too, are outputs, all others inputs,
    which replace those that would be found; ``own`` inputs and outputs of a structure are what they
    are there. ValueError: a column that is not there.
    """
    given = {name: source_of(log, place) for name, place in (asked or {}).items()}
    if missing := [name for name, source in given.items() if source is None]:
        raise ValueError(
            f"{log.path}: there is no column {(asked or {})[missing[0]]!r} for {missing[0]}; name "
            "one as TOPIC.COLUMN of the topics listed by casid import --list"
        )
    named = {name: source for name, source in given.items() if source is not None}
    measured = {*MEASURED, *own[1]} - {*own[0]}
    inputs = {name: source for name, source in named.items() if name not in measured}
    driving = {each.place.removeprefix("-") for each in inputs.values()}
    # ArduPilot's RATE.R is the roll rate: what is documented is nothing else by its name.
    other = driving.union(*OUTPUTS.values())
    outputs = {}
    for name, places in OUTPUTS.items():
        tried = (source_of(log, place) for place in places if place not in driving)
        known = (each for each in tried if each is not None and moves(each))
        alike = (each for each in moving(log, partial(_bears, name)) if each.place not in other)
        if (found := named.get(name) or next(chain(known, alike), None)) is not None:
            outputs[name] = found
    outputs |= {
        name: each for name, each in attitudes(log, outputs).items() if each.place not in driving
    }
    outputs = {name: outputs[name] for name in OUTPUTS if name in outputs}
    outputs |= {name: x for name, x in named.items() if name in measured}
    return inputs or find_inputs(log, outputs), outputs


def _bears(name: str, topic: Topic, column: str) -> bool:
    """Whether a column has that very name; P, I and D together are terms of a controller."""
    return bare(column) == name and not {"p", "i", "d"} <= {x.lower() for x in topic.columns}


def others(log: Log, name: str, taken: Source) -> list[Source]:
    """Columns of other topics that hold the same output."""
    found = (source_of(log, place) for place in OUTPUTS.get(name, ()))
    return [each for each in found if each is not None and each.topic is not taken.topic]


def derived(log: Log, late: float = 0.0) -> Log:
    """The log with Euler angles beside its quaternions, and body velocities beside those in NED.

    A velocity is turned by the attitude at the instant it was sampled, not at that of its stamp;
    of attitudes that come ``late`` [s] by that of so much later.
    """
    topics = {name: _with_angles(topic) for name, topic in log.topics.items()}
    for names, attitude in turned_by(replace(log, topics=topics)):
        topic, reference = topics[names[0]], replace(log, topics=topics)
        places = [place for name in ATTITUDES for place in OUTPUTS[name]]
        own = [place for place in places if place.startswith(f"{attitude}.")]
        angles = [each for place in own if (each := source_of(reference, place))]
        if BODY not in topics and len(angles) == len(own):
            held = [
                at_instants(each.topic.taken - late, continuous(each.values), topic.taken, "foh")
                for each in angles
            ]
            speeds = [topic.columns[each] for each in names[1:]]
            columns = dict(zip(VELOCITIES, into_body(speeds, held), strict=True))
            topics[BODY] = Topic(name=BODY, t=topic.t, columns=columns, age=topic.age)
    return replace(log, topics=topics)


def turned_by(log: Log) -> list[tuple[tuple[str, ...], str]]:
    """Topics of velocities in NED with their columns, and of the attitudes that turn them."""
    return [
        (names, attitude)
        for names, attitude in NED
        if {names[0], attitude} <= {*log.topics} and {*names[1:]} <= {*log.topics[names[0]].columns}
    ]


def _with_angles(topic: Topic) -> Topic:
    names = [f"q[{k}]" for k in range(4)]
    if not set(names) <= set(topic.columns):
        return topic
    w, x, y, z = (topic.columns[name] for name in names)
    phi = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x**2 + y**2))
    theta = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    psi = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    angles = dict(zip(ATTITUDES, (phi, theta, psi), strict=True))
    return replace(topic, columns={**topic.columns, **angles})


def continuous(angle: Array) -> Array:
    """An angle (N,) [rad] that goes on where it turned by a whole turn, unknown where it was."""
    known, goes_on = np.isfinite(angle), angle.copy()
    goes_on[known] = np.unwrap(angle[known])
    return goes_on


def into_body(speeds: Sequence[Array], angles: Sequence[Array]) -> list[Array]:
    """Velocities forward, right, down of those north, east, down, by φ, θ, ψ [rad]."""
    (n, e, d), (phi, theta, psi) = speeds, angles
    ahead, right = n * np.cos(psi) + e * np.sin(psi), e * np.cos(psi) - n * np.sin(psi)
    below = ahead * np.sin(theta) + d * np.cos(theta)
    return [
        ahead * np.cos(theta) - d * np.sin(theta),
        right * np.cos(phi) + below * np.sin(phi),
        below * np.cos(phi) - right * np.sin(phi),
    ]


def with_units(sources: Mapping[str, Source], stated: Mapping[str, str]) -> dict[str, Source]:
    """Sources by channel, those of which the user states the unit read by that.

    An input in µs is one of pulses whether the user says so or the log: no command is a time.
    """
    found = dict(sources)
    pulses = {name: each.unit for name, each in sources.items() if each.unit in PULSES}
    for name, said in (pulses | dict(stated)).items():
        if (source := sources.get(name)) is None:
            continue
        unit = spelt(said)
        meant = "pwm" if name not in MEASURED and unit in PULSES else unit
        factor = factor_of(name, meant) / (in_si(source.unit or "") or 1.0)
        found[name] = replace(source, values=factor * source.values, unit=unit)
    return found


def check_units(
    path: Path, sources: Mapping[str, Source], outputs: Collection[str] = MEASURED
) -> list[str]:
    """What is taken where no known unit is stated, a sentence each.

    ValueError: an output in a unit that is none of its quantity's, wrong by any factor.
    """
    said = []
    for name, source in sources.items():
        if source.unit is None:
            continue
        quantity = MEASURED.get(name, "it is")
        if name not in outputs:
            said += _of_input(name, source.unit)
        elif source.unit == "":
            said.append(f"unit of {name} not stated: taken as {quantity}")
        elif spelt(source.unit) not in (known := MEASURES.get(quantity, SI)):
            raise ValueError(
                f"{path}: column {source.place}, of {name}, is in {source.unit!r}, which is none "
                f"of {', '.join(known)}; state what it is: --unit {name}=UNIT "
                f"(units={{{name!r}: ...}}), or convert the column"
            )
    return said


def _of_input(name: str, unit: str) -> list[str]:
    """What is taken of an input whose unit is not one of a travel, an angle or the like."""
    if unit == "":
        return [f"unit of {name} not stated: taken as it is"]
    if unit in PULSES:
        return [f"{name} is in {unit}: pulses, of which 1000 are one of the record"]
    known = in_si(unit) is not None
    return [] if known else [f"unit of {name}, {unit!r}, is not known: taken as it is"]
