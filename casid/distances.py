"""Is the structure enough? Its distance to the black box, and the black box's to measurements.

Both are told per pair and octave in units of their errors. The structure is moved to where it comes
nearest to the black box, parameters within their bounds: what is left, E, no values of them make.
If the structure is true, E is the part of the black box's error ε that they cannot take up,

    E = (I - J K) ε,   K = (Jᵀ W J)⁻¹ Jᵀ W,   cov ε = F Fᵀ,

J the slopes of the response, W the weights: that both come from the same records is allowed for.
Of a band the distance is d = (Σ |E|² / Σ E|E|²)^½; d² is a sum of χ² weighted by the eigenvalues
of E's covariance, over that of the residual spectrum, which the lines near the band give
(`casid.weighted_squares`). The level, divided by the number of pairs and bands (Bonferroni), holds
for all of them together.

Where an input mostly comes back from the outputs a black box is rather the controller's inverse
than the aircraft: no distance after that input is evidence, nor counts for the level.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from casid.arrays import Array, BoolArray
from casid.checks import check_asked
from casid.display import Shown, listed
from casid.errors import warn
from casid.fit import AnyFit
from casid.free import Free
from casid.frequency.response import FrequencyResponse, response_of_pair
from casid.missing_modes import Lacking, MissingMode
from casid.model import Model
from casid.records import several
from casid.response_fit import BoxResponse, Nearest, movable, nearest
from casid.subspace.blackbox import BlackBox
from casid.tabulation import markdown_table
from casid.threads import one_thread
from casid.values import storable
from casid.weighted_squares import upper_limit

OCTAVE = 8  # frequencies
COHERENT = 0.6  # least coherence of a measured point, T&R section 7.5
STARTS = 8  # of further searches
SCATTER = 0.6  # of their starts, relative to where the structure came nearest before
FEW = 0.1  # share of pairs and bands far, below which one of these may find another minimum
LEFT_OUT = 1.1  # ratio of frequencies asked for that are left out and told
CELLS = 1.5  # spectral lines 2π/T that one independent value of a windowed response takes


@storable
@dataclass(frozen=True, kw_only=True)
class Distance:
    """How far a structure is from a black box in one pair and band, in units of the errors.

    Parameters
    ----------
    output, input : str
        The pair.
    band : (float, float)
        Edges [rad/s].
    structure, structure_level : float
        Distance of the structure to the black box, and which one noise alone hardly exceeds. To the
        errors count one per cent of the pair's response, which no black box is without, and what
        goes on between samples, which it does not see.
    measured, measured_level : float
        Those of the black box to the measured response, in errors of both; NaN where none is
        coherent.
    share : float
        What the structure misses, relative to the response of the output to all inputs.
    missing : MissingMode or None
        The mode of the black box that makes most of what is missed, if the structure has none near.
    fed_back : bool
        Whether the input comes back from the outputs in most of the band: no evidence.
    """

    output: str
    input: str
    band: tuple[float, float]
    structure: float
    structure_level: float
    measured: float = np.nan
    measured_level: float = np.nan
    share: float = 0.0
    missing: MissingMode | None = None
    fed_back: bool = False

    @property
    def far(self) -> bool:
        """Whether the structure is farther from the black box than errors explain."""
        return self.structure > self.structure_level

    @property
    def doubted(self) -> bool:
        """Whether the black box is farther from the measured response than errors explain."""
        return self.measured > self.measured_level

    @property
    def fault(self) -> bool:
        """Whether it is the structure that is at fault."""
        return self.far and not self.doubted and not self.fed_back

    @property
    def cell(self) -> str:
        """The structure's distance in a table: ! where at fault, in brackets where no evidence."""
        told = f"{self.structure:.2g}σ{'!' * self.fault}"
        return f"({told})" if self.fed_back else told

    def told(self) -> str:
        """What is missed, in words."""
        low, high = (f"{edge:.2g}" for edge in self.band)
        return (
            f"{self.output} after {self.input}, {low}-{high} rad/s: the structure misses "
            f"{self.structure:.0f}σ, {self.share:.0%} of its response"
        )


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Distances(Shown):
    """How far a structure is from a black box and this from measured responses.

    Parameters
    ----------
    structure : str
        Name of its class.
    rows : tuple of Distance
        Every pair and band.
    level : float
        Chance that noise alone makes any ``far``.
    held : tuple of str
        Parameters on a bound where the structure comes nearest, which may be what is missed.
    """

    structure: str
    rows: tuple[Distance, ...]
    level: float
    held: tuple[str, ...] = ()

    def headline(self) -> str:
        """The verdict."""
        faults = self.faults
        if not faults:
            left = f"; left out, as outputs feed it back: {self.left_out}" if self.left_out else ""
            return f"{self.structure} misses nothing that the records show{left}"
        return (
            f"{self.structure} misses something in {len(faults)} of {len(self.rows)} bands of "
            f"pairs; {faults[0].told()}{self.bounded}"
        )

    @property
    def bounded(self) -> str:
        """What is said of bounds that keep the structure away; "" of none."""
        are = "is on a bound there, which" if len(self.held) == 1 else "are on bounds there, which"
        return f"; {listed(self.held)} {are} may be the reason" if self.held else ""

    @property
    def enough(self) -> bool:
        """Whether nothing that the structure misses is larger than the errors explain."""
        return not any(row.fault for row in self.rows)

    @property
    def faults(self) -> tuple[Distance, ...]:
        """Where the structure is at fault; first what is missed most clearly and most of."""
        found = (row for row in self.rows if row.fault)
        return tuple(sorted(found, key=lambda row: -row.structure * row.share))

    @property
    def left_out(self) -> str:
        """Inputs and bands that are no evidence, in words; nothing where all is."""
        said = []
        for name in dict.fromkeys(row.input for row in self.rows if row.fed_back):
            edges = [row.band for row in self.rows if row.fed_back and row.input == name]
            low, high = min(edges)[0], max(edges)[1]
            said.append(f"{name} at {low:.2g}-{high:.2g} rad/s")
        return ", ".join(said)

    @property
    def bands(self) -> tuple[tuple[float, float], ...]:
        """The bands [rad/s], lowest first."""
        return tuple(dict.fromkeys(row.band for row in self.rows))

    def by_pair(self) -> dict[tuple[str, str], list[Distance]]:
        """The rows of every (output, input), lowest band first."""
        found: dict[tuple[str, str], list[Distance]] = {}
        for row in self.rows:
            found.setdefault((row.output, row.input), []).append(row)
        return found

    def sentences(self) -> tuple[str, ...]:
        """What is missed of every output at fault, in the order of `faults`."""
        said: dict[str, list[Distance]] = {}
        for row in self.faults:
            said.setdefault(row.output, []).append(row)
        named: set[MissingMode] = set()
        return tuple(_sentence(rows, named) for rows in said.values())

    def to_markdown(self) -> str:
        """One row a pair and band at fault."""
        heading = ("pair", "rad/s", "structure", "level", "measured", "level", "share", "lacks")
        rows = [
            [
                f"{row.output}/{row.input}",
                f"{row.band[0]:.3g}-{row.band[1]:.3g}",
                *(f"{x:.2g}" for x in (row.structure, row.structure_level, row.measured)),
                f"{row.measured_level:.2g}",
                f"{row.share:.0%}",
                str(row.missing or ""),
            ]
            for row in self.faults
        ]
        return markdown_table(heading, rows)


