"""What a structure misses, as a process: small where it is true, large enough where it is not."""

import re
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from truths.closed_roll import TRUTH, NoSideslip, campaign

from casid import (
    Model,
    Record,
    Rows,
    Scalar,
    Undermodelling,
    handling_band,
    mode_bands,
    output_error,
    parameter,
    pbsid,
    response_band,
    structure_error,
)
from casid.errors import DataWarning
from casid.evaluation import MatrixFunction
from casid.response_fit import movable
from casid.undermodelling import _evidence, _own, missed_quantile, missed_square

OMEGA = np.geomspace(1.1, 8.0, 24)


@cache
def box():
    records = campaign(1, 4)
    return pbsid(records, order=6, pole=8.0, past=8, future=8, feedthrough=["ay"])


@cache
def fitted(structure):
    records = [record.decimate(2) for record in campaign(1, 4)]
    if structure == "true":
        return output_error(TRUTH, records)
    with pytest.warns(DataWarning, match="nothing of ay .*, phi "):
        return output_error(NoSideslip(), records)


@cache
def error(structure):
    return structure_error(fitted(structure), box())


def inside(band, G):
    """Share of points within the band, magnitude and phase."""
    low, high = band.magnitude()
    turned = np.abs(np.angle(G / band.G)) <= np.ptp(band.phase(), axis=0) / 2
    return np.mean([(low <= np.abs(G)) & (np.abs(G) <= high), turned])


@pytest.mark.slow
def test_the_band_of_a_structure_that_lacks_something_holds_the_truth():
    G = TRUTH.system().response(OMEGA)
    plain = response_band(fitted("wrong"), OMEGA)
    both = response_band(fitted("wrong"), OMEGA, error=error("wrong"))
    assert inside(plain, G) < 0.9
    assert inside(both, G) > 0.95
    assert (both.magnitude()[0] >= 0).all()


@pytest.mark.second
def test_the_band_of_the_true_structure_is_hardly_wider():
    plain = response_band(fitted("true"), OMEGA)
    both = response_band(fitted("true"), OMEGA, error=error("true"))
    wide = [np.median(np.ptp(band.magnitude(), axis=0)) for band in (plain, both)]
    assert 1 <= wide[1] / wide[0] < 2
    assert inside(both, TRUTH.system().response(OMEGA)) > 0.9


@pytest.mark.second
def test_what_noise_does_to_the_fit_is_no_error_of_its_structure():
    fit = output_error(TRUTH, [campaign(1, 4)[0].decimate(2)])  # of a quarter of the records
    alone = structure_error(replace(fit, covariance=None), box())
    # Squares of noise, exponential, exceed their mean by 1/e of it: what is not there stays.
    assert np.sum(structure_error(fit, box()).std ** 2) < 0.7 * np.sum(alone.std**2)
    unknown = replace(fit, covariance=np.full_like(fit.covariance, np.inf))
    np.testing.assert_array_equal(structure_error(unknown, box()).std, alone.std)


@pytest.mark.second
def test_beside_a_bound_noise_is_that_of_the_band_and_what_is_missed_moves_what_is_free():
    records = [record.decimate(2) for record in campaign(1, 4)]
    fit = output_error(TRUTH, records, bounds={"Lp": (TRUTH.Lp - 1, TRUTH.Lp)})
    assert fit["Lp"].active
    free = movable(fit)
    G, dG = MatrixFunction(free)(free.guess).response_slopes(1j * OMEGA)
    band = response_band(fit, OMEGA)
    size = np.abs(G) * np.hypot(band.magnitude_std, band.phase_std)
    np.testing.assert_allclose(_own(fit, free, dG), size**2, rtol=1e-3, atol=1e-12)
    held = output_error(replace(TRUTH, Lp=fit["Lp"].value), records, fixed=["Lp"])
    moved, alone = (structure_error(replace(each, covariance=None), box()) for each in (fit, held))
    np.testing.assert_allclose(moved.std, alone.std, rtol=1e-3)
    assert not moved.covariance[fit.free_names.index("Lp")].any()
    others = moved.of(held).covariance
    np.testing.assert_allclose(np.diag(others), np.diag(alone.covariance), rtol=1e-2)


