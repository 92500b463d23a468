"""Frequency responses by local rational models of the records' transforms.

R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 7,
the local polynomial method; with a denominator, T. McKelvey, G. Guérin, Non-parametric frequency
response estimation using a local rational model, IFAC SYSID 2012. Near a frequency the transforms
of record r, whole and without a taper, obey

    Y_r(ω) = G(ω) U_r(ω) + T_r(ω) + V_r(ω),      G = B(x)/A(x),   T_r = I_r(x)/A(x),

x the distance from that frequency: B of degree two in x for every pair, I_r of degree one for every
record and output, A of degree two for all of them, since all share the poles. T_r is what began
before the record and goes on after it, leakage: it is estimated, not tapered away. B(0) is the
response. Output by output the residuals V have one variance there; it makes the random error.

References from outside a loop are the inputs of the local models, inputs and outputs their outputs,
which share the loop's poles: `casid.frequency.referring`.

Departure: what models of finite width miss (bias) is estimated too, from the differences to those
of a degree more, of B and of I_r, and stated beside the random error. Of I_r, since near its lowest
frequencies the transform of a linear sweep is as smooth as a transient: little tells them apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import ztrtri

from casid.arrays import Array, BoolArray, ComplexArray
from casid.frequency.feedback import NoiseInInputs, relative
from casid.frequency.leakage import over_three
from casid.frequency.referring import of_inputs
from casid.frequency.spectra import correlation
from casid.frequency.transforms import Lines, lines_at
from casid.record import Record

EDGES = 2  # of x in numerators of transients
POLES = 2  # of the denominator
ROUNDS = 8  # Gauss-Newton steps of the denominator
CERTAIN = 25.0  # twice the gain in log-likelihood that makes a pair of poles more than noise
RANK = 1e-9  # relative to the largest singular value; less is no direction of the denominator
NEAREST = 0.05  # abs(A), one at the centre, may fall to within a model
SHARE = 0.3  # half width, of the frequency
SPACINGS, EQUATIONS = 5.0, 9.0  # half width in distances of lines, equations per input: at least
QUADRATIC, CUBIC = (3, EDGES), (4, EDGES)  # powers of x in numerators of pairs, of transients
LONGER = (3, EDGES + 1)
SURE = 2.0  # of the noise of a difference that is no bias
HIDDEN = 0.3  # of a difference's noise, that a bias may have behind it
LENGTH = 0.25  # of the most power near a frequency: records of less do not widen models for it
SEEN = 0.2  # random error of a response that is there, and no noise
KERNEL = 0.33  # correlation of two local estimates, as a spectral window's width over a half width


@dataclass(frozen=True, eq=False)
class LocalResponse:
    """A response with its errors, relative, one standard deviation; NaN where there is none."""

    G: ComplexArray  # (K, ny, nu)
    random_error: Array  # (K, ny, nu)
    leakage: Array  # (K, ny, nu) bias of models of finite width
    feedback: Array  # (K, ny, nu) bias from noise that inputs carry
    resolution: Array  # (K, ny, nu) [rad/s], as in `FrequencyResponse`
    output_correlation: ComplexArray  # (K, ny, ny)
    input_correlation: ComplexArray  # (K, nu, nu)


def local_response(
    records: Sequence[Record],
    omega: Array,
    noise: NoiseInInputs | None = None,
    references: int = 0,
    end: float = np.inf,
) -> LocalResponse | None:
    """Response at frequencies (K,) [rad/s] of equidistant records, all of whose channels move.

    ``noise`` is that of the outputs in the inputs, none unless given. The last ``references`` of
    the inputs are such, as many as there are inputs beside them. Above ``end`` [rad/s] some input
    is little but noise fed back.

    None where a record lacks a channel, or losses leave no stretch at some frequency.
    """
    if any(np.isnan(record.y).all(axis=0).any() for record in records):
        return None
    lines = lines_at(records, omega, references)
    if not all(lines):
        return None
    G, error, half, back, outputs, inputs = _at_all(lines, omega, QUADRATIC, references, noise)
    squared = np.zeros(G.shape)
    for powers in (CUBIC, LONGER):
        other, more, *_ = _at_all(lines, omega, powers, references)
        squared = np.maximum(squared, _bias(G, error, other, more))
    between = _between_samples(records, omega, G, error, references, end)
    # As a share of response and difference together: a logarithm's error has limits.
    bias = np.sqrt(squared / (1 + squared) + between**2)
    width = np.broadcast_to(KERNEL * half[:, None, None], G.shape)
    bias = np.where(np.isfinite(G), bias, np.nan)
    return LocalResponse(G, error, bias, relative(back, G), width, outputs, inputs)


def _between_samples(
    records: Sequence[Record],
    omega: Array,
    G: ComplexArray,
    random: Array,
    references: int,
    end: float,
) -> Array:
    """Bias (K, ny, nu), relative, as samples do not tell what inputs do between them.

    An input is smooth there, or straight: sinc²(ωh/2) lies between the two, and is what held inputs
    leave open of a response that falls with ω. A direct term follows their steps at once, not half
    a sample later as they do in the mean: ωh/2 of as much as the response is at a quarter of the
    sampling rate, where a direct term is what is left, or at the last frequency where it is seen.
    Neither is above the ``end`` of what comes from outside: noise fed back moves some input there,
    and the response is the controller's inverse.
    """
    smooth = max(record.dt for record in records) * omega[:, None, None]
    between = np.broadcast_to(smooth**2 / 12, G.shape)
    held = max((record.dt for record in records if record.hold == "zoh"), default=0.0)
    if not held:
        return between
    end = max(end, omega[0])
    high = np.array([min(np.pi / 2 / held, end)])
    stretches, found = lines_at(records, high, references), []
    for powers in (QUADRATIC, CUBIC):
        beyond, error, *_ = _at_all(stretches, high, powers, references)
        found.append((np.abs(beyond), error))
    (beyond, error), (other, _) = found
    upto, seen = (each[omega <= end][::-1] for each in (G, random < SEEN))
    seen = np.where(seen.any(axis=0), seen, np.isfinite(upto))
    last = np.take_along_axis(upto, seen.argmax(axis=0)[None], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        there = (error < SEEN) & (np.abs(other - beyond) < beyond / 2)  # nor what a record's end is
        direct = np.where(there, beyond, np.abs(last)) / np.abs(G)
    return np.hypot(between, held * omega[:, None, None] / 2 * direct)


def _bias(G: ComplexArray, error: Array, other: ComplexArray, more: Array) -> Array:
    """Squared relative bias by the difference of two estimates, of which G is the more efficient.

    Beyond what noise alone makes of it, and no less than that hides: where little tells transients
    from the response their noise is many times that of the estimate. Mean of three neighbouring
    frequencies.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = np.nan_to_num(np.maximum(more**2 - error**2, 0.0), posinf=0.0)  # of gain or phase
        apart = np.nan_to_num(np.abs(other - G) ** 2 / np.abs(G) ** 2, posinf=0.0)
    seen = over_three(apart - SURE * 2 * noise)
    return np.asarray(np.maximum(seen, HIDDEN**2 * over_three(noise)))


