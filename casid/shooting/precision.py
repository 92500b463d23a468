"""What an output-error solution says about its own precision."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy
import scipy.linalg

from casid.arrays import Array, BoolArray
from casid.errors import asked
from casid.estimates import ACTIVE, at_bounds, holding, on_bounds, within
from casid.fit import AnyFit
from casid.record import Hold
from casid.shooting import uncertainty
from casid.shooting.nonlinear import Integration
from casid.shooting.outlying_records import Discord
from casid.shooting.programme import Programme
from casid.shooting.scores import NO_SCORES, OwnScores, RecordScores
from casid.shooting.slopes import beginnings, slopes
from casid.shooting.spectral_homogeneity import Opposed
from casid.shooting.spectrum import NoiseSpectrum
from casid.shooting.temporal_homogeneity import contradiction, suspected
from casid.shooting.whiteness import whitened
from casid.values import seal, storable


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class OutputErrorNotes:
    """What output error reports beside its estimates, rows in the order of ``Fit.free_names``.

    Parameters
    ----------
    rounds, nodes : int
        Solves until R settled, and shooting nodes.
    nuisances : int
        Numbers estimated beside λ: initial states, biases, the noise's variances and the gain.
    cramer_rao : (nf, nf) array
        Covariance of the estimates if residuals were white: the inverse information at
        ``Fit.R``. That of ``std_error`` is larger by n/(n - p) too, where n measurements gave
        that R and p other unknowns.
    correlation : (nf, nf) array
        Of the estimates by it.
    collinear : tuple of Collinearity
        Combinations the records hardly determine, the worst first.
    K : (nx, ny) array or None
        Gain of the innovations, of a filter error.
    integration : Integration or None
        How a nonlinear structure was integrated, and what that may have moved.
    spectra : tuple of NoiseSpectrum
        Of the residuals, in the frequency domain, one a kind of manoeuvre.
    process_noise : (nx,) array or None
        Densities of the noises that drive the states [state²/s], if those are estimated.
    response_weights : tuple of array
        By which residuals of measured responses count, one array a response: less than one where
        the structure misses more than their stated errors.
    covered : mapping
        Of a nonlinear structure: the span of each variable its tables are over, and of airspeed,
        in the records.
    hold : {"foh", "zoh"} or None
        What inputs did between the samples of all records; None where these differ in that.
    beside_bounds : (nf, nf) array
        What of ``Fit.covariance`` is that parameters on bounds may be within them.
    record_scores, record_information : (records, nf) and (records, nf, nf) array
        Of every record, all else following the parameters: the slope of its log-likelihood at the
        estimate, which in all is zero, and its information. None of white residuals of records
        that differ by no more than noise, in the frequency domain of any such.
    between_records : (nf, nf) array
        What of ``Fit.covariance`` is that estimates scatter from record to record by more than
        noise makes them; none where records do not contradict each other.
    """

    rounds: int
    nodes: int
    nuisances: int
    cramer_rao: Array
    correlation: Array
    collinear: tuple[uncertainty.Collinearity, ...]
    K: Array | None = None
    integration: Integration | None = None
    spectra: tuple[NoiseSpectrum, ...] = ()
    process_noise: Array | None = None
    response_weights: tuple[Array, ...] = ()
    covered: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    hold: Hold | None = None
    beside_bounds: Array = field(default_factory=lambda: np.zeros((0, 0)))
    record_scores: Array = field(default_factory=lambda: np.zeros((0, 0)))
    record_information: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    between_records: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        seal(self)

    def on_bounds(self, covariance: Array) -> Array:
        """A fit's covariance (nf, nf) with what is on bounds known to be there: a hypothesis."""
        return covariance - self.beside_bounds if self.beside_bounds.size else covariance

    def alike(self, covariance: Array) -> Array:
        """A fit's covariance (nf, nf) as though records did not contradict each other."""
        return covariance - self.between_records if self.between_records.size else covariance


