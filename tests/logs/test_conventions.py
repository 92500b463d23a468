from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casid.logs.conventions import (
    BODY,
    check_units,
    continuous,
    derived,
    find_channels,
    into_body,
    others,
    with_units,
)
from casid.logs.sources import Source
from casid.logs.topics import Log, Topic

T = np.arange(20.0)
rng = np.random.default_rng(3)


def log(**topics):
    made = {name: Topic(name=name, t=T, columns=columns) for name, columns in topics.items()}
    return Log(path=Path("x.ulg"), kind="PX4 ULog", topics=made)


def random(n=1):
    return rng.standard_normal((n, len(T)))


def test_quaternions_become_euler_angles():
    angles = rng.uniform(-1, 1, (len(T), 3))  # ψ, θ, φ
    x, y, z, w = Rotation.from_euler("ZYX", angles).as_quat().T
    found = derived(log(vehicle_attitude={"q[0]": w, "q[1]": x, "q[2]": y, "q[3]": z}))
    columns = found.topics["vehicle_attitude"].columns
    for name, wanted in zip(("psi", "theta", "phi"), angles.T, strict=True):
        np.testing.assert_allclose(columns[name], wanted, atol=1e-12)


def test_a_documented_column_is_no_other_rate_by_its_name():
    p, q, still = *random(2), np.zeros(len(T))
    _, outputs = find_channels(log(RATE={"R": p, "P": q, "Y": still}))
    assert {name: each.place for name, each in outputs.items()} == {"p": "RATE.R", "q": "RATE.P"}


def test_terms_of_a_controller_are_no_rates():
    (p,) = random()
    _, outputs = find_channels(log(PIDR={"P": p, "I": p, "D": p}, own={"P": p}))
    assert {name: each.place for name, each in outputs.items()} == {"p": "own.P"}


def test_velocities_north_east_down_become_those_of_the_body():
    angles = rng.uniform(-1, 1, (len(T), 3))
    speeds = random(3)
    wanted = Rotation.from_euler("ZYX", angles).inv().apply(speeds.T).T
    np.testing.assert_allclose(into_body(speeds, angles.T[::-1]), wanted, atol=1e-12)
    x, y, z, w = Rotation.from_euler("ZYX", angles).as_quat().T
    found = derived(log(
        vehicle_attitude={"q[0]": w, "q[1]": x, "q[2]": y, "q[3]": z},
        vehicle_local_position=dict(zip(("vx", "vy", "vz"), speeds, strict=True)),
    ))  # fmt: skip
    for name, own in zip("uvw", wanted, strict=True):
        np.testing.assert_allclose(found.topics[BODY].columns[name], own, atol=1e-12)


@pytest.mark.parametrize("ages", [(0.0, 0.0), (0.06, 0.06), (0.06, 0.0), (0.002, 0.05)])
def test_velocities_are_turned_by_the_attitude_of_the_instant_they_were_sampled_at(ages):
    # Level flight at 20 m/s, nose up and down by a quarter of a radian: u = 20 cos θ, w = 20 sin θ.
    of_velocity, of_attitude = ages
    pitch = lambda t: 0.25 * np.sin(4.4 * t)  # noqa: E731
    t, own = np.arange(0, 10, 0.02), np.arange(0, 10, 0.01)
    zero, half = np.zeros(len(own)), pitch(own) / 2
    quaternion = {"q[0]": np.cos(half), "q[1]": zero, "q[2]": np.sin(half), "q[3]": zero}
    speeds = dict(zip(("vx", "vy", "vz"), (20 + 0 * t, 0 * t, 0 * t), strict=True))
    topics = (
        ("vehicle_attitude", own, of_attitude, quaternion),
        ("vehicle_local_position", t, of_velocity, speeds),
    )
    made = {n: Topic(name=n, t=x + age, columns=own, age=age) for n, x, age, own in topics}
    found = derived(Log(path=Path("x.ulg"), kind="PX4 ULog", topics=made)).topics[BODY]
    np.testing.assert_allclose(found.taken, t, atol=1e-12)
    known = (t > 0.1) & (t < 9.9)
    # A line between two attitudes errs by h²/8 of θ'': 6e-5 rad, and 20 m/s times as much.
    for name, wanted in (("u", 20 * np.cos(pitch(t))), ("w", 20 * np.sin(pitch(t)))):
        np.testing.assert_allclose(found.columns[name][known], wanted[known], atol=1.3e-3)


def test_one_lost_attitude_loses_no_other_and_a_turn_goes_on_across_it():
    psi = 2.5 + 0.05 * np.arange(len(T))
    slow = 0.05 * T
    angles = np.transpose([psi, 0.1 * np.sin(slow), 0.2 * np.cos(slow)])  # ψ, θ, φ
    speeds = np.transpose([20.0 + np.cos(slow), np.sin(slow), 0.5 * np.sin(slow)])
    x, y, z, w = Rotation.from_euler("ZYX", angles).as_quat().T
    lost = len(T) // 3
    x[lost] = y[lost] = z[lost] = w[lost] = np.nan
    found = derived(log(
        vehicle_attitude={"q[0]": w, "q[1]": x, "q[2]": y, "q[3]": z},
        vehicle_local_position=dict(zip(("vx", "vy", "vz"), speeds.T, strict=True)),
    ))  # fmt: skip
    wanted = Rotation.from_euler("ZYX", angles).inv().apply(speeds).T
    for name, own in zip("uvw", wanted, strict=True):
        off = found.topics[BODY].columns[name] - own
        np.testing.assert_allclose(np.delete(off, lost), 0, atol=1e-9)
        assert abs(off[lost]) < 0.01  # along a line between its neighbours
    turned = (psi + np.pi) % (2 * np.pi) - np.pi
    turned[lost] = np.nan
    left = continuous(turned) - psi
    assert np.isnan(left).sum() == 1
    np.testing.assert_allclose(left[np.isfinite(left)], 0, atol=1e-12)


