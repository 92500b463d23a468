"""Whether data can tell a structure's parameters apart, before anything is fitted.

The Fisher information F of the free parameters is computed at the guess, moved a little so that
parameters guessed at zero hide nothing. In the units in which every parameter alone would have
information one, N = D^(-1/2) F D^(-1/2), D = diag F, an eigenvalue of zero is a combination of
parameters that no output feels, and 1/√eigenvalue is the factor by which that combination's
uncertainty exceeds that of one parameter with all others known (R. V. Jategaonkar, Flight Vehicle
System Identification, 2nd ed., section 4.16, and M. B. Tischler, R. K. Remple, Aircraft and
Rotorcraft System Identification, 2nd ed., chapter 12: insensitivity and Cramér-Rao bound).

A record enters by its Fourier transform over its length T, which an unstable model does not mind:

    Y(ω) = G(jω) U(ω) + C (jωI − A)⁻¹ (x(0) − e^(−jωT) x(T)),        ω = 2πk/T, k > 0

The end states are unknown and projected out; the mean, k = 0, belongs to the biases. Motion left
from before a record is not counted as excitation.

A nonlinear structure enters by its sensitivities along the record, simulated from the measured
states at its beginning; where that runs away, from those at the beginning of shorter and shorter
pieces. Initial states of all pieces and biases are unknown and eliminated.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.display import Shown
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free, free_parameters
from casid.frequency.response import FrequencyResponse
from casid.matching.targets import in_channels
from casid.model import Bounds, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import several, standard_deviations, stretches
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Point, whiteners
from casid.subspace.pbsid import BlackBox

Responses = FrequencyResponse | BlackBox

RANK = 1e-10  # eigenvalue of N below which a combination is not felt: rounding leaves 1e-13
NOTHING = 1e-9  # effect on the outputs, in their standard deviations, that is rounding
WEAK = 1e-4  # eigenvalue below which it is felt a hundred times less than its parameters alone
SHARE = 0.1  # of a combination's largest entry: parameters with less are not named
POINTS = 40  # of a black box's band
COHERENCE = 0.6
ENERGY = 1e-6  # share of the inputs' energy above the highest frequency that is used
WIDE, GUESSES = 1e3, 10.0  # times a guess: bounds that are no scale, and what is one then
AWAY = 100  # standard deviations of an output, off the measured one, that are running away
ROUNDING = 1e-10  # share of an information that eliminating the unknowns leaves of one all theirs
MOST = 200  # frequencies of a record that are used, for time and memory


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Identifiability(Shown):
    """Which parameters of a structure data can determine, and which not.

    Parameters
    ----------
    names : tuple of str
        Free parameters.
    rank : int
        Rank of their information matrix; less than their number if some cannot be told apart.
    condition : float
        Of the normalised information matrix; infinite if it is singular.
    eigenvalues : (nf,) array
        Of the same, descending; without the parameters that no output feels.
    insensitive : tuple of str
        Parameters that no output feels at all.
    tied : tuple of str
        Of which no output feels anything either, but the structure's constraints tell of the rest.
    confounded : tuple of tuple of str
        Groups of parameters of which only combinations are felt: fix one of each.
    weak : tuple of tuple of str
        Groups of which a combination is felt a hundred times less than one of them alone.
    inflation : (nf,) array
        Factor by which a parameter's uncertainty grows because the others are not known; infinite
        in a confounded group, NaN for an insensitive parameter.
    information : (nf, nf) array
        F in physical units, for outputs whose noise has the standard deviation of the output
        (records) or for relative errors of the response of one.
    """

    names: tuple[str, ...]
    rank: int
    condition: float
    eigenvalues: Array
    insensitive: tuple[str, ...]
    tied: tuple[str, ...]
    confounded: tuple[tuple[str, ...], ...]
    weak: tuple[tuple[str, ...], ...]
    inflation: Array
    information: Array

    @property
    def identifiable(self) -> bool:
        """Whether all free parameters can be told apart."""
        return self.rank == len(self.names)

    def headline(self) -> str:
        """Rank, condition and findings."""
        return "; ".join(str(self).splitlines())

    def __str__(self) -> str:
        """Findings and remedies, one a line."""
        lines = [f"rank {self.rank} of {len(self.names)}, condition {self.condition:.3g}"]
        if self.insensitive:
            lines.append(f"no output depends on {_listed(self.insensitive)}: fix or drop")
        if self.tied:
            lines.append(f"only the structure's constraints determine {_listed(self.tied)}")
        lines += [f"cannot be told apart: {_listed(group)}; fix one" for group in self.confounded]
        lines += [f"barely told apart: {_listed(group)}" for group in self.weak]
        return "\n".join(lines)


def identifiability(
    model: Model,
    data: Record | Responses | Sequence[Record | Responses],
    *,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    spread: float = 0.1,
    seed: int = 0,
) -> Identifiability:
    """Rank and condition of the information that data hold about a structure's parameters.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`.
    data : Record, FrequencyResponse or BlackBox, or several
        Of records the inputs, sampling, missing samples and sizes of the outputs count; initial
        states and biases are taken as unknown. Of responses the frequencies and, if measured, where
        coherence is sufficient.
    spread, seed : float, int
        How far the guess is moved, at random, in units of each parameter's scale; of that move.

    Raises
    ------
    ValueError, ModelError
        No data, a channel that is missing, wrong names or bounds; a nonlinear structure with a
        response, which is of one flight condition, or that runs away from measured states.
    """
    free = free_parameters(model, fixed, bounds)
    moved = _moved(free, spread, np.random.default_rng(seed))
    items: tuple[object, ...] = several(data)
    if not items:
        raise ValueError("no data given: identifiability needs records or responses")
    for item in items:
        if not isinstance(item, Responses | Record):
            raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
                f"data is a {type(item).__name__}: identifiability needs records or responses"
            )
    records = stretches([item for item in items if isinstance(item, Record)])
    responses = [item for item in items if isinstance(item, Responses)]
    nf = len(free.index)
    F = np.zeros((nf, nf))
    if isinstance(model, NonlinearModel):
        if responses:
            raise ValueError(
                "a response is of one flight condition, and the structure nonlinear: "
                "identifiability(model.at(Trim(values=...)), response)"
            )
        totals = [record.total().select(model.inputs, model.outputs) for record in records]
        sy = standard_deviations(totals)[1]
        F += sum(_information_along(moved, r, sy) for r in totals)
    elif records:
        at, model = MatrixFunction(moved)(moved.guess), moved.model
        chosen = [record.select(model.inputs, model.outputs) for record in records]
        sy = standard_deviations(chosen)[1]
        F += sum(_record_information(at, r, sy) for r in chosen)
    for response in responses:
        F += _response_information(moved, response)
    return judged(moved, F)


def judged(free: Free, F: Array) -> Identifiability:
    """What information F (nf, nf), by outputs over their noise, says of free parameters."""
    return _judge(free.names, F, _sizes(free), _ties(free))


def _ties(free: Free) -> Array:
    """Gradients (m, nf) of the constraints that are equations."""
    equal = [each.lower == each.upper for each in free.model.constraints()]
    if not any(equal):
        return np.zeros((0, len(free.index)))
    return np.asarray(free.constraint_slopes(free.guess)[np.array(equal)])


def _sizes(free: Free) -> Array:
    """Typical size (nf,) of the free parameters; bounds as wide as one likes say nothing of it."""
    scale, size = free.scale[free.index], np.abs(free.guess)
    return np.asarray(np.where((size > 0) & (scale > WIDE * size), GUESSES * size, scale))


def _moved(free: Free, spread: float, rng: np.random.Generator) -> Free:
    """The same free parameters about a guess moved within the bounds."""
    scale = _sizes(free)
    values = free.guess + spread * scale * rng.uniform(-1, 1, len(scale))
    values = np.clip(values, free.lower[free.index], free.upper[free.index])
    return replace(free, model=free.model.with_vector(free.full(values)))


def _record_information(at: Matrices, record: Record, sy: Array) -> Array:
    """F of one record: its output's Fourier transform, the end states projected out."""
    omega, U, bins = _spectrum(record)
    seen = np.mean(~np.isnan(record.y), axis=0)
    length = record.duration + record.dt
    parseval = 2 * bins[:, None] * seen / (length * record.dt)  # both signs of ω
    weight = np.sqrt(parseval) / sy
    A, _, C, _ = at.blocks
    _, slope = at.response_slopes(1j * omega)
    moves = np.einsum("lkij,kj->kil", slope, U) * weight[:, :, None]
    resolvent = 1j * omega[:, None, None] * np.eye(at.nx) - A
    ends = (C @ np.linalg.inv(resolvent)) * weight[:, :, None]
    J: Array = _real(moves)
    E = _real(ends)
    size = np.linalg.norm(E, axis=0)
    basis, scales, _ = np.linalg.svd(E / np.where(size > 0, size, 1.0), full_matrices=False)
    ends_seen = basis[:, scales > 1e-12 * scales.max(initial=0.0)]
    J = J - ends_seen @ (ends_seen.T @ J)
    return np.asarray(J.T @ J)


