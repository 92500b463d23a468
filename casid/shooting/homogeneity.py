"""Whether a record contradicts the others, as one of a wrong trim, unit or gain does.

A wrong constant of one record's channel, where records have no biases, or its wrong gain, moves all
estimates by many standard errors: residuals stay small, since one estimate between the records
takes the fault as well as it may. Every record's slope of the likelihood tells (`Records`). Its
covariance is that of residuals correlated as they are found to be. Those that there are may be
coloured by the contradiction itself; so those count that each record's own estimate would leave, to
first order. They have lost to it some of their slow noise, for which more is allowed.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.special import chdtri

from casid.arrays import Array
from casid.display import listed
from casid.errors import warn
from casid.record import Record
from casid.shooting import uncertainty
from casid.shooting.amplitudes import end
from casid.shooting.delays import on_breaks
from casid.shooting.hausman import APART, MOST, Source
from casid.shooting.outlying_records import Discord, Records, discord
from casid.shooting.precision import held, information, slopes
from casid.shooting.programme import Programme
from casid.shooting.scores import ProcessScores, summed
from casid.shooting.whiteness import whitened

FAR = 2.0  # errors by noise alone that an estimate moves without the record: that is told
MORE = 2.0  # times the variance of scores that residuals show which are not white
WIDER = 1.2  # times the errors by noise that are stated: that is told

OPPOSED = "output error: records contradict each other"  # how what is told of it begins

Slopes = Callable[[Array], Iterable[Iterable[Array]]]


def warn_of_contradiction(programme: Programme, x: Array) -> None:
    """Tell of records that contradict the others, at scaled variables x.

    Filters say nothing: their gains follow the records, too. Nor is a record to blame where
    responses pull at all of them, or, of two, what is known before: `casid.shooting.hausman` asks
    those.
    """
    layout, free = programme.evaluator.layout, programme.free
    fewest = 3 if free.priors else 2
    if len(layout.records) < fewest or programme.evaluator.filtering or free.evidence is not None:
        return
    F, follow = information(programme, x)
    alone = np.diag(programme.blocks(x).Hll)
    # On a break of its likelihood a delay leaves records slopes that say nothing of contradiction.
    on = np.eye(len(F))[: len(free.index)][on_breaks(programme, programme.unpack(x).lam)]
    P = uncertainty.determined(F, np.vstack([held(programme, x), on]), alone)
    found = contradiction(P, whitened(programme, x), slopes(programme, x, follow))
    if found is None:
        return
    tell(found, layout.records, free.names)


def tell(found: Discord, flown: Sequence[Record], of: Sequence[str]) -> None:
    """Tell of records that contradict the others, if that moves what is estimated ``of`` them.

    Or if their scatter is in the errors stated.
    """
    # Of scattered records standard errors may be so large that they hide the one at fault.
    off, unit = found.off, np.where(found.noise > 0, found.noise, np.inf)
    moves = np.where(np.abs(off.apart) > APART, off.step / unit, 0.0)
    if np.abs(moves).max() > FAR or found.wider is not None:
        names = [record.name or f"record {k}" for k, record in enumerate(flown, 1)]
        warn(_told(found, names, of, moves) + _advice(found, flown, names) + _widened(found, of))


def contradiction(P: Array, residuals: Sequence[Array], along: Slopes) -> Discord | None:
    """Which records contradict the others.

    ``P`` (nf, nf) is the inverse information of all that is known, where parameters are free to
    move and determined, ``residuals`` (N, ny) those of every record, whitened, 0 where missing;
    ``along`` has their derivatives, as of `casid.shooting.uncertainty.coloured_covariance`.
    """
    root, _ = uncertainty.coordinates(P)
    scores = _OwnScores()
    summed(residuals, along(root), [scores])
    white = [Source(g, F, F) for g, F in scores.found]
    if Records(white, root).agree():  # and if residuals are coloured, more so
        return None
    left = _left_alone(residuals, along(root), scores.found)
    scatter = _Scatter(left, root.shape[1])
    summed(residuals, along(root), [scatter])
    larger = 1.0 if scatter.white else MORE
    sources = [e._replace(S=larger * S) for e, S in zip(white, scatter.found, strict=True)]
    return discord(Records(sources, root), white=scatter.white)


class _OwnScores:
    """Gradient (k,) of every record's cost and its information (k, k), in ``found``."""

    def __init__(self) -> None:
        self.found: list[tuple[Array, Array]] = []

    def begin(self, r: Array) -> None:
        """See `casid.shooting.scores.Scores`."""
        self._r, self._first = r, 0
        self._parts: list[tuple[Array, Array]] = []

    def add(self, s: Array) -> None:
        """See `casid.shooting.scores.Scores`."""
        flat, last = s.reshape(-1, s.shape[2]), self._first + len(s)
        self._parts.append((flat.T @ self._r[self._first : last].ravel(), flat.T @ flat))
        self._first = last

    def end(self) -> None:
        """See `casid.shooting.scores.Scores`."""
        g, F = zip(*self._parts, strict=True)
        self.found.append((np.sum(g, axis=0), np.sum(F, axis=0)))


