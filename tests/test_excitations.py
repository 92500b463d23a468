"""Shares from outside against closed forms of simulated loops, and what is doubted."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from truths import uh60

from benchmarks.excitation import DT, RATIOS, flown, share
from casid import Excitation, Record, excitation, pbsid
from casid.commands.inspection import inspect_records
from casid.excitations import at_slowest, outside_shares, wide_bands
from casid.values import decode, encode
from casid.vector_autoregression import of_flights, of_records


@pytest.mark.slow
@pytest.mark.parametrize("axes", [pytest.param(1, marks=pytest.mark.campaign), 4])
def test_the_share_from_outside_is_that_of_the_loop(axes):
    worst = []
    for seed, ratio in enumerate(RATIOS):
        found = excitation(flown(axes, ratio, seed=seed))
        inside = found.within.all(axis=1)
        error = np.abs(found.lower - share(axes, ratio, found.omega))[inside]
        worst.append((np.sqrt(np.mean(error**2)), error.max()))
    # The gate: a tenth, which is some three standard errors of an autoregression's spectrum.
    assert max(rms for rms, _ in worst) < 0.04
    assert np.median([largest for _, largest in worst]) < 0.06
    assert max(largest for _, largest in worst) < 0.1


def test_a_loop_that_noise_drives_is_doubted_and_a_flown_one_is_not():
    said = excitation(flown(1, 0.05)).doubts()
    assert "Of input u0 only" in said[0]
    assert "controller's inverse" in said[0]
    assert excitation(flown(1, 20.0)).doubts() == ()


def test_one_flown_axis_whose_feedback_moves_the_others_excites_only_itself():
    found = excitation(flown(3, (20.0, 0.0, 0.0)))
    assert [each.split()[2] for each in found.doubts() if each.startswith("Of input")] == [
        "u1",
        "u2",
    ]
    assert found.joint.max() < 0.01


def test_an_axis_that_only_another_moves_tells_nothing_though_that_moves_it_from_outside():
    found = excitation(flown(2, (200.0, 0.0), N=3000))
    low = found.omega < 10
    assert found.lower[low, 1].min() > 0.5  # u0's test moves the axis that feedback holds
    assert found.fed_back(("u1", "u0"), found.omega).T.tolist() == [[True] * 60, [False] * 60]
    alone, together = found.doubts()
    assert alone.startswith("Of input u1 only")
    assert "are not moved independently from outside" in together
    flown_too = excitation(flown(2, (200.0, 5.0), N=3000))
    assert not flown_too.fed_back(("u0", "u1"), found.omega).any()


def test_inputs_that_move_alike_are_not_excited_together():
    rng = np.random.default_rng(1)
    w = rng.standard_normal(4000)
    y = np.convolve(w, 0.1 * 0.9 ** np.arange(100))[: len(w)] + 0.05 * rng.standard_normal(len(w))
    u = np.column_stack([w, w + 0.01 * rng.standard_normal(len(w))])
    late = np.concatenate([[0.0], y[:-1]])[:, None]
    (said,) = excitation(Record(DT * np.arange(len(w)), u, late, ("a", "b"), ("p",))).doubts()
    assert "are not moved independently from outside" in said


@pytest.mark.second
def test_an_autopilot_that_is_shaken_by_hand_is_no_aircraft():
    rng = np.random.default_rng(3)
    y = np.zeros((3000, 2))
    for k in range(2, len(y)):
        y[k] = 1.9 * y[k - 1] - 0.92 * y[k - 2] + 0.1 * rng.standard_normal(2)
    u = -0.2 * y + 0.01 * rng.standard_normal(y.shape)
    record = Record(0.01 * np.arange(len(y)), u, y, ("roll", "pitch"), ("p", "q"), "bench")
    said = excitation(record).doubts()
    assert sum("controller's inverse" in each for each in said) == 2
    assert set(said) <= set(inspect_records(record).advice)
    assert set(said) <= set(pbsid(record, order=4, pole=20.0, past=6).doubts())


def test_an_output_of_noise_alone_answers_nothing():
    u, y = np.random.default_rng(8).standard_normal((2, 2000, 2))
    u = np.cumsum(u, axis=0) * 0.1
    (said,) = excitation(Record(DT * np.arange(2000), u, y, ("a", "b"), ("p", "q"))).doubts()
    assert said.startswith("No output responds to the inputs")
    found = excitation(flown(1, 20.0))
    assert found.answer[0] > 0.6


def test_a_rate_that_something_unmeasured_moves_is_told():
    record = flown(1, 20.0)
    y = record.y + 3 * record.y.std() * np.random.default_rng(6).standard_normal(record.y.shape)
    both = Record(
        record.t, record.u, np.hstack([record.y, y]), record.inputs, ("q", "p"), "shaking"
    )
    (said,) = excitation(both).doubts()
    found = re.match(r"The inputs explain only (\d+)% of p", said)
    assert 5 <= int(found[1]) <= 10  # of 1/(1 + 3²) that goes with q
    assert excitation(both.select(outputs=("q",))).doubts() == ()


def test_inputs_that_move_while_all_rests_are_told_with_their_time():
    record = flown(1, 20.0, N=1000)
    y = record.y.copy()
    y[500:] = 1e-4 * np.random.default_rng(2).standard_normal((500, 1))
    lying = Record(record.t, record.u, y, record.inputs, record.outputs, "lying")
    ((name, start, end),) = excitation(lying).unanswered
    assert name == "lying"
    assert (start, end) == pytest.approx((10.0, 19.98))
    assert (
        "lying: at 10-19.98 s the inputs move but no output does" in excitation(lying).doubts()[0]
    )


@pytest.mark.slow
def test_the_campaign_of_the_uh60_is_accepted_and_without_noise_nothing_is_said():
    measured = uh60.sweeps(seed=6)
    found = excitation(measured)
    assert found.doubts() == ()
    assert not found.singular
    assert (
        found.lower[found.within].min() > 0.6
    )  # least below 1 rad/s, where the sweeps hardly begin
    clean = excitation(uh60.sweeps())
    assert clean.singular
    assert clean.doubts() == ()
    assert "exactly predictable" in str(clean)


def test_a_record_too_short_or_at_rest_is_refused_and_never_stops_a_black_box():
    record = flown(2, 1.0, N=40)
    with pytest.raises(ValueError, match="too few to tell feedback"):
        excitation(record)
    still = Record(record.t, 0 * record.u, record.y, record.inputs, record.outputs)
    with pytest.raises(ValueError, match="no input or no output moves"):
        excitation(still)


def test_without_an_input_that_moves_the_headline_is_a_sentence():
    found = excitation(flown(1, 20.0))
    none = replace(found, within=np.zeros_like(found.within))
    assert none.headline() == "no input moves enough to tell what share of it comes from outside"


@pytest.mark.filterwarnings("ignore:.* no straight line:casid.DataWarning")
def test_lost_samples_uneven_intervals_and_slower_records_are_taken():
    record = flown(1, 1.0)
    clean = excitation(record)
    y = np.where(np.random.default_rng(5).random(record.y.shape) < 0.05, np.nan, record.y)
    lossy = Record(record.t, record.u, y, record.inputs, record.outputs)
    found = excitation([lossy, record.resample(0.03)], omega=clean.omega[clean.omega < 60])
    inside = clean.within[: len(found.omega)]
    error = np.abs(found.lower - clean.lower[: len(found.omega)])[inside]
    assert np.median(error) < 0.1


def test_bands_are_told_from_edge_to_edge():
    omega = np.geomspace(1, 10, 11)
    assert wide_bands(omega, omega > 5) == [(pytest.approx(10**0.7), pytest.approx(10))]
    assert wide_bands(omega, np.arange(11) == 3) == []


def test_inputs_are_to_move_together_where_one_of_them_has_its_power():
    K, within = 6, np.array([[0, 1, 1, 0, 0, 0], [0, 0, 1, 1, 0, 0]], dtype=bool).T
    ones = np.ones(2)
    found = Excitation(
        inputs=("lat", "ped"), outputs=("p", "r"), omega=np.arange(1.0, K + 1),
        lower=np.ones((K, 2)), upper=np.ones((K, 2)), joint=np.array([0, 0, 0, 1, 0, 0.0]),
        answer=ones, coherence=ones, within=within, lags=4,
    )  # fmt: skip
    (said,) = found.doubts()
    assert "At 2-3 rad/s the inputs lat, ped are not moved independently from" in said


def test_a_certificate_can_be_stored():
    found = excitation(flown(1, 0.05, N=2000))
    again = decode(encode(found))
    assert again.doubts() == found.doubts()


def looped(K, outside, seed, N=6000):
    """A record of one axis under feedback K, y moved by noise and u by some outside power."""
    rng = np.random.default_rng(seed)
    e, w = rng.standard_normal((2, N))
    y, u, x, v, r = np.zeros(N), np.zeros(N), 0.0, 0.0, 0.0
    for k in range(N):
        v, r = 0.9 * v + 0.1 * e[k], 0.8 * r + 0.2 * np.sqrt(outside) * w[k]
        y[k] = x + v
        u[k] = r - K * y[k]
        x = 0.96 * x + 0.05 * u[k]
    return Record(DT * np.arange(N), u[:, None], y[:, None], ("u",), ("q",), f"gain {K}")


def outside_share(records, omega):
    """Closed form over several flights: outside power of the input over all of it."""
    z = np.exp(1j * omega * DT)
    parts = []
    for K, outside in records:
        S = 1 / (1 + K * 0.05 / (z - 0.96))
        r, v = 0.2 / (1 - 0.8 / z), 0.1 / (1 - 0.9 / z)
        parts.append((outside * np.abs(S * r) ** 2, np.abs(S * K * v) ** 2))
    own, back = np.sum(parts, axis=0)
    return own / (own + back)


def test_flights_under_other_feedback_are_judged_one_by_one():
    loops = [(0.3, 0.01), (4.0, 0.01), (1.2, 0.01)]
    flights = [looped(*each, seed=k) for k, each in enumerate(loops)]
    found = excitation(flights)
    inside = found.within[:, 0]
    truth = outside_share(loops, found.omega)[inside]
    # 18 000 samples of a loop that noise drives: the spread of one such share is about 0.05.
    np.testing.assert_allclose(found.lower[inside, 0], truth, atol=0.1)
    assert "Of input u only" in found.doubts()[0]
    columns = [np.hstack([each.y, each.u]) for each in flights]
    none = np.zeros(1, dtype=bool)
    pooled = outside_shares([of_records(columns, DT)], none, found.omega * DT)[0][inside, 0]
    assert np.median(pooled - truth) > 0.3  # what tells the flights apart, taken for excitation


def jumping(K, force="az"):
    """3-2-1-1 as sharp steps: q and az answer, az in the same sample, and q alone is fed back."""
    rng, flights = np.random.default_rng(int(K)), []
    for k in range(3):
        N = 3000
        steps = np.sign(np.sin(np.cumsum(rng.uniform(0.02, 0.12, N)))) * (np.arange(N) > 200)
        y, u, x, v = np.zeros((N, 2)), np.zeros(N), 0.0, 0.0
        for i in range(N):
            v = 0.9 * v + 0.002 * rng.standard_normal()
            q = x + v
            u[i] = 0.1 * steps[i] - 0.1 * K * q
            y[i] = q, -5.0 * u[i] + 2.0 * q + 0.05 * rng.standard_normal()
            x = 0.96 * x + 0.05 * u[i]
        flights.append(Record(DT * np.arange(N), u[:, None], y, ("lon",), ("q", force), f"{k}"))
    return flights


@pytest.mark.parametrize("K", [0.0, 3.0])
def test_a_force_that_feels_the_stick_at_once_is_no_feedback(K):
    flights = jumping(K)
    found = excitation(flights)
    inside = found.within[:, 0]
    assert not [each for each in found.doubts() if "Of input" in each]
    assert found.lower[inside, 0].min() > 0.8
    driven = [looped(4.0, 0.0, seed=k) for k in range(2)]  # and a loop that nobody flies is told
    rng = np.random.default_rng(1)
    felt = [
        Record(
            each.t, each.u, np.hstack([each.y, each.u + 0.01 * rng.standard_normal(each.u.shape)]),
            each.inputs, ("q", "az"), each.name,
        )
        for each in driven
    ]  # fmt: skip
    assert excitation(felt).lower[:, 0].max() < 0.3


def test_outputs_that_jump_with_the_inputs_may_have_any_name():
    flights = jumping(0.0, "nz")
    assert "Of input lon only" in excitation(flights).doubts()[0]
    found = excitation(flights, direct=["nz"])
    np.testing.assert_array_equal(found.lower, excitation(jumping(0.0)).lower)
    black_box = pbsid(flights, order=1, pole=4.0, past=8, feedthrough=["nz"], refine=False)
    np.testing.assert_array_equal(black_box.excitation.lower, found.lower)


def test_samples_that_a_slower_sensor_repeats_tell_no_excitation():
    loop = looped(4.0, 0.0, seed=3, N=12000)
    fresh = excitation(loop)
    held = loop.y[np.arange(loop.N) // 4 * 4]
    repeats = Record(loop.t, loop.u, held, loop.inputs, loop.outputs, "held")
    found = excitation(repeats)
    low = found.omega < 0.2 * np.pi / DT / 4
    assert fresh.lower[low, 0].max() < 0.1
    assert found.lower[low, 0].max() < 0.3


@pytest.mark.parametrize("every", [5, 10])
def test_what_a_slower_sensor_repeats_is_no_feedback(every):
    # Drawn in straight lines between its samples an output moves before the stick that moves it.
    rng = np.random.default_rng(every)
    u = np.repeat(rng.choice([-1.0, 1.0], size=216), 37)
    p = signal.lfilter([0, 0.02], [1, -0.96], u)
    y = np.column_stack([p, 0.02 * np.cumsum(p)]) + 0.005 * rng.standard_normal((len(u), 2))
    held = y[np.arange(len(u)) // every * every]
    record = Record(0.02 * np.arange(len(u)), u[:, None], held, ("lat",), ("p", "phi"), "held")
    found = excitation(record)
    assert not found.doubts()


@pytest.mark.parametrize(
    ("every", "first", "kept"),
    [((2, 4), (0, 2), 15), ((2, 2), (0, 1), 60), ((3, 4), (0, 0), 60), ((1, 1), (0, 0), 60)],
)
def test_records_are_thinned_where_all_outputs_are_measured_together(every, first, kept):
    y = np.random.default_rng(1).standard_normal((60, 2))
    for j in range(2):
        y[np.arange(60) % every[j] != first[j] % every[j], j] = np.nan
    record = Record(0.1 * np.arange(60), np.ones((60, 1)), y, ("u",), ("p", "q"), "slow")
    assert kept == at_slowest(record).N


def test_flights_that_agree_share_one_autoregression():
    flights = [looped(1.0, 0.5, seed) for seed in range(3)]
    columns = [np.hstack([each.y, each.u]) for each in flights]
    assert len(of_flights(columns, DT)) == 1
    other = looped(1.0, 5.0, 3)  # the same feedback, more from outside
    assert len(of_flights([*columns, np.hstack([other.y, other.u])], DT)) == 4
    short = [z[:60] for z in columns]
    assert len(of_flights([columns[0], *short], DT)) == 1


@pytest.mark.parametrize("N", [900, 3000])
def test_what_goes_with_inputs_by_chance_counts_for_nothing(N):
    """Of outputs of their own, and of one half of which the first input makes."""
    rng = np.random.default_rng(N)
    u, v = (signal.lfilter([1.0], [1.0, -1.6, 0.8], x, axis=0) for x in rng.normal(size=(2, N, 3)))
    v[:, 2] += np.append(0.0, u[:-1, 0])
    record = Record(0.01 * np.arange(N), u, v, ["a", "b", "c"], ["p", "q", "r"], "chance")
    found = excitation(record)
    assert found.lags >= 3
    # Of 3 inputs in N/(2 lags) means; the power of a share scatters by some 1/√N of a resonance.
    np.testing.assert_allclose(found.coherence, [0.0, 0.0, 0.5], atol=3.0 / np.sqrt(N))