@pytest.mark.parametrize("sure", [0.0, 0.3, 1.0])
def test_what_noise_may_hide_is_no_less_than_is_likely_where_something_is_missed(sure):
    difference, deviation = np.array([-30.0, -1.0, 0.0, 0.5, 20.0, 2.0]), np.array([1.0] * 5 + [0])
    above = difference.copy()
    for k in range(5):  # the mean of a normal number above zero, by quadrature
        x = np.linspace(0, 30, 300_001)
        p = np.exp(-0.5 * (x - difference[k]) ** 2 + 0.5 * min(difference[k], 0) ** 2)
        above[k] = np.trapezoid(x * p) / np.trapezoid(p)
    expected = (1 - sure) * np.maximum(difference, 0) + sure * above
    found = missed_square(difference, deviation, sure)
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.parametrize("z", [-3.0, 0.0, 2.0, 6.0])
def test_evidence_is_of_all_pairs_together_and_two_deviations_are_undecided(z):
    # One frequency, four pairs of independent errors: squares less noise scatter by one each.
    F = np.eye(4).reshape(1, 2, 2, 4)
    target = SimpleNamespace(F=F, allowed=np.zeros((1, 2, 2)), variance=np.ones((1, 2, 2)))
    left = np.full((1, 2, 2), z / 2)  # z of their sum over its deviation of two
    assert _evidence(left, target) == pytest.approx(scipy.special.ndtr(z - 2))


@pytest.mark.second
def test_a_structure_is_known_to_miss_something_only_where_it_does():
    assert error("true").sure < 0.05
    assert error("wrong").sure > 0.95


A, B, LAG = np.array([[-4.0, 0.6], [-0.3, -0.9]]), np.array([[8.0, 1.0], [0.5, 4.0]]), 15.0


def lagged(seed):
    """Four records of roll and yaw behind a lag, in much noise."""
    whole = np.block([[A, B], [np.zeros((2, 2)), -LAG * np.eye(2)]])
    sticks, t = np.vstack([np.zeros((2, 2)), LAG * np.eye(2)]), 0.02 * np.arange(1000)
    rng = np.random.default_rng([seed, 15])
    sweep = np.sin(np.cumsum(np.geomspace(0.3, 15.0, len(t))) * 0.02)
    square = np.sign(np.sin(1.7 * t + seed)) + np.sign(np.sin(4.1 * t))
    for k in range(4):
        u = 0.02 * np.sin(0.9 * t[:, None] + [0, 1]) * (t[:, None] > 2)
        u[:, k % 2] = 0.1 * rng.uniform(0.8, 1.2) * (sweep if k < 2 else square)
        y = scipy.signal.lsim((whole, sticks, np.eye(2, 4), np.zeros((2, 2))), u, t)[1]
        y += 0.12 * rng.standard_normal(y.shape)
        yield Record(t=t, u=u, y=y, inputs=("lat", "ped"), outputs=("p", "r"), name=f"{k}")


@pytest.mark.filterwarnings("ignore:output error. records contradict")  # by the lag left out
@pytest.mark.campaign
def test_bands_hold_where_much_noise_hides_a_lag_that_is_left_out():
    held = []
    for seed in range(12):
        records = list(lagged(seed))
        fit, box = output_error(RollYaw(), records), pbsid(records, pole=10.0, past=10, future=10)
        omega = np.geomspace(max(0.5, box.band[0]), min(12.0, box.band[1]), 24)
        s = 1j * omega[:, None, None]
        G = np.linalg.solve(s * np.eye(2) - A, B / (1 + s / LAG))
        band = response_band(fit, omega, error=structure_error(fit, box))
        half = np.ptp(band.phase(), axis=0) / 2
        held.append(np.mean(np.abs(np.angle(G / band.G)) <= half))
    assert np.mean(held) > 0.9  # .84 where what noise hides counts for nothing


@pytest.mark.second
def test_what_a_path_that_the_structure_lacks_is_in_truth_counts_whole():
    records, none = list(lagged(3)), ("Lr", "Np", "Lped", "Nlat")
    apart = output_error(RollYaw(**dict.fromkeys(none, 0.0)), records, fixed=none)
    assert not apart.model.system().response(OMEGA)[:, 0, 1].any()
    box = pbsid(records, pole=10.0, past=10, future=10)
    missed = structure_error(apart, box)
    assert np.isfinite(missed.std).all()
    assert (missed.std[:, 0, 1] > 0).all()