def test_what_is_measured_goes_before_what_is_estimated_and_what_rests_is_passed_over():
    (p,), still = random(), np.zeros(len(T))
    found = log(
        vehicle_angular_velocity={"xyz[0]": still}, sensor_combined={"gyro_rad[0]": p},
        vehicle_attitude={"rollspeed": p}, RATE={"ROut": p, "POut": still, "YOut": p},
        actuator_controls_0={"control[0]": still},
    )  # fmt: skip
    inputs, outputs = find_channels(found)
    assert outputs["p"].place == "sensor_combined.gyro_rad[0]"
    assert {name: each.place for name, each in inputs.items()} == {
        "roll": "RATE.ROut", "yaw": "RATE.YOut",
    }  # fmt: skip
    same = {each.place for each in others(found, "p", outputs["p"])}
    assert same == {"vehicle_angular_velocity.xyz[0]", "vehicle_attitude.rollspeed"}


def test_columns_named_by_the_user_or_like_a_channel_are_taken():
    a, b, c = random(3)
    found = log(**{"Control surfaces": {"A": a, "Lat": b}, "Gyro": {"P": c}})
    inputs, outputs = find_channels(found)
    assert inputs["lat"].place == "Control surfaces.Lat"
    assert outputs["p"].place == "Gyro.P"
    inputs, _ = find_channels(found, {"lat": "-Control surfaces.A"})
    np.testing.assert_array_equal(inputs["lat"].values, -a)
    assert set(inputs) == {"lat"}
    with pytest.raises(ValueError, match=r"no column 'Gyro\.Q' for q"):
        find_channels(found, {"q": "Gyro.Q"})


def test_what_is_measured_drives_nothing_whoever_names_it():
    a, b, c, d = random(4)
    found = log(Sticks={"lat": a}, Gyro={"p": b}, Air={"TAS": c, "AOS": d, "Alt": 30 * d})
    air = {"V": "Air.TAS", "beta": "Air.AOS", "altitude": "Air.Alt"}
    inputs, outputs = find_channels(found, air)
    assert (set(inputs), list(outputs)) == ({"lat"}, ["p", *air])
    named = {"m1": "Air.TAS", "nz": "Air.Alt", "V": "Air.AOS"}  # names are a structure's own
    inputs, outputs = find_channels(found, named, (("m1",), ("nz",)))
    assert (set(inputs), list(outputs)) == ({"m1"}, ["p", "nz", "V"])
    assert "V" in find_channels(found, {"V": "Air.TAS"}, (("V",), ()))[0]  # volts of a motor


PATH = Path("flight.tdms")


def source(unit, values=(1.0, 2.0)):
    topic = Topic(name="flight", t=np.array([0.0, 0.1]), columns={})
    return Source(place="flight.p", topic=topic, values=np.array(values), unit=unit)


def test_what_the_user_states_is_taken_for_what_the_log_says():
    found = with_units({"p": source(""), "q": source("deg/s")}, {"p": "deg/s", "q": "rad/s"})
    np.testing.assert_allclose(found["p"].values, np.radians([1.0, 2.0]))
    np.testing.assert_allclose(found["q"].values, np.degrees([1.0, 2.0]))  # as it stood there


@pytest.mark.parametrize("name", ["lat", "throttle"])
@pytest.mark.parametrize("stated", [{}, {"lat": "us", "throttle": "µs"}, {"lat": "pwm"}])
def test_commands_in_microseconds_are_pulses_whoever_says_so(name, stated):
    logged = source("us", (1500e-6, 1900e-6))  # as a time, which the log's word alone makes of them
    found = with_units({name: logged}, stated)
    np.testing.assert_allclose(found[name].values, [1.5, 1.9])
    (percent,) = with_units({name: logged}, {name: "%"}).values()
    np.testing.assert_allclose(percent.values, [15, 19])  # 1500 and 1900 of what the user says
    (said,) = check_units(PATH, with_units({name: logged}, {}))
    assert said == f"{name} is in us: pulses, of which 1000 are one of the record"


def test_a_unit_that_nobody_states_is_told():
    assert check_units(PATH, {"p": source("")}) == ["unit of p not stated: taken as rad/s"]
    assert check_units(PATH, {"lat": source("V")}) == [
        "unit of lat, 'V', is not known: taken as it is"
    ]
    assert check_units(PATH, {"p": source("deg/s"), "q": source(None)}) == []


def test_measured_channels_in_unknown_units_are_refused_as_rates_are():
    assert check_units(PATH, {"V": source("knots"), "h": source("Feet"), "nz": source("g")}) == []
    for name, unit in (("V", "leagues/h"), ("beta", "mils"), ("h", "kt"), ("nz", "furlongs")):
        with pytest.raises(ValueError, match=f"of {name}, is in '{unit}', which is none of"):
            check_units(PATH, {name: source(unit)}, (name,))


@pytest.mark.parametrize("unit", ["Grad/sec", "m/s", "us"])
def test_an_output_in_a_unit_of_another_kind_is_refused(unit):
    with pytest.raises(ValueError, match=r"flight\.p, of p, is in .* --unit p=UNIT"):
        check_units(PATH, with_units({"p": source(unit)}, {}))
