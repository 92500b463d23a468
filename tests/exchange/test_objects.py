"""Systems and records become other packages' objects, and come back."""

from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
import scipy.integrate
import scipy.io
import scipy.linalg
import scipy.signal
from truths.climbing import AIRCRAFT
from truths.systems import same

from casid.exchange.objects import (
    from_control,
    from_dataframe,
    from_scipy,
    to_control,
    to_dataframe,
    to_scipy,
)

OMEGA = np.geomspace(0.1, 20, 15)
LETTERS = "ABCD"


@pytest.mark.parametrize("dt", [None, 0.02])
def test_python_control_keeps_matrices_names_and_interval(system, dt):
    there = to_control(replace(system, dt=dt))
    back = from_control(there)
    for letter in LETTERS:
        np.testing.assert_array_equal(getattr(back, letter), getattr(system, letter))
    assert (back.dt, back.inputs, back.outputs, back.states) == (
        dt, system.inputs, system.outputs, system.states,
    )  # fmt: skip
    assert there.isdtime(strict=True) == (dt is not None)


@pytest.mark.parametrize("dt", [None, 0.02])
def test_scipy_keeps_matrices_and_interval(system, dt):
    names = {"inputs": system.inputs, "outputs": system.outputs, "states": system.states}
    back = from_scipy(to_scipy(replace(system, dt=dt)), **names)
    for letter in LETTERS:
        np.testing.assert_array_equal(getattr(back, letter), getattr(system, letter))
    assert (back.dt, back.inputs) == (dt, system.inputs)


def test_a_transfer_function_of_scipy_becomes_a_system():
    lag = from_scipy(scipy.signal.lti([2.0], [0.5, 1.0]), inputs=["lat"], outputs=["p"])
    np.testing.assert_allclose(lag.response(OMEGA)[:, 0, 0], 2 / (1 + 0.5j * OMEGA), rtol=1e-12)


def test_a_transfer_function_of_control_becomes_a_system():
    lag = from_control(control.ss(control.tf([2.0], [0.5, 1.0])), delay=[0.1])
    expected = 2 / (1 + 0.5j * OMEGA) * np.exp(-0.1j * OMEGA)
    np.testing.assert_allclose(lag.response(OMEGA)[:, 0, 0], expected, rtol=1e-12)


def test_what_is_no_system_of_control_is_converted_or_refused():
    lag = from_control(control.tf([2.0], [0.5, 1.0]))
    np.testing.assert_allclose(lag.response(OMEGA)[:, 0, 0], 2 / (1 + 0.5j * OMEGA), rtol=1e-12)
    with pytest.raises(TypeError, match="FrequencyResponseData is no state space"):
        from_control(control.frd([1.0], [1.0]))


def test_delays_are_never_dropped_in_silence(system):
    with pytest.raises(ValueError, match=r"delays \(ped 0.1 s\).*pade=3"):
        to_control(replace(system, delay=[0.0, 0.1]))
    assert to_control(replace(system, delay=())).nstates == 3


def test_a_discrete_system_without_interval_is_refused():
    with pytest.raises(ValueError, match="without a sampling interval"):
        from_control(control.ss(0.5, 1, 1, 0, True))


def test_a_dataframe_gives_the_record_back(record):
    frame = to_dataframe(record)
    assert list(frame.columns) == ["lat", "p", "phi"]
    back = from_dataframe(frame)
    same(back, record)
    assert back.name == "a flight"


SINCE = np.datetime64("2026-03-01T12:00:00")


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    "dated",
    [
        lambda steps: pd.Series(SINCE + steps),
        lambda steps: pd.Series(SINCE + steps).dt.tz_localize("Europe/Berlin"),
        pd.Series,
    ],
    ids=["dates", "of a zone", "time deltas"],
)
def test_dates_and_time_deltas_of_a_frame_are_read_as_seconds(record, unit, indexed, dated):
    ticks = np.arange(record.N) * (20 * int(1e-3 / {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]))
    time = dated(ticks.astype(f"m8[{unit}]"))
    frame = to_dataframe(record).reset_index(drop=True)
    frame = frame.set_index(pd.Index(time)) if indexed else frame.assign(t=time)
    found = from_dataframe(frame, inputs=["lat"], outputs=["p"])
    np.testing.assert_allclose(found.t, 0.02 * np.arange(record.N), rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="time 't' holds dates or time deltas, which are no ms"):
        from_dataframe(frame, inputs=["lat"], outputs=["p"], units={"t": "ms"})


def test_a_channel_of_dates_is_refused(record):
    frame = to_dataframe(record)
    frame["p"] = SINCE + np.arange(record.N).astype("m8[s]")
    with pytest.raises(ValueError, match="'p' holds dates or time deltas, expected numbers"):
        from_dataframe(frame, inputs=["lat"], outputs=["p"])


def test_a_foreign_frame_needs_names_and_takes_units(record):
    frame = to_dataframe(record).reset_index()
    frame.attrs = {}
    with pytest.raises(ValueError, match="which columns are inputs"):
        from_dataframe(frame)
    found = from_dataframe(frame, inputs=["lat"], outputs=["p"], units={"p": "deg/s"})
    np.testing.assert_allclose(found.channel("p"), np.radians(record.channel("p")), rtol=1e-14)
    with pytest.raises(ValueError, match="no column 'psi'; it has t, lat, p, phi"):
        from_dataframe(frame, inputs=["lat"], outputs=["psi"])
    frame["p"] = "fast"
    with pytest.raises(ValueError, match="'p' holds no numbers"):
        from_dataframe(frame, inputs=["lat"], outputs=["p"])


def test_an_index_of_time_deltas_is_time_in_seconds(record):
    frame = to_dataframe(record)
    frame.index = pd.to_timedelta(np.arange(50) * 20, unit="ms")
    np.testing.assert_allclose(from_dataframe(frame).t, 0.02 * np.arange(50), rtol=1e-12)


@pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")
def test_a_nonlinear_structure_becomes_a_system_of_python_control():
    there = to_control(AIRCRAFT, pade=2)
    assert there.input_labels == list(AIRCRAFT.inputs)
    assert there.output_labels == list(AIRCRAFT.outputs)
    own = to_scipy(AIRCRAFT, pade=2)
    t, u = np.linspace(0, 2, 41), np.array([0.03, 0.55])
    tight = {"rtol": 1e-10, "atol": 1e-12}
    found = control.input_output_response(
        there, t, np.tile(u[:, None], 41), own.x0, solve_ivp_kwargs=tight
    )
    known = scipy.integrate.solve_ivp(
        own.derivatives, (0, 2), own.x0, args=(lambda _: u,), t_eval=t, **tight
    )
    expected = np.array([own.measurements(0.0, x, u) for x in known.y.T]).T
    np.testing.assert_allclose(found.outputs, expected, atol=1e-7)
