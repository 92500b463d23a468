"""A structure moved to where its response comes nearest to a black box's, and what is left.

Weighted least squares on the response, parameters within their bounds. The weights are those of
what can be reached: first of a share of the response, then of the black box's variance and of what
the step before has left, smoothed over frequency, so that a pair the structure cannot make does not
rule all others.
"""

from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit
from casid.free import Free, free_parameters
from casid.matching.comparison import Comparison, Source
from casid.matching.descent import Condensed, descend
from casid.model import Model
from casid.subspace.blackbox import BlackBox
from casid.subspace.weighing import lines_near

ALLOWED = 0.01  # of a pair's response, 0.003 of its row's: a black box of finite order is no better
OF_ROW = 0.003
ROUGH = 0.1  # of a pair's response: what the first weights take a structure to miss
REACH = 0.35  # nepers of frequency over which misfits are alike: those of next weights are smoothed
ROUNDS = 2  # of weights by what is left
STEPS = 100  # of the descent a round
SETTLED = 1e-7  # relative decrease of the cost that ends a round
UNTOLD = 1e-3  # weight of what the black box may have of the controller, over that of the rest
HELD = 1e-9  # of the width between bounds


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxResponse:
    """A black box's response in the channels of a structure, these divided by their sizes."""

    omega: Array  # (K,) [rad/s]
    G: ComplexArray  # (K, ny, nu)
    F: ComplexArray  # (K, ny, nu, rank): its errors are F z, z standard normal numbers
    allowed: Array  # (K, ny, nu): deviation that is no fault of a structure, as a black box has it
    scale: Array  # (ny, nu): G over the response in physical units
    fed_back: BoolArray  # (K, nu): where it may be the controller's inverse, see `Excitation`
    freedom: Array  # (K,) degrees of freedom of the residual spectra that the size of F comes from

    @classmethod
    def of(cls, black_box: BlackBox, model: Model, omega: Array) -> "BoxResponse":
        """ValueError: a channel that the black box lacks, or a black box without uncertainty."""
        system = black_box.system
        places = []
        for kind, wanted, known in (
            ("output", model.outputs, system.outputs),
            ("input", model.inputs, system.inputs),
        ):
            if missing := [name for name in wanted if name not in known]:
                raise ValueError(
                    f"the structure's {kind} {missing[0]!r} is no {kind} of the black box, which "
                    f"has {', '.join(known)}"
                )
            places.append([known.index(name) for name in wanted])
        rows, columns = places
        sizes = black_box.input_std[columns] / black_box.output_std[rows][:, None]
        G, images = (
            sizes * part(omega)[:, rows][:, :, columns]
            for part in (black_box.response, black_box.images)
        )
        F = np.nan_to_num(black_box.response_factor(omega)[:, rows][:, :, columns]) * G[..., None]
        row = np.sum(np.abs(G) ** 2, axis=2, keepdims=True)
        allowed = np.sqrt((ALLOWED * np.abs(G)) ** 2 + OF_ROW**2 * row + images**2)
        excitation, fed_back = black_box.excitation, np.zeros(G[:, 0].shape, dtype=bool)
        if excitation is not None:
            fed_back = excitation.fed_back(model.inputs, omega)
        seconds = sum(segment.duration for segment in black_box.segments)
        freedom = 2 * lines_near(omega, seconds) if seconds else np.full(len(omega), np.inf)
        parts = {"omega": omega, "G": G, "F": F, "allowed": allowed, "scale": sizes}
        return cls(**parts, fed_back=fed_back, freedom=freedom)

    @property
    def variance(self) -> Array:
        """E|error|² of the response and what is allowed, (K, ny, nu)."""
        return np.asarray(np.sum(np.abs(self.F) ** 2, axis=-1) + self.allowed**2)

    def smoothed(self, E: ComplexArray) -> Array:
        """Mean of |E|² (K, ...) over neighbouring frequencies."""
        return np.asarray(np.tensordot(kernel(self.omega), np.abs(E) ** 2, 1))


def nearness(omega: Array) -> Array:
    """Gaussian kernel (K, K) of the distance of frequencies in nepers, of width `REACH`."""
    L = np.log(omega)
    return np.asarray(np.exp(-0.5 * ((L[:, None] - L) / REACH) ** 2))


