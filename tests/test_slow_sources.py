"""Who estimates from outputs that repeat a slower source's samples is told, once."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from truths.roll_study import Truth

from casid import (
    DataWarning,
    Pbsid,
    Record,
    distortion,
    frequency_response,
    identify,
    output_error,
    pbsid,
    validate,
    without_repeats,
)
from casid.repeated_samples import repeated
from casid.slow_sources import held_outputs, repeats_told, tell_repeats

T = 0.01 * np.arange(2000)
WAVE = np.cumsum(np.random.default_rng(4).standard_normal(len(T)))


def held(x, every):
    """What a logger reads of a source that is ``every`` times slower."""
    return np.repeat(x[::every], every)[: len(x)]


def test_repeated_outputs_are_told_with_rates_records_and_the_delay_they_make():
    y = np.column_stack([WAVE, held(WAVE, 2), held(WAVE, 5)])
    flown = Record(T, WAVE[:, None], y, ("lat",), ("p", "q", "r"), "slow")
    said = repeats_told([flown])
    assert said.startswith("q, r repeat samples of a source slower than the logger: 20 to 50 Hz, ")
    assert "logged at 100 Hz. Treated" in said
    assert "delays up to 20 ms too long" in said  # samples are 0 to 40 ms old
    other = replace(flown, y=flown.y[:, [0, 0, 0]], name="quick")
    assert "r repeats samples of a source slower than the logger in record 'slow': 20 Hz" in (
        repeats_told([flown, other], {"p", "r"})
    )
    with pytest.warns(DataWarning, match=r'without_repeats; repeats = "mask" in \[channels\]'):
        tell_repeats([flown])


def test_neither_held_inputs_nor_counts_nor_rest_nor_masked_repeats_are_told():
    rest = np.where((T > 3) & (T < 12), WAVE, WAVE[300])
    y = np.column_stack([WAVE, np.round(WAVE), rest, np.zeros(len(T)), np.round(WAVE, 1)])
    names = ("p", "counted", "resting", "dead", "digits")
    flown = Record(T, held(WAVE, 5)[:, None], y, ("lat",), names, "flight", "zoh")
    assert not repeats_told([flown])
    slow = replace(flown, y=np.column_stack([held(WAVE, 5), y[:, 1:]]))
    assert repeats_told([slow]).startswith("p repeats")
    assert not repeats_told([without_repeats(slow)])
    assert not repeats_told([slow], names[1:])
    still = Truth().system().simulate(T, np.where(T < 3, 0.0, 0.1)[:, None])  # without noise
    assert not repeats_told([Record(T, WAVE[:, None], still, ("lat",), ("p", "phi"), "clean")])


def rolled(seed, amplitude=0.05, every=5):
    """A roll flown with a random stick, noise of 1 %, logged ``every`` times too fast."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(1500)
    lat = amplitude * np.repeat(rng.choice([-1.0, 0.0, 1.0], 60), 25)
    y = Truth().system().simulate(t, lat[:, None]) + 0.002 * rng.standard_normal((1500, 2))
    y = y[np.arange(1500) // every * every]
    return Record(t, lat[:, None], y, ("lat",), ("p", "phi"), f"{seed}")


def told(work):
    """What ``work`` says of repeats; whatever else is to be said of so short records."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        work()
    return [said for each in caught if "repeat samples" in (said := str(each.message))]


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(
    "estimate",
    [
        lambda flown: output_error(Truth(), flown),
        lambda flown: output_error(Truth(), flown, domain="frequency"),
        frequency_response,
        lambda flown: pbsid(flown, order=3),
        lambda flown: validate({"truth": Truth()}, flown),
    ],
    ids=["output error", "by transforms", "frequency response", "black box", "validation"],
)
def test_who_estimates_from_repeated_outputs_is_told_once(estimate):
    (said,) = told(lambda: estimate([rolled(1), rolled(2)]))
    assert said.startswith("p, phi repeat samples of a source slower than the logger: 10 Hz, ")
    assert not told(lambda: estimate([rolled(1, every=1), rolled(2, every=1)]))


@pytest.mark.slow
def test_a_chain_tells_of_all_its_records_at_once():
    chosen = Pbsid(order=3, pole=4.0, past=6, future=6, feedthrough=False)
    both = {"refinement": rolled(2), "sweeps": rolled(1), "settings": {"pbsid": chosen}}
    assert len(told(lambda: identify(Truth(), rolled(1), unseen=rolled(3), **both))) == 1


@pytest.mark.slow
def test_two_amplitudes_tell_once():
    flown = [rolled(seed, amplitude) for seed in (1, 2) for amplitude in (0.05, 0.1)]
    assert len(told(lambda: distortion(flown, omega=np.array([2.0, 3.0])))) == 1


def test_of_what_is_missing_already_the_rest_is_judged_by_its_own_interval():
    missing = np.arange(len(T)) % 2 == 1
    chance = WAVE.copy()  # three samples of a hundred are as the one measured before
    chance[np.arange(100, len(T), 66)] = chance[np.arange(100, len(T), 66) - 2]
    y = np.where(missing[:, None], np.nan, np.column_stack([chance, held(WAVE, 4)]))
    flown = Record(T, WAVE[:, None], y, ("lat",), ("p", "q"))
    assert repeated(flown)[:, 1].any()
    ((name, found),) = held_outputs(flown).items()
    assert name == "q"
    assert found.interval == pytest.approx(0.04, rel=0.02)
    assert found.logged == pytest.approx(0.02)
    assert found.late == pytest.approx(0.01, rel=0.05)
