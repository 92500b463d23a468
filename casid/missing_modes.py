"""Modes of a black box that no mode of a structure is near, and what they make of responses."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from casid.arrays import BoolArray, ComplexArray
from casid.model import Model
from casid.response_fit import BoxResponse
from casid.subspace.blackbox import BlackBox, passed
from casid.subspace.refinement import ResponseUncertainty
from casid.values import storable

NEAR = 0.3  # of its modulus: how far from a black box's mode the structure's may be
KNOWN = 0.5  # of its modulus: what the errors of a mode that is named may be
MAKES = 0.5  # of what is missed in a band: what a mode that is missing makes there at least


@storable
@dataclass(frozen=True, kw_only=True)
class MissingMode:
    """A mode of the black box that no mode of the structure is near.

    Parameters
    ----------
    real, imag : float
        Of its pole [1/s], imag >= 0.
    real_std, imag_std : float
        Standard deviations of these [1/s]; NaN if not known.
    """

    real: float
    imag: float
    real_std: float
    imag_std: float

    @property
    def pole(self) -> complex:
        """The pole [1/s]."""
        return complex(self.real, self.imag)

    def __str__(self) -> str:
        """The mode with its errors, in words."""
        real = f"{self.real:.2g}{_error(self.real_std)}"
        told = " (1σ)" if np.isfinite(self.real_std) else ""
        if not self.imag:
            return f"a mode at {real}{told}".replace("-", "−")
        imag = f"{self.imag:.2g}{_error(self.imag_std)}"
        return f"a pair at {real} and ±{imag} j{told}".replace("-", "−")


@dataclass(frozen=True, eq=False)
class Lacking:
    """Modes of a black box that no mode of a structure is near, and what they make of responses."""

    modes: tuple[MissingMode, ...]
    parts: ComplexArray  # (modes, K, ny, nu) of the scaled response

    @classmethod
    def of(cls, box: BlackBox, model: Model, target: BoxResponse) -> "Lacking":
        """Those that are known at all."""
        # A discrete pole that is not above zero is of no mode in continuous time, and too fast for
        # any structure.
        system, h = box.system, box.system.dt
        rows = [system.outputs.index(name) for name in model.outputs]
        columns = [system.inputs.index(name) for name in model.inputs]
        poles, right = np.linalg.eig(system.A)
        C, B = system.C[rows] @ right, np.linalg.solve(right, system.B[:, columns].astype(complex))
        told = (poles.imag >= 0) & ((h is None) | (poles.imag > 0) | (poles.real > 0))
        poles, C, B = (part[..., told] for part in (poles, C, B.T))
        own = poles if h is None else np.log(poles) / h
        s = 1j * target.omega[:, None, None]
        x, held = (s, 1.0) if h is None else (np.exp(s * h), passed(target.omega, h, box.hold))
        found, parts = [], []
        for k in _unmatched(own, model.system().poles()):
            mode = _with_errors(complex(own[k]), box)
            error = float(np.nan_to_num(np.hypot(mode.real_std, mode.imag_std)))
            doubtful = np.isclose(mode.pole, box.doubtful).any()
            if error < KNOWN * abs(mode.pole) and not doubtful:
                residue = target.scale * np.outer(C[:, k], B[:, k])
                part = residue / (x - poles[k])
                if mode.pole.imag:
                    part = part + residue.conj() / (x - poles[k].conjugate())
                found.append(mode)
                parts.append(part / held)
        shape = (0, *target.G.shape)
        return cls(tuple(found), np.array(parts) if parts else np.zeros(shape, dtype=complex))

    def of_pair(
        self, band: tuple[float, float], at: tuple[BoolArray, int, int], missed: float
    ) -> MissingMode | None:
        """The one near a band that makes most of a pair's response, if it can be what is missed."""
        near = [band[0] / 2 <= abs(mode.pole) <= 2 * band[1] for mode in self.modes]
        size = np.where(near, np.linalg.norm(self.parts[(slice(None), *at)], axis=1), 0.0)
        if not size.max(initial=0.0) > MAKES * missed:
            return None
        return self.modes[int(np.argmax(size))]


def _unmatched(poles: ComplexArray, others: ComplexArray) -> Iterator[int]:
    """Which poles (Im >= 0) have none of the others near, each of these near one only."""
    others = others[others.imag >= 0]
    apart = np.minimum(np.abs(poles[:, None] - others) / np.abs(poles)[:, None], 1.0)
    mine, theirs = scipy.optimize.linear_sum_assignment(apart)
    near = {int(a) for a, b in zip(mine, theirs, strict=True) if apart[a, b] <= NEAR}
    return (k for k in range(len(poles)) if k not in near)


def _with_errors(pole: complex, box: BlackBox) -> MissingMode:
    """A pole of a black box with the errors of its parts."""
    real_std = imag_std = np.nan
    if isinstance(box.uncertainty, ResponseUncertainty):
        poles, real, imag = box.uncertainty.pole_std()
        k = int(np.argmin(np.abs(poles - pole)))
        real_std, imag_std = float(real[k]), float(imag[k])
    return MissingMode(real=pole.real, imag=pole.imag, real_std=real_std, imag_std=imag_std)


def _error(std: float) -> str:
    """An error in words; nothing if it is not known."""
    return f" ± {std:.1g}" if np.isfinite(std) else ""