@pytest.mark.parametrize("level", [0.68, 0.95, 0.99])
def test_what_is_missed_is_beyond_its_quantile_as_seldom_as_stated(level):
    # A process on a grid of its own, its level the mean of its square over neighbouring points.
    rng, x = np.random.default_rng(5), np.arange(0, 12, 0.1)  # in units of its memory
    near = np.exp(-0.5 * (x[:, None] - x) ** 2)
    root = np.linalg.cholesky(near + 1e-9 * np.eye(len(x)))
    z = np.tensordot(root, rng.standard_normal((len(x), 2, 3000)), 1)
    size = np.sqrt(np.tensordot(near / near.sum(axis=1), np.sum(z**2, axis=1) / 2, 1))
    inside = np.abs(z[:, 0])[30:-30] < missed_quantile(level) * size[30:-30]
    assert np.mean(inside) == pytest.approx(level, abs=0.012)


@pytest.mark.second
def test_modes_and_bandwidth_are_less_certain_with_it():
    fit, missed = fitted("wrong"), error("wrong")
    (plain, *_), (both, *_) = mode_bands(fit), mode_bands(fit, error=missed)
    assert both.real_std >= plain.real_std


@pytest.mark.second
def test_modes_are_as_uncertain_as_they_are_off_those_of_the_black_box():
    fit = fitted("true")
    plain = mode_bands(fit)
    poles = np.array([band.mode.pole for band in plain])
    none = replace(error("true"), covariance=np.zeros_like(error("true").covariance), sure=0.0)

    def beside(apart, noise, sure=0.0):
        """Bands against a black box with modes so far off, so uncertain, and what they gain."""
        std = np.full((2, len(poles)), noise)
        other = replace(none, poles=poles + apart, pole_std=std, sure=sure)
        both = mode_bands(fit, error=other)
        return both, [
            np.sqrt(b.real_std**2 - p.real_std**2) for b, p in zip(both, plain, strict=True)
        ]

    size = 0.1 * np.abs(poles).min()
    both, found = beside(-size, 0.6 * size)
    np.testing.assert_allclose(found, 0.8 * size, rtol=1e-9)
    for band, alone, pole in zip(both, plain, poles, strict=True):
        assert band.imag_std == pytest.approx(alone.imag_std)
        its = abs(pole - size)
        noise = np.hypot(abs(pole - 0.4 * size) - its, abs(pole - size + 0.6j * size) - its)
        beyond = max((abs(pole) - its) ** 2 - noise**2, 0)
        assert band.frequency_std == pytest.approx(np.sqrt(alone.frequency_std**2 + beyond))
    np.testing.assert_array_equal(beside(-size, 1.1 * size)[1], 0)  # it may be noise
    np.testing.assert_array_equal(beside(-100 * size, 0.0)[1], 0)  # others
    # Where something is known to be missed, what may be noise may be off all the same.
    square, spread = size**2 * (1 - 1.1**2), size**2 * np.sqrt(2) * 1.1**2
    above = scipy.stats.truncnorm.mean(-square / spread, np.inf, loc=square, scale=spread)
    np.testing.assert_allclose(beside(-size, 1.1 * size, sure=1.0)[1], np.sqrt(above), rtol=1e-6)


class Lags(Model):
    """Two actuators of one time constant: a pole counted twice."""

    states, inputs, outputs = ("a", "b"), ("lat", "ped"), ("a", "b")
    T: Scalar = parameter(default=0.2, lower=0.05, upper=1.0, unit="s")

    def A(self) -> Rows:
        return [[-1 / self.T, 0], [0, -1 / self.T]]

    def B(self) -> Rows:
        return [[1 / self.T, 0], [0, 1 / self.T]]


def test_equal_poles_are_compared_with_the_mean_of_those_that_noise_split():
    t, rng = 0.02 * np.arange(500), np.random.default_rng(3)
    u = np.sign(np.stack([np.sin(1.3 * t), np.sin(0.9 * t + 1)], axis=1))
    y = Lags().system().simulate(t, u) + 0.05 * rng.standard_normal((500, 2))
    fit = output_error(Lags(), [Record(t, u, y, Lags.inputs, Lags.outputs, "lags")])
    alone = mode_bands(fit)
    pole = alone[0].mode.pole
    assert [band.mode.pole for band in alone] == pytest.approx([pole, pole])
    names = {"inputs": Lags.inputs, "outputs": Lags.outputs, "free_names": ("T",)}
    none = replace(error("true"), covariance=np.zeros((1, 1)), sure=0.0, **names)
    for split in ([1, -1], [1j]):  # two real ones, or a pair, told by one of it
        for away, more in ((0.0, 0.0), (-0.8, 0.8**2 - 0.1**2)):
            poles = pole + away + np.array(split)
            other = replace(none, poles=poles, pole_std=np.full((2, len(split)), 0.1))
            for band, plain in zip(mode_bands(fit, error=other), alone, strict=True):
                assert band.real_std**2 - plain.real_std**2 == pytest.approx(more, abs=1e-9)
                assert band.imag_std == pytest.approx(plain.imag_std)


