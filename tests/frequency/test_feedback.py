import numpy as np
import pytest

from benchmarks import coverage
from casid import DataWarning, Record, StateSpace, frequency_response
from casid.excitations import flights
from casid.frequency.covariance import whitener
from casid.frequency.feedback import NoiseInInputs, noise_in_inputs
from casid.frequency.response import FED_BACK
from casid.linear import foh_step

DT, LAG, NOISE = 0.02, 0.06, 0.04
OMEGA = np.array([16.0, 24.0, 32.0, 48.0])
PLANT = StateSpace(
    [[-2.5, 0.4, -0.6, 0.0], [-0.3, -1.2, 0.0, -0.8], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]],
    [[10.0, 1.0], [0.8, 6.0], [0.0, 0.0], [0.0, 0.0]], np.eye(2, 4), np.zeros((2, 2)), None,
    ("lat", "lon"), ("p", "q"),
)  # fmt: skip
GAIN = np.array([[0.3, 0.03], [0.03, 0.6]])
POLE = np.exp(-DT / LAG)


def loop(seed, gain=GAIN, *, held=False, direct=(0.0, 0.0), names=("p", "q"), seconds=16.0):
    """Doublets on each axis in turn, rates with white noise fed back through a lag, or at once.

    u follows r − K y: by lines one sample ahead, or held and of the present sample.
    """
    rng = np.random.default_rng(seed)
    Ad, B0, B1 = foh_step(PLANT.A, PLANT.B, DT)
    t, D = DT * np.arange(round(seconds / DT)), np.diag(direct)
    records = []
    for axis in range(2):
        r = np.zeros((len(t), 2))
        r[:, axis] = 0.1 * np.sign(np.sin(np.pi * t)) * ((t > 2) & (t < 6))
        x, u, us, ys = np.zeros(4), np.zeros(2), [], []
        for command in r:
            y = PLANT.C @ x + NOISE * rng.standard_normal(2)
            after = POLE * u + (1 - POLE) * (command - gain @ y)
            if held:
                u = after = command - gain @ y
            y = y + D @ u
            us.append(u)
            ys.append(y)
            x = Ad @ x + B0 @ u + B1 @ after
            u = after
        hold = "zoh" if held else "foh"
        records.append(Record(t, us, ys, PLANT.inputs, names, f"axis {axis}", hold))
    return records


def noise_of(omega, gain, *, held):
    """Closed form: white noise times the conjugate of what the loop makes of it in the inputs."""
    z = np.exp(1j * omega * DT)[:, None, None]
    G = PLANT.response(omega)
    if held:
        step = (1 - 1 / z) / (1j * omega[:, None, None] * DT)
        Ad, B0, B1 = foh_step(PLANT.A, PLANT.B, DT)
        G = PLANT.C @ np.linalg.inv(z * np.eye(4) - Ad) @ (B0 + B1)
        C = gain * np.ones_like(z)
    else:
        step, C = 1.0, (1 - POLE) / (z - POLE) * gain
    back = -np.linalg.inv(np.eye(2) + C @ G) @ C * step
    return NOISE**2 * DT * back.conj().swapaxes(1, 2)


@pytest.mark.second
@pytest.mark.parametrize("held", [False, True])
def test_noise_in_inputs_is_what_the_loop_makes_of_it(held):
    gain = (0.5 if held else 1.0) * GAIN
    found = [
        noise_in_inputs(loop(seed, gain, held=held, seconds=60.0), OMEGA).cross for seed in range(6)
    ]
    truth = noise_of(OMEGA, gain, held=held)
    size = np.abs(truth[:, [0, 1], [0, 1]])
    # Ten lags and 6000 samples: each is known to some tenths, their mean over six to half of that.
    error = np.abs(np.mean(found, axis=0) - truth)[:, [0, 1], [0, 1]] / size
    assert error.max() < 0.3


@pytest.mark.second
def test_without_feedback_there_is_none():
    for seed in range(10):
        for direct in ((0.0, 0.0), (0.5, 0.0)):
            records = loop(seed, 0 * GAIN, direct=direct, names=("p", "ay"))
            assert not noise_in_inputs(records, OMEGA).cross.any()


@pytest.mark.second
def test_what_inputs_leave_of_outputs_is_the_noise_where_none_is_fed_back():
    found = [noise_in_inputs(loop(seed, 0 * GAIN, seconds=60.0), OMEGA).left for seed in range(6)]
    # As the cross-spectrum above: a tenth or two by the mean over six.
    np.testing.assert_allclose(np.mean(found, axis=0), NOISE**2 * DT, rtol=0.3)


def test_there_is_no_more_noise_than_inputs_leave_within_an_octave():
    omega, ones = np.geomspace(1.0, 16.0, 11), np.ones((11, 1))  # two fifths of an octave apart
    noise = NoiseInInputs(omega, ones[:, :, None] + 0j, 4 * ones)
    left = np.array([8.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, np.nan])[:, None]
    assert noise.share(left)[:, 0].tolist() == [1.0, 1.0, 1.0] + 8 * [0.25]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casid.errors.DataWarning")
