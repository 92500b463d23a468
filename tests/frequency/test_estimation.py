"""Frequency responses from records: theory of their errors, the UH-60 sweeps."""

import dataclasses
import warnings

import numpy as np
import pytest
import scipy.signal
from truths import uh60
from truths.systems import DT, LAG, TWO, white

from casid import DataWarning, Record, SpectralAnalysis, StateSpace, frequency_response
from casid.frequency.spectra import condition, record_spectra
from casid.linear import foh_step

OMEGA = np.geomspace(0.7, 12.0, 40)


@pytest.fixture(scope="module")
def swept():
    """Three times the linear helicopter's noisy sweeps and the responses found of them."""
    clean = [uh60.linear_sweep(axis) for axis in uh60.INPUTS]
    rngs = [np.random.default_rng(seed) for seed in range(3)]
    campaigns = [[record.with_noise(uh60.NOISE, rng) for record in clean] for rng in rngs]
    return [(records, frequency_response(records, omega=OMEGA)) for records in campaigns]


def relative(response, system):
    return response.G / system.response(response.omega) - 1


@pytest.mark.campaign
def test_bias_is_that_of_the_windows_bandwidth():
    """A Hann window averages G over its bandwidth: the bias is G''/2 times 4π²/(3T²)."""
    rng = np.random.default_rng(3)
    omega, T = np.array([1.1, 1.5, 2.0]), 12.0
    runs = [
        frequency_response(
            [white(LAG, rng, duration=1200.0)], omega=omega, windows=[T], method="windows"
        )
        for _ in range(20)
    ]
    mean = np.mean([relative(run, LAG)[:, 0, 0] for run in runs], axis=0)
    theory = -1 / (1 + 1j * omega) ** 2 * 4 * np.pi**2 / (3 * T**2)  # G''/(2G) of 1/(1 + jω)
    # Leakage acts as noise at about 0.01 a run; the next term of the series is a tenth of this.
    np.testing.assert_allclose(mean, theory, atol=4 * 0.01 / np.sqrt(20) + 0.1 * abs(theory[0]))


@pytest.mark.parametrize(
    ("method", "runs"), [("local", 40), pytest.param("windows", 80, marks=pytest.mark.campaign)]
)
@pytest.mark.campaign
def test_random_error_is_the_scatter_over_realisations(method, runs):
    rng = np.random.default_rng(4)
    omega = np.geomspace(2.0, 12.0, 8)
    asked = {"omega": omega, "windows": [10.0], "method": method}
    found = [frequency_response([white(LAG, rng, noise=0.2)], **asked) for _ in range(runs)]
    errors = np.array([relative(run, LAG)[:, 0, 0] for run in found])
    stated = np.mean([run.random_error[:, 0, 0] for run in found], axis=0)
    scatter = np.std(np.abs(1 + errors), axis=0)
    phase = np.std(np.angle(1 + errors), axis=0)
    # A standard deviation from 40 runs is known to 11 %, its mean over 8 frequencies to 4 %, to 3 %
    # from 80; Welch's exact factor for the Hann window is 0.528 where T&R have 0.55.
    assert np.mean(scatter / stated) == pytest.approx(1.0, abs=0.1)
    assert np.mean(phase / stated) == pytest.approx(1.0, abs=0.1)


@pytest.mark.campaign
def test_stated_errors_hold_with_few_windows():
    """Lengths are weighed by their errors: one that is too small by chance must not lead."""
    rng, omega, z = np.random.default_rng(17), np.geomspace(2.0, 12.0, 16), []
    asked = {"omega": omega, "windows": [12.0, 17.0, 24.0], "method": "windows"}
    for _ in range(60):
        found = frequency_response(white(LAG, rng, noise=0.05, duration=60.0), **asked)
        error = np.log(found.G / LAG.response(omega))
        z.append(np.abs([error.real, error.imag]) / found.error)
    # Some 1000 independent ones: their mean square is known to 4 or 5 %.
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.07)
    assert np.mean(np.array(z) < 1.96) == pytest.approx(0.95, abs=0.02)
    assert np.max(z) < 4.5