class Integral(Model):
    """A pole that is zero, whatever the gain."""

    states, inputs, outputs = ("phi",), ("lat",), ("phi",)
    k: Scalar = parameter(default=0.5, lower=0.1, upper=5.0, unit="1/s")

    def A(self) -> Rows:
        return [[0.0]]

    def B(self) -> Rows:
        return [[self.k]]


def test_an_integrator_is_near_no_mode_of_the_black_box():
    t = 0.02 * np.arange(500)
    u = np.sin(1.3 * t)[:, None]
    y = Integral(k=0.8).system().simulate(t, u)
    y += 0.01 * np.random.default_rng(4).standard_normal(y.shape)
    fit = output_error(Integral(), [Record(t, u, y, Integral.inputs, Integral.outputs, "turn")])
    names = {"inputs": Integral.inputs, "outputs": Integral.outputs, "free_names": ("k",)}
    whole = replace(error("true"), covariance=np.zeros((1, 1)), sure=0.0, **names)
    far = np.array([-2.0, -3e10])  # some are all but at once
    other = replace(whole, poles=far, pole_std=np.full((2, 2), 0.1))
    (both,), (plain,) = mode_bands(fit, error=other), mode_bands(fit)
    assert (both.mode.pole, both.real_std, both.imag_std) == (0.0, plain.real_std, plain.imag_std)


class RollYaw(Model):
    """Roll and yaw rates, and no actuators."""

    states, inputs, outputs = ("p", "r"), ("lat", "ped"), ("p", "r")

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Lr: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="1/s")
    Np: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="1/s")
    Nr: Scalar = parameter(default=-1.0, lower=-10.0, upper=2.0, unit="1/s")
    Llat: Scalar = parameter(default=5.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s^2")
    Nlat: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=3.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Lp, self.Lr], [self.Np, self.Nr]]

    def B(self) -> Rows:
        return [[self.Llat, self.Lped], [self.Nlat, self.Nped]]