@one_thread
def distances(
    fit: AnyFit | Model,
    black_box: BlackBox,
    responses: FrequencyResponse | Sequence[FrequencyResponse] = (),
    *,
    band: tuple[float, float] | None = None,
    level: float = 0.01,
) -> Distances:
    """Distance of a structure to a black box, and of that to measured responses, by pair and band.

    The fit is where the search begins, and says what is fixed and between which bounds the rest may
    move; it need not be near the black box. The model's constraints are not asked for.

    Parameters
    ----------
    fit : Fit or Model
        The structure.
    black_box : BlackBox
        With an uncertainty: refined to maximum likelihood.
    responses : FrequencyResponse or sequence of them
        Measured; each pair is compared with the first that has it.
    band : (float, float)
        Frequencies [rad/s] among those of the black box; these unless given. Divided into octaves.
    level : float
        Chance that noise alone makes the structure look insufficient anywhere.

    Raises
    ------
    ValueError
        A black box without uncertainty or without a channel of the structure, a band or a level
        that makes no sense. A `DataWarning` tells of a black box that is no measure of a structure.
    """
    check_asked(band, level)
    low, high = band = _known(black_box.band, band)
    if black_box.uncertainty is not None and not black_box.measures:
        warn(
            "distances: this black box cannot judge a structure, because its errors do not hold: "
            f"{' '.join(black_box.doubts())}"
        )
    free = movable(fit)
    octaves = max(1, round(float(np.log2(high / low))))
    target = BoxResponse.of(black_box, free.model, np.geomspace(low, high, octaves * OCTAVE + 1))
    bands = list(pairwise(np.geomspace(low, high, octaves + 1).tolist()))
    fed_back = [
        target.fed_back[_inside(target.omega, edges)].mean(axis=0) > 1 / 2 for edges in bands
    ]
    chance = level / max(int(np.sum(~np.array(fed_back))) * len(free.model.outputs), 1)
    found, scores = searched(free, target, bands, chance)
    lacking = Lacking.of(black_box, found.model, target)
    measured = several(responses) if responses else ()
    rows = []
    for edges, doubted, (far, limits) in zip(bands, fed_back, scores, strict=True):
        k = _inside(target.omega, edges)
        for i, output in enumerate(free.model.outputs):
            size = max(float(np.linalg.norm(target.G[k, i])), 1e-300)
            for j, channel in enumerate(free.model.inputs):
                missed, at = float(np.linalg.norm(found.E[k, i, j])), (k, i, j)
                row = Distance(
                    output=output,
                    input=channel,
                    band=edges,
                    share=missed / size,
                    missing=lacking.of_pair(edges, at, missed),
                    fed_back=bool(doubted[j]),
                    structure=float(far[i, j]),
                    structure_level=float(limits[i, j]),
                    **_measured(measured, black_box, (output, channel), edges, chance),
                )
                rows.append(row)
    name = type(free.model).__name__
    return Distances(structure=name, rows=tuple(rows), level=level, held=found.held)


