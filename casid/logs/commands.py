"""Which columns of a log drive the aircraft: documented ones, or by names of its writer's own."""

import re
from collections.abc import Collection, Mapping
from functools import partial
from shlex import quote

import numpy as np

from casid.logs import attitude_columns
from casid.logs.attitude_columns import AXES, attitude_topics, axis_of
from casid.logs.sources import UNIT, Source, moves, moving, source_of
from casid.logs.topics import Log, Topic

ACTUATORS = ("actuator_outputs", "actuator_motors", "actuator_servos", "RCOU")  # drive aircraft
INPUTS: tuple[Mapping[str, str], ...] = (  # sets of which the first that moves is taken
    {
        "roll": "vehicle_torque_setpoint.xyz[0]",
        "pitch": "vehicle_torque_setpoint.xyz[1]",
        "yaw": "vehicle_torque_setpoint.xyz[2]",
        "thrust": "-vehicle_thrust_setpoint.xyz[2]",
    },
    {name: f"actuator_controls_0.control[{k}]" for k, name in enumerate((*AXES, "thrust"))},
    {name: f"RATE.{'RPYA'[k]}Out" for k, name in enumerate((*AXES, "thrust"))},
    {"roll": "AETR.Ail", "pitch": "AETR.Elev", "yaw": "AETR.Rudd", "thrust": "AETR.Thr"},
)
SURFACES = ("aileron", "elevator", "rudder")
OWN = (  # names of a recorder's own, and what goes with each: that of which most move is taken
    (("lat", "lon", "ped"), ("col",)),
    (SURFACES, ("col", "throttle")),
    (AXES, ("thrust", "col", "throttle")),  # of sticks, where they are no attitudes
)
MOVES = {  # the rate or force that an input moves
    **dict.fromkeys(("roll", "lat", "aileron"), "p"),
    **dict.fromkeys(("pitch", "lon", "elevator"), "q"),
    **dict.fromkeys(("yaw", "ped", "rudder"), "r"),
    **dict.fromkeys(("thrust", "col", "throttle"), "az"),
}
NAMED = 12  # columns that are named where none is known for inputs
SPELT = {  # as recorders call inputs, in words of lower case
    **dict.fromkeys(("lateral", "quer"), "lat"),
    **dict.fromkeys(("longitudinal", "längs", "laengs"), "lon"),
    **dict.fromkeys(("pedal", "pedals", "pedale"), "ped"),
    **dict.fromkeys(("collective", "coll", "kollektiv", "kollektivhebel"), "col"),
    **dict.fromkeys(("ailerons", "ail", "ailn", "ailrn", "querruder"), "aileron"),
    **dict.fromkeys(("elev", "höhenruder", "hoehenruder"), "elevator"),
    **dict.fromkeys(("rudd", "ruddr", "seitenruder"), "rudder"),
    **dict.fromkeys(("thr", "thro", "thro1", "gas"), "throttle"),
    **attitude_columns.SPELT,
}
BESIDE = {  # words of a name that say that it is an input, or how it is counted
    *("stick", "yoke", "yoke1", "joystick", "cmd", "command", "commanded", "input", "lever", "rc"),
    *("deflection", "surface", "surf", "servo", "actuator", "control", "ctrl", "cyclic", "pedal"),
    *("pct", "percent", "norm", "pwm", "us", "part", "knüppel", "knueppel", "hebel", "ausschlag"),
    *("stellung", "befehl", "pedals"),
}
COORDINATES = {"alt", "altitude", "height", "lng", "latitude", "longitude", "hdop", "eph"}
PLACES = re.compile(r"gps|gnss|global_position|^pos$|^home", re.IGNORECASE)  # of coordinates
WORD = re.compile(r"[A-ZÄÖÜ]?[a-zäöüß]+\d*|[A-ZÄÖÜ]+(?![a-zäöüß])\d*|\d+")  # also of CamelCase