@pytest.mark.second
def test_coherence_is_the_share_of_the_output_that_the_input_explains():
    rng = np.random.default_rng(5)
    sigma = 0.3
    omega = np.geomspace(2.0, 12.0, 8)
    found = frequency_response(
        [white(LAG, rng, duration=4000.0, noise=sigma)], omega=omega, windows=[10.0]
    )
    signal = np.abs(LAG.response(omega)[:, 0, 0]) ** 2  # per unit of white input density
    # A linearly interpolated white sequence has the triangle's spectrum, sinc⁴; the samples of the
    # output then hold sinc² of the input's samples.
    theory = signal / (signal + sigma**2)
    np.testing.assert_allclose(found.coherence[:, 0, 0], theory, atol=0.03)
    np.testing.assert_allclose(found.multiple_coherence, found.coherence[:, :, 0], atol=1e-9)


@pytest.mark.slow
def test_errors_on_the_linear_helicopters_sweeps_are_those_stated(swept):
    truth = uh60.oracle().response(OMEGA)
    scores = []
    for _, found in swept:
        score = np.abs(found.G / truth - 1) / found.random_error
        scores.append(score[found.coherence >= 0.6])
    scores = np.concatenate(scores)
    # Real and imaginary part of one standard deviation each: the median of the modulus is 1.18,
    # 98.9 % lie below 3. Taking nu - 1 of 8 averages off for the conditioning makes the statement
    # up to 1/√(1 - 3/8) = 1.26 too large, bias below 1 rad/s too small: it adds to the tail.
    assert 1 / 1.3 < np.median(scores) / 1.18 < 1.15
    assert np.mean(scores < 3) > 0.93


@pytest.mark.second
def test_uh60_sweeps_agree_with_the_linearised_helicopter():
    omega = np.geomspace(0.5, 12.0, 40)
    found = frequency_response(uh60.sweeps(seed=0), omega=omega)
    ratio = found.G / uh60.oracle(delay=0.004).response(omega)
    for output, name in uh60.ON_AXIS:
        i, j = found.index(output, name)
        seen = found.coherence[:, i, j] >= 0.8
        assert seen.sum() > 30
        assert np.median(np.abs(20 * np.log10(np.abs(ratio[seen, i, j])))) < 1.0
        assert np.median(np.abs(np.degrees(np.angle(ratio[seen, i, j])))) < 7.0
    assert not found.flags
    assert found.condition.max() < 40


@pytest.mark.second
def test_conditioning_separates_inputs_that_move_together():
    rng = np.random.default_rng(7)
    mix = [[1.0, 0.0], [0.7, 0.7]]  # coherence 0.5 between the inputs
    record = white(TWO, rng, duration=2000.0, mix=mix)
    omega = np.geomspace(4.0, 12.0, 10)
    conditioned = frequency_response([record], omega=omega, windows=[20.0])
    alone = frequency_response([record], omega=omega, windows=[20.0], conditioned=False)
    # 100 averages; leakage is the only noise.
    assert np.abs(relative(conditioned, TWO)).max() < 0.1
    assert np.median(np.abs(relative(alone, TWO)[:, 1, 0])) > 0.3
    np.testing.assert_allclose(
        conditioned.condition, (1 + np.sqrt(0.5)) / (1 - np.sqrt(0.5)), rtol=0.35
    )


def test_one_axis_at_a_time_gives_the_figures_of_that_axis_records():
    rng = np.random.default_rng(9)
    first = white(TWO, rng, noise=0.5, mix=[[1.0, 0.0], [0.0, 0.0]], name="a")
    second = white(TWO, rng, noise=0.5, mix=[[0.0, 0.0], [0.0, 1.0]], name="b")
    omega = np.geomspace(3.0, 10.0, 6)
    both = condition(record_spectra([first, second], omega, 20.0), conditioned=True)
    alone = condition(record_spectra([first.select(inputs=["a"])], omega, 20.0), conditioned=True)
    np.testing.assert_allclose(both.Gxy[:, :, 0] / both.Gxx[:, :, 0], alone.response[:, :, 0])
    np.testing.assert_allclose(both.coherence[:, :, 0], alone.coherence[:, :, 0])
    # Conditioning costs one of all averages, here of 40.
    np.testing.assert_allclose(both.random_error[:, :, 0], alone.random_error[:, :, 0], rtol=1 / 40)


