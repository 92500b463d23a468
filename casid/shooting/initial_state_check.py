"""Whether the records bear out what is stated of how they begin.

A stated initial state with a small deviation holds its estimate, which then says nothing: what
contradicts it is how the records pull at it. With g the gradient of the records' part of the
negative log-likelihood and F their information about that state, all else following, the records
alone would have it, by a Gauss-Newton step, at

    x = m − g (σ² + 1/F),   of variance 1/F, as the stated m is of σ²;

which is `casid.shooting.priors.warn_contradicted` without a difference of nearly equal numbers.
Residuals correlated in time make another variance of x: gusts over the first seconds are no other
initial state. Of several that are contradicted the worst is left out before the others are asked.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from casid.arrays import Array
from casid.display import listed
from casid.errors import warn
from casid.shooting import uncertainty
from casid.shooting.precision import held
from casid.shooting.priors import CONTRADICTED, CONTRADICTS
from casid.shooting.programme import Programme
from casid.shooting.whiteness import whitened

STIFF = 1e4  # times the records' information: knowledge of more holds a state all the same
NOTHING = 1e-8  # share of an information that is rounding if no more is left


class Contradiction(NamedTuple):
    """A stated initial state, mean and deviation, and what the records alone would say."""

    record: str
    state: str
    stated: tuple[float, float]
    alone: tuple[float, float]
    off: float  # standard deviations between the two


class _Told(NamedTuple):
    """What the records say of the stated initial states (k,), in units (k,) that make F_ii one."""

    F: Array  # (k, k) information, all else following; a row of zeros where there is none
    g: Array  # (k,) gradient
    unit: Array  # (k,)
    variance: Callable[[Array, float, float], float]  # along a way (k,), see `_coloured`


def warn_of_beginnings(programme: Programme, x: Array) -> None:
    """Tell of initial states that the records contradict, at scaled variables x."""
    found = list(contradictions(programme, x))
    for state in dict.fromkeys(each.state for each in found):
        mine = sorted((c for c in found if c.state == state), key=lambda c: -c.off)
        where, worst = listed([c.record or "the record" for c in mine]), mine[0]
        warn(
            f"{CONTRADICTS} the initial state {state} = {worst.stated[0]:.4g} ± "
            f"{worst.stated[1]:.2g} of {where}: alone they would say {worst.alone[0]:.3g} ± "
            f"{worst.alone[1]:.2g}, {worst.off:.1f} standard deviations from it, and all "
            "estimates and errors assume that both are right: check the value (SI; of a "
            "nonlinear structure the total, of a linear one what is added to the trim), widen it "
            "or leave it out"
        )


def contradictions(programme: Programme, x: Array) -> Iterator[Contradiction]:
    """Stated initial states that the records contradict, the worst first."""
    free = programme.free
    if not free.initial:
        return
    names, records = free.model.states, programme.evaluator.layout.records
    columns = np.array([names.index(name) for name in free.initial])
    told = _told(programme, x, columns)
    means = programme.knowledge.mean[:, columns].ravel()
    std = np.tile([pair[1] for pair in free.initial.values()], len(records)) / told.unit
    weight, kept = np.minimum(std**-2.0, STIFF), np.full(len(means), True)
    asked = ~kept
    while not asked.all():
        spread = np.linalg.pinv(told.F + np.diag(weight * kept), hermitian=True)
        # What is left out follows the records: so do the others' gradients.
        pull = told.g - told.F @ spread @ np.where(kept, 0.0, told.g)
        left = 1 / np.maximum(np.diag(spread), NOTHING) - weight
        own = 1 / np.where(~asked & (left > NOTHING), left, np.inf)  # variance, 0 of nothing to ask
        i = int(np.argmax(np.where(own > 0, np.abs(pull) * np.sqrt(std**2 + own), 0.0)))
        step, asked[i] = pull[i] * (std[i] ** 2 + own[i]), True
        if not own[i] or abs(step) <= CONTRADICTED * np.hypot(std[i], own[i] ** 0.5):
            return
        alone = told.variance(spread[i] / spread[i, i], -step, own[i])
        if (off := abs(step) / np.sqrt(std[i] ** 2 + alone)) <= CONTRADICTED:
            continue
        kept[i], asked[kept] = False, False
        unit, (record, column) = told.unit[i], divmod(i, len(columns))
        stated, found = (means[i], std[i] * unit), (means[i] - step * unit, alone**0.5 * unit)
        yield Contradiction(records[record].name, names[columns[column]], stated, found, off)


def _told(programme: Programme, x: Array, columns: np.ndarray) -> _Told:
    """Of the states ``columns`` of every record, record by record.

    Parameters, biases and other states follow, and what is known of those stays.
    """
    bare = programme.variant(free=replace(programme.free, initial={}))
    firsts = np.searchsorted(bare.record, np.arange(bare.records))
    places = (bare.first_node + firsts[:, None] * bare.evaluator.nx + columns).ravel()
    rest = np.setdiff1d(np.arange(bare.size), places)
    upper, ties = bare.hessian_matrix(x), held(bare, x)
    H = scipy.sparse.csc_array(upper + scipy.sparse.triu(upper, 1).T)
    still = scipy.sparse.csc_array(np.pad(ties, ((0, 0), (0, bare.size - ties.shape[1]))))
    G = scipy.sparse.csc_array(scipy.sparse.vstack([bare.continuity_matrix(x), still]))
    slope = bare.n * bare.gradient(x)
    own = np.block([[H[places][:, places].toarray(), slope[places, None]], [slope[places], 0.0]])
    cross = np.hstack([H[rest][:, places].toarray(), slope[rest, None]])
    gaps = np.hstack([G[:, places].toarray(), np.zeros((G.shape[0], 1))])
    quadratic, follow = uncertainty.eliminate(own, H[rest][:, rest], cross, G[:, rest], gaps)
    felt = np.diag(quadratic)[:-1]
    some = felt > NOTHING * np.diag(own)[:-1]
    unit = 1 / np.sqrt(np.where(some, felt, 1.0))

    def variance(way: Array, step: float, white: float) -> float:
        move = np.zeros(bare.size)
        move[places] = unit * way
        move[rest] = follow[: len(rest), :-1] @ move[places]
        return _coloured(bare, x, move, step, white)

    root, sizes = unit * some, np.tile(bare.scales.state[columns], bare.records)
    F, g = quadratic[:-1, :-1] * np.outer(root, root), quadratic[:-1, -1] * root
    return _Told(F, g, unit * sizes, variance)


def _coloured(programme: Programme, x: Array, move: Array, step: float, white: float) -> float:
    """Variance of a step along scaled variables, which is ``white`` if residuals are.

    By what residuals are correlated before and after the step, which is so many times the move.
    """
    point, layout = programme.unpack(move), programme.evaluator.layout
    parts = np.tile(point.lam, (programme.J, 1)), point.nodes, point.bias[programme.record]
    slopes = programme.blocks(x).sweep.influence(np.hstack(parts)[layout.node, :, None])
    along = [np.concatenate(list(pieces)) for pieces in slopes]
    before = whitened(programme, x)
    after = [r + step * d[:, :, 0] for r, d in zip(before, along, strict=True)]
    # The first are coloured by the contradiction, too; in the second the step has followed gusts.
    one, other = (
        uncertainty.coloured_covariance(np.array([[white]]), r, lambda z: ([d @ z] for d in along))
        for r in (before, after)
    )
    return float(np.sqrt(one[0] * other[0])[0, 0])
