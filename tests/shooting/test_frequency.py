"""Output error on the transforms of whole records, against the time domain and the truth."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import (
    NAMES,
    NOISE,
    TRUTH,
    Roll,
    campaign,
    flown,
    off,
    relative_error,
)

from casid import Rows, output_error
from casid.shooting import anderson_acceleration

CLEAN = campaign()


def test_a_noise_free_truth_is_found_from_afar():
    fit = output_error(off(share=0.2), CLEAN, domain="frequency")
    assert relative_error(fit).max() < 1e-5
    np.testing.assert_allclose(fit.initial_states[0], [0.3, -0.02, 0.01], atol=1e-4)
    np.testing.assert_allclose(fit.biases[0], [0.1, 0.01, -0.02], atol=1e-4)


@pytest.mark.second
def test_white_noise_of_known_variance_makes_both_domains_one():
    # Then the transform changes nothing: the likelihoods are the same function of λ, but for the
    # line of the biases.
    records, R = campaign(1), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
    time = output_error(TRUTH, records, R=R)
    frequency = output_error(TRUTH, records, R=R, domain="frequency")
    for name in NAMES:
        row, other = time[name], frequency[name]
        assert abs(row.value - other.value) < 1e-3 * row.cramer_rao
        assert other.cramer_rao == pytest.approx(row.cramer_rao, rel=1e-4)


@pytest.mark.second
def test_both_domains_agree_where_the_structure_is_right():
    records = campaign(2)
    time, frequency = (output_error(off(), records, domain=d) for d in ("time", "frequency"))
    apart = [(frequency[n].value - time[n].value) / time[n].cramer_rao for n in NAMES]
    # A spectrum of some 40 degrees of freedom costs √(2/40) of a standard error at most.
    assert np.sqrt(np.mean(np.square(apart))) < 0.3


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*few lines")
def test_noise_in_a_band_counts_less_there():
    # A sine of noise as large as the signal, on one line of every record, ruins white weights.
    rng, k = np.random.default_rng(0), 12
    t = CLEAN[0].t
    spoilt = []
    for record in campaign(4):
        sine = 0.3 * np.sin(2 * np.pi * k * t / (600 * 0.02) + rng.uniform(0, 2 * np.pi))
        spoilt.append(replace(record, y=record.y + sine[:, None] * [1.0, 0.3, 0.3]))
    errors = [
        np.mean(relative_error(output_error(TRUTH, spoilt, domain=domain)))
        for domain in ("frequency", "time")
    ]
    assert errors[0] < 0.5 * errors[1]


class Flapping(Roll):
    """The same with a rotor that follows the stick in 0.12 s."""

    states = ("v", "p", "phi", "b")

    def A(self) -> Rows:
        moment = [self.Lv, self.Lp, 0, self.Llat]
        return [[self.Yv, 0, 9.81, 0], moment, [0, 1, 0, 0], [0, 0, 0, -1 / 0.12]]

    def B(self) -> Rows:
        return [[self.Ylat, 0], [0, self.Lped], [0, 0], [1 / 0.12, 0]]

    def C(self) -> Rows:
        return [[self.Yv, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*follow the inputs")
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*rests on few lines")
@pytest.mark.parametrize(
    "seed", [*(pytest.param(k, marks=pytest.mark.campaign) for k in (0, 1)), 2]
)
def test_spectra_of_what_a_structure_misses_settle(seed, monkeypatch):
    # Without a rotor its lag is no delay: rounds creep along what the delay may be.
    rng, truth, start = np.random.default_rng(seed), Flapping(tau=0.02), (0.3, -0.02, 0.01, 0.0)
    records = [flown(truth, seed=k, x0=start).with_noise(NOISE, rng) for k in range(3)]
    found = output_error(TRUTH, records, domain="frequency")
    assert 0.1 < found["tau"].value < 0.14
    monkeypatch.setattr(anderson_acceleration, "SLOW", np.inf)
    assert found.notes.rounds < output_error(TRUTH, records, domain="frequency").notes.rounds


@pytest.mark.campaign
def test_errors_are_as_small_as_stated():
    z = []
    for seed in range(30):
        fit = output_error(TRUTH, campaign(seed), domain="frequency")
        z.append([(fit[n].value - getattr(TRUTH, n)) / fit[n].cramer_rao for n in NAMES])
    # 30 runs of 7 parameters, not independent: 0.07 is two standard deviations or so.
    assert 0.9 < np.sqrt(np.mean(np.square(z))) < 1.1
    assert 0.92 < np.mean(np.abs(z) < 1.96) < 0.985