def test_inputs_nobody_can_separate_are_refused_by_name():
    rng = np.random.default_rng(10)
    record = white(TWO, rng, mix=[[1.0, 0.0], [0.999, 0.0001]])
    with pytest.warns(DataWarning, match=r"condition number above 1000.*they are NaN"):
        found = frequency_response([record], omega=np.geomspace(4, 10, 5), windows=[20.0])
    assert np.isnan(found.G).all()
    assert (found.condition > 1000).all()
    assert any("nothing separates them" in reason for reason in found.flags)


def test_inputs_hard_to_separate_are_flagged():
    record = white(TWO, np.random.default_rng(11), mix=[[1.0, 0.0], [1.0, 0.15]])
    with pytest.warns(DataWarning, match=r"condition number above 40 \(up to \d"):
        found = frequency_response([record], omega=np.geomspace(4, 10, 5), windows=[20.0])
    assert np.isfinite(found.G).all()
    assert list(found.flags.values()) == [(0, 1, 2, 3, 4)]


def test_an_input_that_never_moves_has_no_response():
    record = white(TWO, np.random.default_rng(12), mix=[[1.0, 0.0], [0.0, 0.0]])
    with pytest.warns(DataWarning, match="input 'b' never moves"):
        found = frequency_response([record], omega=np.geomspace(4, 10, 5))
    assert np.isnan(found.G[:, :, 1]).all()
    assert np.isfinite(found.G[:, :, 0]).all()


@pytest.mark.second
def test_an_output_that_never_moves_has_no_response():
    record = white(TWO, np.random.default_rng(12))
    dead = dataclasses.replace(record, y=record.y * [1.0, 0.0] + 0.3)
    with pytest.warns(DataWarning, match=f"output '{record.outputs[1]}' never moves: its row"):
        found = frequency_response([dead], omega=np.geomspace(4, 10, 5))
    assert np.isnan(found.G[:, 1]).all()
    assert np.isnan(found.multiple_coherence[:, 1]).all()
    first = record.select(outputs=record.outputs[:1])
    alone = frequency_response([first], omega=np.geomspace(4, 10, 5))
    np.testing.assert_allclose(found.G[:, 0], alone.G[:, 0])
    np.testing.assert_allclose(found.leakage[:, 0], alone.leakage[:, 0])


@pytest.mark.second
def test_windows_too_short_or_lossy_are_not_taken_for_inputs_that_move_together():
    record = white(TWO, np.random.default_rng(13), duration=120.0)
    y = record.y.copy()
    y[np.arange(100, 2300, 300)[:, None] + np.arange(40)] = np.nan  # 2 s of every 15 s
    lossy = dataclasses.replace(record, y=y)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frequency_response([lossy], omega=np.geomspace(1.0, 10, 9), windows=[6.0, 20.0])
    said = [str(each.message) for each in caught]
    assert any("leave too few windows" in each for each in said)
    assert not any("together" in each for each in said)


@pytest.mark.campaign
def test_several_windows_are_nearer_over_the_whole_band_than_any_one(swept):
    truth = uh60.oracle().response(OMEGA)

    def error(found):
        seen = found.coherence >= 0.6
        return np.sqrt(np.mean(np.log(np.abs(found.G / truth)[seen]) ** 2))

    for records, found in swept[:2]:
        for length in (19.14, 35.0):
            assert error(found) < error(frequency_response(records, omega=OMEGA, windows=[length]))


