"""Whether innovations are white, against noise that is and gusts that are not."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
import scipy.stats

from casid import DataWarning, Model, NonlinearModel, Record, Scalar, output_error, parameter
from casid.shooting.whiteness import LAGS, _uneven, correlations

DT, LAG = 0.1, 6.0  # s; of samples and gusts


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_of_white_noise_they_are_standard_normal_whatever_is_missing(lost):
    rng, squares = np.random.default_rng(1), []
    for _ in range(300):
        records = [rng.standard_normal((n, 3)) * (rng.random((n, 3)) >= lost) for n in (150, 250)]
        squares.append(correlations(records) ** 2)
    squares = np.array(squares)
    assert squares[0].shape == (LAGS, 3, 3)
    np.testing.assert_allclose(squares.mean(axis=(0, 1)), 1.0, atol=0.12)
    total = squares.sum(axis=(1, 2, 3))
    assert scipy.stats.kstest(total, scipy.stats.chi2(9 * LAGS).cdf).pvalue > 1e-3


def test_what_follows_is_told_with_its_sign_and_lag():
    e = np.random.default_rng(2).standard_normal((4000, 2))
    e[3:, 1] -= 0.5 * e[:-3, 0]
    found = correlations([e])
    assert found[2, 0, 1] < -20
    found[2, 0, 1] = 0.0
    assert np.abs(found).max() < 4.5


class Drifting(Model):
    """Forward speed and pitch of something slow, in still or moving air."""

    states, inputs, outputs = ("u", "q", "theta"), ("lon",), ("u", "q", "theta")

    Xu: Scalar = parameter(default=-0.1, lower=-2.0, upper=0.0, unit="1/s")
    Mu: Scalar = parameter(default=0.02, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-0.8, lower=-5.0, upper=0.0, unit="1/s")
    Mlon: Scalar = parameter(default=0.6, lower=0.0, upper=5.0, unit="1/s^2")

    def A(self):
        return [[self.Xu, 0, -9.80665], [self.Mu, self.Mq, 0], [0, 1, 0]]

    def B(self):
        return [[0], [self.Mlon], [0]]


class Gusty(Drifting):
    """With a gust along, a state of its own."""

    states = ("u", "q", "theta", "gust")

    def A(self):
        return [
            [self.Xu, 0, -9.80665, self.Xu], [self.Mu, self.Mq, 0, self.Mu],
            [0, 1, 0, 0], [0, 0, 0, -1 / LAG],
        ]  # fmt: skip

    def B(self):
        return [[0], [self.Mlon], [0], [0]]

    def C(self):
        return np.eye(3, 4)


def flown(seed, gust):
    """A pilot holds it; the gust is exact at the samples, held controls too."""
    rng, system = np.random.default_rng(seed), Gusty().system()
    whole = np.zeros((5, 5))
    whole[:4, :4], whole[:4, 4:] = system.A, system.B
    pulse = scipy.linalg.expm(whole * DT)
    x, u, y = np.zeros(4), np.zeros(800), np.zeros((800, 3))
    x[3] = gust * rng.standard_normal()
    test = 0.05 * np.sign(np.sin(2 * np.pi * DT * np.arange(800) / rng.uniform(5, 9)))
    for k in range(800):
        y[k] = x[:3] + [0.1, 0.002, 0.002] * rng.standard_normal(3)
        u[k] = test[k] - 0.9 * y[k, 2] - 0.6 * y[k, 1] + 0.02 * y[k, 0]
        x = pulse[:4, :4] @ x + pulse[:4, 4] * u[k]
        x[3] += gust * np.sqrt(1 - np.exp(-2 * DT / LAG)) * rng.standard_normal()
    return Record(
        DT * np.arange(800), u[:, None], y, ("lon",), ("u", "q", "theta"), f"{seed}", "zoh"
    )


@pytest.mark.campaign
def test_gusts_of_seconds_are_told_unless_they_have_a_state_of_their_own():
    records = [flown(seed, 1.5) for seed in (1, 2)]
    with pytest.warns(DataWarning, match="innovations are correlated in time"):
        output_error(Drifting(), records, process_noise=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = output_error(Gusty(), records, process_noise=True)
    std = np.array([row.std_error for row in fit.parameters])
    assert (np.abs(fit.model.vector() - Gusty().vector()) < 4 * std).all()


class Lags(Model):
    """Two lags that one stick drives."""

    states, inputs, outputs = ("p", "q"), ("lat",), ("p", "q")

    Lp: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    Mp: Scalar = parameter(default=0.5, lower=-9.0, upper=9.0, unit="1/s")
    Llat: Scalar = parameter(default=3.0, lower=0.0, upper=9.0, unit="1/s^2")

    def A(self):
        return [[self.Lp, 0], [self.Mp, -1]]

    def B(self):
        return [[self.Llat], [1]]


def driven(seed, gust, n=500, lag=0.0):
    """Noise (2, any) into both states, exact at the samples; controls are held.

    ``lag`` is the share of what drives them over a step that lasts for the next.
    """
    rng, system, h = np.random.default_rng(seed), Lags().system(), 0.05
    whole, noise = np.zeros((3, 3)), np.zeros((4, 4))
    whole[:2, :2], whole[:2, 2:] = system.A, system.B
    noise[:2, :2], noise[:2, 2:], noise[2:, 2:] = -system.A, gust @ gust.T, system.A.T
    pulse, turned = scipy.linalg.expm(whole * h), scipy.linalg.expm(noise * h)
    size = turned[2:, 2:].T @ turned[:2, 2:] + 1e-12 * np.eye(2)  # C. F. Van Loan, 1978
    kicks = rng.standard_normal((n, 2)) @ np.linalg.cholesky(size).T
    kicks = scipy.signal.lfilter([1.0], [1.0, -lag], kicks, axis=0)
    u = np.repeat(rng.choice([-0.3, 0.3], n // 20), 20)
    x = np.zeros((n, 2))
    for k in range(n - 1):
        x[k + 1] = pulse[:2, :2] @ x[k] + pulse[:2, 2] * u[k] + kicks[k]
    y = x + 0.01 * rng.standard_normal((n, 2))
    return Record(h * np.arange(n), u[:, None], y, ("lat",), ("p", "q"), f"flight {seed}", "zoh")


ONE, TWO = np.array([[0.1], [0.1]]), np.diag([0.1, 0.1])  # gusts: into both, into each its own


@pytest.mark.second
def test_one_gust_that_drives_two_states_is_told_and_two_are_not():
    with pytest.warns(DataWarning, match="innovations of p and q are correlated, .+ R=.full."):
        output_error(Lags(), [driven(1, ONE), driven(2, ONE)], process_noise=True)
    output_error(Lags(), [driven(1, TWO), driven(2, TWO)], process_noise=True)
    told = {"process_noise": "gain", "R": "full"}  # the remedy that it names
    fit = output_error(Lags(), [driven(1, ONE), driven(2, ONE)], **told)
    std = np.array([row.std_error for row in fit.parameters])
    assert (np.abs(fit.model.vector() - Lags().vector()) < 3 * std).all()


@pytest.mark.campaign
def test_a_gust_that_lasts_is_told():
    with pytest.warns(DataWarning, match="innovations are correlated in time"):
        output_error(Lags(), driven(1, TWO, 300, 0.9), process_noise=True)


@pytest.mark.second
def test_a_record_in_rougher_air_is_told_and_chance_is_not():
    with pytest.warns(
        DataWarning, match=r"innovations of . in flight 2 have [\d.]+ times .* flight 1: the air"
    ):
        output_error(Lags(), [driven(1, 0.3 * TWO), driven(2, 3 * TWO)], process_noise=True)
    output_error(Lags(), [driven(1, TWO, 60), driven(2, 1.2 * TWO, 500)], process_noise=True)
    output_error(Lags(), [driven(1, TWO), driven(2, 1.45 * TWO)], process_noise=True)  # little


def test_air_that_one_output_feels_is_told_beside_many_that_do_not():
    rng, names = np.random.default_rng(3), ("q", "theta", "az")
    drawn = [
        [rng.standard_normal((n, 3)) for n in (400, 800)] for _ in range(200)
    ]  # alike, as whitened
    assert not any(_uneven(each, names, ("a", "b")) for each in drawn)
    told = [_uneven([a, b * [1, 1, 0.5]], names, ("a", "b")) for a, b in drawn[:20]]
    assert all(said.startswith("innovations of az in a have ") for said in told)
    a, b = drawn[0]
    b = np.where([True, False, True], b, 0.0)  # theta is missing there
    assert not _uneven([a, b], names, ("a", "b"))
    sure = [np.ones((20000, 3)), np.sqrt(1.8) * np.ones((20000, 3))]
    assert not _uneven(sure, names, "ab")  # by no chance, but too little to matter
    assert "of q in b have 9 times" in _uneven(
        [np.ones((200, 3)), 3 * np.ones((200, 3))], names, "ab"
    )


class Roll(Model):
    """Rolling with a delay of its stick."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-2.5, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=100.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.06, lower=0.0, upper=0.3, unit="s")

    def A(self):
        return [[self.Lp, 0], [1, 0]]

    def B(self):
        return [[self.Llat], [0]]

    def delays(self):
        return {"lat": self.tau}