def _at_all(
    lines: Sequence[Sequence[Lines]],
    omega: Array,
    powers: tuple[int, int],
    references: int = 0,
    noise: NoiseInInputs | None = None,
) -> tuple[ComplexArray, Array, Array, ComplexArray, ComplexArray, ComplexArray]:
    """Responses, random errors, half widths, fed-back bias, correlations of outputs and inputs.

    To inputs, of records with references, by way of the responses to these.
    """
    K, nu, ny = len(omega), *(len(each.T) for each in (lines[0][0].U, lines[0][0].Y))
    G, error = np.full((K, ny, nu), np.nan, complex), np.full((K, ny, nu), np.nan)
    back, left = np.zeros((K, ny, nu), complex), np.zeros((K, ny))
    half, outputs = np.zeros(K), np.tile(np.eye(ny, dtype=complex), (K, 1, 1))
    inputs = np.tile(np.eye(nu, dtype=complex), (K, 1, 1))
    for k, (near, centre) in enumerate(zip(lines, omega, strict=True)):
        half[k] = _half_width(near, centre)
        model = _LocalModel.of(near, centre, half[k], powers)
        found = model.solved() if model is not None else None
        if model is None or found is None:
            continue
        G[k], variance, S, P = found.result()
        if noise is not None:
            back[k], left[k] = found.fed_back(noise.cross[k]), found.variance
        with np.errstate(invalid="ignore", divide="ignore"):
            error[k] = np.sqrt(variance / 2) / np.abs(G[k])
        # Shrunk towards none, as few residuals tell little.
        outputs[k] = (model.freedom * correlation(S) + ny * np.eye(ny)) / (model.freedom + ny)
        inputs[k] = correlation(P)
    if noise is not None:
        back *= noise.share(left)[:, :, None]
    if references:
        G, error, outputs, inputs = of_inputs(G, error, outputs, inputs, references)
        back = np.zeros_like(G)  # averaged spectra tell what noise does in references
    return G, error, half, back, outputs, inputs