@pytest.mark.second
def test_inputs_held_by_steps_are_taken_as_steps():
    rng = np.random.default_rng(24)
    t = DT * np.arange(20001)
    u = np.repeat(rng.standard_normal((4001, 1)), 5, axis=0)[: len(t)]
    record = Record(t, u, LAG.simulate(t, u, hold="zoh"), ("u",), ("y",), hold="zoh")
    omega = np.array([2.0, 4.0, 6.0])
    stepped = relative(frequency_response([record], omega=omega, windows=[20.0]), LAG)
    smooth = dataclasses.replace(record, hold="foh")
    wrong = relative(frequency_response([smooth], omega=omega, windows=[20.0]), LAG)
    # Half a sample of delay is 0.15 rad at 6 rad/s; leakage over 150 averages leaves about 0.01.
    assert np.abs(stepped).max() < 0.03
    assert np.abs(wrong).max() > 0.1


def spoiled(record, rng, share=0.01, gaps=2, length=0.5):
    """The record with a share of all output samples lost one by one, and all of them in gaps."""
    y = record.y.copy()
    y[rng.random(y.shape) < share] = np.nan
    n = round(length / record.dt)
    for start in rng.integers(200, record.N - 200 - n, gaps):
        y[start : start + n] = np.nan
    return dataclasses.replace(record, y=y)


@pytest.mark.campaign
def test_losses_cost_next_to_nothing_and_the_stated_error_covers_what_they_do(swept):
    truth, rng = uh60.oracle().response(OMEGA), np.random.default_rng(0)
    size, inside = [], []
    for records, whole in swept:
        with pytest.warns(DataWarning, match=r"up to 2.* % of an output's samples are missing"):
            holed = frequency_response([spoiled(each, rng) for each in records], omega=OMEGA)
        seen = (whole.coherence >= 0.6) & (holed.coherence >= 0.6)
        size.append([np.mean(np.abs(each.G / truth - 1)[seen] ** 2) for each in (whole, holed)])
        error = np.log(np.abs(holed.G / truth))[seen] / holed.error[seen]
        inside.append(np.mean(np.abs(error) < 1.96))
    clean, found = np.sqrt(np.mean(size, axis=0))
    assert found < 1.2 * clean
    assert 0.90 < np.mean(inside) < 0.985  # windows share samples: errors are stated a little large


@pytest.mark.campaign
def test_channels_at_rates_of_their_own_cost_what_their_noise_shows(swept):
    truth, (records, whole) = uh60.oracle().response(OMEGA), swept[0]
    step = np.array([{"a": 2, "p": 1, "q": 1, "r": 1}.get(name[0], 4) for name in uh60.OUTPUTS])
    step[uh60.OUTPUTS.index("phi")] = 4  # rates at 50 Hz, specific forces 25, attitudes 12.5
    rare = [each.mask(np.arange(each.N)[:, None] % step > 0) for each in records]
    with pytest.warns(DataWarning, match="samples are missing"):
        slow = frequency_response(rare, omega=OMEGA)
    seen = (whole.coherence >= 0.6) & (slow.coherence >= 0.6)
    clean, found = (np.abs(each.G / truth - 1)[seen] for each in (whole, slow))
    # Noise of attitudes has four times the density, that of specific forces twice.
    assert np.sqrt(np.mean(found**2)) < 1.5 * np.sqrt(np.mean(clean**2))
    inside = np.abs(np.log(np.abs(slow.G / truth))[seen]) < 1.96 * slow.error[seen]
    assert 0.9 < np.mean(inside) < 0.99


@pytest.mark.second
def test_windows_that_lack_samples_for_longer_than_a_period_are_left_out():
    record = white(LAG, np.random.default_rng(17), duration=1000.0)
    y = record.y.copy()
    y[5000:5100] = 1e3  # nobody may look at these
    y[5000:5100] = np.nan
    holed = dataclasses.replace(record, y=y)
    with pytest.warns(DataWarning, match="left out where they are missing for longer"):
        found = frequency_response(holed, omega=np.array([2.0, 4.0]), windows=[20.0])
    parts = [holed.take(slice(5000)), holed.take(slice(5100, None))]
    apart = frequency_response(parts, omega=np.array([2.0, 4.0]), windows=[20.0])
    # At 4 rad/s 5 s are three periods; at 2 rad/s 1.6. The windows lie a little otherwise.
    assert np.abs(found.G / apart.G - 1).max() < 0.03
    assert np.abs(relative(found, LAG)).max() < 0.1
    y[::2] = np.nan
    y[1::400] = np.nan
    y[np.arange(len(y)) % 400 < 200] = np.nan
    with pytest.raises(ValueError, match=r"missing samples \(NaN\) in 'y'"):
        frequency_response(dataclasses.replace(record, y=y), omega=np.array([2.0]), windows=[20.0])