def _information_along(free: Free, record: Record, sy: Array) -> Array:
    """F of one record and a nonlinear structure: its sensitivities, initial states and biases out.

    ValueError: it runs away even from the states measured a few samples before.
    """
    nf, nx, ny = len(free.index), len(free.model.states), len(free.model.outputs)
    pieces = 1
    while True:
        evaluator = NonlinearEvaluator(free, lay_out([record], record.duration / pieces))
        point = Point(lam=free.guess, bias=np.zeros((1, ny)), nodes=evaluator.resting())
        with np.errstate(over="ignore", invalid="ignore"):
            motion = evaluator.simulate(point)
            off = motion.residuals - np.nanmedian(motion.residuals, axis=0)  # a bias is no matter
        if (np.abs(off) <= AWAY * sy).all() and np.isfinite(motion.ends).all():
            break
        pieces *= 2
        if record.N / pieces < nx + 2:
            raise ValueError(
                f"{type(free.model).__name__} runs away from the states measured in record "
                f"{record.name!r} at its guess: give a better one, or judge the linear structure "
                "about a flight condition, identifiability(model.at(Trim(values=...)), record)"
            )
    W = whiteners(np.diag(sy**2), evaluator.layout)
    total = np.zeros((nf + ny, nf + ny))
    for batch in evaluator.sweep(point, motion, W).batches():
        for gram in batch.gram[:, :-1, :-1]:
            total += _without(gram, np.arange(nf, nf + nx))
    return _without(total, np.arange(nf, nf + ny))


