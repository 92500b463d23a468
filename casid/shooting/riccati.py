"""The covariance of a Kalman filter, one step on and many steps alike at once.

Without its gain a step of `casid.shooting.kalman` is

    f(P) = Θ + Φ P (I + J P)⁻¹ Φᵀ,    Φ = A_d,    Θ = Q_d,    J = Cᵀ R⁻¹ C,

and so are two, f₂ after f₁ (S. Särkkä, Á. F. García-Fernández, Temporal parallelization of Bayesian
smoothers, IEEE Trans. Automatic Control 66, 2021):

    Φ = Φ₂ M Φ₁,    Θ = Θ₂ + Φ₂ M Θ₁ Φ₂ᵀ,    J = J₁ + Φ₁ᵀ J₂ M Φ₁,    M = (I + Θ₁ J₂)⁻¹.

The maps over one to `MANY` steps come by doubling, and with them as many covariances from one. What
a nearly exact sensor (R near 0) costs them in digits one step in Joseph's form mends; where it
would have to mend much, steps are taken one by one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array

FEW, MANY = 8, 64
NEAR = 1e-9  # of the standard deviations, at most: what Joseph's form may mend


@dataclass(frozen=True, eq=False)
class Step:
    """What takes a covariance over a step, or over each of several (...)."""

    A: Array  # (..., nx, nx) A_d
    Q: Array  # (..., nx, nx) Q_d
    C: Array  # (..., ny, nx), 0 of a channel that is missing
    R: Array  # (..., ny, ny), 1 alone on the diagonal there

    def apart(self) -> "list[Step]":
        """Each of several (g) alone."""
        return [Step(*each) for each in zip(self.A, self.Q, self.C, self.R, strict=True)]

    def gain(self, P: Array) -> tuple[Array, Array]:
        """K (..., nx, ny) and S (..., ny, ny) from P (..., nx, nx) before the sample."""
        CP = self.C @ P
        S = CP @ _turned(self.C) + self.R
        return _turned(np.linalg.solve(S, CP @ _turned(self.A))), S

    def ahead(self, P: Array) -> Array:
        """P before the next sample, in Joseph's form: never indefinite by rounding."""
        K, _ = self.gain(P)
        F = self.A - K @ self.C
        ahead = F @ P @ _turned(F) + K @ self.R @ _turned(K) + self.Q
        return np.asarray(ahead + _turned(ahead)) / 2

    def repeated(self, P: Array, count: int) -> Iterator[Array]:
        """P (nx, nx) behind each of so many samples, MANY at a time."""
        powers = Powers.of(self, count) if count >= FEW else None
        while count:
            many = min(count, MANY)
            found = None if powers is None or many < FEW else powers.after(self, P, many)
            if found is None:
                one, found = P, np.empty((many, *P.shape))
                for k in range(many):
                    found[k] = one = self.ahead(one)
            yield found
            P, count = found[-1], count - many


@dataclass(frozen=True, eq=False)
class Powers:
    """Φ, Θ and J over 1, 2, ... steps (n, nx, nx)."""

    Phi: Array
    Theta: Array
    J: Array

    @classmethod
    def of(cls, step: Step, count: int) -> "Powers | None":
        """Over so many steps, but no more than MANY; None where R has no inverse."""
        try:
            J = step.C.T @ np.linalg.solve(step.R, step.C)
            found = cls(step.A[None], step.Q[None], J[None])
            with np.errstate(all="ignore"):  # told by `after`
                while len(found.J) < min(count, MANY):
                    found = found.doubled()
        except np.linalg.LinAlgError:
            return None
        return found

    def doubled(self) -> "Powers":
        """Twice as many: these, and the longest of them behind each."""
        Phi, Theta, J = self.Phi[-1], self.Theta[-1], self.J[-1]
        both = np.concatenate([self.Phi, self.Theta], axis=2)
        M = np.linalg.solve(np.eye(len(J)) + self.Theta @ J, both)
        by_Phi, by_Theta = M[..., : len(J)], M[..., len(J) :]
        return Powers(
            np.concatenate([self.Phi, Phi @ by_Phi]),
            np.concatenate([self.Theta, Theta + Phi @ by_Theta @ Phi.T]),
            np.concatenate([self.J, self.J + _turned(self.Phi) @ J @ by_Phi]),
        )

    def after(self, step: Step, P: Array, count: int) -> Array | None:
        """P (count, nx, nx) behind the first of them; None where too few digits would be left."""
        Phi, Theta, J = self.Phi[:count], self.Theta[:count], self.J[:count]
        with np.errstate(all="ignore"):
            try:
                held = np.linalg.solve(np.eye(len(P)) + P @ J, P)
            except np.linalg.LinAlgError:
                return None
            rough = Theta + Phi @ held @ _turned(Phi)
            found = step.ahead(np.concatenate([P[None], rough[:-1]]))
            size = np.sqrt(np.einsum("kii->ki", found))
            size[size == 0] = 1.0  # what nothing drives
            off = np.abs(found - rough) / (size[:, :, None] * size[:, None])
        return found if off.max() <= NEAR else None  # NaN is not


def _turned(X: Array) -> Array:
    return np.swapaxes(X, -1, -2)