def _spacing(lines: Sequence[Lines], centre: float) -> float:
    """Distance of lines [rad/s] in the records that move the input whose records are shortest.

    Of several that move it about as much near the frequency the longest counts: wide models for
    the sake of short records would miss what the long one resolves.
    """
    apart = np.array([each.omega[0] for each in lines])
    near = [each.U[(each.omega > centre / 2) & (each.omega < 2 * centre)] for each in lines]
    energy = np.array([np.sum(np.abs(U) ** 2, axis=0) for U in near]).T
    return max(float(apart[each >= LENGTH * each.max()].min()) for each in energy)


def _half_width(lines: Sequence[Lines], centre: float) -> float:
    """The least half width [rad/s] that leaves equations enough for the numerators."""
    wanted = EQUATIONS * lines[0].U.shape[1]
    half = max(SHARE * centre, SPACINGS * _spacing(lines, centre))
    while True:
        counts = np.array([_near(each, centre, half).sum() for each in lines])
        if np.maximum(counts - EDGES, 0).sum() >= wanted or half > lines[0].omega[-1]:
            return half
        half *= 1.1


def _near(lines: Lines, centre: float, half: float) -> BoolArray:
    """Lines of a band of twice a half width about a frequency, above it where zero is near."""
    low = max(centre - half, 0.0)
    return (lines.omega >= low * (1 - 1e-9)) & (lines.omega <= (low + 2 * half) * (1 + 1e-9))


@dataclass(frozen=True, eq=False)
class _LocalModel:
    """The equations A Y = B U + I + A V about one frequency."""

    x: Array  # (m,) distance from the frequency, in half widths
    U: ComplexArray  # (m, nu)
    Y: ComplexArray  # (m, ny)
    own: BoolArray  # (m, records) whose line each is
    powers: tuple[int, int]  # of x in numerators of pairs, of transients
    freedom: float  # of the residuals of one output

    @classmethod
    def of(
        cls, lines: Sequence[Lines], centre: float, half: float, powers: tuple[int, int]
    ) -> "_LocalModel | None":
        """The lines of all records that have more than their own transient takes."""
        near, (of_pairs, edges) = [(each, _near(each, centre, half)) for each in lines], powers
        used = [(each, at) for each, at in near if at.sum() > edges]
        if not used:
            return None
        U = np.vstack([each.U[at] for each, at in used])
        Y = np.vstack([each.Y[at] for each, at in used])
        unknown = of_pairs * U.shape[1] + edges * len(used) + POLES / Y.shape[1]
        freedom = len(U) - unknown
        x = np.concatenate([(each.omega[at] - centre) / half for each, at in used])
        own = np.repeat(np.eye(len(used), dtype=bool), [at.sum() for _, at in used], axis=0)
        return cls(x, U, Y, own, powers, freedom) if freedom > 1 else None

    @cached_property
    def along(self) -> Array:
        """Powers of x of the denominator, one aside, (m, POLES)."""
        return np.vander(self.x, POLES + 1, increasing=True)[:, 1:]

    @cached_property
    def edges(self) -> Array:
        """Those of each record's transient, (m, records powers)."""
        powers = np.vander(self.x, self.powers[1], increasing=True)
        return np.asarray(powers[:, None] * self.own[:, :, None]).reshape(len(self.x), -1)

    @cached_property
    def pairs(self) -> ComplexArray:
        """Those of each input's numerators, times the input, (m, powers nu)."""
        powers = np.vander(self.x, self.powers[0], increasing=True)
        return np.asarray(powers[:, :, None] * self.U[:, None, :]).reshape(len(self.x), -1)

    def solved(self) -> "_LocalFit | None":
        """The best fit, None where inputs are not separable.

        Gauss-Newton steps of the denominator, common to all outputs, each weighed by its residuals;
        numerators are linear and follow (variable projection).
        """
        first = _LocalFit.of(self, np.zeros(POLES, complex))
        if first is None:
            return None
        fit = first
        for _ in range(ROUNDS):
            better = fit.step()
            if better is None:
                break
            fit = better
        # Where noise rules, a pair of poles would only follow it.
        certain = 2 * len(self.x) * (first.cost - fit.cost) > CERTAIN
        return fit if certain else first


