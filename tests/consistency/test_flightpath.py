"""Kinematics of rigid bodies, against closed forms and rotation matrices."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from truths.flights import FORCES, RATES, STATES, truth

from casid.consistency.errors_in_variables import Corrected, Normal
from casid.consistency.flightpath import PLACED, _Reconstruction, _solved, reconstruct
from casid.consistency.measured import Flight


def of_record(found, record=0):
    """Gain, bias and skew of each channel in a record, and their errors, (channels, 3) each."""
    values = np.insert(found.unknowns, 1, found.biases[record], axis=1)
    return values, np.insert(found.errors, 1, found.bias_errors[record], axis=1)


def test_what_flights_do_not_tell_stays_where_it_was_expected():
    # A rate that stands still tells of its bias alone, and nothing of the accelerometers' place.
    attitude = 1e-3 * np.random.default_rng(2).standard_normal(500)
    found = reconstruct([Flight(0.02, 0, {"p": np.zeros(500), "phi": attitude})], ["phi"])
    assert found.channels == ("p",)
    ((gain, bias, skew),), (errors,) = of_record(found)
    assert (gain, skew) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert (errors[0], errors[2]) == pytest.approx((1.0, 0.1), rel=1e-3)
    assert abs(bias) < 4 * errors[1] < 0.01
    np.testing.assert_allclose(found.place, 0, atol=1e-6)
    np.testing.assert_allclose(found.place_errors, 10.0, rtol=1e-3)


OMEGA, PHASE = np.array([0.7, 1.1, 1.9, 2.6]), np.array([0.3, 2.0, 4.1, 5.2])


def waves(t, late=0.0, order=0):
    """Four sines of 0.1 each, so many seconds late, and derivatives; order -1 is the integral."""
    angle = OMEGA * (t[:, None] - late) + PHASE + order * np.pi / 2
    return np.sum(0.1 * OMEGA ** float(order) * np.sin(angle), axis=1)


def rolls(rng, lengths, noise):
    """Flights in which p reads 1.25 true + 0.05 and is 0.12 s late; the bank has noise."""
    found = []
    for n, begin in zip(lengths, (0.0, 40.0, 90.0), strict=False):
        t = begin + 0.02 * np.arange(n)
        bank = 0.2 + waves(t, 0.0, -1) + noise * rng.standard_normal(n)
        found.append(Flight(0.02, 0, {"p": 1.25 * waves(t, 0.12) + 0.05, "phi": bank}))
    return found


def test_a_rate_late_and_out_of_scale_is_found_as_by_nonlinear_least_squares():
    flights = rolls(np.random.default_rng(3), (900, 1500), 0.01)
    found = reconstruct(flights, ["phi"])

    def left(z):
        gain, bias, skew = z[:3]
        parts = []
        for flight, start, begin in zip(flights, z[3:], (0.0, 40.0), strict=True):
            t = flight.t
            # The integral of what p will have read: closed, but for its straight line.
            read = 1.25 * (waves(begin + t, 0.12 - skew, -1)) + 0.05 * t
            parts.append(flight.values["phi"] - (gain * read - bias * t + start))
        return np.concatenate(parts) / 0.01

    best = scipy.optimize.least_squares(left, [1, 0, 0, 0.2, 0.2], x_scale=[1, 1, 0.1, 1, 1])
    std = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))[:3]
    inside = [(0.8, 0.04, 0.12), best.x[:3]]
    for each, limit in zip(inside, (4.0, 0.5), strict=True):
        assert np.abs((of_record(found)[0] - each) / std).max() < limit
    (errors,) = of_record(found)[1]
    assert (errors > 0.9 * std).all()
    assert (errors < 1.4 * std).all()
    assert found.against == {"p": ("phi",)}
    assert [len(e) for e in found.left["phi"]] == [900, 1500]
    np.testing.assert_allclose([np.std(e) for e in found.left["phi"]], 0.01, rtol=0.1)


def test_biases_are_of_records_and_one_in_all_stretches_of_each():
    flights = rolls(np.random.default_rng(3), (900, 700, 1500), 0.01)
    flights[2] = replace(flights[2], record=4)
    flights[2].values["p"] -= 0.25
    found = reconstruct(flights, ["phi"])
    assert found.biases.shape == (2, 1)
    for k, bias in enumerate((0.04, 0.8 * -0.2)):  # after the gain
        values, errors = of_record(found, k)
        assert np.abs((values - [0.8, bias, 0.12]) / errors).max() < 4
    assert found.bias_errors.max() < 0.002
    np.testing.assert_allclose([np.std(e) for e in found.left["phi"]], 0.01, rtol=0.1)


LATER = dict(zip((*RATES, *FORCES), (0.3, -0.25, 0.2, 0.28, -0.3, 0.22), strict=True))
GAINS = dict(zip((*RATES, *FORCES), (0.7, 1.4, 0.8, 0.9, 1.2, 1.1), strict=True))
PLACE = np.array([0.8, -0.4, 0.5])


@pytest.mark.second
def test_far_skews_scales_and_a_lever_are_found_together_and_hold_where_they_are():
    signals, t = truth(2, duration=40.0)  # its ends, beyond which nothing is read, weigh little
    values = {name: signals(t)[name] for name in STATES}
    for name in RATES:
        values[name] = signals(t - LATER[name])[name] / GAINS[name] + 0.02
    for k, name in enumerate(FORCES):
        at = t - LATER[name]
        omega, before, after = (
            np.column_stack([signals(each)[rate] for rate in RATES])
            for each in (at, at - 1e-4, at + 1e-4)
        )
        turned = np.cross((after - before) / 2e-4, PLACE) + np.cross(omega, np.cross(omega, PLACE))
        values[name] = (signals(at)[name] + turned[:, k]) / GAINS[name] - 0.1
    found = reconstruct([Flight(0.02, 0, values)], STATES)
    assert found.channels == (*RATES, *FORCES)
    gain, skew = np.array([*GAINS.values()]), np.array([*LATER.values()])
    true = np.column_stack([gain, gain * [0.02, 0.02, 0.02, -0.1, -0.1, -0.1], skew])
    values, errors = of_record(found)
    assert np.abs((values - true) / errors).max() < 4
    assert np.abs((found.place - PLACE) / found.place_errors).max() < 4
    np.testing.assert_allclose(found.unknowns[:, 0], gain, rtol=3e-3)
    np.testing.assert_allclose(found.unknowns[:, 1], skew, atol=3e-3)
    np.testing.assert_allclose(found.place, PLACE, atol=0.1)


@pytest.mark.parametrize("late", [0.7, -0.7])
def test_no_skew_leaves_the_span_that_is_looked_at(late):
    t = 0.02 * np.arange(1000)
    phi, theta, late_rate = waves(t, 0, -1), waves(t, 1, -1), waves(t, late)
    flight = Flight(0.02, 0, {"p": late_rate, "q": waves(t, 1 + late), "phi": phi, "theta": theta})
    found = reconstruct([flight], ["phi", "theta"])
    np.testing.assert_allclose(found.unknowns[:, 1], np.sign(late) * 0.5, atol=1e-9)


# Of gain, and of skew where the noise is so little that it is told.
@pytest.mark.parametrize(("noise", "told"), [(0.1, 1), (0.02, 2)])
def test_where_the_steps_end_no_step_is_left_with_the_noise_drawn_there_anew(noise, told):
    rng = np.random.default_rng(3)
    flights = rolls(rng, (1500, 900), 0.002)
    for flight in flights:
        flight.values["p"] += noise * rng.standard_normal(len(flight.t))
    problem = _Reconstruction(flights, ("phi",))
    reach = np.array([1.0, 0.1, *np.full(PLACED + 3, 1.0)])
    x, own, blocks, corrected, _ = _solved(problem, reach)
    plain, _ = problem.normal(problem.whitened(blocks), own)
    prior = Normal(np.diag(reach**-2.0), reach**-2.0 * (np.eye(1, len(x))[0] - x))
    pretended = problem.pretended(x, own, plain)
    left = Corrected(plain + prior, pretended).step()
    errors = np.sqrt(np.diag(corrected.covariance(np.zeros((1, len(x))), reach)))
    assert np.all(np.abs(left[:told]) < 0.01 * errors[:told])


def test_a_skew_whose_error_is_made_wider_takes_along_what_depends_on_it(monkeypatch):
    flights = rolls(np.random.default_rng(3), (900, 1500), 0.01)
    errors = {}
    for times in (1.0, 3.0, 5.0):

        def wider(*given, times=times):
            found, skews = given[-2:]
            return found * np.where(np.isin(np.arange(len(found)), skews), times, 1.0)

        monkeypatch.setattr("casid.consistency.flightpath.ratio_errors", wider)
        errors[times] = reconstruct(flights, ["phi"]).errors[0]
    (gain, skew), (gain_3, skew_3), (gain_5, skew_5) = errors.values()
    assert (skew_3, skew_5) == pytest.approx((3 * skew, 5 * skew))
    # var(gain): that given the skew, which stays, and what the skew explains, as its own.
    assert gain_3 > gain
    assert (gain_5**2 - gain**2) / (gain_3**2 - gain**2) == pytest.approx((25 - 1) / (9 - 1))