def find_inputs(log: Log, outputs: Mapping[str, Source]) -> dict[str, Source]:
    """Inputs by name: the first documented set that moves, or names of the log's own.

    No column is an input that is an output, none that is an attitude under another's name.
    """
    for wanted in INPUTS:
        found = {name: source_of(log, place) for name, place in wanted.items()}
        if inputs := {n: each for n, each in found.items() if each is not None and moves(each)}:
            return inputs
    taken = {each.place for each in outputs.values()}
    angles = attitude_topics(log, outputs)
    named = {
        name: [each for each in rows if each.place not in taken]
        for name, rows in _named(log, angles).items()
    }
    every = {_name(column) for topic in log.topics.values() for column in topic.columns}
    turned: dict[str, Source] = {}
    lifted: dict[str, Source] = {}
    for sticks, heave in OWN:
        if sticks is AXES and (turned or every & set(SURFACES)):
            continue  # beside surfaces they are attitudes
        own = [name for name in sticks if named[name]]
        up = [name for name in heave if named[name]][:1]
        of = {name: _likely(named, name, (*sticks, *heave)) for name in (*own, *up)}
        if own and len(of) > len(turned):
            turned = of
        lifted = lifted or of
    return turned or ({} if _driving(log) else lifted)


def undriven(log: Log, outputs: Mapping[str, Source]) -> str:
    """Why a log has no inputs, and which of its columns that move might be named so."""
    taken = {each.place for each in outputs.values()}
    angles = attitude_topics(log, outputs)
    free = _driving(log) or moving(
        log, lambda topic, column: topic.name not in angles or _name(column) not in AXES
    )
    left = [each.place for each in free if each.place not in taken]
    said = [f"{log.path}: no column is known for inputs", *still(log)]
    if not left:
        return "; ".join((*said, "nothing moves but what was measured: were commands logged?"))
    shown = ", ".join(left[:NAMED]) + (f" and {len(left) - NAMED} more" if left[NAMED:] else "")
    said.append(f"what moves beside the outputs is {shown}")
    said.append(
        f"name what drives an axis, --column {quote(f'lat={left[0]}')} "
        f"(columns={{'lat': {left[0]!r}}}), as {', '.join(MOVES)}, or as your structure does"
    )
    return "; ".join(said)


def still(log: Log) -> list[str]:
    """Topics of actuators that rest."""
    return [
        f"{name} never moves: nothing is driven, so nothing can be identified"
        for name in ACTUATORS
        if name in log.topics
        and not any(np.nanstd(x) > 0 for x in log.topics[name].columns.values())
    ]


def _driving(log: Log) -> list[Source]:
    """What moves of what was sent to actuators."""
    return moving(log, lambda topic, _: topic.name.split("[")[0] in ACTUATORS)


def _named(log: Log, angles: Collection[str]) -> dict[str, list[Source]]:
    """Columns that move under each name of an input, those of its very name first."""
    found: dict[str, list[Source]] = {}
    for name in dict.fromkeys(name for own in OWN for part in own for name in part):
        rows = moving(log, partial(_calls, name, angles))
        found[name] = sorted(rows, key=lambda each: not each.place.lower().endswith(f".{name}"))
    return found


def _calls(name: str, angles: Collection[str], topic: Topic, column: str) -> bool:
    """Whether a column is the input of that name, and neither a coordinate nor an attitude."""
    if _name(column) != name:
        return False
    if name in ("lat", "lon"):
        beside = {each.lower() for each in topic.columns}
        driven = {_name(each) for each in topic.columns} & {"ped", "col"}
        return bool(driven) or not (beside & COORDINATES or PLACES.search(topic.name))
    return name not in AXES or topic.name not in angles or axis_of(column) != name


def _likely(named: Mapping[str, list[Source]], name: str, names: Collection[str]) -> Source:
    """Of a name's columns the first of the topic in which most of a set's names are."""
    topics = [topic for other in names for topic in {id(each.topic) for each in named[other]}]
    return max(named[name], key=lambda each: topics.count(id(each.topic)))


def _name(column: str) -> str:
    """The input that a column's name says, if any: ``"Aileron_Cmd [%]"`` says aileron."""
    words = WORD.findall(UNIT.sub("", column))
    lower = [word.lower() for word in words]
    left = [word for word in lower if word not in BESIDE] or lower
    return " ".join(SPELT.get(word, word) for word in left)
