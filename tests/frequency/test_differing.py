"""Records whose own response is not that of the others."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from casid import DataWarning, Record, frequency_response
from casid.frequency.differing import differing

OMEGA, DT, T = np.geomspace(0.8, 10, 24), 0.02, 40.0
PLANT = ([12.0], [1.0, 2.8])


def sweep(seed, name, size=0.05, noise=0.003):
    """p and phi after a sweep of lat, p' = -2.8 p + 12 lat, by scipy; the noise of a good gyro."""
    rng, t = np.random.default_rng(seed), np.arange(0, T, DT)
    lat = size * np.sin(0.4 * t + (11 - 0.4) / T / 2 * t**2)
    p = scipy.signal.lsim(PLANT, lat, t)[1]
    phi = scipy.signal.lsim(([12.0], [1.0, 2.8, 0.0]), lat, t)[1]
    y = np.column_stack([p, phi]) + noise * rng.standard_normal((len(t), 2))
    return Record(t, lat[:, None], y, ("lat",), ("p", "phi"), name)


def three(seed=0, noise=0.003):
    sizes = (0.05, 0.03, 0.06)
    return [sweep(3 * seed + k, f"sweep {k}", size, noise) for k, size in enumerate(sizes)]


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("noise", [0.003, 0.06])
def test_sound_records_of_several_sizes_agree(noise):
    for seed in range(6):
        frequency_response(three(seed, noise), omega=OMEGA)  # a warning would raise
    assert differing(three()[:1], OMEGA, np.ones((len(OMEGA), 2, 1), complex)) == ""


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda one: replace(one, u=0.5 * one.u),
            r"all outputs after lat in 'sweep 2' are (1\.9|2\.0)\d ± \S+ times as large as those "
            r"in 'sweep 0', 'sweep 1', as of a lat of 0\.(49|50|51) times its size",
        ),
        (
            lambda one: replace(one, y=one.y * [0.5, 1]),
            r"disagree: p after lat in 'sweep 2' is 0\.(49|50|51) ± \S+ times as large",
        ),
        (
            lambda one: replace(one, y=one.y * [-1, 1]),
            r"p after lat in 'sweep 2' is -(0\.9|1\.0)\d ± \S+ times as large",
        ),
        (
            lambda one: one.shift({"lat": 0.06}),
            r"'sweep 2' are (59|60|61) ± \d ms earlier than .* logged (59|60|61) ms late",
        ),
    ],
    ids=["scale of a stick", "scale of an output", "sign", "clock"],
)
@pytest.mark.second
def test_a_spoiled_record_is_named_with_channel_and_size(spoil, said):
    first, second, third = three()
    with pytest.warns(DataWarning, match=said) as told:
        frequency_response([first, second, spoil(third)], omega=OMEGA)
    assert len(told) == 1
    assert "nonlinear" in str(told[0].message)