@dataclass(frozen=True, eq=False)
class Precision:
    """Covariances of the free parameters and what spoils them, physical units."""

    cramer_rao: Array  # (n, n) bound for white residuals; infinite where not determined
    covariance: Array  # (n, n) corrected for the residuals' correlation in time and across outputs
    insensitivity: Array  # (n,) 1/√F_ii, initial states and biases eliminated from F
    collinear: tuple[uncertainty.Collinearity, ...]  # hardly determined, the worst first
    undetermined: tuple[str, ...]  # parameters in directions without information
    records: RecordScores = NO_SCORES  # of whole records, by the free parameters
    beside_bounds: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (n, n) in covariance
    discord: Discord | None = None  # of the records, in scaled unknowns
    between_records: Array = field(default_factory=lambda: np.zeros((0, 0)))  # in covariance, too

    def notes(
        self, rounds: int, nodes: int, nuisances: int, K: Array | None, Q: Array | None = None
    ) -> OutputErrorNotes:
        """What is said of it in the fit."""
        return OutputErrorNotes(
            rounds=rounds,
            nodes=nodes,
            nuisances=nuisances,
            cramer_rao=self.cramer_rao,
            correlation=uncertainty.correlation(self.cramer_rao),
            collinear=self.collinear,
            K=K,
            process_noise=Q,
            beside_bounds=self.beside_bounds,
            record_scores=self.records[0],
            record_information=self.records[1],
            between_records=self.between_records,
        )


def known_apart(near: AnyFit | None) -> bool | None:
    """Whether records contradict each other, as a fit nearby has it; None: ask them."""
    notes = None if asked() or near is None else near.notes
    return bool(notes.between_records.size) if isinstance(notes, OutputErrorNotes) else None


def precision(
    programme: Programme,
    x: Array,
    multipliers: Array,
    prices: Array,
    apart: bool | None = None,
) -> tuple[Array, Precision]:
    """Free values (n,) at a solver's scaled variables x, on the bounds that hold; their precision.

    ``multipliers`` (n,) of the parameters and ``prices`` of the constraints are as in the tables;
    ``apart`` is as `known_apart` has it.
    """
    n, lam = len(programme.free.index), _meant(programme, x, multipliers)
    x = np.append(lam / programme.scales.lam[:n], x[n:])
    return lam, _precision(programme, x, (multipliers, prices), apart)


def _meant(programme: Programme, x: Array, multipliers: Array) -> Array:
    n, scale = len(programme.free.index), programme.scales.lam

    def felt() -> Array:
        try:
            F = information(programme, x)[0]
        except (RuntimeError, np.linalg.LinAlgError):  # SciPy's word for an exactly singular factor
            return np.full(n, np.inf)
        return np.asarray(scale[:n] / np.sqrt(np.maximum(np.diag(F)[:n], 1e-300)))

    return on_bounds(programme.free, programme.unpack(x).lam[:n], multipliers, felt)


def _precision(
    programme: Programme, x: Array, slopes: tuple[Array, Array], apart: bool | None
) -> Precision:
    names = unknown_names(programme)
    try:
        F, follow = information(programme, x)
    except (RuntimeError, np.linalg.LinAlgError):  # SciPy's word for an exactly singular factor
        return _no_precision(programme, names)
    ties = held(programme, x)
    alone = np.diag(programme.blocks(x).Hll)  # information with the other variables known
    scaled = uncertainty.bound(F, ties, alone)
    unknown = np.isinf(np.diag(scaled))
    lost = tuple(name for name, out in zip(names, unknown, strict=True) if out)
    if programme.evaluator.kalman:  # a noise that does not matter need not be known
        lost = tuple(name for name in lost if name in programme.free.names)
    n = len(programme.free.index)
    known = uncertainty.determined(F, ties, alone)  # scores keep clear of what is confounded
    tied = int(ties[:, :n].any(axis=1).sum())
    coloured, records, own = _coloured(programme, x, known, follow, tied)
    found = _against_each_other(programme, x, known, own, apart)
    between = np.zeros((0, 0))
    if found is not None and not programme.free.priors:
        alike = coloured
        coloured, records, found = _widened(programme, coloured, found)
        between = coloured - alike
    beside = _beside_bounds(programme, x, slopes, (F, alone), (known, coloured))
    robust = np.where(np.isfinite(scaled), coloured + beside, scaled)
    unit = np.outer(programme.scales.lam, programme.scales.lam)
    diagonal = np.diag(F)[:n]
    with np.errstate(divide="ignore"):
        insensitivity = programme.scales.lam[:n] / np.sqrt(np.maximum(diagonal, 0.0))
    return Precision(
        cramer_rao=(scaled * unit)[:n, :n],
        covariance=(robust * unit)[:n, :n],
        beside_bounds=(beside * unit)[:n, :n],
        insensitivity=insensitivity,
        collinear=uncertainty.collinearities(F, ties, names, alone),
        undetermined=lost,
        records=records,
        discord=None if found is None else found[1],
        between_records=(between * unit[: len(between), : len(between)])[:n, :n],
    )