def test_frequencies_below_the_longest_window_are_flagged():
    record = white(LAG, np.random.default_rng(21))
    with pytest.warns(DataWarning) as caught:
        found = frequency_response([record], omega=np.array([0.2, 0.5, 2.0]), windows=[20.0])
    assert np.isnan(found.G[0]).all()
    assert np.isfinite(found.G[1:]).all()
    assert sorted(found.flags.values()) == [(0,), (1,)]
    assert len(caught) == 2


def test_records_in_which_nothing_moves_are_refused():
    t = DT * np.arange(1000)
    still = Record(t, np.zeros((1000, 1)), np.zeros((1000, 1)), ("u",), ("y",))
    with pytest.raises(ValueError, match="no input moves"):
        frequency_response([still], omega=np.array([1.0]))


def test_the_value_and_the_door_find_the_same_and_nobody_writes_into_it():
    record = white(LAG, np.random.default_rng(21), duration=60.0)
    door = frequency_response(record, omega=np.array([1.0, 2.0]), windows=[15.0])
    value = SpectralAnalysis(omega=np.array([1.0, 2.0]), windows=[15.0]).fit([record])
    np.testing.assert_array_equal(door.G, value.G)
    with pytest.raises(ValueError, match="read-only"):
        door.G[0] = 0.0


def test_a_number_stands_only_beside_a_reason_that_has_one():
    record = white(LAG, np.random.default_rng(0), duration=60.0)
    with pytest.warns(DataWarning, match=r"less than 2 periods in the longest window \(\d+ s\)$"):
        frequency_response(record, omega=np.array([1.0, 2.0, 3.0]))


# ---- references --------------------------------------------------------------------------------


def in_loop(seed, duration=300.0):
    """Two axes flown under feedback, noise in the loop, with the set points r recorded.

    x' = A x + B u sampled exactly for straight inputs; u = lag (r − K y) as the noise goes round.
    """
    rng = np.random.default_rng(seed)
    plant = StateSpace(
        [[-1.5, 0.4], [-0.3, -2.5]], [[3.0, 0.5], [0.4, 4.0]], np.eye(2), np.zeros((2, 2)), None,
        ("a", "b"), ("p", "q"),
    )  # fmt: skip
    K = np.array([[1.2, 0.3], [0.2, 0.8]])
    N = round(duration / DT)
    r = np.cumsum(rng.standard_normal((2, N)), axis=1)
    r = scipy.signal.lfilter([0.1], [1, -0.9], np.diff(r, prepend=0.0)).T * 1.5
    e = scipy.signal.lfilter([0.1], [1, -0.9], rng.standard_normal((2, N))).T
    Ad, B0, B1 = foh_step(plant.A, plant.B, DT)
    x, u = np.zeros(2), np.zeros(2)
    us, ys = np.empty((N, 2)), np.empty((N, 2))
    for k in range(N):
        ys[k], us[k] = x + e[k], u
        after = 0.8 * u + 0.2 * (r[k] - K @ ys[k])
        x, u = Ad @ x + B0 @ u + B1 @ after, after
    columns = np.hstack([us, r])
    return plant, Record(DT * np.arange(N), columns, ys, ("a", "b", "ra", "rb"), ("p", "q"))


