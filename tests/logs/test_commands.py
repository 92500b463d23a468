from pathlib import Path

import numpy as np
import pytest
from truths.logs import RATES, flight

from casid.logs.commands import find_inputs, still, undriven
from casid.logs.conventions import derived, find_channels
from casid.logs.topics import Log, Topic

T, X = flight()
A, B, C = X["roll"], X["pitch"], X["yaw"]
D = np.abs(A) + np.abs(B)
YAW = np.cumsum(X["r"]) * T[1]
P, Q, R = (X[name] for name in RATES)
GYROS = {name: X[name] for name in RATES}
WHERE = 47 + 1e-6 * np.cumsum(X["theta"])


def log(**topics):
    """A log whose writer states no units."""
    made = {
        name: Topic(name=name, t=T, columns=columns, units=dict.fromkeys(columns, ""))
        for name, columns in topics.items()
    }
    return Log(path=Path("flight.tdms"), kind="TDMS", topics=made)


def taken(found, asked=None):
    """Places of inputs by name, and of attitudes."""
    inputs, outputs = find_channels(derived(found), asked)
    assert not {each.place for each in inputs.values()} & {x.place for x in outputs.values()}
    angles = {name: outputs[name].place for name in ("phi", "theta", "psi") if name in outputs}
    return {name: each.place for name, each in inputs.items()}, angles


