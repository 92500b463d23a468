"""The structure nearest to a black box's response: recovery, bounds, what errors leave."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign, off

from casid import pbsid
from casid.free import free_parameters
from casid.response_fit import ALLOWED, OF_ROW, BoxResponse, gain, kernel, nearest

OMEGA = np.geomspace(0.7, 8.0, 20)


def response(model, seed=0):
    """A black box's response that is a model's own, with errors in five directions."""
    rng = np.random.default_rng(seed)
    G = model.system().response(OMEGA)
    F = 0.01 * np.abs(G[..., None]) * (rng.standard_normal((*G.shape, 5)) + 0j)
    size = np.where(np.abs(G) > 0, 0.01 * np.abs(G), 1e-6)
    return BoxResponse(
        omega=OMEGA, G=G, F=F, allowed=size, scale=np.ones(G.shape[1:]),
        fed_back=np.zeros(G[:, 0].shape, dtype=bool), freedom=np.full(len(G), np.inf),
    )  # fmt: skip


def test_a_response_of_the_structure_leads_to_its_parameters():
    found = nearest(free_parameters(off(share=0.2)), response(TRUTH))
    np.testing.assert_allclose(found.model.vector(), TRUTH.vector(), rtol=1e-4)
    assert np.abs(found.E).max() < 1e-5


def test_parameters_stay_within_their_bounds():
    free = free_parameters(TRUTH, bounds={"Lp": (-1.5, 0.0), "tau": (0.1, 0.2)})
    found = nearest(free, response(TRUTH))
    assert found.model.Lp >= -1.5
    assert found.model.tau >= 0.1
    assert {"Lp", "tau"} <= set(found.held)
    assert not nearest(free_parameters(off(share=0.2)), response(TRUTH)).held
    assert np.abs(found.E).max() > 1e-2


def test_small_errors_leave_what_the_factor_says():
    # The response moved by errors F z: what the nearest structure misses is minus its factor times
    # z, to first order. A step a thousand times smaller than the errors is linear to 1e-3.
    at, z = response(TRUTH), 1e-3 * np.array([1.0, -0.5, 2.0, 0.3, -1.0])
    calm = nearest(free_parameters(TRUTH), at)
    moved = nearest(free_parameters(TRUTH), replace(at, G=at.G + at.F @ z))
    apart = np.linalg.norm(moved.E + calm.factor @ z) / np.linalg.norm(moved.E)
    assert apart < 0.02
    assert np.linalg.norm(moved.E) < 0.999 * np.linalg.norm(at.F @ z)  # parameters took a part


@pytest.fixture(scope="module")
def box():
    return pbsid(campaign(1, 2), order=3, pole=8.0, past=6, future=6, feedthrough=["ay"])


def test_what_is_no_fault_is_a_share_of_each_pair_and_of_what_its_output_does_at_that_frequency(
    box,
):
    box = replace(box, interval=None)  # and of what samples leave open
    found = BoxResponse.of(box, TRUTH, OMEGA)
    G = box.system.response(OMEGA)
    for k, i in np.ndindex(len(OMEGA), len(TRUTH.outputs)):
        row = [abs(G[k, i, j]) * box.input_std[j] / box.output_std[i] for j in range(box.system.nu)]
        whole = np.linalg.norm(row)
        expected = [np.hypot(ALLOWED * size, OF_ROW * whole) for size in row]
        np.testing.assert_allclose(found.allowed[k, i], expected, rtol=1e-9)
        np.testing.assert_allclose(np.abs(found.G[k, i]), row, rtol=1e-9)


def test_what_samples_leave_open_is_no_fault(box):
    slow = replace(box, interval=0.2)
    plain, found = (
        BoxResponse.of(each, TRUTH, OMEGA) for each in (replace(slow, interval=None), slow)
    )
    left = np.sqrt(found.allowed**2 - plain.allowed**2) / found.scale
    np.testing.assert_allclose(left, slow.images(OMEGA), rtol=1e-3, atol=1e-5)
    assert left.max() > 0


def test_a_channel_that_the_black_box_lacks_is_named(box):
    half = replace(box, system=replace(box.system, outputs=("ax", "p", "phi")))
    with pytest.raises(ValueError, match="output 'ay' is no output of the black box"):
        BoxResponse.of(half, TRUTH, OMEGA)


def test_the_gain_is_that_of_weighted_least_squares():
    rng = np.random.default_rng(3)
    J, e = (rng.standard_normal((*n, 5, 2, 2)) @ np.array([1, 1j])[:, None] for n in ((4,), ()))
    J, e = J[..., 0, None] * np.ones(3), e[..., 0, None] * np.arange(1, 4)
    W = rng.uniform(0.5, 2, e.shape)
    rows = [np.concatenate([x.real.ravel(), x.imag.ravel()]) for x in (*(W * J), W * e)]
    expected = np.linalg.lstsq(np.array(rows[:-1]).T, rows[-1], rcond=None)[0]
    np.testing.assert_allclose(np.sum(gain(J, W).conj() * e, axis=(1, 2, 3)).real, expected)


def test_smoothing_over_frequency_leaves_a_constant_as_it_is():
    omega = np.concatenate(
        [np.geomspace(0.5, 1.0, 3), np.geomspace(2.0, 9.0, 20)]
    )  # at the ends, too
    np.testing.assert_allclose(kernel(omega) @ np.ones(23), 1.0, rtol=1e-12)