def rolled(seed, gust, gain, *, lag=0.0, wait=0, noise=0.01, N=750, h=0.04):
    """Pulses on the stick of an exactly sampled roll with white gusts on p; a lag nobody models."""
    rng, half = np.random.default_rng(seed), h / 2
    A = np.array([[-2.5, 0, 10.0], [1, 0, 0], [0, 0, -1 / lag if lag else 0.0]])
    B = np.array([[0.0], [0.0], [1 / lag]]) if lag else np.array([[10.0], [0.0], [0.0]])
    A[0, 2] *= bool(lag)
    whole = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 4))]]) * half)
    spread = scipy.linalg.expm(
        np.block([[-A, np.diag([gust, 0, 0])], [np.zeros((3, 3)), A.T]]) * half
    )
    Q = whole[:3, :3] @ spread[:3, 3:]
    root = np.linalg.cholesky((Q + Q.T) / 2 + 1e-18 * np.eye(3))
    test, k = np.zeros(N), 50
    while k < N:
        k, start = k + rng.integers(8, 50), k
        test[start:k] = 0.08 * rng.choice([-1, 0, 1])
    x, u, y, late = np.zeros(3), np.zeros(N), np.zeros((N, 2)), [0.0] * 4  # 60 ms
    for k in range(N):
        y[k] = x[:2] + noise * rng.standard_normal(2)
        u[k] = test[k] - y[max(k - wait, 0)] @ gain
        for _ in range(2):
            late = [*late[1:], u[k]]
            x = whole[:3, :3] @ x + whole[:3, 3] * late[0] + root @ rng.standard_normal(3)
    return Record(h * np.arange(N), u[:, None], y, ("lat",), ("p", "phi"), f"{seed}", "zoh")