@dataclass(frozen=True, eq=False)
class _LocalFit:
    """Numerators that are best with one denominator."""

    model: _LocalModel
    a: ComplexArray  # (POLES,)
    A: ComplexArray  # (m,) values of the denominator
    edges: ComplexArray  # (m, powers records) orthonormal basis of transients
    Q: ComplexArray  # (m, powers nu) orthonormal basis of the inputs, transients removed
    inverse: ComplexArray  # (powers nu, powers nu) of the triangular factor
    theta: ComplexArray  # (powers nu, ny) numerators
    E: ComplexArray  # (m, ny) residuals

    @classmethod
    def of(cls, model: _LocalModel, a: ComplexArray) -> "_LocalFit | None":
        A = 1 + model.along @ a
        if np.abs(A).min() < NEAREST:
            return None
        edges = np.linalg.qr(model.edges / A[:, None])[0]
        K, Y = _without(edges, model.pairs / A[:, None]), _without(edges, model.Y)
        size = np.linalg.norm(K, axis=0)
        if not size.all():
            return None
        Q, R = np.linalg.qr(K / size)
        if np.abs(np.diag(R)).min() < 1e-9:
            return None
        inverse = ztrtri(R)[0] / size[:, None]
        inner = Q.conj().T @ Y
        return cls(model, a, A, edges, Q, inverse, inverse @ inner, Y - Q @ inner)

    @cached_property
    def variance(self) -> Array:
        """Of an output's residuals, (ny,)."""
        power = np.sum(np.abs(self.model.Y) ** 2, axis=0)
        left = np.sum(np.abs(self.E) ** 2, axis=0)
        floor = 1e-20 * np.where(power > 0, power, 1.0)
        return np.asarray(np.maximum(left, floor) / self.model.freedom)

    @property
    def cost(self) -> float:
        """Logarithm of the residuals' variances, all outputs together."""
        return float(np.sum(np.log(self.variance)))

    def slopes(self) -> tuple[ComplexArray, ComplexArray]:
        """Of fitted outputs along a, (m, ny, POLES): that which transients leave, and inputs."""
        Y = self.model.Y - self.E
        along = -Y[:, :, None] * (self.model.along / self.A[:, None])[:, None, :]
        J = _without(self.edges, along.reshape(len(along), -1))
        return J, J - self.Q @ (self.Q.conj().T @ J)

    def step(self) -> "_LocalFit | None":
        """A better denominator; None where there is none, or hardly."""
        weight = 1 / np.sqrt(self.variance)
        J = (self.slopes()[1].reshape(*self.E.shape, POLES) * weight[:, None]).reshape(-1, POLES)
        step = np.linalg.lstsq(J, (self.E * weight).ravel(), rcond=RANK)[0]
        for share in (1.0, 0.5, 0.25, 0.125):
            other = _LocalFit.of(self.model, self.a + share * step)
            if other is not None:
                gain = self.cost - other.cost
                if gain > 0:
                    return other if gain > 1e-3 else None
        return None

    def result(self) -> tuple[ComplexArray, Array, ComplexArray, ComplexArray]:
        """Response (ny, nu), its variance, residuals' covariance, inverse of the inputs' power."""
        nu = self.model.U.shape[1]
        root = self.inverse[:nu]  # B(0) is in the first rows
        P = root @ root.conj().T
        spread = self._of_poles(root) if self.a.any() else 0.0
        variance = self.variance[:, None] * np.diag(P).real + spread
        # Of Student's distribution, the variance of residuals being estimated as well.
        variance *= self.model.freedom / (self.model.freedom - 1)
        S = self.E.T @ self.E.conj() / self.model.freedom
        return self.theta[:nu].T, variance, S, P

    def fed_back(self, noise: ComplexArray) -> ComplexArray:
        """Bias (ny, nu) of the response where inputs carry noise (ny, nu) of the outputs."""
        powers = np.vander(self.model.x, self.model.powers[0], increasing=True) / self.A[:, None]
        count = powers.sum(axis=0).conj() * (1 - self.edges.shape[1] / len(self.A))
        products = np.kron(count[:, None], noise.T)  # mean of the inputs' rows times noise
        return np.asarray(self.inverse[: len(noise.T)] @ self.inverse.conj().T @ products).T

    def _of_poles(self, root: ComplexArray) -> Array:
        """What errors of the denominator add to variances of the response, (ny, nu)."""
        ny = self.E.shape[1]
        whole, left = (part.reshape(len(self.E), ny, POLES) for part in self.slopes())
        J = (left / np.sqrt(self.variance)[:, None]).reshape(-1, POLES)
        R = np.linalg.pinv(J, rcond=RANK)
        poles = R @ R.conj().T
        along = np.einsum("jp,mp,mia->ija", root, self.Q.conj(), whole, optimize=True)
        spread = np.einsum("ija,ab,ijb->ij", along, poles, along.conj(), optimize=True)
        return np.asarray(spread.real)


def _without(edges: ComplexArray, M: ComplexArray) -> ComplexArray:
    """Columns (m, c) without the part that transients explain, record by record."""
    return M - edges @ (edges.conj().T @ M)
