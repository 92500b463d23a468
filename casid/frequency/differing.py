"""Whether a record's own response is that of the others: a scale, a sign, a clock that is off.

A stick logged at half its size in one of several sweeps makes a pooled response that is neither's,
and errors that do not know of it. Where several records excite an input, each one's own response
G_r (`casid.frequency.local`, at frequencies far enough apart for errors to be independent) over the
mean of the others is

    log G_r/G = log c - jωτ + errors,

with one real factor c and one delay τ for every pair where something of the logging is wrong. What
differs from frequency to frequency, as of an aircraft that is nonlinear, counts as error of both.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.display import listed
from casid.frequency.local import local_response
from casid.record import Record
from casid.records import still

APART = 1.35  # ratio of frequencies, at least: three widths of local models
EXCITED = 0.1  # of an input's largest power in any record, in those that are compared
KNOWN = 0.3  # relative errors up to which a point is compared
FEWEST = 4  # frequencies of a pair
FLOOR = 0.02  # relative error of a point, at least: bias of local models, of manoeuvres not alike
LONGEST = 0.4  # delay [s]: beyond, phases are of something else
SURE = 6.0  # standard errors, of which a few frequencies tell the size
GAIN, DELAY = 0.15, 0.015  # logarithm of a factor and delay [s] that are worth telling
ONE = 0.5  # of the typical difference, by which those of an input's outputs differ at most

WHY = (
    "the response is between them. Look for a scale, a sign or a clock of that record's channels, "
    "another flight condition or mass, or an aircraft that is nonlinear where amplitudes differ "
    "(`distortion`); leave the record out and compare"
)


class Difference(NamedTuple):
    """Of one pair of one record from the others."""

    factor: float  # signed
    factor_error: float  # relative
    delay: float  # [s]
    delay_error: float

    @property
    def gained(self) -> bool:
        """Whether the factor is surely not one."""
        size = abs(np.log(abs(self.factor)))
        return self.factor < 0 or bool(size > max(GAIN, SURE * self.factor_error))

    @property
    def late(self) -> bool:
        """Whether there is surely a delay."""
        return bool(abs(self.delay) > max(DELAY, SURE * self.delay_error))

    @property
    def size(self) -> float:
        """In standard errors."""
        gain = np.pi if self.factor < 0 else abs(np.log(abs(self.factor)))
        return float(max(gain / self.factor_error, abs(self.delay) / self.delay_error))

    def told(self) -> str:
        """In words, of the record."""
        said = []
        if self.gained:
            error = abs(self.factor) * self.factor_error
            said.append(f"{self.factor:.2f} ± {error:.2g} times as large as")
        if self.late:
            way = "later" if self.delay > 0 else "earlier"
            said.append(f"{1e3 * abs(self.delay):.0f} ± {1e3 * self.delay_error:.0f} ms {way} than")
        return " and ".join(said)


def differing(records: Sequence[Record], omega: Array) -> str:
    """What says that a record's response is not that of the others; "" without such.

    Records are equidistant; ``omega`` (K,) are the frequencies [rad/s] of their response.
    """
    if len(records) < 2:
        return ""
    chosen = [omega[0]]
    for each in omega:
        if each > APART * chosen[-1]:
            chosen.append(each)
    omega = np.array(chosen)
    own = [_response(record, omega) for record in records]
    inputs, power = records[0].inputs, np.array([np.var(record.u, axis=0) for record in records])
    # Of its axis: other inputs follow it, or answer noise, and tell little by themselves.
    share = power / np.maximum(power.max(axis=0), np.finfo(float).tiny)
    told: list[str] = []
    for j, name in enumerate(inputs):
        excite = [r for r, own_share in enumerate(share) if own_share[j] > EXCITED]
        excite = [r for r in excite if share[r, j] == share[r].max()]
        found = [
            (r, pairs)
            for r in excite
            if (pairs := _pairs(omega, own, r, [s for s in excite if s != r], j))
        ]
        if found:
            r, pairs = max(found, key=lambda each: max(one.size for one in each[1].values()))
            others = listed([repr(records[s].name) for s in excite if s != r], 3)
            told += _told(records[r], name, pairs, others)
    return f"records disagree: {'; '.join(told)}: {WHY}" if told else ""


def _told(record: Record, name: str, pairs: dict[int, Difference], others: str) -> Iterator[str]:
    """Of one record and input: the outputs together if all differ alike."""
    logs = np.array([[np.log(abs(one.factor)), one.delay] for one in pairs.values()])
    signs = {one.factor > 0 for one in pairs.values()}
    spread, typical = np.ptp(logs, axis=0), np.abs(logs).mean(axis=0)
    alike = len(signs) == 1 and (spread < np.maximum(ONE * typical, (GAIN, DELAY))).all()
    if len(pairs) == record.ny > 1 and alike:
        best = max(pairs.values(), key=lambda one: one.size)
        yield (
            f"all outputs after {name} in {record.name!r} are {best.told()} those in {others}, as "
            f"of a {name} of {1 / best.factor:.2f} times its size"
            + f" that is logged {1e3 * abs(best.delay):.0f} ms "
            f"{'early' if best.delay > 0 else 'late'}" * best.late
        )
    else:
        for i, one in pairs.items():
            yield f"{record.outputs[i]} after {name} in {record.name!r} is {one.told()} in {others}"


def _response(record: Record, omega: Array) -> tuple[ComplexArray, Array]:
    """A record's own response and its relative errors (K', ny, nu), NaN where unknown."""
    shape = (len(omega), record.ny, record.nu)
    G, error = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    silent = still([record], (*record.inputs, *record.outputs))
    columns = [k for k, name in enumerate(record.inputs) if name not in silent]
    rows = [k for k, name in enumerate(record.outputs) if name not in silent]
    if rows and columns:
        part = record.select([record.inputs[k] for k in columns], [record.outputs[k] for k in rows])
        found = local_response([part], omega)
        if found is not None:
            at = np.ix_(range(len(omega)), rows, columns)
            G[at], error[at] = found.G, np.hypot(found.random_error, found.leakage)
    short = omega < 4 * np.pi / record.duration  # two periods
    G[short] = np.nan
    return G, error


def _pairs(
    omega: Array, own: Sequence[tuple[ComplexArray, Array]], r: int, others: Sequence[int], j: int
) -> dict[int, Difference]:
    """Outputs whose response to an input surely differs from the others, and how."""
    found: dict[int, Difference] = {}
    if not others:
        return found
    G, error = (np.array([each[k][:, :, j] for each in own]) for k in range(2))
    usable = np.isfinite(G) & (np.abs(G) > 0) & (error < KNOWN)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(usable, 1 / np.maximum(error, FLOOR) ** 2, 0.0)[list(others)]
        size = np.where(weight > 0, np.abs(G[list(others)]), 1.0)
        total = weight.sum(axis=0)
        # Of unequal responses the mean of logarithms, phases by the mean direction.
        turn = np.where(weight > 0, G[list(others)] / size, 0.0)
        phase = np.angle((weight * turn).sum(axis=0))
        mean = np.exp((weight * np.log(size)).sum(axis=0) / total + 1j * phase)
        variance = np.maximum(error[r], FLOOR) ** 2 + 1 / total
    for i in range(G.shape[2]):
        at = usable[r, :, i] & (total[:, i] > 0)
        if at.sum() < FEWEST:
            continue
        one = _difference(omega[at], G[r, at, i] / mean[at, i], variance[at, i])
        if one is not None and (one.gained or one.late):
            found[i] = one
    return found


def _difference(omega: Array, ratio: ComplexArray, variance: Array) -> Difference | None:
    """Factor and delay of responses' ratios (n,) with variances of real and imaginary part.

    None where phases are of no delay, or no sign is surely the right one.
    """
    w, fits, freedom = 1 / variance, [], len(omega) - 1
    logs = np.log(np.abs(ratio))
    gain = float(w @ logs / w.sum())
    for sign in (1.0, -1.0):
        phase = np.unwrap(np.angle(sign * ratio))
        delay = -float(w @ (omega * phase) / (w @ omega**2))
        fits.append((float(w @ (phase + omega * delay) ** 2), sign, delay))
    (misses, sign, delay), (other, *_) = sorted(fits)
    scatter = np.array([float(w @ (logs - gain) ** 2), misses]) / freedom
    grown = np.sqrt(np.maximum(1.0, scatter))
    if abs(delay) > LONGEST or (sign < 0 and other < misses + (SURE * grown[1]) ** 2):
        return None
    return Difference(
        factor=sign * float(np.exp(gain)),
        factor_error=float(grown[0] / np.sqrt(w.sum())),
        delay=delay,
        delay_error=float(grown[1] / np.sqrt(w @ omega**2)),
    )
