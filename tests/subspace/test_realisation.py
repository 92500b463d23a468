"""Models of gathered columns in the channels' own units."""

from dataclasses import replace

import numpy as np
import pytest
from truths.systems import closed_loop_record, relative_error, sampled_plant, unstable_plant

from casid import Record
from casid.subspace.campaign import Campaign, Windows


def records(kind, scale=1.0, noise=0.05):
    """One record in other units."""
    if kind == "projections":
        gain = np.array([[0.5, 1.2, 0.3], [1.0, 0.0, 0.0]])
        rng = np.random.default_rng(1)
        record = closed_loop_record(unstable_plant(), rng, gain=gain, noise=noise)
        return replace(record, u=record.u / scale, y=record.y * scale)
    rng, t = np.random.default_rng(2), np.arange(400.0)
    u = rng.standard_normal((400, 1))
    y = sampled_plant().simulate(t, u, hold="zoh") + noise * rng.standard_normal((400, 2))
    return Record(t, u / scale, y * scale, ("u",), ("a", "b"), hold="zoh")


WINDOWS = {"projections": Windows(10, 10, 6.0, 0.0), "samples": Windows(8, 8, np.nan, 0.0)}


def test_samples_without_noise_give_the_discrete_system():
    found = Campaign.of(records("samples", noise=0.0), False).subspace(3, WINDOWS["samples"])
    assert found.system.dt == 1.0
    assert relative_error(found.system, sampled_plant(), np.linspace(0.2, 3.0, 8)) < 1e-6
    assert found.K.shape == (3, 2)


@pytest.mark.parametrize("kind", WINDOWS)
def test_units_of_the_channels_go_through(kind):
    made = [Campaign.of(records(kind, s), False).subspace(3, WINDOWS[kind]) for s in (1.0, 100.0)]
    one, other = made
    omega = np.linspace(0.2, 3.0, 8)
    # Outputs in hundredths, inputs a hundredfold: the response is 10⁴ times what it was.
    G, G_hundred = (each.system.response(omega) for each in made)
    np.testing.assert_allclose(G_hundred, 1e4 * G, rtol=1e-6)
    R, R_hundred = one.residual_covariance, other.residual_covariance
    np.testing.assert_allclose(R_hundred, 1e4 * R, rtol=1e-6, atol=1e-9 * R_hundred.max())
    poles = np.sort_complex(np.linalg.eigvals(one.system.A - one.K @ one.system.C))
    again = np.sort_complex(np.linalg.eigvals(other.system.A - other.K @ other.system.C))
    np.testing.assert_allclose(again, poles, rtol=1e-5, atol=1e-8)
    assert (one.system.dt is None) is (kind == "projections")