def _without(F: Array, unknown: np.ndarray) -> Array:
    """Information of the other parameters, those unknown eliminated."""
    rest = np.setdiff1d(np.arange(len(F)), unknown)
    own, size = F[np.ix_(rest, rest)], np.sqrt(np.maximum(np.diag(F)[unknown], 1e-300))
    cross = F[np.ix_(unknown, rest)] / size[:, None]
    inner = F[np.ix_(unknown, unknown)] / np.outer(size, size)
    left = own - cross.T @ np.linalg.pinv(inner, rcond=1e-12, hermitian=True) @ cross
    felt = np.diag(left) > ROUNDING * np.diag(own)
    return np.asarray(np.where(np.outer(felt, felt), left, 0.0))


def _spectrum(record: Record) -> tuple[Array, ComplexArray, Array]:
    """Frequencies 2πk/T that hold nearly all of the inputs' energy, and the inputs' transforms."""
    # Of very many some are taken, denser where they are low; the last array says how many each
    # stands for.
    t = record.t - record.t[0]
    omega = 2 * np.pi / (record.duration + record.dt) * np.arange(1, max(2, record.N // 2))
    if record.equidistant:
        U = record.dt * np.fft.fft(record.u, axis=0)[1 : len(omega) + 1]
    else:
        weight = np.gradient(t)
        U = np.array([(weight * np.exp(-1j * w * t)) @ record.u for w in omega])
    power = np.sum(np.abs(U) ** 2 / np.maximum(np.var(record.u, axis=0), 1e-300), axis=1)
    above = np.cumsum(power[::-1])[::-1]
    n = int(np.sum(above > ENERGY * above[0])) or 1
    some = np.unique(np.geomspace(1, n, min(MOST, n)).round().astype(int)) - 1
    edges = np.concatenate([[0], (some[1:] + some[:-1] + 1) / 2, [n]])
    return omega[some], U[some], np.diff(edges)


def _response_information(free: Free, response: Responses) -> Array:
    """F for errors relative to the size of the response, pair by pair."""
    model = free.model
    if isinstance(response, BlackBox):
        system = response.system
        omega: Array = np.geomspace(*response.band, POINTS)
        G, names = system.response(omega), (system.outputs, system.inputs)
        coherence = np.ones(G.shape)
    else:
        omega, G, names = response.omega, response.G, (response.outputs, response.inputs)
        coherence = np.nan_to_num(response.coherence)
    if not (set(names[0]) & set(model.outputs) and set(names[1]) & set(model.inputs)):
        raise ValueError(
            f"the response has {', '.join(names[1])} -> {', '.join(names[0])}, the model "
            f"{', '.join(model.inputs)} -> {', '.join(model.outputs)}: no pair in common"
        )
    G, coherence = in_channels(model, *names, G), in_channels(model, *names, coherence)
    good = np.isfinite(G) & (coherence >= COHERENCE) & (np.abs(G) > 0)
    _, slope = MatrixFunction(free)(free.guess).response_slopes(1j * omega)
    J: Array = _real((slope[:, good] / np.abs(G[good])).T)
    return np.asarray(J.T @ J)


def _real(J: ComplexArray) -> Array:
    """Rows of real and imaginary parts, (rows, columns)."""
    flat = J.reshape(-1, J.shape[-1])
    return np.concatenate([flat.real, flat.imag])


def _judge(names: tuple[str, ...], F: Array, scale: Array, ties: Array) -> Identifiability:
    size = np.sqrt(np.diag(F))
    felt = size * scale > NOTHING * (size * scale).max(initial=1.0)
    bound = ties * scale
    alone = ~felt & (np.abs(bound) > NOTHING * np.abs(bound).max(initial=1e-300)).any(axis=0)
    told = int(np.linalg.matrix_rank(bound[:, alone])) if alone.any() else 0
    tied = alone if told == alone.sum() else np.zeros_like(alone)
    kept = np.flatnonzero(felt)
    N = F[np.ix_(kept, kept)] / np.outer(size[kept], size[kept])
    eigenvalues, V = np.linalg.eigh(N)
    lost = eigenvalues < RANK * max(eigenvalues.max(initial=0.0), 1e-300)
    faint = ~lost & (eigenvalues < WEAK)
    inside = [names[i] for i in kept]
    inflation = np.full(len(names), np.nan)
    with np.errstate(divide="ignore"):
        variance = (V[:, ~lost] ** 2 / eigenvalues[~lost]).sum(axis=1)
    blind = (np.abs(V[:, lost]) > 1e-4).any(axis=1)
    inflation[kept] = np.where(blind, np.inf, np.sqrt(variance))
    singular = bool(lost.any()) or not (felt | tied).all()
    return Identifiability(
        names=names,
        rank=int((~lost).sum() + tied.sum()),
        condition=float("inf") if singular else float(eigenvalues[-1] / eigenvalues[0]),
        eigenvalues=eigenvalues[::-1],
        insensitive=tuple(n for n, yes in zip(names, felt | tied, strict=True) if not yes),
        tied=tuple(name for name, yes in zip(names, tied, strict=True) if yes),
        confounded=_groups(V[:, lost], inside),
        weak=tuple(_prominent(v, inside, 3 * SHARE) for v in V[:, faint].T),
        inflation=inflation,
        information=F,
    )


def _groups(null: Array, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Parameters in each combination that is not felt, with as few in each as can be."""
    # Gauss-Jordan with the largest pivot gives a basis of the null space in which every combination
    # has one parameter of its own.
    rows = null.T.copy()
    for k in range(len(rows)):
        i, j = map(int, np.unravel_index(np.argmax(np.abs(rows[k:])), rows[k:].shape))
        rows[[k, k + i]] = rows[[k + i, k]]
        rows[k] /= rows[k, j]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, j], rows[k])
    return tuple(_prominent(row, names, SHARE) for row in rows)


def _prominent(row: Array, names: Sequence[str], share: float) -> tuple[str, ...]:
    """Names of the entries above a share of the largest."""
    sizes = np.abs(row)
    return tuple(name for name, s in zip(names, sizes, strict=True) if s > share * sizes.max())


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