def test_few_lags_do_not_make_noise_of_a_helicopters_slow_motion():
    """Its loop feeds back the instruments' noise; below 0.9 rad/s that is a ten-thousandth."""
    plant = coverage.truths(None)["UH-60"]
    closed, omega = coverage.loop("UH-60", plant), np.geomspace(0.5, 1.0, 8)
    error, stated = [], []
    for seed in range(2):
        flown = coverage.flights("UH-60", closed, np.random.default_rng([seed, 70]))[:4]
        found = frequency_response(flown, omega=omega)
        seen = found.coherence >= 0.6
        assert np.isfinite(found.G).all()
        error.append(np.log(found.G / plant.response(omega))[seen])
        stated.append(found.error[seen])
    error, stated = np.concatenate(error), np.concatenate(stated)
    z = np.abs([error.real, error.imag]) / stated
    assert np.mean(z < 1.96) > 0.93
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.1


def test_a_direct_term_of_a_force_is_no_feedback():
    """Of held inputs under feedback of the other output."""
    gain = np.array([[0.0, 0.15], [0.0, 0.3]])
    both = [
        loop(1, gain, held=True, direct=(10.0, 0.0), names=n, seconds=60.0)
        for n in (("ay", "q"), ("p", "q"))
    ]
    force, rate = (np.abs(noise_in_inputs(each, OMEGA).cross[:, 0, 0]).max() for each in both)
    assert force < 0.1 * rate


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casid.errors.DataWarning")
def test_the_stated_error_holds_under_feedback():
    omega = np.geomspace(1.5, 100.0, 30)
    truth, off, without = PLANT.response(omega), [], []
    for seed in range(20, 30):
        found = frequency_response(loop(seed), omega=omega)
        seen = np.isfinite(found.G) & (found.coherence >= 0.6)
        error = np.log(np.where(seen, found.G / truth, np.nan))
        for part in (error.real, error.imag):
            off.append((np.abs(part) / found.error)[seen])
            without.append((np.abs(part) / found.random_error)[seen])
    off, without = np.concatenate(off), np.concatenate(without)
    assert len(off) > 400
    assert np.mean(off < 1.96) >= 0.9
    assert off.max() < 6
    assert np.mean(without < 1.96) < np.mean(off < 1.96)


def test_pairs_that_noise_rules_are_left_out_and_others_of_the_frequency_kept():
    gain = np.diag([0.0, 0.9])  # of pitch only
    omega = np.geomspace(2.0, 40.0, 12)
    with pytest.warns(DataWarning, match="noise that is fed back into it"):
        found = frequency_response(loop(3, gain), omega=omega)
    at = found.flags[FED_BACK.format("lon")]
    lost = np.isnan(found.G)
    np.testing.assert_array_equal(np.flatnonzero(lost[:, :, 1].any(axis=1)), at)
    assert np.isnan(found.coherence[lost]).all()
    assert np.isfinite(found.G[list(at), 0, 0]).any()
    wanted = np.zeros((2, 2), dtype=bool)
    wanted[0, 0] = True  # roll after lateral stick counts where pitch after longitudinal does not
    assert whitener(found, wanted).used[list(at), 0, 0].any()


def test_channels_that_rest_have_none():
    records = [
        Record(r.t, np.column_stack([r.u, 0 * r.t]), r.y, (*r.inputs, "ped"), r.outputs)
        for r in loop(2)
    ]
    found = noise_in_inputs(records, OMEGA).cross
    assert found[:, :, 2].tolist() == np.zeros((4, 2)).tolist()
    np.testing.assert_allclose(found[:, :, :2], noise_in_inputs(loop(2), OMEGA).cross, rtol=1e-9)


def test_together_flights_share_one_autoregression():
    assert len(flights(loop(4), together=True).models) == 1


def with_backlash(width):
    """Two sweeps, one reversed, of a first-order lag behind backlash, flown in open loop."""
    t, records = DT * np.arange(3000), []
    phase = 2 * np.pi * (0.06 * (t - 2) + 0.7 * (t - 2) ** 2 / 56)
    u = 0.05 * np.sin(phase) * (t > 2) * (t < 58) * np.clip((t - 2) / 3, 0, 1)
    rng = np.random.default_rng(1)
    for sign in (1, -1):
        played = [0.0]
        for command in sign * u[1:]:
            played.append(min(max(played[-1], command - width), command + width))
        y = StateSpace([[-2.0]], [[10.0]], [[1.0]], [[0.0]]).simulate(t, np.array(played)[:, None])
        y += 0.004 * rng.standard_normal(y.shape)
        records.append(Record(t, sign * u[:, None], y, ("lon",), ("q",), f"sweep {sign}"))
    return records


def test_what_looks_fed_back_in_open_loop_is_said_to_be_perhaps_nonlinear():
    assert np.isfinite(frequency_response(with_backlash(0.0)).G).all()
    with pytest.warns(DataWarning, match="fed back into it, or what no linear model follows"):
        found = frequency_response(with_backlash(0.015))
    assert np.isnan(found.G[list(found.flags[FED_BACK.format("lon")])]).all()