def _against_each_other(
    programme: Programme, x: Array, P: Array, own: OwnScores, apart: bool | None
) -> tuple[Opposed, Discord | None] | None:
    """Records that contradict each other, at scaled variables x; P (nf, nf) is `determined`.

    As is known if ``apart`` is not None. Filters say nothing: their gains follow the records, too.
    Nor is a record to blame where responses pull at all of them, or, of two, what is known before:
    `casid.shooting.hausman` asks those.
    """
    free, flown = programme.free, programme.evaluator.layout.records
    fewest = 3 if free.priors else 2
    if len(flown) < fewest or programme.evaluator.filtering or free.evidence is not None:
        return None
    if apart is False or not P.any():
        return None
    if not apart and not suspected(flown, own.found, uncertainty.coordinates(P)[0]):
        return None
    upper = programme.hessian_matrix(x)
    quadratic, follow = quadratic_model(programme, x, upper + scipy.sparse.triu(upper, 1).T)
    follow = follow[: programme.size - programme.evaluator.nf, :-1]
    along = slopes(programme, x, follow)(np.eye(len(P))), beginnings(programme, x)
    F, g = quadratic[:-1, :-1], quadratic[:-1, -1]
    return contradiction(flown, whitened(programme, x), along, P, F, g, known=bool(apart))


def _widened(
    programme: Programme, covariance: Array, found: tuple[Opposed, Discord | None]
) -> tuple[Array, RecordScores, tuple[Opposed, Discord | None]]:
    """A covariance (nf, nf) of the scaled unknowns no less than records scatter; their scores."""
    own, told = found
    wide = own.widened(covariance)
    before, after = np.diag(covariance), np.diag(wide)
    wider = np.sqrt(np.divide(after, before, out=np.ones_like(after), where=before > 0))
    unit = programme.scales.lam
    scores = own.scores[0] / unit, own.scores[1] / np.outer(unit, unit)
    return wide, scores, (own, told and told._replace(wider=wider))


def _beside_bounds(
    programme: Programme,
    x: Array,
    slopes: tuple[Array, Array],
    told: tuple[Array, Array],
    covariances: tuple[Array, Array],
) -> Array:
    """What is on bounds adds to the covariance of the scaled unknowns, (nf, nf).

    ``told`` are the information and that with the other variables known.
    """
    (F, alone), n = told, len(programme.free.index)
    values, scale = programme.unpack(x).lam[:n], programme.scales.lam[:n]
    bounded, ties = within(programme.free, values, _on_bounds(programme, x), *slopes)
    if not len(bounded.slope):
        return np.zeros_like(F)
    rows = np.pad(bounded.rows * scale, ((0, 0), (0, len(F) - n)))
    holding_still = scipy.linalg.block_diag(ties * scale, _filter_held(programme, x))
    scaled = bounded._replace(rows=rows)
    return uncertainty.beside_bounds(F, holding_still, alone, scaled, covariances)


def _no_precision(programme: Programme, names: tuple[str, ...]) -> Precision:
    """What is said where the likelihood degenerates: nothing is determined."""
    n = len(programme.free.index)
    nothing = np.where(np.eye(n, dtype=bool), np.inf, np.nan)
    return Precision(nothing, nothing, np.full(n, np.inf), (), names)


def unknown_names(programme: Programme) -> tuple[str, ...]:
    """Names of λ and of a filter's unknowns."""
    free, more = programme.free, programme.evaluator.more
    return free.names if more is None else (*free.names, *more.names(free.model))


