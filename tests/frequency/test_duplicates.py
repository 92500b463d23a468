"""Responses of the same numbers."""

from dataclasses import replace

import numpy as np
import pytest

from casid import FrequencyResponse
from casid.frequency.duplicates import same_numbers

OMEGA = np.geomspace(0.3, 10, 12)


def measured(seed, **changes):
    """Random numbers with errors of 3 %, of two outputs after one input."""
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((12, 2, 1)) + 1j * rng.standard_normal((12, 2, 1))
    known = {"coherence": np.full(G.shape, 0.9), "random_error": np.full(G.shape, 0.03)}
    sizes = {"input_std": np.ones(1), "output_std": np.ones(2)}
    names = {"inputs": ("lon",), "outputs": ("w", "q")}
    return replace(FrequencyResponse(omega=OMEGA, G=G, **known, **sizes, **names), **changes)


@pytest.mark.parametrize(
    ("pairs", "once", "every"), [([], "", ""), ([1], "q", ""), ([0, 1], "w", "w")]
)
def test_pairs_of_the_same_numbers_are_named(pairs, once, every):
    one, other = measured(1), measured(2)
    for nearly in (1.0, 1 + 1e-3):
        G = other.G.copy()
        G[:, pairs] = nearly * one.G[:, pairs]
        copy = replace(other, G=G)
        for said, name in (
            (same_numbers(one, copy), once),
            (same_numbers(one, copy, every=True), every),
        ):
            assert bool(said) == bool(name)
            assert f"{name} after lon" * bool(name) in said


def test_zeros_and_what_was_not_measured_are_no_same_numbers():
    one, other = measured(1), measured(2)
    for nothing in (0.0, np.nan):
        G = [each.G.copy() for each in (one, other)]
        for each in G:
            each[:, 1] = nothing
        both = replace(one, G=G[0]), replace(other, G=G[1])
        assert same_numbers(*both) == same_numbers(*both, every=True) == ""
        assert "w after lon" in same_numbers(both[0], both[0], every=True)


def test_numbers_rounded_with_their_frequencies_are_the_same():
    one = measured(1)
    rounded = [float(f"{omega:.4g}") for omega in OMEGA]
    copy = replace(one, omega=np.array(rounded), G=np.round(one.G, 4))
    assert "as one does with its numbers rounded" in same_numbers(one, copy)