def kernel(omega: Array) -> Array:
    """Gaussian smoothing over frequency as a matrix (K, K) whose rows add up to one."""
    near = nearness(omega)
    return np.asarray(near / near.sum(axis=1, keepdims=True))


def movable(fit: AnyFit | Model) -> Free:
    """Free parameters of a structure, or of a fit those it estimated, within their bounds."""
    if isinstance(fit, Model):
        return free_parameters(fit)
    fixed = [row.name for row in fit.parameters if row.fixed]
    bounds = {row.name: (row.lower, row.upper) for row in fit.parameters if not row.fixed}
    return free_parameters(fit.model, fixed, bounds)


@dataclass(frozen=True, eq=False, kw_only=True)
class Nearest:
    """Where a structure comes nearest.

    ``E`` (K, ny, nu) is its response less the black box's; ``factor`` (K, ny, nu, rank) what it is
    if the structure is true: minus factor z, with the z of the black box's errors; ``cost`` what
    weights by what is left minimise. ``held`` names parameters that are on a bound there.
    """

    model: Model
    cost: float
    E: ComplexArray
    factor: ComplexArray
    held: tuple[str, ...] = ()


def nearest(free: Free, target: BoxResponse) -> Nearest:
    """The structure's parameters that make its response most like the black box's."""
    matrices, s = MatrixFunction(free), 1j * target.omega
    low, high = free.lower[free.index], free.upper[free.index]
    counted = np.where(target.fed_back, UNTOLD, 1.0)[:, None]

    def weights(lam: Array, error: Array) -> Array:
        E = target.scale * matrices(lam).response(s) - target.G
        return np.asarray(counted / np.sqrt(error + target.smoothed(E)))

    W = weights(free.guess, (ROUGH * np.abs(target.G)) ** 2 + target.allowed**2)
    lam = _settled(free, target, free.guess, W)
    for _ in range(ROUNDS):
        W = weights(lam, target.variance)
        lam = _settled(free, target, lam, W)
    G, dG = matrices(lam).response_slopes(s)
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    inside = np.minimum(lam - low, high - lam) > HELD * width
    moved = free.model.with_vector(free.full(lam))
    factor = _left(target.F, target.scale * dG[inside], W)
    E = target.scale * G - target.G
    cost = float(np.sum(counted**2 * np.log1p(target.smoothed(E) / target.variance)))
    held = tuple(np.array(free.names)[~inside].tolist())
    return Nearest(model=moved, cost=cost, E=E, factor=factor, held=held)


def _settled(free: Free, target: BoxResponse, lam: Array, W: Array) -> Array:
    """Free parameters (nf,) after a descent on the misfit under weights held."""
    source = Source.measured(target.omega, target.G / target.scale, target.scale * W)
    band, inputs = (float(target.omega[0]), float(target.omega[-1])), np.ones(W.shape[2])
    comparison = Comparison(sources=(source,), input_scale=inputs, band=band, shift=0.0)
    problem = replace(Condensed.of(free, comparison), penalty=0.0)  # constraints do not count
    return descend(problem, lam, steps=STEPS, tolerance=SETTLED).values


def _left(F: ComplexArray, J: ComplexArray, W: Array) -> ComplexArray:
    """(I - J K) F: errors F (K, ny, nu, rank) less their projection on the slopes J."""
    rank = F.shape[-1]
    columns = _real((W * J).reshape(len(J), -1)).T
    size = np.linalg.norm(columns, axis=0)
    Q = np.linalg.qr(columns[:, size > 0] / size[size > 0])[0]
    errors = _real((W[..., None] * F).reshape(-1, rank).T).T
    errors -= Q @ (Q.T @ errors)
    half = len(errors) // 2
    return np.asarray((errors[:half] + 1j * errors[half:]).reshape(F.shape) / W[..., None])


def gain(J: ComplexArray, W: Array) -> ComplexArray:
    """K (nf, K, ny, nu): errors ε of the response move the parameters by Re Σ K ε*."""
    columns = _real((W * J).reshape(len(J), -1)).T
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(columns / size, rcond=1e-8) / size[:, None]
    half = inverse.shape[1] // 2
    return np.asarray((inverse[:, :half] + 1j * inverse[:, half:]).reshape(J.shape) * W)


def _real(rows: ComplexArray) -> Array:
    """Real parts, then imaginary ones, of every row."""
    return np.hstack([rows.real, rows.imag])