def held(programme: Programme, x: Array) -> Array:
    """Gradients by the scaled unknowns of what holds them, (m, nf)."""
    # Parameters on a bound do not move, nor do ties and inequalities with no room left.
    n = len(programme.free.index)
    values, scale = programme.unpack(x).lam[:n], programme.scales.lam[:n]
    rows = holding(programme.free, values, _on_bounds(programme, x)) * scale
    return scipy.linalg.block_diag(rows, _filter_held(programme, x))


def _on_bounds(programme: Programme, x: Array) -> BoolArray:
    """Which free parameters (n,) are on a bound, as far as the data tell."""
    n, scale = len(programme.free.index), programme.scales.lam
    alone = np.maximum(np.diag(programme.blocks(x).Hll)[:n], 1e-300)
    return at_bounds(programme.free, programme.unpack(x).lam[:n], scale[:n] / np.sqrt(alone))


def _filter_held(programme: Programme, x: Array) -> Array:
    """Unit rows of a filter's unknowns on their bounds."""
    n = len(programme.free.index)
    lower, upper = programme.limits()[0]
    near = np.minimum(x[: len(lower)] - lower, upper - x[: len(lower)])[n:] <= ACTIVE
    return np.eye(len(near))[near]


def information(programme: Programme, x: Array) -> tuple[Array, Array]:
    """Fisher information of the scaled unknowns, and dν/dλ of scaled biases and nodes."""
    upper = programme.hessian_matrix(x)
    F, follow = quadratic_model(programme, x, upper + scipy.sparse.triu(upper, 1).T)
    return F[:-1, :-1], follow[: programme.size - programme.evaluator.nf, :-1]


def quadratic_model(
    programme: Programme, x: Array, hessian: scipy.sparse.sparray
) -> tuple[Array, Array]:
    """The cost about scaled variables as a function of [d; 1], d the unknowns' step.

    Biases and nodes ν follow so as to minimise it on the continuity constraints, which they meet
    whatever the gaps at x. ``hessian`` is that of the whole cost; variables beyond the programme's
    own follow too. Up to a constant the cost is half the form of the first array (nf + 1, nf + 1);
    ν moves by the product of the second (nn + m, nf + 1) with [d; 1], its last rows give the
    continuity's multipliers.
    """
    H, G = scipy.sparse.csc_array(hessian), programme.continuity_matrix(x)
    nf, more = programme.evaluator.nf, H.shape[0] - programme.size
    g = np.append(programme.n * programme.gradient(x), np.zeros(more))[:, None]
    free = scipy.sparse.csc_array((G.shape[0], more))
    own = np.block([[H[:nf, :nf].toarray(), g[:nf]], [g[:nf].T, np.zeros((1, 1))]])
    cross = np.hstack([H[nf:, :nf].toarray(), g[nf:]])
    tied = scipy.sparse.csc_array(scipy.sparse.hstack([G[:, nf:], free]))
    gaps = np.hstack([G[:, :nf].toarray(), programme.values(x).g[: G.shape[0], None]])
    return uncertainty.eliminate(own, H[nf:, nf:], cross, tied, gaps)


def _coloured(
    programme: Programme, x: Array, covariance: Array, follow: Array, held: int
) -> tuple[Array, RecordScores, OwnScores]:
    """What residuals correlated as they are make of a covariance (nf, nf), few data allowed for.

    And scores of whole records, if the scatter of estimates is in these alone; and by the
    covariance's coordinates.
    """
    nf, s, sweep = programme.evaluator.nf, programme.scales, programme.blocks(x).sweep
    own = OwnScores()
    data, (scores, shares) = uncertainty.coloured_covariance(
        covariance, whitened(programme, x), slopes(programme, x, follow), [own]
    )
    n = len(programme.free.index)
    unit, known = s.lam[:n], covariance[:, :n]
    surprise = programme.free.prior_scatter(programme.unpack(x).lam[:n])
    larger = programme.understatement(held)
    total = larger * data + known @ (surprise * np.outer(unit, unit)) @ known.T
    if sweep.gains is not None:
        _, more = sweep.gains.through_covariance(sweep.motion.residuals)
        more = larger * more * np.outer(s.lam, s.lam)
        total = total + covariance @ more @ covariance
    if nf > n or surprise.any() or not len(scores):
        return np.asarray(total), NO_SCORES, own
    return np.asarray(total), (scores / unit, shares / np.outer(unit, unit)), own
