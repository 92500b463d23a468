"""Flight path reconstruction: what instruments must be for a flight to obey kinematics.

    φ' = p + (q sin φ + r cos φ) tan θ        u' = ax − g sin θ + r v − q w
    θ' = q cos φ − r sin φ                    v' = ay + g cos θ sin φ + p w − r u
    ψ' = (q sin φ + r cos φ)/cos θ            w' = az + g cos θ cos φ + q u − p v

V. Klein, E. A. Morelli, Aircraft System Identification: Theory and Practice, chapter 10;
R. V. Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 10. A rate or a specific
force is taken as measured(t) = (1 + scale) true(t − skew) + bias, attitudes and velocities as right
but for noise and for clocks: velocities and, where flights tell it
(`casid.consistency.attitude_clocks`), θ and ψ may be late against φ, as what one of several sources
delays. A skew is against what the channel turns or moves; all terms of an equation are taken at the
time of what they are compared with (`casid.consistency.rigid.Sides`): a late θ in φ' would be read
as a skew of q, u times a late q as an accelerometer's place. Scale and skew are one for all
records. Biases are constant over a record and of its own: instruments drift from flight to flight,
and trim is subtracted record by record. A pitch attitude neither recorded nor given, in φ' alone,
is unknown in each record but of a credible size, `TILT`, and moves in straight lines between knots.

Departures. Both sides are integrated, with the measured attitudes and velocities in the products:
the unknowns but for the skews then enter linearly, and no trajectory can diverge. Noise of the
rates adds up in the integral; innovations of a filter with one gain an equation, fitted with the
unknowns, are what is minimised (gain 0 is output error), as far as aircraft move: up to `BAND`.
Noise of the measured signals is in the regressors, too: what it pretends there is taken out at the
end (`casid.consistency.errors_in_variables`). Standard errors allow for what colour is left.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.clipping import Beside, Limit, Whitened, beside, cut_off, judged, standing
from casid.consistency.errors_in_variables import Corrected, Eliminated, Normal
from casid.consistency.innovations import growing, innovations, integral, steady_gain
from casid.consistency.instruments import CLOCKS, OWN, Instruments
from casid.consistency.measured import Flight, noisier, white_noise
from casid.consistency.rigid import TURNED, WHOLE, Sides, Terms, terms_of
from casid.consistency.saturation import HELD, LONGEST, Block, ratio_errors

GAINS = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 25)])
ITERATIONS = 12
CORRECTIONS = 5  # last iterations, without what noise pretends
SETTLED = 1e-3  # of gains and skews [s]
REGAIN = (2, 5, 8)  # iterations after which the filters' gains are fitted anew
LATE = 0.5  # largest skew [s]
PLACED = len(CLOCKS)  # of the unknowns of no channel those before the accelerometers' place
GROUPS = (RATES, FORCES)
BATCH = 1.0  # time [s] over which innovations may be correlated
PRIOR = np.array([1.0, 0.1])  # of gain and skew, so that nothing is singular
FAR_OFF = 10.0  # from the centre of gravity [m], a prior too
TILT = 0.2  # tangent of a pitch attitude that is not known, its mean and what moves about it
SLOW, KNOTS = 2.0, 60  # s from one value of it to the next, and the most of them in a record
ROUNDING = 1e-9  # of a channel's range: no record is more exact


def reconstruct(
    flights: Sequence[Flight],
    equations: Sequence[str],
    *,
    parted: bool = False,
    alone: str = "",
) -> Instruments:
    """Gain, bias and skew of each rate and specific force by Gauss-Newton steps.

    Between the steps the filters' gains and the weights of the ``equations`` (named by attitude or
    velocity) are fitted. Attitudes have one clock unless they are ``parted``, and so do velocities;
    one of either may have one of its own, ``alone``.
    """
    problem = _Reconstruction(flights, tuple(equations), alone)
    n, placed = len(problem.channels), problem.placed
    free = np.concatenate([np.tile(PRIOR, n), np.full(placed, PRIOR[1]), np.full(3, FAR_OFF)])
    attitudes, reach = slice(2 * n, 2 * n + PLACED - 1), free.copy()
    if not parted:
        reach[attitudes] = HELD
    x, own, blocks, corrected, step = _solved(problem, reach)
    parts = problem.whitened(blocks)
    plain, flown = problem.normal(parts, own)
    pairs = [(one, problem.scores(parts, k)) for k, one in enumerate(flown)]
    scores = np.concatenate([one.scores(whole) for one, whole in pairs])
    loose = Corrected(plain + Normal(np.diag(free**-2.0), np.zeros(len(free))), plain * 0.0)
    P = corrected.covariance(scores, reach) + np.diag(step**2)
    clock, size = 2 * n, np.sqrt(np.diag(P))
    wider = ratio_errors(problem, parts, x, own, reach, size, range(1, clock, 2))
    pulled = P / size**2 * np.sqrt(wider**2 - size**2)  # what a delay takes with it
    P = P + pulled @ pulled.T
    errors = np.sqrt(np.diag(P))
    late = [*range(1, clock, 2), *range(clock, clock + placed)]
    return Instruments(
        channels=problem.channels,
        unknowns=x[:clock].reshape(n, 2),
        errors=errors[:clock].reshape(n, 2),
        biases=own[:, :n],
        bias_errors=np.sqrt([one.variances(whole, P)[:n] for one, whole in pairs]),
        tilts=np.arctan(own[:, n:]),
        against=problem.against(),
        left={one: [rows[0] for name, _, rows in blocks if name == one] for one in equations},
        clocks=x[clock : clock + placed],
        drawn=np.array([np.transpose([each.drawn(k) for each in flown]) for k in problem.clocks()]),
        covariance=P[np.ix_(late, late)],
        alone=alone,
        place=x[-3:],
        place_errors=errors[-3:],
        parted=parted,
        parting=float(np.abs(loose.step()[attitudes]).max()),
        coupled=problem.coupled(x, own, parts),
        held=max(flight.held for flight in flights),
        limits=problem.limits(parts, x),
        drifts=problem.drifts(blocks, parts),
    )


def _solved(
    problem: "_Reconstruction", reach: Array
) -> tuple[Array, Array, list[Block], Corrected, Array]:
    """Unknowns that all share and those of records, there blocks, normal equations, the next step.

    What noise pretends is evaluated once, where plain steps end, and carried on as a quadratic.
    """
    n = len(problem.channels)
    start = np.append(np.tile([1.0, 0.0], n), np.zeros(problem.placed + 3))
    prior, skews = reach**-2.0, [*range(1, 2 * n, 2), *range(2 * n, len(start) - 3)]
    x, own, pretended = start, np.zeros((problem.records, n + problem.knots)), None
    iteration = 0
    while True:
        blocks = problem.blocks(x, own)
        if iteration in REGAIN:
            problem.fit_gains(blocks, x[: 2 * n : 2])
        if iteration <= REGAIN[-1]:
            problem.fit_sizes(blocks)
        plain, flown = problem.normal(problem.whitened(blocks), own)
        seen = plain + Normal(np.diag(prior), prior * (start - x))
        corrected = Corrected(seen, pretended or plain * 0.0)
        step = corrected.step()
        near = iteration > REGAIN[-1] and np.abs(step[:-3]).max() < SETTLED
        if (near and pretended) or iteration == ITERATIONS + CORRECTIONS:
            break
        if pretended is None and (near or iteration == ITERATIONS):
            pretended = problem.pretended(x, own, plain)
            corrected = Corrected(seen, pretended)
            step = corrected.step()
        most = LONGEST * (iteration >= REGAIN[0])  # an integral's walk would pass for a skew
        step[skews] = np.clip(step[skews], -most, most).clip(-LATE - x[skews], LATE - x[skews])
        x, own = x + step, own + [one.step(step) for one in flown]
        still = step.copy()
        still[skews] = 0.0  # stationary noise is as large whenever it is read
        pretended = pretended and pretended.after(still)
        iteration += 1
    return x, own, blocks, corrected, step


class _Reconstruction:
    """Residuals of all equations over all flights, and the filters that whiten them."""

    def __init__(
        self, flights: Sequence[Flight], equations: tuple[str, ...], alone: str = ""
    ) -> None:
        self.flights, self.equations, self.alone = flights, equations, alone
        self.placed = PLACED + bool(alone)
        self.terms = [{each: terms_of(each, flight) for each in equations} for flight in flights]
        there = set(flights[0].values)
        judged = {  # what another term takes the place of that is missing there is not
            name
            for each, (factors, _) in self.terms[0].items()
            for name in factors
            if OWN[name] == each or WHOLE[each] <= there
        }
        self.channels = tuple(name for name in (*RATES, *FORCES) if name in judged & there)
        self.shared = 2 * len(self.channels) + self.placed + 3
        found, self.of = np.unique([flight.record for flight in flights], return_inverse=True)
        self.records = len(found)
        end = max((each.start + each.t[-1] for each in flights if each.tilts), default=-np.inf)
        self.apart = max(SLOW, end / KNOTS)
        self.knots = int(max(np.ceil(end / self.apart) + 1, 0))
        self.splines = []  # cubic pieces between samples, (4, N - 1) each
        products = (*TURNED, *(VELOCITIES if alone in VELOCITIES else ()))
        turned = tuple(name for name in products if name in flights[0].values)
        for flight in flights:
            y = np.column_stack([flight.values[name] for name in (*self.channels, *turned)])
            pieces = scipy.interpolate.CubicSpline(flight.t, y).c
            rows = np.ascontiguousarray(np.moveaxis(pieces, 2, 0))
            self.splines.append(dict(zip((*self.channels, *turned), rows, strict=True)))
        self.columns = {each: self._own(each) for each in equations}
        self.gains = dict.fromkeys(equations, 0.0)
        self.sizes = dict.fromkeys(equations, 1.0)

    def against(self) -> dict[str, tuple[str, ...]]:
        """The equations in which each rate or force stands."""
        factors = {each: terms for each, (terms, _) in self.terms[0].items()}
        return {
            name: tuple(each for each in self.equations if name in factors[each])
            for name in self.channels
        }

    def clocks(self) -> list[list[int]]:
        """Skews of the rates, of the forces, among the unknowns."""
        return [[2 * i + 1 for i, name in enumerate(self.channels) if name in g] for g in GROUPS]

    def _own(self, equation: str) -> NDArray[np.intp]:
        """Which unknowns stand in an equation."""
        factors, n = self.terms[0][equation][0], len(self.channels)
        own = [i for i, name in enumerate(self.channels) if name in factors]
        found = [k for i in own for k in (2 * i, self.shared + i, 2 * i + 1)]
        common = range(2 * n, self.shared - 3 * (equation not in VELOCITIES))
        tilts = self.shared + n + np.arange(self.knots * (equation == "phi"))
        return np.array([*found, *common, *tilts])

    def blocks(self, x: Array, own: Array) -> list[Block]:
        """Residuals and slopes of each equation and flight at these unknowns."""
        found = []
        for sides, k in zip(self._sides(x, own), self.of, strict=True):
            flight = sides.flight
            for each in self.equations:
                slopes, f = sides.of(each)
                F = integral(np.array([f, *slopes]).T, flight.dt).T
                F = F[:, flight.rows.get(each, slice(None))]
                F[0] = flight.own(each) - F[0]
                F[0] -= F[0].mean()
                found.append((each, int(k), F))
        return found

    def _sides(self, x: Array, own: Array) -> list[Sides]:
        """Right-hand sides of every flight at these unknowns."""
        n = 2 * len(self.channels)
        shared, clocks, place = x[:n].reshape(-1, 2), x[n:-3], x[-3:]
        found = []
        for flight, k, pieces in zip(self.flights, self.of, self.splines, strict=True):
            biases, knots = np.split(own[k], [len(self.channels)])
            table = dict(zip(self.channels, np.insert(shared, 1, biases, axis=1), strict=True))
            known = pieces, table, self.equations, clocks, place, self.alone
            found.append(Sides(flight, *known, knots, self.apart))
        return found

    def coupled(self, x: Array, own: Array, parts: Sequence[Block]) -> tuple[float, float]:
        """How many times the coupling of attitudes is flown beside once, and its error."""
        more = []
        for sides in self._sides(x, own):
            for each in self.equations:
                turns = sides.coupling(each) if each in ATTITUDES else np.zeros(len(sides.flight.t))
                F = integral(turns[:, None], sides.flight.dt).T
                F = F[:, sides.flight.rows.get(each, slice(None))]
                more.append(self._whitened(each, F - F.mean()))
        (value,), (scatter,) = beside(self._batched(parts), more, [(e, k) for e, k, _ in parts])
        return float(value), float(np.linalg.norm(scatter))

    def whitened(self, blocks: Sequence[Block]) -> list[Block]:
        """Innovations up to `BAND` and slopes, in standard deviations of all of the innovations."""
        return [(each, k, self._whitened(each, rows)) for each, k, rows in blocks]

    def fit_sizes(self, blocks: Sequence[Block]) -> None:
        """Take the standard deviations of the innovations."""
        for each in self.equations:
            mine = [innovations(self.gains[each], r[:1])[0] for n, _, r in blocks if n == each]
            floor = ROUNDING * max(np.ptp(flight.values[each]) for flight in self.flights)
            size = np.sqrt(np.mean(np.concatenate(mine) ** 2) + floor**2 + 1e-300)
            self.sizes[each] = float(size)

    def normal(self, parts: Sequence[Block], own: Array) -> tuple[Normal, list[Eliminated]]:
        """Normal equations of all records and of each; of priors only that of pitch attitudes."""
        n = self.shared + len(self.channels) + self.knots
        found = [Normal(np.zeros((n, n)), np.zeros(n)) for _ in range(self.records)]
        for each, k, rows in parts:
            at, products = self.columns[each], rows @ rows.T
            found[k].information[np.ix_(at, at)] += products[1:, 1:]
            found[k].slope[at] += products[1:, 0]
        first, prior = n - self.knots, TILT**-2 * (np.eye(self.knots) - 1 / (1 + self.knots))
        for whole, tilts in zip(found, own[:, len(self.channels) :], strict=True):
            whole.information[first:, first:] += prior
            whole.slope[first:] -= prior @ tilts
        flown = [Eliminated(whole, self.shared) for whole in found]
        return sum((one.shared for one in flown[1:]), flown[0].shared), flown

    def pretended(self, x: Array, own: Array, plain: Normal) -> Normal:
        """The noise's part of the normal equations, found by adding as much noise again."""
        found = plain * -1.0
        for other in self._noisier:
            noisy, _ = other.normal(other.whitened(other.blocks(x, own)), own)
            found += noisy * (1 / len(self._noisier))
        return found

    @cached_property
    def _noisier(self) -> list["_Reconstruction"]:
        """The same with noise on top, so that in their mean only its squares remain."""
        found, rng = [], np.random.default_rng(0)
        for flights in noisier(self.flights, rng):
            found.append(_Reconstruction(flights, self.equations, self.alone))
            found[-1].gains, found[-1].sizes = self.gains, self.sizes
        return found

    def fit_gains(self, blocks: Sequence[Block], scaling: Array) -> None:
        """Take the gains with the smallest innovations, no less than the rates' noise asks for."""
        # Without that floor a bias explains a random walk too well now and then: K = 0.
        sizes = {each: np.zeros(len(GAINS)) for each in self.equations}
        for n in {rows.shape[1] for _, _, rows in blocks}:
            names = [name for name, _, rows in blocks if rows.shape[1] == n]
            alike = np.array([rows[0] for _, _, rows in blocks if rows.shape[1] == n])
            for k, K in enumerate(GAINS):
                for name, left in zip(names, innovations(K, alike), strict=True):
                    sizes[name][k] += left @ left
        for each in self.equations:
            seen = float(
                np.mean([white_noise(rows[0]) ** 2 for name, _, rows in blocks if name == each])
            )
            ratio = float(self._walk(each, scaling) / max(seen, 1e-300))
            self.gains[each] = max(float(GAINS[int(np.argmin(sizes[each]))]), steady_gain(ratio))

    def _walk(self, equation: str, scaling: Array) -> float:
        """Variance that the noise of rates and forces adds from one sample to the next."""
        total = 0.0
        for flight, terms, level in zip(self.flights, self.terms, self._levels, strict=True):
            for name, gain in zip(self.channels, scaling, strict=True):
                if name in terms[equation][0]:
                    share = np.mean(np.square(terms[equation][0][name]))
                    span = flight.step(equation) * flight.step(name)
                    total += float(share * span * (gain * flight.dt * level[name]) ** 2)
        return total / len(self.flights)

    @cached_property
    def _levels(self) -> list[dict[str, float]]:
        """Noise of each rate and force in each flight."""
        return [
            {name: white_noise(each.own(name)) for name in self.channels} for each in self.flights
        ]

    def limits(self, parts: Sequence[Block], x: Array) -> dict[str, Limit]:
        """Sensors at their limits, each by the attitude or velocity that says most of it."""
        found: dict[str, Limit] = {}
        regressed = self._batched(parts)
        for i, name in enumerate(self.channels):
            if (each := OWN[name]) not in self.equations:
                continue
            whole = [one for (of, *_), one in zip(parts, regressed, strict=True) if of == each]
            ends = standing(self.flights, name)
            more = [
                np.array([self._beyond(*both, each, name, (x[2 * i + 1], *end)) for end in ends])
                for both in zip(self.flights, self.terms, strict=True)
            ]
            for end, *off in zip(ends, *cut_off(whole, more), strict=True) if ends else ():
                if limit := judged(*end[1:], *off):
                    found[name] = limit
        return found

    def drifts(self, blocks: Sequence[Block], parts: Sequence[Block]) -> Beside:
        """How fast each skew and, last, the clock of velocities grow [s/s]."""
        n, more = len(self.channels), []
        for i, (each, _, rows) in enumerate(blocks):
            flight, own = self.flights[i // len(self.equations)], self.columns[each]
            late = (own == 2 * n + PLACED - 1) | (own < 2 * n) & (own % 2 == 1)
            grows = growing(rows[1:][late], flight.dt * self.flights[0].step(each), flight.start)
            more.append(np.zeros((n + 1, rows.shape[1])))
            more[-1][np.minimum(own[late] // 2, n)] = self._whitened(each, grows)
        return beside(self._batched(parts), more, [(each, k) for each, k, _ in blocks])

    def _beyond(
        self, flight: Flight, terms: Mapping[str, Terms], each: str, name: str, at: Sequence[float]
    ) -> Array:
        """Slope (N,) of an equation by what a channel near its extreme is off by, whitened."""
        skew, threshold, _, reach = at
        there = np.sign(reach) * (flight.values[name] - threshold) > 0
        late = np.interp(flight.t + skew, flight.t, there.astype(float))
        moved = integral((terms[each][0][name] * late)[:, None], flight.dt).T
        moved = moved[:, flight.rows.get(each, slice(None))]
        return np.asarray(self._whitened(each, moved - moved.mean())[0])

    def _whitened(self, each: str, rows: Array) -> Array:
        dt = self.flights[0].dt * self.flights[0].step(each)
        return np.asarray(innovations(self.gains[each], rows, dt) / self.sizes[each])

    def _batched(self, parts: Sequence[Block]) -> list[Whitened]:
        """Residuals, slopes, and stretches that count as independent, shared by all equations."""
        found, first = [], 0
        for k, (each, _, rows) in enumerate(parts, 1):
            dt = self.flights[0].dt * self.flights[0].step(each)
            batch = np.arange(rows.shape[1]) // max(1, round(BATCH / dt))
            found.append((rows[0], rows[1:], first + batch))
            if k % len(self.equations) == 0:  # what follows is the next flight's
                first = 1 + max(int(one[2][-1]) for one in found)
        return found

    def scores(self, parts: Sequence[Block], record: int) -> Array:
        """Sums of slope times innovation over stretches of a record that count as independent."""
        first, found = self.flights[0], []
        for each, k, rows in parts:
            if k != record:
                continue
            step = max(1, round(BATCH / (first.dt * first.step(each))))
            starts = np.arange(0, rows.shape[1], step)
            found.append(np.zeros((len(starts), self.shared + len(self.channels) + self.knots)))
            sums = np.add.reduceat(rows[1:] * rows[0], starts, axis=1)
            found[-1][:, self.columns[each]] = sums.T
        return np.concatenate(found)