def _known(known: tuple[float, float], asked: tuple[float, float] | None) -> tuple[float, float]:
    """What is asked for of a band as far as a black box knows it; warns of what is left out."""
    if asked is None:
        return known
    low, high = max(asked[0], known[0]), min(asked[1], known[1])
    if not low < high:
        raise ValueError(
            f"band={asked}: the black box is of {known[0]:.3g} to {known[1]:.3g} rad/s, expected "
            "frequencies among these"
        )
    if max(low / asked[0], asked[1] / high) > LEFT_OUT:
        warn(
            f"distances: of {asked[0]:.3g} to {asked[1]:.3g} rad/s the black box covers "
            f"{low:.3g} to {high:.3g}; beyond these it cannot judge, and they are left out"
        )
    return low, high


def _sentence(rows: Sequence[Distance], named: set[MissingMode]) -> str:
    """The worst band of an output, and after which other inputs it is at fault too."""
    worst, others = rows[0], dict[str, float]()
    for row in rows[1:]:
        if row.input != worst.input:
            others[row.input] = max(row.structure, others.get(row.input, 0.0))
    also = ", ".join(f"{name} {most:.0f}σ" for name, most in others.items())
    told = worst.told() + (f" (also after {also})" if also else "")
    if worst.missing is None or worst.missing in named:
        return told
    named.add(worst.missing)
    return f"{told}; the black box has {worst.missing}, and the structure none near"


def _inside(omega: Array, edges: tuple[float, float]) -> BoolArray:
    return np.asarray((omega >= edges[0] * (1 - 1e-9)) & (omega <= edges[1] * (1 + 1e-9)))