class Bank(Model):
    """Roll and bank with a delay, and no actuator."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-4.0, lower=-20.0, upper=0.0, unit="1/s")
    Lphi: Scalar = parameter(default=-1.0, lower=-20.0, upper=20.0, unit="1/s^2")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.3, unit="s")

    def A(self) -> Rows:
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat], [0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau}


@pytest.mark.second
@pytest.mark.parametrize("lag", [0.06, 0.12])
def test_a_pole_that_takes_up_a_lag_is_as_uncertain_as_it_is_off(lag):
    rng, t, records = np.random.default_rng(3), 0.02 * np.arange(1500), []
    A, B = [[-5.0, -2.0, 12.0], [1, 0, 0], [0, 0, -1 / lag]], [[0], [0], [1 / lag]]
    for k in range(3):
        steps = np.repeat(rng.choice([-0.1, 0.0, 0.1], 60), 25)
        u = np.convolve(steps, np.ones(6) / 6, mode="same")  # a stick takes its time
        _, y, _ = scipy.signal.lsim((A, B, np.eye(2, 3), np.zeros((2, 1))), u, t)
        y += 0.002 * rng.standard_normal(y.shape)
        records.append(Record(t, u[:, None], y, ("lat",), ("p", "phi"), f"{k}"))
    fit = output_error(Bank(), records)
    missed = structure_error(fit, pbsid(records, order=4, pole=10.0, past=10))
    roll = np.linalg.eigvals(np.array(A)[:2, :2]).min()
    plain, both = (min(mode_bands(fit, error=e), key=lambda b: b.mode.pole.real)
                   for e in (None, missed))  # fmt: skip
    off = both.mode.pole.real - roll
    assert off > 5 * plain.real_std
    assert 0.5 * off < both.real_std < 2 * off


@pytest.mark.second
def test_a_phase_delay_is_as_uncertain_as_its_draws():
    # The response is 20 % off, in gain or phase, for a third of a neper of frequency each time.
    fit, omega = fitted("true"), np.geomspace(0.5, 40, 200)
    size = np.abs(fit.model.system().response(error("true").omega))
    missed = replace(error("true"), std=0.2 * size)
    plain, both = (handling_band(fit, ("phi", "lat"), omega, error=e) for e in (None, missed))
    assert both.phase_delay == plain.phase_delay
    assert 0.05 < both.phase_delay_std / both.phase_delay < 1
    assert both.phase_delay_std > 5 * plain.phase_delay_std


def test_draws_have_the_size_and_the_memory_that_are_stated():
    omega = np.geomspace(1, 10, 6)
    made = Undermodelling(
        omega=omega, std=np.linspace(1, 2, 6)[:, None, None], covariance=np.eye(1),
        poles=np.array([-1.0 + 0j]), pole_std=np.zeros((2, 1)), free_names=("a",),
        inputs=("u",), outputs=("y",), size=np.full((6, 1, 1), 4.0), sure=0.0,
    )  # fmt: skip
    drawn = made.drawn(omega, np.ones((6, 1, 1)), 4000, seed=1)[:, :, 0, 0]
    np.testing.assert_allclose(
        np.mean(np.abs(drawn) ** 2, axis=0), made.std[:, 0, 0] ** 2, rtol=0.1
    )
    unit = drawn / made.std[:, 0, 0]
    step = np.log(omega[1] / omega[0])
    expected = np.exp(-0.5 * (step / 0.35) ** 2)
    assert np.mean(unit[:, 0] * unit[:, 1].conj()).real == pytest.approx(expected, abs=0.05)
    outside = made.at(np.array([0.1, 100.0]), np.array([8.0, 0.4j])[:, None, None])[:, 0, 0]
    np.testing.assert_allclose(outside, [2.0, 0.2])  # of the response the edges' shares
    assert "std at 10 rad/s" in made._repr_html_()


@pytest.mark.slow
def test_an_error_is_that_of_channels_and_parameters_not_of_their_places():
    fit, whole = fitted("wrong"), error("wrong")
    turned = replace(
        whole, std=whole.std[:, ::-1, ::-1], size=whole.size[:, ::-1, ::-1],
        covariance=whole.covariance[::-1, ::-1], free_names=whole.free_names[::-1],
        inputs=whole.inputs[::-1], outputs=whole.outputs[::-1],
    )  # fmt: skip
    bands = [response_band(fit, OMEGA, error=each).missed for each in (whole, turned)]
    np.testing.assert_array_equal(*bands)
    assert [str(mode_bands(fit, error=each)) for each in (whole, turned)]
    first, second = (mode_bands(fit, error=each) for each in (whole, turned))
    np.testing.assert_allclose([b.real_std for b in first], [b.real_std for b in second])
    other = replace(whole, outputs=("ax", *whole.outputs[1:]))
    for ask in (response_band, partial(handling_band, pair=("phi", "lat"))):
        with pytest.raises(ValueError, match="structure error has no output 'ay', only ax"):
            ask(fit, omega=np.geomspace(0.5, 40, 200), error=other)
    with pytest.raises(ValueError, match="has no free parameter 'Lp'"):
        mode_bands(fit, error=replace(whole, free_names=("a",) * len(whole.free_names)))


@pytest.mark.campaign
def test_a_reading_far_off_in_a_few_draws_is_no_standard_deviation():
    # Far above the band a small part of the response is missed, and the phase is read there too.
    fit, missed = fitted("true"), error("true")
    small = replace(missed, std=0.02 * missed.size)
    wide = [
        handling_band(fit, ("phi", "lat"), np.geomspace(0.5, top, 300), error=small)
        for top in (20.0, 40.0, 80.0)
    ]
    spreads = np.array([each.phase_delay_std for each in wide])
    assert np.ptp(spreads) < 0.3 * spreads.mean()


@pytest.mark.second
def test_readings_that_scatter_are_told():
    fit, missed, omega = fitted("true"), error("true"), np.geomspace(0.5, 40, 200)
    calm, wild = (
        handling_band(fit, ("phi", "lat"), omega, error=replace(missed, std=share * missed.size))
        for share in (0.01, 0.8)
    )
    assert not any("of 100 responses" in said for said in calm.remarks)
    assert any(re.search(r"of 100 responses .*, \d+ have no", said) for said in wild.remarks)


def test_a_band_from_zero_is_refused():
    with pytest.raises(ValueError, match="expected 0 < lowest < highest"):
        structure_error(fitted("true"), box(), band=(0.0, 10.0))