REFERENCES = ("ra", "rb")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*noise that is fed back into it:casid.errors.DataWarning")
def test_a_recorded_reference_removes_the_bias_of_feedback_and_states_its_error():
    omega = np.geomspace(1.5, 8.0, 7)
    joint, stated = [], []
    for seed in range(16):
        plant, record = in_loop(seed)
        kept = {"omega": omega, "windows": [15.0, 20.0]}
        truth = plant.response(omega)
        found = frequency_response(record, reference=REFERENCES, **kept)
        assert (found.inputs, found.outputs) == (("a", "b"), ("p", "q"))
        joint.append(found.G - truth)
        stated.append(found.random_error * np.abs(found.G))
        plain = frequency_response(record.select(inputs=("a", "b")), **kept)
        # Without it feedback makes half of the first axis's response, and says so.
        assert (np.isnan(plain.G) | (plain.leakage > 0.3))[:, 0, 0].all()
    left = np.abs(np.mean(joint, axis=0))
    std = np.std(joint, axis=0) / np.sqrt(2)  # of a real or imaginary part
    # A mean of 16 has a quarter of one run's error: squares of mean one, scattered by one, of which
    # some ten of the 28 are independent.
    assert np.mean((left / (std * np.sqrt(2) / 4)) ** 2) < 2
    # Each deviation of 16 runs is known to 13 %, their median over 28 to half of that or better.
    ratio = std / np.median(stated, axis=0)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
    assert ((ratio > 0.6) & (ratio < 1.6)).all()


def spoilt(seed, kind):
    """In the loop for two minutes, its references as they are or as they should not be."""
    plant, record = in_loop(seed, duration=120.0)
    u = record.u.copy()
    if kind == "one of another flight":
        u[:, 3] = in_loop(seed + 50, duration=120.0)[1].u[:, 3]
    elif kind == "fed back":
        u[:, 2:] -= 2 * record.y
    return plant, dataclasses.replace(record, u=u)


@pytest.mark.second
@pytest.mark.filterwarnings("ignore::casid.errors.DataWarning")
@pytest.mark.parametrize("kind", ["as it is", "one of another flight", "fed back"])
def test_references_that_move_no_input_or_are_fed_back_tell_nothing_wrong(kind):
    omega, off = np.geomspace(1.5, 8.0, 7), []
    for seed in range(4):
        plant, record = spoilt(seed, kind)
        found = frequency_response(record, omega=omega, windows=[15.0, 20.0], reference=REFERENCES)
        told = [reason for reason in found.flags if "hardly move" in reason]
        assert any("fed back into" in reason for reason in found.flags) == (kind == "fed back")
        if kind != "fed back":
            foreign = kind != "as it is"
            assert np.isnan(found.G[:, :, 1]).all() == foreign
            assert any("'b'" in reason for reason in told) == foreign
        assert np.isnan(found.G).mean() < 0.2 or kind != "as it is"
        std = np.hypot(np.sqrt(2) * found.random_error, found.leakage) * np.abs(found.G)
        off.append(np.abs(found.G - plant.response(omega)) / std)
    assert np.nanmax(off) < 3
    assert kind == "fed back" or np.sqrt(np.nanmean(np.square(off))) < 1.1


def test_what_references_give_of_an_input_is_an_f_of_one_by_chance():
    rng, omega = np.random.default_rng(4), np.linspace(5.0, 40.0, 200)
    record = white(LAG, rng, duration=300.0)
    for part in (0.0, 0.5):
        r = part * record.u + rng.standard_normal(record.u.shape)
        both = dataclasses.replace(record, u=np.hstack([record.u, r]), inputs=("u", "r"))
        spectra = record_spectra([both], omega, 10.0, references=1)
        found = condition(spectra, conditioned=True)
        Grr, Gru, _ = (each[0, :, 0, 0] for each in spectra.references)
        shared = np.abs(Gru) ** 2 / (Grr * spectra.Guu[0, :, 0, 0]).real
        count = spectra.averages[0] / 0.55 - 1
        np.testing.assert_allclose(found.driven[:, 0], count * shared / (1 - shared), rtol=1e-9)
    r = rng.standard_normal(record.u.shape)
    alone = dataclasses.replace(record, u=np.hstack([record.u, r]), inputs=("u", "r"))
    chance = condition(record_spectra([alone], omega, 10.0, references=1), conditioned=True)
    # Some fifty bands of 0.4 rad/s, each exponential: a mean that scatters by a seventh.
    assert np.mean(chance.driven) == pytest.approx(1.0, abs=0.45)