class _Scatter:
    """Covariance (k, k) of every record's score, in ``found``.

    Of a process correlated as residuals (N, ny) are, each channel of its size in each record.
    """

    def __init__(self, residuals: Sequence[Array], k: int) -> None:
        self._sizes, self._k = [_sizes(r) for r in residuals], k
        pairs = zip(residuals, self._sizes, strict=True)
        self._C = uncertainty.residual_covariance([r / size for r, size in pairs])
        self.white = len(self._C) == 1
        self.found: list[Array] = []

    def begin(self, r: Array) -> None:
        """See `casid.shooting.scores.Scores`."""
        self._own = ProcessScores(self._C, self._k)
        self._own.begin(r)

    def add(self, s: Array) -> None:
        """See `casid.shooting.scores.Scores`."""
        self._own.add(s * self._sizes[len(self.found)][:, None])

    def end(self) -> None:
        """See `casid.shooting.scores.Scores`."""
        self.found.append(self._own.total())


def _left_alone(
    residuals: Sequence[Array], along: Iterable[Iterable[Array]], own: Sequence[tuple[Array, Array]]
) -> list[Array]:
    """What every record's own estimate leaves of its residuals, (N, ny), to first order.

    As large as they were before that estimate, of noise.
    """
    found = []
    for r, pieces, (g, F) in zip(residuals, along, own, strict=True):
        step, directions = uncertainty.own_step(g, F)
        left = r - np.concatenate([piece @ step for piece in pieces])
        samples = int(np.count_nonzero(r))
        free = max(samples - directions, 1)
        found.append(np.where(r != 0, left * np.sqrt(samples / free), 0.0))
    return found


def _sizes(r: Array) -> Array:
    """Root mean squares (ny,) of a record's channels, 1 of what it has not."""
    count = (r != 0).sum(axis=0)
    size = np.sqrt(np.sum(r**2, axis=0) / np.maximum(count, 1))
    return np.where(size > 0, size, 1.0)


def _told(found: Discord, names: Sequence[str], of: Sequence[str], moves: Array) -> str:
    """In words; ``moves`` are of the parameters in standard errors."""
    blamed, off, n = [names[i] for i in found.which], found.off, len(names)
    far = [k for k in np.argsort(-np.abs(moves))[:MOST] if abs(moves[k]) > FAR]
    moved = listed([f"{of[k]} by {moves[k]:+.2g}" for k in far])
    square, freedom, of_what = off.square, off.freedom, "combinations of parameters"
    if found.sides is not None:
        smaller, larger = (listed([names[i] for i in side]) for side in found.sides)
        who = f"those of the larger inputs, {larger}, and those of the smaller, {smaller}"
        without, n = f"of {smaller} alone", 1
    elif len(names) == 2:
        other = names[1 - found.which[0]]
        who, without = f"{blamed[0]} and {other}", f"of {other} alone"
    elif found.any is None:
        who = f"{blamed[0]} most, but also the others, whichever few are left out"
        without = f"without {blamed[0]}"
    elif found.any:
        who = f"one of {listed(blamed)} and the others, which agree without any one of them"
        without = f"without {blamed[0]}"
    else:
        who, without = f"{listed(blamed)} and all others, which agree", f"without {listed(blamed)}"
    if found.whole is not None:
        (square, freedom), n, of_what = found.whole, 1, "combinations of parameters of all records"
    return (
        f"{OPPOSED}: {who} (chi-square of {square:.0f} in {freedom} {of_what}, "
        f"where chance hardly exceeds {chdtri(freedom, found.seldom / n):.0f}). "
        + f"Estimates {without} differ, in standard errors from noise alone: {moved}. "
        * bool(far)
    )


def _widened(found: Discord, of: Sequence[str]) -> str:
    """By how much standard errors are those of how records scatter."""
    if found.wider is None or not found.wider.max(initial=0.0) > WIDER:
        return ""
    k = int(np.argmax(found.wider))
    return (
        ". Standard errors are taken from the scatter between records where that is larger: that "
        f"of {of[k]} is {found.wider[k]:.2g} times what noise alone makes it"
    )


def _advice(found: Discord, flown: Sequence[Record], names: Sequence[str]) -> str:
    """What to do."""
    if found.sides is not None:
        return (
            "The response seems to depend on amplitude (ask distortion): a linear model holds for "
            "one of them. Estimate together what was flown alike"
        )
    if found.any is None:
        return (
            "A response that depends on amplitude (ask distortion) or on flight condition looks "
            "the same: estimate together what was flown alike"
        )
    said = (
        "Standard errors do not know which is right. Check there the offset, unit, sign and gain "
        "of every channel, and the trim; biases or state_biases allow for constant offsets; "
        "leave it out and compare"
    )
    if ends := [(i, way) for i in found.which if (way := end(flown, i))]:
        i, way = ends[0]
        said += (
            f". {names[i]} has the {way} inputs: a response that depends on amplitude looks the "
            "same (ask distortion)"
        )
    return said
