"""An aircraft in its loop at its sampling instants, and what its records tell of the parameters.

The sticks are u = r - K y with the designed input r; between samples they are straight lines. The
delayed stick d(t) = u(t - τ) has the slope v[k] at sample k, and one break before the next sample,
ρ before it, where the slope becomes v[k+1] (`intersample`, whose integrals are P₁ and P₂):

    x[k+1] = E x[k] + P₁(h) B d[k] + P₂(h) B v[k] + P₂(ρ) B (v[k+1] - v[k])
    y[k] = C x[k] + D d[k]

The derivatives s = ∂x/∂λ for given sticks, which are what output error works with, follow

    s[k+1] = E s[k] + Φ0 z[k] + Φ1 v[k+1],    ∂y[k]/∂λ = C s[k] + Ψ z[k],    z = (x, d, v),

with ∂d/∂τ = -v and ∂P₂(ρ)/∂τ = -P₁(ρ).

and F = Σ (∂y/∂λ)ᵀ R⁻¹ (∂y/∂λ), the initial state and a bias of each output, which are estimated
too, projected out. All is linear in r, so z is a convolution of r with impulse responses of the
loop, and the derivatives of any criterion of F by r come from one recursion backward in time.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.checks import check_known
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.intersample import integral_slopes

Feedback = Mapping[str, Mapping[str, float]]  # {"lat": {"p": 0.15}}: u_lat = r_lat - 0.15 p

GROWTH = 15.0  # e-folds of an unstable mode over a manoeuvre beyond which numbers lose their sense
ALONE = 2.0  # e-folds that are left to an unstable mode that no feedback holds
FAINT = 1e-9  # what an output that is no rate, angle or other state counts for as an example
GROWN = 3.0  # how much larger the end of an impulse response may be than all before


class UnheldError(ValueError):
    """An aircraft that its feedback does not hold; ``example`` is one that may, as it is told."""

    def __init__(self, message: str = "", example: Feedback | None = None) -> None:
        super().__init__(message)
        self.example = example or {}


@dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """What the loop does: sticks, outputs, and z of the sensitivities, (N, ...) each."""

    u: Array
    y: Array
    z: Array
    nx: int

    @property
    def signals(self) -> Array:
        """Sticks, outputs and states, (N, nu + ny + nx)."""
        return np.concatenate([self.u, self.y, self.z[:, : self.nx]], axis=1)


class Loop:
    """A structure at its guess in its loop, sampled N times every h seconds."""

    def __init__(self, free: Free, feedback: Feedback, R: Array, *, h: float, N: int) -> None:
        at = MatrixFunction(free)(free.guess)
        self.inputs, self.outputs = free.model.inputs, free.model.outputs
        self.nx, self.nu, self.ny, self.nf = at.nx, at.dtau.shape[1], len(R), len(free.index)
        self.h, self.N = h, N
        poles, modes = np.linalg.eig(at.blocks[0])
        k = int(np.argmax(poles.real))
        self.growth = float(poles[k].real)
        # What a gain of stick j by output i takes from it: Re c_i v wᴴ b_j, of first order.
        C, B = at.blocks[2], at.blocks[1]
        self._held = np.outer(C @ modes[:, k], np.linalg.pinv(modes)[k] @ B).real
        self._held[[name not in free.model.states for name in self.outputs]] *= FAINT
        self._whiten = np.linalg.inv(np.linalg.cholesky(R))
        whole, self._part = np.divmod(at.tau / h, 1.0)
        self._lag = whole.astype(int)
        self._discretise(at)
        self._impulses(gains(feedback, self.inputs, self.outputs))

    def _discretise(self, at: Matrices) -> None:
        """Steps of the states and the maps Φ0, Φ1, Ψ to their derivatives and those of outputs."""
        A, B, C, D = at.blocks
        nx, h, dN = self.nx, self.h, at.slopes
        times = np.append(h * (1.0 - self._part), h)  # ρ of each stick, and the whole step
        maps = integral_slopes(A, times, np.moveaxis(dN[:, :nx, :nx], 0, 2))
        P, slopes = maps[..., 0], np.moveaxis(maps[..., 1:], 4, 2)
        dB = dN[:, :nx, nx:]
        (ramp, dramp), (rest, _) = (_by_columns(P[p, :-1], slopes[p, :-1], B, dB) for p in (2, 1))
        self.E, self._from_d = P[0, -1], P[1, -1] @ B
        self._from_v, self._from_next_v = P[2, -1] @ B - ramp, ramp
        late = at.dtau[:, None, :]  # ∂τ/∂λ
        dd = slopes[1, -1] @ B + P[1, -1] @ dB
        dv = slopes[2, -1] @ B + P[2, -1] @ dB - dramp - (self._from_d - rest) * late
        self._from_this = np.concatenate([slopes[0, -1], dd, dv], axis=2)
        self._from_next = dramp - rest * late
        direct = np.concatenate([dN[:, nx:, :nx], dN[:, nx:, nx:], -D * late], axis=2)
        self._direct = self._whiten @ direct
        self.C, self.D, self._C = C, D, self._whiten @ C

    def _impulses(self, K: Array) -> None:
        """Responses of sticks, outputs and z to one sample of each r, (N, ..., nu), as spectra."""
        # A line rises to the impulse from the sample before.
        nx, nu = self.nx, self.nu
        now, rise = np.where(self._lag == 0, [1.0 - self._part, np.full(nu, 1 / self.h)], 0.0)
        own = self.C @ (self._from_next_v * rise) + self.D * now
        inverse, before = np.linalg.inv(np.eye(nu) + K @ own), int(self._lag.max()) + 1
        sizes = np.cumsum([nx, nu, nu])
        now, rise = now[:, None], rise[:, None]

        def after(s: Array, impulse: Array) -> Array:
            """States, delayed sticks, their slopes and the last sticks, one sample later."""
            x, d, v, u = np.split(s, sizes)
            past = np.concatenate([u, 0.0 * impulse]).reshape(before + 1, nu, -1)
            d_now, v_now = self._delayed(past, before)
            step = self.E @ x + self._from_d @ d + self._from_v @ v + self._from_next_v @ v_now
            u_now = inverse @ (impulse - K @ (self.C @ step + self.D @ d_now))
            x = step + self._from_next_v @ (rise * u_now)
            return np.concatenate([x, d_now + now * u_now, v_now + rise * u_now, u[nu:], u_now])

        n = nx + (2 + before) * nu
        every = after(np.zeros((n, nu)), np.eye(nu))[None]
        with np.errstate(over="ignore", invalid="ignore"):  # of a loop that is refused below
            further = after(np.eye(n), np.zeros((nu, n)))
            while len(every) < self.N:  # twice as far with every product
                every = np.concatenate([every, further @ every])
                further = further @ further
        x, d, v, u = np.split(every[: self.N], sizes, axis=1)
        u = u[:, -nu:]
        self._check_stable(u, K)
        y = self.C @ x + self.D @ d
        self._sizes = np.cumsum([nu, self.ny])
        self.length = scipy.fft.next_fast_len(2 * self.N, real=True)
        whole = np.concatenate([u, y, x, d, v], axis=1)
        self.spectra = scipy.fft.rfft(whole, self.length, axis=0)

    def _delayed(self, u: Array, k: int) -> tuple[Array, Array]:
        """Delayed sticks and their slopes at row k of u, in which that row itself is still zero."""
        sticks, rows = np.arange(self.nu), k - self._lag
        this, last = u[rows, sticks], u[rows - 1, sticks]
        f = self._part[:, None]
        return (1.0 - f) * this + f * last, (this - last) / self.h

    def _check_stable(self, u: Array, K: Array) -> None:
        growth, span = self.growth, self.h * (self.N - 1)
        longest = np.floor(10 * GROWTH / max(growth, 1e-9)) / 10  # not rounded up: told to be flown
        if not K.any() and growth * span > ALONE:
            i, j = np.unravel_index(int(np.argmax(np.abs(self._held))), self._held.shape)
            gain = float(np.copysign(0.1, self._held[i, j]))
            shorter = f", and fly {longest:g} s at most" if growth * span > GROWTH else ""
            example = {self.inputs[j]: {self.outputs[i]: gain}}
            raise UnheldError(
                f"the aircraft is unstable ({growth:.3g} 1/s) and nothing holds it over "
                f"{span:.4g} s, in which it grows by more than e^{ALONE:g}: give the feedback that "
                f"is flown, such as feedback={example}{shorter}",
                example,
            )
        if growth * span > GROWTH:
            raise UnheldError(
                f"an unstable mode of the aircraft grows with {growth:.3g} 1/s, by a factor of "
                f"e^{growth * span:.0f} over {span:.4g} s: design manoeuvres of {longest:g} s at "
                "most"
            )
        last = 4 * self.N // 5
        if K.any() and not np.abs(u[last:]).max() <= GROWN * np.abs(u[:last]).max() < np.inf:
            raise UnheldError(
                "the loop is unstable with this feedback: u = r - K y, so a gain that damps has "
                "the sign of its control derivative; check signs, units (rad, rad/s), the model, "
                "which without a fit is the guess, and dt: feedback acts once a sample, here every "
                f"{self.h:.3g} s"
            )

    @cached_property
    def _unknown(self) -> Array:
        """Orthonormal basis of what initial states and biases do to the weighted outputs."""
        free = np.empty((self.N, self.ny, self.nx))
        state = np.eye(self.nx)
        for k in range(self.N):
            free[k] = self._C @ state
            state = self.E @ state
        biases = np.broadcast_to(self._whiten, (self.N, self.ny, self.ny))
        return spanned(np.concatenate([free, biases], axis=2).reshape(self.N * self.ny, -1))

    def fly(self, r: Array) -> Response:
        """Sticks, outputs and z after a designed input r (N, nu)."""
        spectrum = scipy.fft.rfft(r, self.length, axis=0)
        every = scipy.fft.irfft(
            (self.spectra @ spectrum[:, :, None])[:, :, 0], self.length, axis=0
        )[: self.N]
        u, y, z = np.split(every, self._sizes, axis=1)
        return Response(u=u, y=y, z=z, nx=self.nx)

    def impulses(self) -> Array:
        """Sticks, outputs and states (N, nu + ny + nx, nu) after one sample of each r."""
        some = self.spectra[:, : self.nu + self.ny + self.nx]
        return scipy.fft.irfft(some, self.length, axis=0)[: self.N]

    def pulled_back(self, signals: Array, z: Array) -> Array:
        """Derivatives by r (N, nu) of a function with these derivatives by signals and z."""
        u, y, x = np.split(signals, self._sizes, axis=1)
        late = z[:, self.nx :]
        every = np.concatenate([u, y, x + z[:, : self.nx], late], axis=1)
        whole = scipy.fft.rfft(every, self.length, axis=0)
        product = np.einsum("kij,ki->kj", np.conj(self.spectra), whole)
        return np.asarray(scipy.fft.irfft(product, self.length, axis=0)[: self.N])

    def held(self, u: Array) -> Array:
        """The z (N, nx + 2 nu) of sticks u (N, nu) that were flown, from rest."""
        before = int(self._lag.max()) + 1
        late = np.concatenate([np.zeros((before, self.nu)), u])[..., None]
        both = [self._delayed(late, before + k) for k in range(self.N)]
        d, v = (np.array(each)[..., 0] for each in zip(*both, strict=True))
        x = np.zeros((self.N, self.nx))
        for k in range(1, self.N):
            x[k] = self.E @ x[k - 1] + self._from_d @ d[k - 1] + self._from_v @ v[k - 1]
            x[k] += self._from_next_v @ v[k]
        return np.concatenate([x, d, v], axis=1)

    def sensitivities(self, z: Array) -> Array:
        """Derivatives of the weighted outputs by λ, unknowns projected out: (N ny, nf)."""
        push = np.tensordot(z[:-1], self._from_this, (1, 2))
        push += np.tensordot(z[1:, -self.nu :], self._from_next, (1, 2))
        s, E = np.zeros((self.N, self.nf, self.nx)), self.E.T
        for k in range(self.N - 1):
            s[k + 1] = s[k] @ E + push[k]
        J = s @ self._C.T + np.tensordot(z, self._direct, (1, 2))
        J = J.transpose(0, 2, 1)
        flat = J.reshape(-1, self.nf)
        return np.asarray(flat - self._unknown @ (self._unknown.T @ flat))

    def information_slope(self, J: Array, M: Array) -> Array:
        """Derivatives by z (N, nz) of tr(M F), F = JᵀJ with the sensitivities J at z."""
        G = (2 * J @ M).reshape(self.N, self.ny, self.nf)
        pull = G.transpose(0, 2, 1) @ self._C
        for k in range(self.N - 2, -1, -1):
            pull[k] += pull[k + 1] @ self.E
        slope = np.tensordot(G, self._direct, ([1, 2], [1, 0]))
        slope[:-1] += np.tensordot(pull[1:], self._from_this, ([1, 2], [0, 1]))
        slope[1:, -self.nu :] += np.tensordot(pull[1:], self._from_next, ([1, 2], [0, 1]))
        return slope


class Crowd:
    """Loops of models of which only shares of limits are asked, on one grid, in single precision.

    They are taken one by one, because each knows far more than is kept of it: of sticks, rates,
    outputs and states only the C signals with a finite limit.
    """

    def __init__(self, loops: Iterable[Loop], limits: Array) -> None:
        self.places, self._n = np.flatnonzero(np.isfinite(limits)), len(limits)
        parts = []
        for each in loops:
            self.N, self._length = each.N, each.length
            parts.append(self._shares(each, limits).astype(np.complex64))
        self.count = len(parts)
        # Of all models side by side, (frequencies, M C, nu): one product each.
        self._spectra = np.concatenate(parts, axis=1) if parts else np.zeros((0, 0, 0))

    def _shares(self, loop: Loop, limits: Array) -> ComplexArray:
        """Spectra of shares after one sample of each r, (frequencies, C, nu)."""
        u, sides, _ = np.split(loop.spectra, [loop.nu, loop.nu + loop.ny + loop.nx], axis=1)
        before = np.exp(-2j * np.pi * np.arange(len(u)) / loop.length)[:, None, None]
        whole = np.concatenate([u, (1.0 - before) * u / loop.h, sides], axis=1)
        return np.asarray(whole[:, self.places] / limits[self.places, None])

    def fly(self, r: Array) -> Array:
        """Shares (M, N, C) of every model after r (N, nu)."""
        spectrum = scipy.fft.rfft(r.astype(np.float32), self._length, axis=0)
        every = (self._spectra @ spectrum[:, :, None])[..., 0]
        flown = scipy.fft.irfft(every, self._length, axis=0)[: self.N]
        return np.moveaxis(flown.reshape(self.N, self.count, -1), 1, 0)

    def peaks(self, r: Array) -> Array:
        """Largest shares (M, n) of each model; zero of what has no limit."""
        out = np.zeros((self.count, self._n))
        out[:, self.places] = np.abs(self.fly(r)).max(axis=1)
        return out

    def impulses(self, model: int) -> Array:
        """Shares (N, C, nu) of one model after one sample of each r."""
        rows = slice(model * len(self.places), (model + 1) * len(self.places))
        return scipy.fft.irfft(self._spectra[:, rows], self._length, axis=0)[: self.N]

    def pulled_back(self, slope: Array) -> Array:
        """Derivatives by r (N, nu) of a function with these derivatives by what `fly` gives."""
        flat = np.moveaxis(slope, 0, 1).reshape(self.N, -1)
        whole = np.conj(scipy.fft.rfft(flat, self._length, axis=0))[:, None]
        product = np.conj(whole @ self._spectra)[:, 0]
        return np.asarray(scipy.fft.irfft(product, self._length, axis=0)[: self.N])


def spanned(block: Array) -> Array:
    """Orthonormal basis (n, m or fewer) of what the columns of a block (n, m) span."""
    block = block / np.maximum(np.linalg.norm(block, axis=0), 1e-300)
    basis, sizes, _ = np.linalg.svd(block, full_matrices=False)
    return np.asarray(basis[:, sizes > 1e-10 * sizes[0]])


def gains(feedback: Feedback, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Array:
    """K (nu, ny) of u = r - K y."""
    K = np.zeros((len(inputs), len(outputs)))
    for stick, gains in feedback.items():
        for output, gain in gains.items():
            for name, known in ((stick, inputs), (output, outputs)):
                check_known("feedback names", [name], known)
            if not np.isfinite(gain):
                raise ValueError(f"feedback: the gain of {stick!r} by {output!r} is {gain}")
            K[inputs.index(stick), outputs.index(output)] = gain
    return K


def _by_columns(P: Array, dP: Array, B: Array, dB: Array) -> tuple[Array, Array]:
    """P_j b_j for each column j of B, (nx, nu), and its derivatives (nf, nx, nu)."""
    moved = np.einsum("jlab,bj->laj", dP, B) + np.einsum("jab,lbj->laj", P, dB)
    return np.einsum("jab,bj->aj", P, B), moved
