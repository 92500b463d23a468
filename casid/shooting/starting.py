"""Starting point of multiple shooting: nodes that follow the data, and the variables' units.

The starting model's states are smoothed over the records: the nodes minimise the residuals plus the
gaps between intervals, weighted by what a share of the inputs' effect may do over an interval. So a
poor start, or an unstable one, does not run away from the measurements.
"""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy
import scipy.linalg

from casid.arrays import Array
from casid.channels import UNITS
from casid.display import listed
from casid.errors import ConvergenceError
from casid.fit import AnyFit
from casid.free import Free
from casid.shooting.likelihood import CovarianceKind, Noise
from casid.shooting.programme import Blocks, Programme, Scales
from casid.shooting.sensitivity import Evaluator, Point

SURPRISE = 0.5  # share of the inputs' effect that the starting model may miss
FLOOR = 1e-6  # standard deviation of a residual is at least this share of the channel's
MOST = 10.0  # deviations that a channel's distance from zero counts for
ROUND = ("phi", "psi")  # angles that may turn further than a right angle
OTHER = 4.0  # times the variances of a fit: residuals that are not of its motion


def channel_size(evaluator: Evaluator) -> Array:
    """Root mean square of the measured samples of every output, (ny,); 1 where that is 0."""
    layout = evaluator.layout
    seen = layout.patterns[layout.pattern].sum(axis=0)
    moved = (layout.y - evaluator.level()[1]) * layout.patterns[layout.pattern]
    size = np.sqrt(np.sum(moved**2, axis=0) / np.maximum(seen, 1))
    return np.where(size > 0, size, 1.0)


def deviation(evaluator: Evaluator) -> Array:
    """Standard deviation of every output (ny,) within the records; 1 where it never moves.

    However far from zero a channel is, its noise is as small as its digits let it be.
    """
    total, count, ends = 0.0, 0.0, np.cumsum([0, *(each.N for each in evaluator.layout.records)])
    for a, b in itertools.pairwise(ends):
        rows = slice(a, b)
        there = evaluator.layout.patterns[evaluator.layout.pattern[rows]]
        y, n = evaluator.layout.y[rows], there.sum(axis=0)  # 0 where missing
        total = total + np.sum(((y - y.sum(axis=0) / np.maximum(n, 1)) * there) ** 2, axis=0)
        count = count + n
    size = np.sqrt(total / np.maximum(count, 1))
    return np.where(size > 0, size, 1.0)


def noise_of(evaluator: Evaluator, given: Array | None, kind: CovarianceKind) -> Noise:
    """Noise model of the records, R held at ``given`` unless that is None."""
    layout = evaluator.layout
    counts = np.bincount(layout.pattern, minlength=len(layout.patterns))
    size = np.minimum(channel_size(evaluator), MOST * deviation(evaluator))
    return Noise(layout.patterns, counts, FLOOR * size, kind, given)


def starting_programme(
    evaluator: Evaluator, free: Free, R: Array | CovarianceKind, biases: bool
) -> tuple[Programme, Point]:
    """The first programme, and the point to start it from."""
    # Its R is held: as given, or that of the starting residuals in the structure named. A Kalman
    # filter has its own.
    start = _start(evaluator, free)
    if evaluator.kalman:
        noise = noise_of(evaluator, np.eye(evaluator.ny), "diagonal")
        point, scales = _smoothed(evaluator, free, noise, start)
    elif isinstance(R, np.ndarray):
        noise = noise_of(evaluator, R, "diagonal")
        point, scales = _smoothed(evaluator, free, noise, start)
    else:
        coarse = np.diag((0.1 * channel_size(evaluator)) ** 2)
        point, scales = _smoothed(evaluator, free, noise_of(evaluator, coarse, R), start)
        loose = Programme(evaluator, free, scales, noise_of(evaluator, None, R), biases)
        noise = noise_of(evaluator, loose.values(loose.pack(point)).R, R)
    programme = Programme(evaluator, free, scales, noise, biases)
    return programme.balanced(point), point


def neighbouring_programme(
    evaluator: Evaluator, free: Free, R: Array | CovarianceKind, biases: bool, near: AnyFit
) -> tuple[Programme, Point] | None:
    """The programme of another fit's records, and that fit as a point of it."""
    # λ is the fit's, whatever the bounds; biases are only if its records are as many. None if the
    # fit has no noise and biases.
    if near.R is None or near.biases is None:
        return None
    start = replace(_start(evaluator, free), lam=near.model.vector()[free.index])
    if near.biases.shape == start.bias.shape:
        start = replace(start, bias=near.biases)
    kind: CovarianceKind = "diagonal" if isinstance(R, np.ndarray) else R
    given = R if isinstance(R, np.ndarray) else None
    point = _flown(evaluator, free, start, near)
    if point is None:
        known = noise_of(evaluator, near.R if given is None else given, kind)
        point, scales = _smoothed(evaluator, free, known, start, biases)
    else:
        scales = _units(evaluator, free, _size(point, _drift(evaluator, point.lam)))
    programme = Programme(evaluator, free, scales, noise_of(evaluator, given, kind), biases)
    return programme.balanced(point), point


