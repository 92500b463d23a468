"""Inputs read at other instants: steps that move, corners that are cut."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from casid import DataWarning, Record

T = 0.02 * np.arange(1000)


def flown(u, hold, t=T):
    y = np.column_stack([np.sin(t), np.cos(t)])
    return Record(t, u[:, None], y, ("lat",), ("p", "phi"), hold=hold, name="flown")


def stepped(every=25):
    levels = np.random.default_rng(1).standard_normal(len(T) // every + 1)
    return np.repeat(levels, every)[: len(T)]


STEPS = flown(stepped(), "zoh")


@pytest.mark.parametrize(
    "read",
    [
        lambda: STEPS.shift({"lat": 0.01}),
        lambda: STEPS.shift({"lat": -0.005}),
        lambda: STEPS.resample(0.015),
        lambda: replace(STEPS.select(inputs=[]), t=T + 0.007).join(STEPS.select(outputs=[])),
    ],
    ids=["later", "earlier", "resampled", "joined"],
)
def test_steps_that_fall_on_no_instant_are_told(read):
    with pytest.warns(DataWarning, match="lat is held in steps that do not fall"):
        read()


@pytest.mark.parametrize(
    "read",
    [
        lambda: STEPS.shift({"lat": 0.02}),
        lambda: STEPS.shift({"p": 0.01, "phi": 0.01}),
        lambda: STEPS.resample(0.01),
        lambda: STEPS.select(inputs=[]).join(STEPS.select(outputs=[])),
        lambda: flown(stepped(), "foh").shift({"lat": 0.01}),
        lambda: flown(np.sin(T), "foh").resample(0.1),
    ],
    ids=["a sample", "outputs", "twice as fast", "joined", "lines", "slow"],
)
def test_what_keeps_its_steps_and_lines_is_taken_in_silence(read):
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        read()


def test_corners_that_a_slower_record_cuts_are_told_with_their_size():
    with pytest.warns(
        DataWarning, match=r"every 0.1 s lat is no straight line, and up to \d+\.\d% is"
    ):
        flown(stepped(35), "foh").resample(0.1)
    # Straight lines between samples h apart leave ω² h² / 8 of a sine in the middle, by √(8 / 15)
    # as much in the mean: of 5 rad/s 2.3 % at 0.1 s.
    with pytest.warns(DataWarning, match=r"lat is no straight line, and up to 2\.[0-9]% is"):
        flown(np.sin(5 * T), "foh").resample(0.1)


def test_a_second_loggers_steps_stay_steps_and_what_it_lost_is_left_out():
    first, second = STEPS.select(inputs=[]), STEPS.select(outputs=[])
    joined = replace(first, hold="foh").join(second)
    assert joined.hold == "zoh"
    np.testing.assert_array_equal(joined.u, STEPS.u)
    gone = second.take((T < 5) | (T > 7))
    joined = first.join(gone)
    assert joined.N == gone.N
    assert np.isfinite(joined.u).all()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_what_moves_between_samples_that_are_kept_is_told_with_its_size(hold):
    u = stepped(35)  # every second step is with a sample that is left out
    kept = u[::2]
    rest = (kept[:-1] + np.append(kept[1:], kept[-1])[:-1]) / 2 if hold == "foh" else kept[:-1]
    between = np.append(rest, u[-1])
    off = np.zeros_like(u)
    off[1::2] = between - u[1::2]
    share = np.std(off[:-1]) / np.std(u[:-1])
    assert share > 0.1
    said = (
        f"flown.*are kept lat moves otherwise, by up to {share:.1%}, which is lost: a step may be"
    )
    with pytest.warns(DataWarning, match=said):
        flown(u, hold).decimate(2)


def test_samples_that_tell_nothing_new_are_left_out_in_silence():
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        flown(stepped(26), "zoh").decimate(2)
        flown(np.sin(5 * T), "foh").decimate(5)  # of a sine ω² h² / 8 is off in the middle: 3 %
