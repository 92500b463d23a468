"""Samples that rest on an extreme, counted by hand; and what a study says of them."""

import numpy as np
import pytest
from truths.roll_study import write_study

from casid import DataWarning
from casid.exchange.formats import read_table, write_table
from casid.saturation import longest_stop, saturated
from casid.studies.study import read_records
from casid.studies.studyfile import read_study

T = 0.02 * np.arange(1000)
SWING = np.sin(2.1 * T) + 0.01 * np.random.default_rng(0).standard_normal(1000)


@pytest.mark.parametrize("end", [1, -1])
def test_a_sensor_at_the_end_of_its_range_is_there_as_long_as_it_reads_so(end):
    clipped = end * np.minimum(SWING, 0.7)
    beyond = SWING >= 0.7
    edges = np.flatnonzero(np.diff(np.concatenate([[0], beyond.astype(int), [0]])))
    assert longest_stop(clipped, stick=False) == np.diff(edges)[::2].max() > 20
    assert longest_stop(SWING, stick=False) == 0


def test_four_samples_are_none_and_a_channel_without_values_or_movement_neither():
    few = SWING.copy()
    few[500:504] = 2.0
    assert longest_stop(few, stick=False) == 0
    few[500:505] = 2.0
    assert longest_stop(few, stick=False) == 5
    assert longest_stop(np.full(50, 3.0), stick=False) == 0
    assert longest_stop(np.zeros(0), stick=False) == 0


def test_trim_is_no_stop_and_a_stick_has_its_own():
    held = np.concatenate([np.full(100, -2.0), SWING, np.full(80, -2.0)])
    assert longest_stop(held, stick=False) == 0
    assert longest_stop(np.clip(SWING, -0.7, 0.7), stick=True) == 0
    assert longest_stop(np.clip(2 * SWING, -1, 1), stick=True) > 20


@pytest.mark.parametrize("step", [0.01, 3e-3, 2e-3, 5e-4, 1e-4, 1e-9])
def test_a_smooth_channel_of_few_digits_turns_and_does_not_rest(step):
    turning = np.round(np.cos(0.3 * T) * np.exp(-0.05 * T) / step) * step
    assert longest_stop(turning, stick=False) == 0
    assert longest_stop(np.minimum(turning, 0.8), stick=False) == 0  # it begins there, as in trim
    assert longest_stop(np.maximum(turning, -0.4), stick=False) > 20


def test_what_is_counted_in_coarse_steps_rests_on_all_of_them():
    assert longest_stop(np.round(2 * SWING) / 2, stick=False) == 0
    assert longest_stop(np.round(40 * np.minimum(SWING, 0.7)) / 40, stick=False) > 20


def test_a_study_tells_it(tmp_path):
    study = write_study(tmp_path)
    file = next(iter(tmp_path.glob("**/*.csv")))
    table = read_table(file)
    write_table(file, table | {"p": np.minimum(table["p"], 0.6 * table["p"].max())})
    with pytest.warns(DataWarning, match=f"Record {file.stem}: p stays at its extreme value"):
        read_records(read_study(study))


def test_a_stick_stands_at_a_stop():
    assert saturated("one", "lat", 9, stick=True).startswith("one: lat stays at its extreme stop")


def test_a_slower_source_that_is_repeated_does_not_saturate():
    x = np.sin(0.3 * np.arange(300.0)) + 0.01 * np.random.default_rng(2).standard_normal(300)
    assert longest_stop(np.repeat(x, 10), stick=False) == 0
    assert longest_stop(np.repeat(np.minimum(x, 0.8), 10), stick=False) >= 40
    assert longest_stop(np.repeat(np.clip(1.01 * x, -1, 1), 10), stick=True) == 20
