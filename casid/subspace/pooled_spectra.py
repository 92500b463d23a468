"""Spectra that are alike, of one grid and one set of weights: summed before they are weighed.

What a model makes of such spectra is, line by line, the same combinations T of what drives them,

    s_r(ω) = T(ω) v_r(ω),    v = (inputs, transient, residuals),

whose products, Σ_r s_r s_rᴴ = T (Σ_r v_r v_rᴴ) Tᴴ, are those of the columns of a triangular factor
of all v_r instead: no more than v has entries, however many pieces a long record is cut into.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.subspace.fourier import Spectrum


@dataclass(frozen=True, eq=False)
class Alike:
    """Transforms of R stretches and what their lines count, 1/√Φ."""

    which: tuple[int, ...]  # their places among all spectra
    first: Spectrum
    U: ComplexArray  # (R, K, nu)
    Y: ComplexArray  # (R, K, ny)
    w: Array  # (K, ny)

    def pole_factors(self, lam: ComplexArray) -> tuple[ComplexArray, ...]:
        """Those of any of the spectra, (K, nm); see `Spectrum.pole_factors`."""
        return self.first.pole_factors(lam)


class Drive(NamedTuple):
    """What signals of modes are made of, at every line of every stretch, or of fewer in its place.

    Of these what is conjugate of a transient no longer is, and a transient depends on the line.
    """

    U: ComplexArray  # (R, K, nu)
    delta: ComplexArray  # (R, K, nm) or (R, 1, nm)
    delta_c: ComplexArray  # likewise, conjugate; zero of real modes
    E: ComplexArray  # (R, K, ny)


def alike(data: Sequence[Spectrum], weights: Sequence[Array]) -> list[Alike]:
    """The spectra in groups of one grid and, as the same array, one set of weights (K, ny)."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, (spectrum, w) in enumerate(zip(data, weights, strict=True)):
        groups.setdefault((*spectrum.grid, id(w)), []).append(i)
    return [
        Alike(
            which=tuple(group),
            first=data[group[0]],
            U=np.array([data[i].U for i in group]),
            Y=np.array([data[i].Y for i in group]),
            w=weights[group[0]],
        )
        for group in groups.values()
    ]


def fewest(U: ComplexArray, delta: ComplexArray, E: ComplexArray, real: BoolArray) -> Drive:
    """What has the products of inputs U (R, K, nu), transients δ (R, nm) and residuals (R, K, ny).

    That is themselves if they are no more than entries of all of them together.
    """
    ends, R = delta[:, None], len(U)
    ends_c = np.where(real, 0.0, ends.conj())
    nu, nm, nc = U.shape[2], len(real), int((~real).sum())
    if nu + nm + nc + E.shape[2] >= R:
        return Drive(U, ends, ends_c, E)
    lines = (*U.shape[:2], -1)
    both = np.concatenate([ends, ends_c[..., ~real]], axis=2)
    v = np.concatenate([U, np.broadcast_to(both, (*lines[:2], nm + nc)), E], axis=2)
    v = np.asarray(np.linalg.qr(v.swapaxes(0, 1), mode="r")).swapaxes(0, 1)
    U, ends, some, E = np.split(v, np.cumsum([nu, nm, nc]), axis=2)
    ends_c = np.zeros_like(ends)
    ends_c[..., ~real] = some
    return Drive(U, ends, ends_c, E)
