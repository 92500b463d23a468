"""Local rational models: exact ones recovered, errors that hold, in the band's edges too."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from truths import uh60
from truths.systems import LAG, TWO, white

from casid import Record, StateSpace, frequency_response
from casid.frequency.local import (
    EDGES,
    EQUATIONS,
    QUADRATIC,
    _at_all,
    _between_samples,
    _half_width,
    _LocalFit,
    local_response,
)
from casid.frequency.transforms import Lines

LIGHT = StateSpace([[0, 1], [-4, -0.4]], [[0], [4]], [[1, 0]], [[0]], None, ("u",), ("y",))


def rational(rng, noise=0.0, records=3, nu=2, ny=3):
    """Lines of records of a response with one pair of poles, each with its own transient."""
    residues, direct = rng.standard_normal((ny, nu, 2)), rng.standard_normal((ny, nu))
    pole = -0.3 + 2j

    def response(omega):
        s = 1j * np.asarray(omega)[:, None, None]
        return (residues[..., 0] + s * residues[..., 1]) / (
            (s - pole) * (s - np.conj(pole))
        ) + direct

    lines = []
    for r in range(records):
        omega = 2 * np.pi * np.arange(1, 60) / (40.0 + 5 * r)
        shape = (len(omega), nu + ny)
        U, V = np.split(rng.standard_normal(shape) + 1j * rng.standard_normal(shape), [nu], axis=1)
        edge = rng.standard_normal((2, ny)) * 3
        s = 1j * omega[:, None]
        T = (edge[0] + s * edge[1]) / ((s - pole) * (s - np.conj(pole)))
        Y = np.einsum("kij,kj->ki", response(omega), U) + T + noise * V
        lines.append(Lines(omega, U, Y))
    return lines, response


def test_a_rational_response_is_recovered_beside_the_transients_of_every_record():
    lines, response = rational(np.random.default_rng(0))
    omega = np.array([0.2, 1.0, 2.0, 2.2, 5.0])
    G, error, *_ = _at_all([lines] * len(omega), omega, QUADRATIC)
    np.testing.assert_allclose(G, response(omega), atol=1e-6)
    assert error.max() < 1e-6


def test_a_denominator_that_is_hardly_told_has_the_error_of_its_orthogonal_columns():
    rng = np.random.default_rng(4)
    m, ny = 40, 2
    first, other = (rng.standard_normal((m, ny)) + 1j * rng.standard_normal((m, ny)) for _ in "ab")
    left = np.stack([first, first + 1e-6 * other], axis=2)
    Q = np.linalg.qr(rng.standard_normal((m, 1)) + 0j)[0]
    whole = left + np.einsum("ma,ip->mip", Q, rng.standard_normal((ny, 2)))
    fit = SimpleNamespace(E=np.zeros((m, ny)), variance=np.ones(ny), Q=Q,
                          slopes=lambda: (whole.reshape(m, -1), left.reshape(m, -1)))  # fmt: skip
    found = _LocalFit._of_poles(fit, np.ones((1, 1)))
    inverse = np.linalg.inv(np.linalg.qr(left.reshape(-1, 2))[1])  # of the triangular factor
    along = np.einsum("ma,mip->aip", Q.conj(), whole)[0]
    np.testing.assert_allclose(found[:, 0], np.sum(np.abs(along @ inverse) ** 2, axis=1), rtol=1e-4)


def test_the_random_error_is_the_scatter_over_realisations_at_a_resonance_too():
    omega, scores = np.array([0.4, 2.0, 5.0]), []
    for seed in range(40):
        lines, response = rational(np.random.default_rng(seed), noise=0.1)
        G, error, *_ = _at_all([lines] * len(omega), omega, QUADRATIC)
        scores.append((G - response(omega)) / np.abs(G) / error)
    # Complex errors of 60 runs, three outputs, two inputs: known to 1/√720; the fit is nonlinear.
    power = np.mean(np.abs(scores) ** 2, axis=(0, 2, 3)) / 2
    np.testing.assert_allclose(power, 1.0, atol=0.2)


@pytest.mark.parametrize("nu", [1, 3])
@pytest.mark.parametrize("spacings", [(0.1,), (0.1, 0.3), (0.2, 0.21, 0.22, 0.23)])
def test_a_band_is_as_wide_as_it_takes_beside_the_transients_of_all_records(
    nu, spacings, monkeypatch
):
    lines, centre = [], 12.0
    for every in spacings:
        omega = every * np.arange(1, int(60 / every))
        lines.append(Lines(omega, np.ones((len(omega), nu)), np.ones((len(omega), 1))))

    def equations(half):
        inside = [(np.abs(each.omega - centre) <= half * (1 + 1e-9)).sum() for each in lines]
        return sum(max(n - EDGES, 0) for n in inside)

    for name, small in (("SHARE", 1e-3), ("SPACINGS", 0.1)):
        monkeypatch.setattr(f"casid.frequency.local.{name}", small)
    half, wanted = _half_width(lines, centre), EQUATIONS * nu
    assert half < centre
    assert equations(half / 1.1) < wanted <= equations(half)


def test_a_held_input_is_the_steps_that_it_is():
    rng, dt, omega = np.random.default_rng(6), 0.2, np.array([0.5, 2.0, 6.0])
    u = rng.standard_normal((1000, 1))
    record = Record(dt * np.arange(1000), u, LAG.simulate(dt * np.arange(1000), u, hold="zoh"),
                    LAG.inputs, LAG.outputs, "held", "zoh")  # fmt: skip
    G = local_response([record], omega).G[:, 0, 0]
    # The samples answer by the pulse transfer function, by SciPy, to samples of the input; steps
    # have the spectrum of these times that of one.
    z = np.exp(1j * omega * dt)
    A, B, C, D, _ = scipy.signal.cont2discrete((LAG.A, LAG.B, LAG.C, LAG.D), dt, "zoh")
    pulse = [(C @ np.linalg.solve(at * np.eye(1) - A, B) + D).item() for at in z]
    np.testing.assert_allclose(G, pulse / ((1 - 1 / z) / (1j * omega * dt)), rtol=1e-3)


@pytest.mark.parametrize("known", [True, False], ids=["steps", "a slow sine"])
def test_what_held_inputs_leave_open_of_direct_terms_is_stated(known):
    rng, dt, omega = np.random.default_rng(7), 0.05, np.array([1.0, 3.0, 8.0])
    t = dt * np.arange(2000)
    u = rng.standard_normal((2000, 1)) if known else np.sin(0.3 * t + 0.075 * t**2 / 2)[:, None]
    lag = scipy.signal.StateSpace([[-2.0]], [[2.0]], [[1.0], [-2.0]], [[0.0], [3.0]])
    pulse = lag.to_discrete(dt)
    noise = 1e-4 if known else 3e-2  # which is all there is where the sine has no power
    y = scipy.signal.dlsim(pulse, u)[1] + noise * rng.standard_normal((2000, 2))
    found = local_response([Record(t, u, y, ("u",), ("y", "a"), "held", "zoh")], omega)
    true = np.array([lag.C @ lag.B / (1j * w + 2.0) + lag.D for w in omega])[..., 0]
    off = np.abs(found.G[..., 0] / true - 1)
    stated = found.leakage[..., 0]
    assert (off <= 1.1 * np.hypot(stated, 3 * found.random_error[..., 0])).all()
    assert off[-1, 1] > 0.15  # half a sample of the direct term
    assert (stated[:, 1] < 1.5 * off[:, 1] + 3 * found.random_error[:, 1, 0]).all()
    assert (stated[:, 0] < omega * dt + 3 * found.random_error[:, 0, 0]).all()  # beside noise
    if known:  # that the other output has none is seen where the steps have power
        assert (stated[:, 0] < 0.5 * omega * dt / 2).all()


def held_in_loop(seed, noise=0.02, dt=0.02, last=9.0):
    """A minute's sweep to ``last`` rad/s, held by a computer that adds what it measures.

    The second output has a direct term of three.
    """
    rng, t = np.random.default_rng(seed), dt * np.arange(3000)
    swept = np.sin(0.5 * t + (last - 0.5) * t**2 / 120)
    lag = scipy.signal.StateSpace([[-2.0]], [[2.0]], [[1.0], [-2.0]], [[0.0], [3.0]])
    pulse = lag.to_discrete(dt)
    v = noise * rng.standard_normal((3000, 2))
    x, back, u, y = 0.0, 0.0, np.zeros(3000), np.zeros((3000, 2))
    for k in range(3000):
        u[k] = swept[k] + back
        y[k] = pulse.C[:, 0] * x + pulse.D[:, 0] * u[k] + v[k]
        back += (1 - np.exp(-dt / 0.05)) * (-0.5 * y[k, 0] - back)
        x = pulse.A[0, 0] * x + pulse.B[0, 0] * u[k]
    return Record(t, u[:, None], y, ("u",), ("p", "a"), f"{seed}", "zoh")


@pytest.mark.filterwarnings("ignore:.*noise that is fed back into it:casid.errors.DataWarning")
@pytest.mark.parametrize("method", ["local", "windows"])
def test_noise_fed_back_above_a_sweep_is_no_direct_term(method):
    omega = np.geomspace(2.0, 8.0, 5)
    lag = 2.0 / (1j * omega + 2.0)
    true = np.column_stack([lag, 3.0 - 2.0 * lag])
    found = [
        frequency_response(held_in_loop(k), omega=omega, method=method, windows=[15.0, 20.0])
        for k in range(4)
    ]
    off = np.sqrt(np.mean([np.abs(each.G[..., 0] / true - 1) ** 2 for each in found], axis=0))
    leakage = np.median([each.leakage[..., 0] for each in found], axis=0)
    random = np.median([each.random_error[..., 0] for each in found], axis=0)
    assert (off < 1.1 * np.hypot(leakage, 3 * random)).all()
    # At most that of a direct term as large as the response where the sweep ends.
    assert (leakage[:, 0] < 0.02 * omega / 2 + 3 * random[:, 0]).all()
    assert off[-1, 1] > 0.07  # half a sample of the direct term
    assert (leakage[:, 1] < 1.1 * off[:, 1] + 3 * random[:, 1]).all()


def test_a_direct_term_that_cannot_be_seen_is_at_most_the_response_where_inputs_come_from():
    rng, dt = np.random.default_rng(0), 0.02
    u, y = rng.standard_normal((2, 4000, 1))  # noise alone: nothing is there at any frequency
    record = Record(dt * np.arange(4000), u, y, ("lat",), ("p",), "noise", "zoh")
    omega = np.array([1.0, 2.0, 4.0, 8.0])
    G = np.array([4.0, 2.0, 1.0, 50.0])[:, None, None] + 0j  # the controller's inverse at last
    for noisy, least in (([0.1] * 4, 1.0), ([0.1, 0.1, 0.3, 0.1], 2.0), ([0.3] * 4, 1.0)):
        random = np.array(noisy)[:, None, None]  # what is mostly noise says only that it is no more
        direct = least / np.abs(G[:, 0, 0]) * omega * dt / 2
        found = _between_samples([record], omega, G, random, 0, 5.0)[:, 0, 0]
        np.testing.assert_allclose(found, np.hypot(direct, (omega * dt) ** 2 / 12), rtol=1e-9)
    G[2] = np.nan  # inputs that cannot be told apart there
    found = _between_samples([record], omega, G, np.full(G.shape, 0.3), 0, 5.0)[:2, 0, 0]
    direct = 2.0 / np.abs(G[:2, 0, 0]) * omega[:2] * dt / 2
    np.testing.assert_allclose(found, np.hypot(direct, (omega[:2] * dt) ** 2 / 12), rtol=1e-9)


def test_errors_of_outputs_and_inputs_correlate_as_noise_and_inputs_do():
    rng, mixed = np.random.default_rng(1), []
    lines, _ = rational(rng, noise=0.0, nu=2, ny=2)
    along = np.array([[1.0, 0.0], [0.8, 0.6]])
    for each in lines:
        V = rng.standard_normal((len(each.omega), 2)) @ along.T
        U = each.U @ along.T
        mixed.append(Lines(each.omega, U, 0.1 * (V + 1j * rng.standard_normal(V.shape) @ along.T)))
    *_, outputs, inputs = _at_all([mixed], np.array([4.0]), QUADRATIC)
    assert outputs[0, 0, 1].real == pytest.approx(0.8, abs=0.15)
    assert inputs[0, 0, 1].real == pytest.approx(-0.8, abs=0.15)  # of the inverse


@pytest.mark.second
@pytest.mark.parametrize("system", [LAG, LIGHT], ids=["lag", "light damping"])
def test_what_began_before_the_record_is_told_from_the_response(system):
    t = 0.02 * np.arange(3001)
    rate = np.log(15 / 0.3)
    u = np.sin(18 / rate * np.expm1(rate * t / 60))[:, None]  # begins and ends abruptly
    x0 = np.full(system.nx, 2.0)
    record = Record(t, u, system.simulate(t, u, x0=x0), ("u",), ("y",))
    local, windows = (frequency_response(record, method=m) for m in ("local", "windows"))
    away = [np.abs(f.G / system.response(f.omega) - 1)[:, 0, 0] for f in (local, windows)]
    assert away[0].max() < 0.02
    assert away[0].max() < 0.1 * away[1].max()
    assert np.mean(away[0] < 1.96 * np.sqrt(2) * local.error[:, 0, 0]) > 0.9


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casid.DataWarning")
def test_stated_errors_hold_where_sweeps_are_as_smooth_as_transients():
    """Linear sweeps, one of each input, begun and ended at rest: near their lowest frequencies."""
    A = [[-0.12, 0.3, -19.6, 9.81], [-0.03, -2.2, 0.3, 0], [0.02, -0.15, -0.6, 0], [0, 1, 0, 0]]
    B = [[0.5, 0.8], [6, 0.4], [0.3, 4], [0, 0]]
    C = np.eye(4)[1:]
    inner = StateSpace(A, B, C, np.zeros((3, 2)), None, ("a", "b"), ("p", "r", "phi"))
    omega, off, stated = np.geomspace(0.5, 12, 30), [], []
    for seed, duration in itertools.product(range(6), (80, 50)):
        rng, flown = np.random.default_rng([seed, 17]), []
        t = 0.02 * np.arange(50 * duration)
        s = np.clip((t - 3) / (duration - 6), 0, 1)
        inside = np.clip((t - 3) / 2, 0, 1) * np.clip((duration - 3 - t) / 2, 0, 1)
        sweep = 0.5 * np.sin((duration - 6) * (0.4 * s + 12.6 * s**2 / 2)) * inside
        for column in range(2):
            u = np.outer(sweep, np.eye(2)[column])
            y = inner.simulate(t, u, x0=0.02 * np.array([25, 1, 1, 1]) * rng.standard_normal(4))
            y += 0.01 * np.array([0.5, 0.2, 0.3]) * rng.standard_normal(y.shape)
            flown.append(Record(t, u, y, ("a", "b"), ("p", "r", "phi")))
        found = frequency_response(flown, omega=omega, method="local")
        error = np.log(found.G / inner.response(omega))
        off.append(np.abs([error.real, error.imag]) / found.error)
        stated.append(np.broadcast_to(found.error, off[-1].shape))
    off, stated = (np.moveaxis(each, 2, 0)[:12] for each in (np.array(off), np.array(stated)))
    told = stated < 0.3
    assert np.mean(off < 1.96) > 0.9
    assert np.mean(off[told] < 1.96) > 0.9
    assert np.mean(off[told] > 4) < 0.02


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casid.DataWarning")
@pytest.mark.parametrize("sweeps", [True, False], ids=["3-2-1-1 and sweeps", "3-2-1-1"])
def test_stated_errors_hold_where_records_hold_few_periods(sweeps):
    omega = np.geomspace(*((0.4, 12.0, 40) if sweeps else (0.85, 12.0, 30)))
    truth = uh60.oracle().response(omega)
    kinds = (uh60.linear_sweep, uh60.linear_steps)[not sweeps :]
    clean = [kind(axis) for kind in kinds for axis in uh60.INPUTS]
    inside = []
    for seed in range(3):
        rng = np.random.default_rng([seed, 32])
        found = frequency_response([r.with_noise(uh60.NOISE, rng) for r in clean], omega=omega)
        error = np.log(found.G / truth) / found.error
        within = np.abs([error.real, error.imag]) < 1.96
        inside.append(np.where(found.coherence >= 0.6, within, np.nan))
    fifths = np.array_split(np.arange(len(omega)), 5)
    covered = [np.nanmean(np.array(inside)[:, :, at]) for at in fifths]
    assert min(covered) > 0.88
    assert max(covered) < 0.99


def test_short_records_beside_a_long_one_do_not_blur_what_that_resolves():
    A, B = [[0, 1], [-0.16, -0.1]], [[0], [1]]
    system = StateSpace(A, B, np.eye(2), np.zeros((2, 1)), None, ("u",), ("a", "b"))
    omega, errors = np.geomspace(0.45, 4.0, 20), []
    for seed in range(2):
        rng, flown = np.random.default_rng([seed, 4]), []
        for duration in (100, 16, 16, 16):
            t = 0.05 * np.arange(20 * duration)
            u = rng.choice([-1.0, 1.0], duration).repeat(20)[:, None]
            y = system.simulate(t, u)
            y += 0.02 * np.std(y, axis=0) * rng.standard_normal(y.shape)
            flown.append(Record(t, u, y, ("u",), ("a", "b")))
        found = [local_response(records, omega) for records in (flown[:1], flown)]
        assert found[1].resolution[0, 0, 0] == found[0].resolution[0, 0, 0]
        errors.append([np.mean(np.abs(f.G / system.response(omega) - 1) ** 2) for f in found])
    alone, together = np.sqrt(np.mean(errors, axis=0))
    assert together < alone


@pytest.mark.campaign
def test_stated_errors_hold_in_every_fifth_of_the_band_and_are_smaller_than_of_windows():
    omega = np.geomspace(0.4, 12.0, 40)
    truth = uh60.oracle().response(omega)
    clean = [uh60.linear_sweep(axis) for axis in uh60.INPUTS]
    inside, size = [], {"local": [], "windows": []}
    for seed in range(6):
        rng = np.random.default_rng([seed, 31])
        records = [record.with_noise(uh60.NOISE, rng) for record in clean]
        found = {m: frequency_response(records, omega=omega, method=m) for m in size}
        seen = found["windows"].coherence >= 0.6
        for m, each in found.items():
            size[m].append(np.where(seen, np.abs(np.log(each.G / truth)) ** 2, np.nan))
        error = np.log(found["local"].G / truth) / found["local"].error
        both = np.stack([error.real, error.imag])
        inside.append(np.where(seen, np.abs(both) < 1.96, np.nan))
    fifths = np.array_split(np.arange(40), 5)
    covered = [np.nanmean(np.array(inside)[:, :, at]) for at in fifths]
    # Some 1300 points a fifth, of which a sixth are independent: 0.95 ± 0.015.
    assert min(covered) > 0.91
    assert max(covered) < 0.985
    local, windows = (
        np.sqrt([np.nanmean(np.array(size[m])[:, at]) for at in fifths]) for m in size
    )
    assert (local < 0.95 * windows).all()
    assert local.mean() < 0.7 * windows.mean()


def test_there_is_none_where_losses_leave_nothing():
    record = white(TWO, np.random.default_rng(2), duration=60.0)
    y = record.y.copy()
    y[2:-2, 0] = np.nan
    assert local_response([dataclasses.replace(record, y=y)], np.array([3.0])) is None


def test_there_is_none_where_a_record_lacks_a_channel():
    rng = np.random.default_rng(3)
    whole, lacking = (white(TWO, rng, noise=0.1, duration=200.0, name=n) for n in ("a", "b"))
    lacking = dataclasses.replace(lacking, y=lacking.y * [1.0, np.nan])
    assert local_response([whole, lacking], np.array([3.0])) is None


def test_inputs_that_move_alike_have_no_local_model():
    record = white(TWO, np.random.default_rng(4), mix=[[1.0, 0.0], [1.0, 0.0]], duration=100.0)
    assert np.isnan(local_response([record], np.array([3.0])).G).all()


def test_a_longer_record_resolves_more():
    widths = []
    for duration in (40.0, 160.0):
        record = white(LAG, np.random.default_rng(5), duration=duration)
        widths.append(local_response([record], np.array([0.6])).resolution[0, 0, 0])
    # So low the half width is a number of lines, which are 2π/T apart.
    assert widths[0] / widths[1] == pytest.approx(4.0, rel=0.2)


@pytest.mark.second
def test_errors_of_neighbouring_frequencies_correlate_as_the_resolution_says():
    # Spectral windows of standard deviation b, d apart, share exp(-d²/4b²) of what they see;
    # those of local models are no Gaussian ones.
    t, at = 0.1 * np.arange(1200), 6.0
    fixed = np.random.default_rng(0).standard_normal(1200)
    errors, b = [], 0.0
    for seed in range(40):
        y = np.random.default_rng([1, seed]).standard_normal(1200)
        record = Record(t, fixed[:, None], y[:, None], ("u",), ("y",))
        if not b:
            b = local_response([record], np.array([at])).resolution[0, 0, 0]
        omega = at + b * np.array([0.0, 1.0, 2.0, 6.0])
        errors.append(local_response([record], omega).G[:, 0, 0])
    errors = np.array(errors)
    power = np.sum(np.abs(errors) ** 2, axis=0)
    alike = np.abs(errors[:, 0].conj() @ errors) / np.sqrt(power[0] * power)
    np.testing.assert_allclose(alike[1:3], np.exp([-0.25, -1.0]), atol=0.2)
    assert alike[3] < 0.35  # of 40 independent pairs 0.14 on average
