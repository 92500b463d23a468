"""Stated initial states against what least squares makes of the records alone."""

import warnings

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter, lsim
from truths.structures import Banking

from casid import (
    DataWarning,
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    parameter,
)

T = np.arange(0, 8, 0.04)
U = 0.2 * np.sign(np.sin(2 * T)) * (T > 0.5)
NOISE = np.array([0.03, 0.01])
TRUE = (0.5, 0.3)


class BankingWritten(NonlinearModel):
    """`Banking` as equations."""

    states, inputs, outputs = Banking.states, Banking.inputs, Banking.outputs

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=8.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def derivatives(self, x, u):
        return [self.Lp * x.p + self.Llat * u.lat, x.p]


def motion(Lp, Llat, begun, gust=0.0):
    system = [[Lp, 0], [1, 0]], [[Llat, 1], [0, 0]], np.eye(2), np.zeros((2, 2))
    return lsim(system, np.c_[U, np.zeros_like(U) + gust], T, begun)[1]


def flown(*seeds, gust=0.0, begun=TRUE):
    """Records of Lp = -4, Llat = 10."""
    return [
        Record(T, U[:, None], motion(-4.0, 10.0, begun, gust) + NOISE * noise, ("lat",),
               ("p", "phi"), f"flight {seed}")
        for seed in seeds
        for noise in [np.random.default_rng(seed).standard_normal((len(T), 2))]
    ]  # fmt: skip


def told(model, records, **initial):
    """What is said, with R estimated and no biases."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        OutputError(biases=False, initial=initial).fit(model, records)
    return [str(each.message) for each in caught if "contradict" in str(each.message)]


@pytest.mark.second
@pytest.mark.parametrize("std", [1e-8, 0.01])
def test_a_contradicted_initial_state_is_told_with_what_the_records_would_say(std):
    (record,) = flown(0)
    wrong = 0.35

    def off(z):  # the records alone: p is held where it began
        return ((motion(z[0], z[1], (TRUE[0], z[2])) - record.y) / NOISE).ravel()

    alone = least_squares(off, [-4.0, 10.0, 0.3], xtol=1e-12)
    error = np.sqrt(np.linalg.inv(alone.jac.T @ alone.jac)[2, 2])
    (said,) = told(Banking(), [record], phi=(wrong, std), p=(TRUE[0], 1e-9))
    assert f"the initial state phi = 0.35 ± {std:.2g} of flight 0" in said
    value, spread, deviations = (
        float(part.split()[0]) for part in said.replace("±", ",").split("say ")[1].split(",")[:3]
    )
    assert value == pytest.approx(alone.x[2], abs=error)
    assert 0.7 * error < spread < 5 * error  # what contradicts it leaves coloured residuals, too
    assert deviations == pytest.approx(abs(value - wrong) / np.hypot(spread, std), rel=0.05)


@pytest.mark.second
@pytest.mark.parametrize("model", [Banking(), BankingWritten()])
def test_only_the_records_and_states_that_are_contradicted_are_named(model):
    records = [*flown(0, 1), *flown(2, begun=(0.5, 0.6))]
    (said,) = told(model, records, phi=(0.3, 0.001), p=(0.5, 0.01))
    assert "initial state phi = 0.3 ± 0.001 of flight 2:" in said


@pytest.mark.slow
@pytest.mark.parametrize("std", [1e-6, 0.02])
def test_what_is_right_is_not_told(std):
    rng = np.random.default_rng(9)
    for seed in range(4):
        p, phi = TRUE + std * rng.standard_normal(2)
        assert not told(Banking(), flown(seed), p=(p, std), phi=(phi, std))
    assert not told(BankingWritten(), flown(7), p=(TRUE[0], std), phi=(TRUE[1], std))


def test_gusts_are_no_other_initial_state():
    gust = lfilter([0.1], [1, -0.95], np.random.default_rng(4).standard_normal(len(T)))
    assert not told(Banking(), flown(4, gust=gust), p=(TRUE[0], 1e-3), phi=(TRUE[1], 1e-3))