def _flown(evaluator: Evaluator, free: Free, start: Point, near: AnyFit) -> Point | None:
    """The start with nodes along the fit's motion, which is one of the records as a whole.

    None if that is not known, or far from the records: they are others, or a mode has grown beyond
    what is known of how they begin.
    """
    e, model = evaluator, free.model
    own = np.isin(model.states, near.model.states)
    first, constants = near.initial_states, near.state_biases
    count = len(e.layout.records)
    if e.filtering or near.R is None or first is None or first.shape != (count, own.sum()):
        return None
    begin = np.zeros((count, e.nx))
    begin[:, own] = first
    if e.constants:
        if constants is None or constants.shape != (count, len(e.constants)):
            return None
        begin[:, e.constants] = constants
    with np.errstate(over="ignore", invalid="ignore"):
        motion = e.unbroken().simulate(replace(start, nodes=begin))
        seen = e.layout.patterns[e.layout.pattern].sum(axis=0)
        variance = np.sum(motion.residuals**2, axis=0) / np.maximum(seen, 1)
    if not (variance <= OTHER * np.diag(near.R)).all():
        return None
    return replace(start, nodes=motion.states[np.sort(e.layout.start)])


def continued_programme(
    evaluator: Evaluator, free: Free, R: Array | CovarianceKind, last: Programme, x: Array
) -> tuple[Programme, Point]:
    """The first programme of a filter from where another, or output error, has ended at ``x``."""
    e, done, motion = evaluator, last.unpack(x), last.values(x).motion
    more = np.zeros(0) if e.more is None else e.more.start
    lam = np.concatenate([done.lam[: len(free.index)], more])
    point = Point(lam=lam, bias=done.bias, nodes=motion.states[np.sort(e.layout.start)])
    scales = _units(e, free, np.sqrt(np.mean(motion.states**2, axis=0)))
    if isinstance(R, np.ndarray) or e.kalman:
        noise = noise_of(e, R if isinstance(R, np.ndarray) else np.eye(e.ny), "diagonal")
    else:
        loose = Programme(e, free, scales, noise_of(e, None, R), last.biases)
        noise = noise_of(e, loose.values(loose.pack(point)).R, R)
    programme = Programme(e, free, scales, noise, last.biases)
    return programme.balanced(point), point


def _start(evaluator: Evaluator, free: Free) -> Point:
    """The guess, at rest."""
    e, layout = evaluator, evaluator.layout
    more = np.zeros(0) if e.more is None else e.more.start
    return Point(
        lam=np.concatenate([free.guess, more]),
        bias=np.zeros((len(layout.records), e.ny)),
        nodes=e.resting(),
    )


def _smoothed(
    evaluator: Evaluator, free: Free, noise: Noise, point: Point, biases: bool = False
) -> tuple[Point, Scales]:
    """A point with nodes that follow the data, and units of the variables."""
    e = evaluator
    ones = Scales(np.ones(e.nf), np.ones(e.ny), np.ones(e.nx))
    programme = Programme(e, free, ones, noise, biases)
    with np.errstate(over="ignore", invalid="ignore"):
        drift = _drift(e, point.lam)
    rest = point.nodes
    for _ in range(e.smoothings):
        blocks = programme.blocks(programme.pack(point))
        point = replace(point, nodes=_smooth(blocks, point, rest, programme, drift))
    return point, _units(e, free, _size(point, drift))


def _size(point: Point, drift: Array) -> Array:
    """Of the states (nx,), at least what may be missed of them over an interval."""
    return np.maximum(np.sqrt(np.mean(point.nodes**2, axis=0)), np.sqrt(np.diag(drift)))


def _units(e: Evaluator, free: Free, size: Array) -> Scales:
    """Units of the variables for states of some size (nx,)."""
    state, spread = np.where(size > 0, size, 1.0), channel_size(e)
    more = np.zeros(0) if e.more is None else e.more.typical(state, spread)
    return Scales(np.concatenate([free.scale[free.index], more]), spread, state)