def searched(
    free: Free, target: BoxResponse, bands: Sequence[tuple[float, float]], chance: float
) -> tuple[Nearest, list[tuple[Array, Array]]]:
    """Where the structure comes nearest, and its distances and their levels there, by band."""
    # A search may end in a minimum that is not the lowest. Of a structure that hardly anything is
    # far from others are looked for: of one that much is far from there is no need to.
    rng, found = np.random.default_rng(0), nearest(free, target)
    scores = [_scores(found, target, edges, chance) for edges in bands]
    for _ in range(STARTS):
        far = np.mean([distance > limit for distance, limit in scores])
        if not 0 < far < FEW:
            break
        values = found.model.vector()[free.index] * rng.normal(1, SCATTER, len(free.index))
        start = free.full(np.clip(values, free.lower[free.index], free.upper[free.index]))
        other = nearest(replace(free, model=free.model.with_vector(start)), target)
        if other.cost < found.cost:
            found = other
            scores = [_scores(found, target, edges, chance) for edges in bands]
    return found, scores


def _scores(
    found: Nearest, target: BoxResponse, edges: tuple[float, float], chance: float
) -> tuple[Array, Array]:
    """Distances (ny, nu) of the structure in a band, and their levels."""
    k = _inside(target.omega, edges)
    E, factor, allowed = (
        np.moveaxis(part[k], 0, 2) for part in (found.E, found.factor, target.allowed)
    )  # (ny, nu, frequencies, ...)
    errors = np.concatenate([factor.real, factor.imag], axis=2)
    V = errors @ errors.swapaxes(2, 3)
    V += np.eye(V.shape[-1]) * np.concatenate([allowed, allowed], axis=2)[:, :, None] ** 2 / 2
    mean = np.trace(V, axis1=2, axis2=3)
    weights = np.maximum(np.linalg.eigvalsh(V / mean[:, :, None, None]), 0.0)
    limits = upper_limit(weights, float(target.freedom[k].mean()), chance)
    return np.linalg.norm(E, axis=2) / np.sqrt(mean), np.sqrt(limits)


def _measured(
    responses: Sequence[FrequencyResponse],
    box: BlackBox,
    pair: tuple[str, str],
    edges: tuple[float, float],
    chance: float,
) -> dict[str, float]:
    """Distance of the black box to a measured response, and its level; nothing without one."""
    known = [each for each in responses if pair[0] in each.outputs and pair[1] in each.inputs]
    if not known:
        return {}
    data = response_of_pair(known, pair)
    i, j = data.index(*pair)
    usable = np.isfinite(data.G[:, i, j]) & (data.coherence[:, i, j] >= COHERENT)
    usable &= _inside(data.omega, edges)
    if not usable.any():
        return {}
    omega, G = data.omega[usable], data.G[usable, i, j]
    at = box.system.outputs.index(pair[0]), box.system.inputs.index(pair[1])
    own = box.response(omega)[:, *at]
    # Errors of neighbouring frequencies are alike; those of the two responses, if both are of the
    # same records, as well, which makes them less apart than is allowed for.
    cells = np.abs(omega[:, None] - omega) * max(data.windows, default=0.0) / (2 * np.pi * CELLS)
    near = np.maximum(1 - cells, 0.0)  # of windows that nobody knows, all are
    of_data = np.tile(data.error[usable, i, j] * np.abs(G), 2)
    of_box = own[:, None] * np.nan_to_num(box.response_factor(omega)[:, *at])
    both = np.vstack([of_box.real, of_box.imag])
    V = np.kron(np.eye(2), near) * np.outer(of_data, of_data) + both @ both.T
    whole = max(float(np.trace(V)), 1e-300)
    weights = np.maximum(np.linalg.eigvalsh(V / whole), 0.0)
    limit = np.sqrt(upper_limit(weights[None], np.inf, chance))
    far = float(np.linalg.norm(G - own)) / np.sqrt(whole)
    return {"measured": far, "measured_level": float(limit[0])}
