import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from truths.structures import SECOND, TRUTH, HoverRoll, Lag, black_box

from casid import StateSpace
from casid.matching.certificate import TERMS, _series, band_norm, peaks
from casid.matching.targets import comparison_of


def random_system(rng, nx, ny, nu, delay):
    A = rng.standard_normal((nx, nx))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.01, 1.0)) * np.eye(nx)
    names = tuple(f"u{j}" for j in range(nu)), tuple(f"y{i}" for i in range(ny))
    return StateSpace(
        A, rng.standard_normal((nx, nu)), rng.standard_normal((ny, nx)),
        rng.standard_normal((ny, nu)), None, *names, delay=delay * rng.uniform(0, 0.3, nu),
    )  # fmt: skip


class Channels:
    """Enough of a model for a comparison: the names."""

    def __init__(self, system):
        self.inputs, self.outputs = system.inputs, system.outputs


@pytest.mark.slow
@given(
    st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 3), st.integers(1, 3), st.booleans()
)
def test_bounds_enclose_a_dense_search(seed, nx, ny, nu, relative):
    rng = np.random.default_rng(seed)
    system = random_system(rng, nx, ny, nu, delay=1.0)
    box = random_system(rng, nx + 1, ny, nu, delay=0.0)
    comparison = comparison_of(
        Channels(system), [black_box(box)], weight="relative" if relative else None,
        omega=np.geomspace(0.1, 10.0, 7),
    )  # fmt: skip
    source = comparison.sources[0]
    band = band_norm(system, source, tolerance=1e-3)
    dense = source.at(np.geomspace(0.1, 10.0, 3000))
    found = np.linalg.norm(dense.error(system), 2, axis=(1, 2)).max()
    assert found <= band.upper * (1 + 1e-12)
    assert band.lower <= band.upper <= band.lower * (1 + 1e-3) * (1 + 1e-12)


def test_a_series_with_delays_is_off_by_less_than_its_bound_and_by_its_order():
    system = random_system(np.random.default_rng(4), nx=3, ny=2, nu=2, delay=1.0)
    centre, turns = np.array([0.5j, 2.0j]), np.exp(2j * np.pi * np.arange(8) / 8)
    off, bounds = [], []
    for h in (0.1, 0.05):
        g, tail = _series(system, centre, np.full(2, h))
        assert g.shape == (TERMS + 1, 2, 2, 2)
        s = centre + h * turns[:, None]
        R = np.linalg.inv(s[..., None, None] * np.eye(3) - system.A)
        exact = (system.C @ R @ system.B + system.D) * np.exp(-s[..., None, None] * system.delay)
        kept = np.einsum("kc,kn...->cn...", (h * turns) ** np.arange(TERMS + 1)[:, None], g)
        off.append(abs(exact - kept).max(axis=0))
        assert (off[-1] <= tail).all()
        bounds.append(tail)
    # half as far, the first term left out is 2^5 times smaller, the others more
    assert (off[0] > 25 * off[1]).all()
    assert (bounds[0] > 25 * bounds[1]).all()


def test_a_resonance_between_the_points_is_found():
    # Damping ratio 1e-4: a peak of width 1e-3 rad/s between points 0.5 rad/s apart.
    box = StateSpace([[0.0, 1.0], [-9.0, -6e-4]], [[0.0], [1.0]], [[9.0, 0.0]], [[0.0]],
                     inputs=("u",), outputs=("x",))  # fmt: skip
    comparison = comparison_of(Lag(), [black_box(box)], omega=np.arange(0.25, 9.5, 0.5), shift=0.0)
    band = band_norm(Lag(a=1.0, k=0.0).system(), comparison.sources[0])
    assert band.lower == pytest.approx(1 / (2 * 1e-4), rel=1e-3)
    assert band.peak_omega == pytest.approx(3.0, abs=1e-3)
    added = peaks(band, 0.5 * band.lower, 0.01)
    assert len(added) == 1
    assert added[0] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("weight", [None, np.array([[1.0, 0.0], [1.0, 1.0]])])
def test_a_bound_holds_where_outputs_or_pairs_feel_no_state(weight):
    # r follows the second input at once, and the peak at 3 rad/s lies between two points.
    names = {"inputs": ("a", "b"), "outputs": ("p", "r")}
    A, B, C = [[0.0, 1.0], [-9.0, -0.06]], [[0.0, 0.0], [1.0, 2.0]], [[9.0, 0.0], [0.0, 0.0]]
    box = StateSpace(A, B, C, np.diag([0.0, 1.0]), **names)
    model = StateSpace(A, np.zeros((2, 2)), C, np.diag([0.0, 0.5]), **names)
    comparison = comparison_of(
        Channels(model), [black_box(box)], weight=weight, omega=np.arange(0.25, 9.5, 0.5), shift=0.0
    )
    source = comparison.sources[0]
    dense = source.at(np.linspace(2.5, 3.5, 4001))
    found = np.linalg.norm(dense.error(model), 2, axis=(1, 2)).max()
    assert found > 5 * np.linalg.norm(source.error(model), 2, axis=(1, 2)).max()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        band = band_norm(model, source)
    assert found <= band.upper <= 1.01 * found


def test_an_exact_match_has_no_gap_to_close():
    comparison = comparison_of(HoverRoll(), [black_box(TRUTH.system())])
    band = band_norm(TRUTH.system(), comparison.sources[0], negligible=1e-6)
    assert band.upper < 1e-6
    assert len(band.omega) < 2000


def test_measured_points_are_their_own_band():
    comparison = comparison_of(Lag(), [black_box(SECOND)], omega=np.array([1.0]))
    band = band_norm(Lag().system(), comparison.sources[0])
    assert band.lower == band.upper