def _drift(e: Evaluator, lam: Array) -> Array:
    """Covariance of what a start may miss in the states over one interval, (nx, nx)."""
    m = e.matrices(lam)
    u = np.concatenate([record.u for record in e.layout.records]) - e.level()[0]
    dt = float(np.median([record.dt for record in e.layout.records]))
    T = float(np.median(e.layout.count)) * dt
    Q = SURPRISE**2 * (m.B * np.mean(u**2, axis=0)) @ m.B.T
    drift, nx = accumulated(m.A, Q, T), len(Q)
    for i in e.constants:  # a constant may do in a second what the inputs may
        drift[i, i] = drift.diagonal() @ (m.A[:, i] != 0)
    scale = np.trace(drift) / nx
    floor = 1e-6 * (np.diag(drift) + (scale if scale > 0 else 1.0) * 1e-3)
    return np.asarray((drift + drift.T) / 2 + np.diag(floor))


def accumulated(A: Array, Q: Array, T: float) -> Array:
    """∫ e^{As} Q e^{Aᵀs} ds over [0, T], (nx, nx), positive semidefinite however stiff A is."""
    # Over a step with ‖A‖ h <= 1 by Van Loan's exponential, whose growing half would swamp the
    # other over longer ones, and from there by doubling.
    nx = len(Q)
    doublings = max(0, int(np.ceil(np.log2(max(float(np.linalg.norm(A, 2)) * T, 1e-300)))))
    block = np.zeros((2 * nx, 2 * nx))
    block[:nx, :nx], block[:nx, nx:], block[nx:, nx:] = -A, Q, A.T
    expm = scipy.linalg.expm(block * (T / 2**doublings))
    step = expm[nx:, nx:].T
    total = step @ expm[:nx, nx:]
    for _ in range(doublings):
        total = total + step @ total @ step.T
        step = step @ step
    return np.asarray(total)


def _units_told(programme: Programme) -> str:
    """A reminder of units, with the angles of the records that are too large for radians."""
    own: Mapping[str, str] = UNITS | dict(getattr(programme.free.model, "units", {}))
    largest: dict[str, float] = {}
    for record in programme.evaluator.layout.records:
        for name, x in zip(
            (*record.inputs, *record.outputs), (*record.u.T, *record.y.T), strict=True
        ):
            if name not in ROUND and own.get(name) == "rad" and np.isfinite(x).any():
                largest[name] = max(largest.get(name, 0.0), float(np.nanmax(np.abs(x))))
    odd = [f"{name} reaches {size:.3g} rad" for name, size in largest.items() if size > np.pi / 2]
    return f"or convert degrees: {listed(odd)}" if odd else "or check the units of the records"


def _smooth(blocks: Blocks, point: Point, rest: Array, programme: Programme, drift: Array) -> Array:
    """Nodes minimising the residuals and, weighted by drift⁻¹, the gaps between intervals."""
    H, g, slope, link = blocks.Hnn, blocks.gn, blocks.slope_n, programme.links
    nodes = point.nodes
    J, nx = g.shape
    gaps = blocks.ends[link] - nodes[link + 1]
    if not all(np.isfinite(part).all() for part in (H, g, slope, gaps, drift)):
        raise ConvergenceError(
            "the starting model's simulation overflows within one interval"
            f"{programme.evaluator.lost(point)}; give a shorter interval or a "
            f"start nearer the data, {_units_told(programme)}"
        )
    P = np.linalg.inv(drift)
    diagonal, right = H.copy(), -g
    above: dict[int, Array] = {}
    first = np.setdiff1d(np.arange(J), link + 1)
    diagonal[first] += P  # a record begins near rest
    right[first] -= (nodes - rest)[first] @ P
    for j, gap in zip(link.tolist(), gaps, strict=True):
        diagonal[j] += slope[j].T @ P @ slope[j]
        diagonal[j + 1] += P
        above[j] = -slope[j].T @ P
        right[j] -= slope[j].T @ P @ gap
        right[j + 1] += P @ gap
    ridge = 1e-12 * float(np.abs(diagonal).max()) * np.eye(nx)
    grid: dict[tuple[int, int], Array] = {(j, j): diagonal[j] + ridge for j in range(J)}
    grid |= {(j, j + 1): block for j, block in above.items()}
    grid |= {(j + 1, j): block.T for j, block in above.items()}
    i, k = np.divmod(np.arange(nx * nx), nx)
    row = np.concatenate([j * nx + i for j, _ in grid])
    col = np.concatenate([j * nx + k for _, j in grid])
    values = np.concatenate([block.ravel() for block in grid.values()])
    K = scipy.sparse.csc_array((values, (row, col)), (J * nx, J * nx))
    return nodes + np.asarray(scipy.sparse.linalg.splu(K).solve(right.ravel()).reshape(J, nx))