FOLLOWED = r"residuals are correlated in time \(p, phi\), and later inputs \(lat\) follow them"


@pytest.mark.campaign
def test_gusts_that_are_fed_back_are_told_and_a_filter_is_the_remedy():
    records = [rolled(seed, 0.02, [0.1, 0.3]) for seed in range(1, 5)]
    with pytest.warns(
        DataWarning, match=FOLLOWED + r".*process_noise=True \(filter error\) or, if"
    ):
        biased = output_error(Roll(), records)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = output_error(Roll(), records, process_noise=True)
    assert biased["tau"].value > 0.06 + 3 * biased["tau"].std_error
    for row, true in zip(fit.parameters, Roll().vector(), strict=True):
        assert abs(row.value - true) < 3 * row.std_error


@pytest.mark.parametrize(
    ("gust", "gain", "lag"),
    [(0.02, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.12), (0.0, 1.0, 0.12)],
    ids=["gusts in open loop", "white noise fed back", "a lag is missed", "in closed loop"],
)
def test_neither_gusts_nor_feedback_nor_what_is_missed_is_told_alone(gust, gain, lag):
    records = [rolled(seed, gust, [0.1 * gain, 0.3 * gain], lag=lag) for seed in (1, 2)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        output_error(Roll(), records)
    assert not [each for each in caught if "follow them" in str(each.message)]


class RollingFreely(NonlinearModel):
    """The same, written as a nonlinear structure, without the delay."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-2.5, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=100.0, unit="rad/s^2")

    def derivatives(self, x, u):
        return [self.Lp * x.p + self.Llat * u.lat, x.p]


@pytest.mark.second
def test_a_nonlinear_structure_is_told_its_way_to_a_filter():
    records = [rolled(seed, 0.02, [0.1, 0.3], wait=1) for seed in (1, 2)]
    told = FOLLOWED + r".*process_noise=True \(filter error\) and RollingFreely\(\)\.at\(trim\)"
    with pytest.warns(DataWarning, match=told):
        output_error(RollingFreely(), records)


@pytest.mark.slow
def test_of_held_outputs_the_repeats_are_told_and_not_what_follows_them():
    flown = [rolled(seed, 0.02, [0.1, 0.3]) for seed in range(1, 5)]
    held = [replace(each, y=each.y[np.arange(each.N) // 2 * 2]) for each in flown]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        output_error(Roll(), held)
    (said,) = [str(each.message) for each in caught]
    assert said.startswith("p, phi repeat samples")