@pytest.mark.second
def test_a_reference_that_is_the_input_changes_nothing():
    rng = np.random.default_rng(8)
    record = white(TWO, rng, duration=300.0, noise=0.2)
    lengths = [10.0, 15.0]
    twice = dataclasses.replace(
        record, y=np.hstack([record.y, record.u]), outputs=(*record.outputs, "ra", "rb")
    )
    for method, rounding in (("windows", 1e-6), ("local", 0.05)):  # errors of poles are shared
        kept = {"omega": [1.0, 3.0], "windows": lengths, "method": method}
        plain = frequency_response(record, **kept)
        found = frequency_response(twice, reference=REFERENCES, **kept)
        for name in ("G", "coherence", "condition"):
            np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-6)
        for name in ("random_error", "input_correlation"):
            own, other = getattr(found, name), getattr(plain, name)
            np.testing.assert_allclose(own, other, rtol=rounding, atol=rounding * 1e-2)
        assert found.fingerprints == plain.fingerprints


def test_signs_and_order_of_references_change_nothing():
    _, record = in_loop(3, duration=120.0)
    wrong = dataclasses.replace(record, u=record.u * np.array([1, 1, -1, 1]))
    kept = {"omega": [2.0, 4.0], "windows": [10.0, 15.0]}
    right = frequency_response(record, reference=REFERENCES, **kept)
    found = frequency_response(wrong, reference=REFERENCES[::-1], **kept)
    for name in ("G", "coherence", "random_error", "condition"):
        np.testing.assert_allclose(getattr(found, name), getattr(right, name), rtol=1e-8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reference": ("ra", "rc")}, "no channel 'rc'; they have a, b, ra, rb, p, q"),
        ({"reference": ("ra",)}, r"one moving reference for each input that moves \(a, b, rb\)"),
        ({"reference": REFERENCES, "conditioned": False}, "does not go with a reference"),
        ({"reference": ("a", "b", "ra", "rb")}, "leaves no input or no output"),
    ],
)
def test_references_that_cannot_be_are_refused(options, message):
    _, record = in_loop(0, duration=60.0)
    with pytest.raises(ValueError, match=message):
        frequency_response(record, omega=[2.0, 3.0], **options)


@pytest.mark.second
def test_windows_longer_than_all_records_of_an_input_do_not_count():
    # A long record moves b at 2 rad/s and else in answer to the output; those that do are short.
    rng, omega = np.random.default_rng(6), np.array([2.0, 4.0])
    A, B, C, D = *(scipy.linalg.expm(DT * TWO.A), DT * TWO.B), TWO.C, TWO.D
    records = []
    for name, duration, mover in (("long", 300.0, 0), ("one", 90.0, 1), ("other", 90.0, 1)):
        N, x = round(duration / DT), np.zeros(2)
        u, y = np.zeros((N, 2)), np.zeros((N, 2))
        for k in range(N):
            y[k] = C @ x + D @ u[k]
            u[k, mover] = rng.standard_normal()
            u[k, 1 - mover] = -0.5 * y[k, 0]
            u[k, 1] += 2.0 * np.sin(2.0 * DT * k) * (name == "long")
            x = A @ x + B @ u[k]
        records.append(Record(DT * np.arange(N), u, y, TWO.inputs, TWO.outputs, name, hold="zoh"))
    z = np.exp(1j * omega * DT)
    steps = np.array([C @ np.linalg.solve(s * np.eye(2) - A, B) for s in z])
    truth = steps * (1j * omega * DT / (1 - np.exp(-1j * omega * DT)))[:, None, None]
    short = frequency_response(records, omega=omega, windows=[20.0], method="windows")
    both = frequency_response(records, omega=omega, windows=[20.0, 120.0], method="windows")
    for found in (short, both):
        np.testing.assert_allclose(found.G, truth, atol=0.15 * np.abs(truth).max())
        assert not found.flags
        assert found.condition.max() < 5
    np.testing.assert_allclose(both.G[1], short.G[1], rtol=1e-9)
    assert np.all(np.abs(both.G[0] - short.G[0]) > 1e-9)  # where the long windows count
    assert both.windows == (20.0, 120.0)
