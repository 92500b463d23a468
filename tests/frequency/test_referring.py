"""Responses by way of references against the closed form, their errors against scatter."""

import dataclasses

import numpy as np
import pytest
from scipy import signal

from casid import Record, frequency_response
from casid.frequency.referring import of_inputs

DT, N = 0.02, 4000
OMEGA = np.geomspace(1.0, 12.0, 12)


def looped(seed, noise, *, linear=True):
    """Two sweeps of an unstable rate, p' = 0.3 p + 8 lat, held by lat = ref - 0.4 p."""
    t, rng = DT * np.arange(N), np.random.default_rng(seed)
    a = np.exp(0.3 * DT)
    b = 8 * (a - 1) / 0.3
    flown = []
    for k in range(2):
        ref = 0.15 * np.sin(2 * np.pi * (0.1 * t + 2.2 / 160 * t**2) + k)
        if not linear:
            ref = 0.15 * np.sin(np.cumsum(np.geomspace(0.6, 15.0, N)) * DT + k)
        v = noise * signal.lfilter([1], [1, -0.6], rng.standard_normal(N))
        p, y, u = 0.0, np.zeros(N), np.zeros(N)
        for n in range(N):
            y[n] = p + v[n]
            u[n] = ref[n] - 0.4 * y[n]
            p = a * p + b * u[n]
        channels = np.column_stack([u, ref])
        flown.append(Record(t, channels, y[:, None], ("lat", "ref"), ("p",), f"{k}", "zoh"))
    z = np.exp(1j * OMEGA * DT)
    held = (1 - 1 / z) / (1j * OMEGA * DT)  # the spectrum of steps over that of their samples
    return flown, b / (z - a) / held


def test_a_brisk_linear_sweep_leaks_nothing_into_a_response_by_its_reference():
    flown, G = looped(0, 0.0)
    found = frequency_response(flown, omega=OMEGA, reference=["ref"])
    np.testing.assert_allclose(found.G[:, 0, 0] / G, 1, atol=2e-3)
    windows = frequency_response(flown, omega=OMEGA, reference=["ref"], method="windows")
    off = np.abs(windows.G[:, 0, 0] / G - 1)
    assert off[:3].min() > 0.1  # all lengths are biased alike there
    assert (off < 1.5 * windows.error[:, 0, 0]).all()


@pytest.mark.campaign
def test_errors_by_way_of_references_hold():
    inside = []
    for seed in range(24):
        flown, G = looped(seed, 0.02, linear=False)
        found = frequency_response(flown, omega=OMEGA, reference=["ref"])
        ratio = np.log(found.G[:, 0, 0] / G)
        error = found.error[:, 0, 0]
        inside.append([np.abs(ratio.real) < 1.96 * error, np.abs(ratio.imag) < 1.96 * error])
    # 576 points, of which neighbours are alike: 0.95 give or take 0.02.
    assert 0.9 < np.mean(inside) < 0.985


def test_errors_are_those_of_drawn_responses():
    rng = np.random.default_rng(4)

    def drawn(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    nu, ny, count = 2, 3, 40_000
    G = drawn(1, nu + ny, nu) + 3 * np.eye(nu + ny, nu)
    spread, along = 0.01 * drawn(nu + ny, nu + ny), np.eye(nu) + 0.3 * drawn(nu, nu)
    z = drawn(count, nu + ny, nu) / np.sqrt(2)
    moved = G + np.einsum("ia,naj,jb->nib", spread, z, along)
    S, P = spread @ spread.conj().T, along.T @ along.conj()
    error = np.sqrt(np.outer(np.diag(S), np.diag(P)).real / 2)[None] / np.abs(G)
    scaled = [M / np.sqrt(np.outer(np.diag(M), np.diag(M)).real) for M in (S, P)]
    found, relative, outputs, inputs = of_inputs(G, error, scaled[0][None], scaled[1][None], nu)
    truth = moved[:, nu:] @ np.linalg.inv(moved[:, :nu])
    np.testing.assert_allclose(found[0], G[0, nu:] @ np.linalg.inv(G[0, :nu]))
    off = truth - found
    scatter = np.sqrt(np.mean(np.abs(off) ** 2, axis=0) / 2)
    np.testing.assert_allclose(relative[0] * np.abs(found[0]), scatter, rtol=0.05)
    across = np.einsum("nij,nkj->ik", off, off.conj()) / count
    size = np.sqrt(np.diag(across).real)
    np.testing.assert_allclose(outputs[0], across / np.outer(size, size), atol=0.05)
    along = np.einsum("nij,nil->jl", off / scatter.mean(axis=1)[:, None], off.conj())
    size = np.sqrt(np.diag(along).real)
    assert np.abs(inputs[0] - along / np.outer(size, size)).max() < 0.25  # outputs weigh there


def test_a_frequency_without_a_response_has_none_by_way_of_references_either():
    G = np.array([[[1.0 + 0j], [2.0]], [[np.nan], [1.0]]])
    found, error, *_ = of_inputs(
        G, np.full((2, 2, 1), 0.1), *(np.ones((2, n, n)) for n in (2, 1)), 1
    )
    assert found[0, 0, 0] == 2.0
    assert np.isnan(found[1]).all()
    assert np.isnan(error[1]).all()


def test_another_order_of_records_changes_nothing():
    flown, _ = looped(3, 0.02)
    one = frequency_response(flown, omega=OMEGA[4:8], reference=["ref"])
    named = [dataclasses.replace(each, name=each.name) for each in flown[::-1]]
    other = frequency_response(named, omega=OMEGA[4:8], reference=["ref"])
    np.testing.assert_allclose(one.G, other.G, rtol=1e-9)
