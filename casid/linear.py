"""Linear state-space models with input delays: dx/dt = A x + B u(t - τ), y = C x + D u(t - τ)."""

import math
from dataclasses import dataclass, field
from typing import get_args

import numpy as np
import scipy.linalg

from casid.arrays import Array, ComplexArray
from casid.display import Shown, listed
from casid.intersample import break_forcing, delayed_input, integrals
from casid.record import Hold
from casid.values import storable

NEGLIGIBLE = 1e-250  # entries of a matrix, whose inverses would overflow


@storable
@dataclass(frozen=True, eq=False, repr=False)
class StateSpace(Shown):
    """A state-space model; continuous when ``dt`` is None, else discrete with that interval [s].

    Parameters
    ----------
    A, B, C, D : (nx, nx), (nx, nu), (ny, nx), (ny, nu) array
        Model matrices.
    dt : float or None
        Sampling interval [s].
    inputs, outputs, states : sequence of str
        Names; numbered ones unless given.
    delay : (nu,) array
        Pure delay of each input [s], >= 0; zero unless given.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    delay: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for letter in "ABCD":
            self._keep(letter, np.array(getattr(self, letter), dtype=float, ndmin=2))
        nx, nu, ny = self.A.shape[0], self.D.shape[1], self.D.shape[0]
        wanted = {"A": (nx, nx), "B": (nx, nu), "C": (ny, nx), "D": (ny, nu)}
        for letter, shape in wanted.items():
            if getattr(self, letter).shape != shape:
                raise ValueError(
                    f"{letter} has shape {getattr(self, letter).shape}, expected {shape}"
                )
        for attribute, n in (("inputs", nu), ("outputs", ny), ("states", nx)):
            letter = {"inputs": "u", "outputs": "y", "states": "x"}[attribute]
            names = tuple(getattr(self, attribute)) or tuple(f"{letter}{i + 1}" for i in range(n))
            if len(names) != n:
                raise ValueError(f"{len(names)} names for {n} {attribute}: {', '.join(names)}")
            object.__setattr__(self, attribute, names)
        if self.dt is not None and not self.dt > 0:
            raise ValueError(f"dt={self.dt}: expected a positive interval [s], or None")
        delay = np.array(self.delay, dtype=float) if len(self.delay) else np.zeros(nu)
        if delay.shape != (nu,) or not (delay >= 0).all():
            raise ValueError(f"delay is {delay}, expected {nu} values >= 0 s")
        self._keep("delay", delay)

    def _keep(self, name: str, values: Array) -> None:
        values.setflags(write=False)
        object.__setattr__(self, name, values)

    def headline(self) -> str:
        """Order, time, channels."""
        kind = "continuous" if self.dt is None else f"discrete, every {self.dt:g} s"
        late = f", delays up to {self.delay.max():.3g} s" if np.any(self.delay) else ""
        names = f"inputs {listed(self.inputs)}, outputs {listed(self.outputs)}"
        return f"order {self.nx}, {kind}, {names}{late}"

    @property
    def nx(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.D.shape[1])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return int(self.D.shape[0])

    def poles(self) -> ComplexArray:
        """Eigenvalues of A, the fastest growing first."""
        poles = np.linalg.eigvals(self.A).astype(complex)
        return poles[np.lexsort((poles.imag, -poles.real))]

    def response(self, omega: Array, shift: float = 0.0) -> ComplexArray:
        """Frequency response on s = shift + jω, or on z = exp(jω dt) of a discrete model.

        Parameters
        ----------
        omega : (K,) array
            Frequencies [rad/s].
        shift : float
            Real part of s [1/s]; the σ of the shifted norm, paper (8)-(9).

        Returns
        -------
        (K, ny, nu) complex array
        """
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        line = shift + 1j * omega
        s = line if self.dt is None else np.exp(line * self.dt)
        resolvent = s[:, None, None] * np.eye(self.nx) - self.A
        X = np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(s), self.nx, self.nu)))
        G = self.C @ X + self.D
        return np.asarray(G * np.exp(-line[:, None, None] * self.delay), dtype=complex)

    def transform(self, T: Array) -> "StateSpace":
        """The same model in the coordinates z = T x."""
        T_inv = np.linalg.inv(T)
        names = self.inputs, self.outputs, ()
        return StateSpace(
            T @ self.A @ T_inv, T @ self.B, self.C @ T_inv, self.D, self.dt, *names, self.delay
        )

    def simulate(self, t: Array, u: Array, x0: Array | None = None, hold: Hold = "foh") -> Array:
        """Outputs (N, ny) at the instants t, exact for inputs held as said and then delayed.

        Parameters
        ----------
        t : (N,) array
            Increasing instants [s], any spacing; of a discrete model, samples ``dt`` apart.
        u : (N, nu) array
            Inputs; before the first sample they rest at their first value.
        x0 : (nx,) array
            Initial state; zero unless given.
        hold : {"foh", "zoh"}
            What the inputs do between samples.

        Raises
        ------
        ValueError
            Arrays of other shapes, instants that do not increase, another hold.
        """
        steps = self.steps(t, u, hold)
        x = np.zeros(self.nx) if x0 is None else np.asarray(x0, dtype=float)
        if x.shape != (self.nx,):
            raise ValueError(f"x0 has shape {x.shape}, expected ({self.nx},)")
        if len(steps.maps) == 1:
            states = recursion(steps.maps[0], steps.forcing[:, :, None], x[:, None])[:, :, 0]
        else:
            states = np.empty((len(steps.which) + 1, self.nx))
            states[0] = x
            for k, i in enumerate(steps.which):
                states[k + 1] = steps.maps[i] @ states[k] + steps.forcing[k]
        return np.asarray(states @ self.C.T + steps.direct)

    def steps(self, t: Array, u: Array, hold: Hold = "foh") -> "Steps":
        """The simulation as a recursion, for those who want more of it than the outputs.

        Parameters
        ----------
        t, u, hold
            As in `simulate`.
        """
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if hold not in get_args(Hold):
            raise ValueError(f'hold={hold!r}, expected "foh" or "zoh"')
        if t.ndim != 1 or not (np.diff(t) > 0).all():
            raise ValueError("t: expected increasing instants [s], (N,)")
        if u.shape != (len(t), self.nu):
            raise ValueError(
                f"u has shape {u.shape}, expected (N, nu) = ({len(t)}, {self.nu}) for "
                f"{', '.join(self.inputs)}"
            )
        if self.dt is not None:
            return _discrete_steps(self, t, u, self.dt)
        held = delayed_input(t, u, self.delay, hold)
        widths, which = step_groups(t)
        E, P1, P2 = integrals(self.A, widths)
        forcing = break_forcing(held, self.A, self.B, 2 if hold == "foh" else 1)
        for i in range(len(widths)):
            here = np.flatnonzero(which == i)
            forcing[here] += held.value[here] @ (P1[i] @ self.B).T
            forcing[here] += held.slope[here] @ (P2[i] @ self.B).T
        return Steps(tuple(E), which, forcing, held.value @ self.D.T)


@dataclass(frozen=True, eq=False)
class Steps:
    """x[k + 1] = maps[which[k]] x[k] + forcing[k], and y = C x + direct."""

    maps: tuple[Array, ...]
    which: np.ndarray
    forcing: Array
    direct: Array


def recursion(E: Array, forcing: Array, start: Array) -> Array:
    """x[k + 1] = E x[k] + forcing[k], x[0] = start (n, c): (N + 1, n, c) for forcing (N, n, c)."""
    # In √N blocks: all at once from rest, then with what each takes over from the one before.
    N, n, c = forcing.shape
    size = math.isqrt(max(N - 1, 0)) + 1
    count = -(-N // size)
    padded = np.zeros((count * size, n, c))
    padded[:N] = forcing
    x = padded.reshape(count, size, n, c).transpose(1, 0, 3, 2).reshape(size, count * c, n)
    for j in range(1, size):
        x[j] += x[j - 1] @ E.T
    heads, whole = np.empty((count + 1, c, n)), np.linalg.matrix_power(E, size).T
    heads[0] = start.T
    for b, last in enumerate(x[-1].reshape(count, c, n)):
        heads[b + 1] = last + heads[b] @ whole
    carried = heads[:-1].reshape(count * c, n)
    for j in range(size):
        carried = carried @ E.T
        x[j] += carried
    found = x.reshape(size, count, c, n).transpose(1, 0, 3, 2).reshape(-1, n, c)
    return np.concatenate([start[None], found[:N]])


def step_groups(t: Array) -> tuple[Array, np.ndarray]:
    """Distinct sampling intervals [s], rounding of instants apart, and which each interval is."""
    steps = np.diff(t)
    rounding = 8 * np.finfo(float).eps * np.abs(t).max() / steps.max()
    digits = int(-np.log10(np.clip(rounding, 1e-15, 1e-3)))
    rounded, first, which = np.unique(
        np.round(steps / steps.max(), digits), return_index=True, return_inverse=True
    )
    return (np.array([steps.mean()]) if len(rounded) == 1 else steps[first]), which


def foh_step(A: Array, B: Array, h: float) -> tuple[Array, Array, Array]:
    """A_d, B0, B1 of x(t + h) = A_d x(t) + B0 u(t) + B1 u(t + h), exact for inputs linear between.

    One exponential of the augmented matrix (Van Loan 1978).
    """
    nx, nu = B.shape
    block = np.zeros((nx + 2 * nu, nx + 2 * nu))
    block[:nx, :nx] = A * h
    block[:nx, nx : nx + nu] = B * h
    block[nx : nx + nu, nx + nu :] = np.eye(nu)
    expm = scipy.linalg.expm(block)
    Ad, G0, B1 = expm[:nx, :nx], expm[:nx, nx : nx + nu], expm[:nx, nx + nu :]
    return Ad, G0 - B1, B1


def from_zoh(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Continuous A, B of a zero-order-hold pair; ValueError for an eigenvalue on (-∞, 0]."""
    nx, nu = B.shape
    poles = np.linalg.eigvals(A)
    if np.any((np.abs(poles.imag) < 1e-12) & (poles.real <= 0)):
        worst = poles[np.argmin(poles.real)].real
        raise ValueError(
            f"the discrete model has a pole at {worst:.3g}: it has no continuous equivalent under "
            "zero-order hold; lower the order or sample faster"
        )
    block = np.zeros((nx + nu, nx + nu))
    block[:nx, :nx], block[:nx, nx:], block[nx:, nx:] = A, B, np.eye(nu)
    block[np.abs(block) < NEGLIGIBLE] = 0.0  # SciPy's logarithm divides by what stands off diagonal
    log = np.real(scipy.linalg.logm(block)) / dt
    return log[:nx, :nx], log[:nx, nx:]


def _discrete_steps(system: StateSpace, t: Array, u: Array, dt: float) -> Steps:
    if np.any(np.abs(np.diff(t) - dt) > 1e-3 * dt):
        raise ValueError(
            f"a discrete model of interval {dt:g} s cannot follow samples "
            f"{np.diff(t).min():g} to {np.diff(t).max():g} s apart; convert it to continuous time"
        )
    lags = np.rint(system.delay / dt).astype(int)
    if np.any(np.abs(system.delay - lags * dt) > 1e-6 * dt):
        raise ValueError(
            f"delays {system.delay} s are no multiples of the interval {dt:g} s of this discrete "
            "model; convert it to continuous time"
        )
    rows = np.maximum(np.arange(len(t))[:, None] - lags, 0)
    delayed = u[rows, np.arange(system.nu)]
    which = np.zeros(len(t) - 1, dtype=int)
    direct = delayed @ system.D.T
    return Steps((system.A,), which, delayed[:-1] @ system.B.T, direct)
