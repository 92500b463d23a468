"""Spectra summed before they are weighed, against every spectrum by itself in plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from truths.systems import campaign, unstable_plant

from casid.records import standard_deviations
from casid.subspace.fourier import parts as cut
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import parts
from casid.subspace.modal import moved, to_modal
from casid.subspace.pooled_spectra import alike, fewest
from casid.subspace.slopes import normal_equations, with_outputs


def flown(records):
    """Groups of spectra of so many records, a model that is off, and where its D is free."""
    data, plant = campaign(noise=0.05, records=records, duration=8.0), unstable_plant()
    longer = campaign(noise=0.05, records=2, duration=11.0)
    su, sy = standard_deviations(data)
    lines, mask, rng = (
        spectra([*data, *longer], su, sy, 12.0),
        plant.D != 0,
        np.random.default_rng(1),
    )
    weights = {s.grid: rng.uniform(0.5, 2.0, (len(s.omega), 3)) for s in lines}
    free = np.argwhere(mask)
    step = 0.02 * rng.standard_normal(plant.nx * (1 + sum(mask.shape)) + len(free))
    modal = moved(to_modal(plant, su, sy, mask), step, free)
    return lines, [weights[s.grid] for s in lines], modal, free


def residuals(modal, s, w):
    """Weighted residuals of one spectrum but for transients, and what these span, real."""
    lam = np.r_[modal.lam, modal.lam.conj()]
    B, C = np.r_[modal.B, modal.B.conj()], np.c_[modal.C, modal.C.conj()]
    own = np.r_[np.ones(len(modal.lam)), np.where(modal.real, 0.0, 1.0)]  # a real mode counts once
    r, _, ends, _ = s.pole_factors(lam)
    e = s.Y - (own * r * (s.U @ B.T)) @ C.T - s.U @ modal.D.T
    both = (ends * own)[:, None] * C * w[:, :, None]  # (K, ny, 2 nm)
    one, other = np.split(both, 2, axis=2)
    P = np.concatenate([one + other, (1j * (one - other))[..., ~modal.real]], axis=2)
    P = P.reshape(-1, P.shape[2])
    e = (e * w).ravel()
    return np.r_[e.real, e.imag], np.vstack([P.real, P.imag])


def left(modal, lines, weights):
    """Weighted residuals of all spectra, each with its best transient."""
    found = []
    for s, w in zip(lines, weights, strict=True):
        e, P = residuals(modal, s, w)
        found.append(e - P @ np.linalg.lstsq(P, e)[0])
    return np.concatenate(found)


@pytest.mark.second
@pytest.mark.parametrize("records", [2, 30])
def test_sums_of_spectra_are_those_of_every_one_by_itself(records):
    lines, weights, modal, free = flown(records)
    groups = alike(lines, weights)
    assert [len(group.which) for group in groups] == [records, 2]
    known = parts(modal, groups)
    e = left(modal, lines, weights)
    assert sum(part.cost.sum() for part in known) == pytest.approx(e @ e, rel=1e-11)
    _, gradient = normal_equations(modal, known, free)
    h = 1e-5
    slopes = [
        (
            left(moved(modal, step, free), lines, weights)
            - left(moved(modal, -step, free), lines, weights)
        )
        / (2 * h)
        for step in h * np.eye(len(gradient))
    ]
    np.testing.assert_allclose(gradient, -np.array(slopes) @ e, atol=1e-7 * np.abs(gradient).max())


def test_of_many_spectra_alike_fewer_have_the_same_products():
    lines, weights, modal, free = flown(30)
    many = parts(modal, alike(lines, weights))
    few = parts(modal, alike(lines, [w.copy() for w in weights]))  # each in a group of its own
    assert (len(many), len(few)) == (2, 32)
    assert len(many[0].drive().U) < 20
    for ours, theirs in zip(
        normal_equations(modal, many, free), normal_equations(modal, few, free), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, atol=1e-11 * np.abs(theirs).max())
    ours, theirs = with_outputs(modal, many, free), with_outputs(modal, few, free)
    np.testing.assert_allclose(ours.C, theirs.C, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(ours.D, theirs.D, rtol=1e-10, atol=1e-12)


def test_products_of_all_that_drives_modes_stay():
    rng = np.random.default_rng(2)

    def drawn(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    U, delta, E, real = (
        drawn(40, 5, 2),
        drawn(40, 3),
        drawn(40, 5, 4),
        np.array([True, False, False]),
    )
    delta[:, real] = delta[:, real].real
    found = fewest(U, delta, E, real)
    assert len(found.U) == 2 + 3 + 2 + 4
    ends = np.broadcast_to(delta[:, None], (40, 5, 3))
    every = np.concatenate([U, ends, ends.conj() * ~real, E], axis=2)
    summed = np.concatenate(found, axis=2)
    expected = np.einsum("rki,rkj->kij", every.conj(), every)
    np.testing.assert_allclose(
        np.einsum("rki,rkj->kij", summed.conj(), summed),
        expected,
        atol=1e-12 * np.abs(expected).max(),
    )


@pytest.mark.second
def test_pieces_that_differ_in_the_rounding_of_their_clock_alone_are_alike():
    (whole,) = campaign(records=1, duration=1200.0)
    su, sy = standard_deviations([whole])
    pieces = cut(replace(whole, t=0.0173 * np.arange(whole.N)), 30.0)
    assert len({piece.duration for piece in pieces[:-1]}) > 1
    data = spectra(pieces, su, sy, 30.0)
    assert len({lines.grid for lines in data[:-1]}) == 1