RECORDERS = {  # topics, what is asked, inputs
    "X-Plane": (
        {"sim": {
            "_elev,yoke1": B, "ailrn,yoke1": A, "ruddr,yoke1": C, "thro1,_part": D,
            "___P,rad/s": P, "_roll,__deg": np.degrees(X["phi"]), "__lat,__deg": WHERE,
            "__lon,__deg": WHERE, "__alt,ftmsl": WHERE,
        }},
        {"p": "sim.___P,rad/s"},
        {
            "aileron": "sim.ailrn,yoke1", "elevator": "sim._elev,yoke1",
            "rudder": "sim.ruddr,yoke1", "throttle": "sim.thro1,_part",
        },
    ),
    "DJI": (
        {"log": {
            "OSD.roll [°]": np.degrees(X["phi"]), "RC.aileron": A, "RC.elevator": B,
            "RC.rudder": C, "RC.throttle": D, "GYRO.x": P, "OSD.latitude": WHERE,
        }},
        {"p": "log.GYRO.x"},
        {
            "aileron": "log.RC.aileron", "elevator": "log.RC.elevator", "rudder": "log.RC.rudder",
            "throttle": "log.RC.throttle",
        },
    ),
    "German sticks": (
        {
            "Steuerung": {
                "Knüppel quer [%]": A, "Knüppel längs [%]": B, "Pedale [%]": C, "Kollektivhebel": D,
            },
            "Kreisel": GYROS,
            "Lage": {"Roll [°]": np.degrees(X["phi"]), "Nick [°]": np.degrees(X["theta"])},
        },
        None,
        {
            "lat": "Steuerung.Knüppel quer [%]", "lon": "Steuerung.Knüppel längs [%]",
            "ped": "Steuerung.Pedale [%]", "col": "Steuerung.Kollektivhebel",
        },
    ),
    "German surfaces": (
        {"Flug": {"Querruder": A, "Höhenruder": B, "Seitenruder [deg]": C, "Nick": B, **GYROS}},
        None,
        {
            "aileron": "Flug.Querruder", "elevator": "Flug.Höhenruder",
            "rudder": "Flug.Seitenruder [deg]",
        },
    ),
    "capital letters, attitudes beside surfaces": (
        {"REC": {"ROLL": X["phi"], "PITCH": 0.01 * D, "AILERON": A, "RUDDER": C, **GYROS}},
        None,
        {"aileron": "REC.AILERON", "rudder": "REC.RUDDER"},
    ),
    "surfaces that rest": (
        {"rec": {"Roll": X["phi"], "Yaw": C, "Aileron": 0 * A, **GYROS}}, None, {},
    ),
    "words together": (
        {"s": {"RollStick": A, "pitch_cmd": B, "Yaw Input (%)": C, "roll": X["phi"], **GYROS}},
        None,
        {"roll": "s.RollStick", "pitch": "s.pitch_cmd", "yaw": "s.Yaw Input (%)"},
    ),
    "helicopter": (
        {"s": {
            "Lateral Cyclic": A, "Longitudinal Cyclic": B, "Pedals": C, "Collective": D, **GYROS,
        }},
        None,
        {
            "lat": "s.Lateral Cyclic", "lon": "s.Longitudinal Cyclic", "ped": "s.Pedals",
            "col": "s.Collective",
        },
    ),
    "sticks beside attitudes of the same names": (
        {
            "ins": {"roll": X["phi"], "pitch": X["theta"], "yaw": YAW}, "gyros": GYROS,
            "pilot": {"roll": A, "pitch": B, "yaw": C, "collective": D},
        },
        None,
        {
            "roll": "pilot.roll", "pitch": "pilot.pitch", "yaw": "pilot.yaw",
            "col": "pilot.collective",
        },
    ),
    "coordinates": (
        {"gnss": {"lat": WHERE, "lon": WHERE}, "s": {"Lat": A, "Lon": B, "Ped": C}, "g": GYROS},
        None,
        {"lat": "s.Lat", "lon": "s.Lon", "ped": "s.Ped"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORDERS)
def test_inputs_are_what_recorders_call_so_and_never_what_was_measured(name):
    topics, asked, wanted = RECORDERS[name]
    assert taken(log(**topics), asked)[0] == wanted


def test_attitudes_of_a_recorder_become_outputs_where_they_turn_as_rates():
    found = log(flight={"Roll": X["phi"], "Pitch": X["theta"], "Yaw": YAW, "lat": A, **GYROS})
    assert taken(found) == (
        {"lat": "flight.lat"},
        {"phi": "flight.Roll", "theta": "flight.Pitch", "psi": "flight.Yaw"},
    )
    degrees = log(flight={"Roll": np.degrees(X["phi"]), "lat": A, **GYROS})
    assert taken(degrees) == ({"lat": "flight.lat"}, {})  # nobody states the unit


def test_actuators_without_a_name_are_told_with_what_moves():
    rest = np.full(len(T), 1500.0)
    found = log(
        ATT={"Roll": X["phi"], "Yaw": YAW}, GPS={"Lat": WHERE, "Lng": WHERE, "Alt": WHERE},
        IMU={"GyrX": P, "GyrY": Q, "GyrZ": R}, RCOU={"C1": rest + A, "C2": rest, "C4": rest + C},
        PIDR={"P": A, "I": B, "D": C}, CTUN={"throttle": D},
    )  # fmt: skip
    inputs, outputs = find_channels(found)
    assert inputs == {}
    assert [outputs[name].place for name in "pqr"] == ["IMU.GyrX", "IMU.GyrY", "IMU.GyrZ"]
    said = undriven(found, outputs)
    assert "what moves beside the outputs is RCOU.C1, RCOU.C4; name" in said
    assert "--column lat=RCOU.C1 (columns={'lat': 'RCOU.C1'})" in said
    assert still(found) == []


def test_actuators_at_rest_are_told_and_attitudes_are_not_offered():
    found = log(ATT={"Roll": X["phi"]}, RATE={"R": P}, RCOU={"C1": 0 * A})
    _, outputs = find_channels(found)
    assert undriven(found, outputs) == (
        "flight.tdms: no column is known for inputs; RCOU never moves: nothing is driven, so "
        "nothing can be identified; nothing moves but what was measured: were commands logged?"
    )


def test_columns_with_blanks_are_offered_in_quotes_and_no_more_than_can_be_read():
    found = log(own={f"Motor {k}": A + k for k in range(15)} | GYROS)
    said = undriven(found, find_channels(found)[1])
    assert "own.Motor 11 and 3 more; " in said
    assert "--column 'lat=own.Motor 0'" in said


def test_set_points_and_sticks_of_an_autopilot_serve_as_before():
    found = log(
        vehicle_rates_setpoint={"roll": A, "pitch": B, "yaw": C},
        vehicle_local_position={"yaw": YAW},
        sensor_combined={f"gyro_rad[{k}]": X[name] for k, name in enumerate(RATES)},
        actuator_motors={"control[0]": D},
    )
    inputs = find_inputs(found, find_channels(found)[1])
    assert {each.topic.name for each in inputs.values()} == {"vehicle_rates_setpoint"}
    assert list(inputs) == ["roll", "pitch", "yaw"]


def test_what_the_user_calls_an_input_is_no_output():
    found = log(ATT={"Roll": X["phi"]}, RATE={"R": P})
    inputs, outputs = find_channels(found, {"lat": "-ATT.Roll"})
    assert (list(inputs), list(outputs)) == (["lat"], ["p"])
