"""What structures miss of measured responses, in stated errors."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from casid import DataWarning, FrequencyResponse, Model, match, parameter

OMEGA, ERROR = np.geomspace(0.3, 12.0, 24), 0.005


class Lags(Model):
    """Two outputs after one input, a first order lag each."""

    states, inputs, outputs = ("p", "r"), ("lat",), ("p", "r")
    a: float = parameter(default=-3.0, lower=-20.0, upper=-0.1, unit="1/s")
    b: float = parameter(default=-1.0, lower=-20.0, upper=-0.1, unit="1/s")
    k: float = parameter(default=5.0, lower=0.0, upper=50.0, unit="1/s^2")
    n: float = parameter(default=1.0, lower=0.0, upper=50.0, unit="1/s^2")

    def A(self):
        return [[self.a, 0], [0, self.b]]

    def B(self):
        return [[self.k], [self.n]]


def measured(seed, *, missed=1.0, points=slice(None)):
    """Closed form of both, p times ``missed`` at some points, with errors as stated."""
    rng, s = np.random.default_rng(seed), 1j * OMEGA
    G = np.stack([8 / (s + 2), 2 / (s + 0.7)], axis=1)[:, :, None]
    G[points, 0, 0] *= np.broadcast_to(missed, OMEGA.shape)[points]
    G = G * (1 + ERROR * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)))
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, ERROR),
        inputs=("lat",), outputs=("p", "r"), input_std=np.ones(1), output_std=np.ones(2),
    )  # fmt: skip


@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_a_lag_that_the_structure_lacks_is_told_of_its_pair_alone(norm):
    lagged = measured(0, missed=1 / (1 + 0.1j * OMEGA))
    with pytest.warns(DataWarning, match=r"stated errors, p after lat \S+ times, in half") as told:
        match(Lags(), lagged, norm=norm)
    assert len(told) == 1


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_a_true_structure_is_not_accused_whatever_the_norm(norm):
    for seed in range(6):  # tests raise on any warning
        match(Lags(), measured(seed), norm=norm)


def test_a_single_point_and_unknown_errors_accuse_nothing():
    match(Lags(), measured(0, missed=1.1, points=slice(10, 11)), norm="quadratic")
    lagged = measured(0, missed=1 / (1 + 0.1j * OMEGA))
    match(Lags(), replace(lagged, random_error=np.full(lagged.G.shape, np.nan)), norm="quadratic")


@pytest.mark.parametrize(("apart", "size"), [(2.5, None), (6.0, np.sqrt(19)), (20.0, np.sqrt(201))])
def test_what_no_parameter_explains_is_told_by_its_size(apart, size):
    # Errors of G in turn: beside noise of unit variance the mean of both parts' squares is this.
    turn = 1 + apart * ERROR * (-1.0) ** np.arange(len(OMEGA))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        match(Lags(), measured(0, missed=turn), norm="quadratic")
    told = re.findall(r"p after lat (\S+) times", " ".join(str(each.message) for each in caught))
    assert len(told) == (size is not None)
    for factor in told:
        assert float(factor) == pytest.approx(size, rel=0.2)
