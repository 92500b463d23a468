"""Whether a record's own response is that of the others: a scale, a sign, a clock that is off.

A stick logged at half its size in one of several sweeps makes a pooled response that is neither's,
and errors that do not know of it. Where several records excite an input, the lines of each in a
band about some frequencies, transients T of degree one there, tell

    Y_r(ω) = Σ κ_rj G_j(ω) U_rj(ω) + T_r(ω) + V_r(ω)

how many times the response G of all of them its own is: few unknowns, since the shape is known.
One κ_r over the mean of the others' is

    log κ_r/κ = log c - jωτ + errors,

with one real factor c and one delay τ for every pair where something of the logging is wrong. What
differs from frequency to frequency, as of an aircraft that is nonlinear, counts as error of both.
Records of opposite signs cancel in G: signs are those of gains that are constant in a band.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.display import listed
from casid.frequency.transforms import Lines, lines_at
from casid.record import Record
from casid.records import still

APART = 1.35  # ratio of frequencies, at least
SHARE = 0.15  # half width of a band, of the frequency: bands of such frequencies are apart
EDGES = 2  # of a band's transients
SPARE = 6  # lines of a band beyond its unknowns, at least
APPROACH = 1e-6  # least eigenvalue of inputs' products, of unit size, that can be told apart
EXCITED = 0.03  # of an input's largest power in any record, in those that are compared
MAIN = 0.7  # of the share of the input that a record excites most
KNOWN = 0.5  # relative errors up to which a point is compared
FEWEST = 4  # frequencies of a pair
FLOOR = 0.02  # relative error of a point, at least: of manoeuvres that are not alike
LONGEST = 0.25  # delay [s]: beyond, phases are of something else
DIRECT = 0.5  # of the power of an output after the input that moves it most
SURE = 5.0  # standard errors, of which a few frequencies tell the size
GAIN, DELAY = 0.15, 0.015  # logarithm of a factor and delay [s] that are worth telling
MIRROR = 0.4  # logarithm of a factor, at most, of a channel whose sign alone is wrong
ONE = 0.5  # of the typical difference, by which those of an input's outputs differ at most

WHY = (
    "the response is a compromise. Look for a scale, a sign or a clock of that record's "
    "channels, another flight condition or mass, or an aircraft that is nonlinear where "
    "amplitudes differ (`distortion`); leave the record out and compare"
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


class _Own(NamedTuple):
    """Gains over some shape of a record's own response, K' bands; NaN where unknown."""

    gain: ComplexArray  # (K', ny, nu)
    error: Array  # (K', ny, nu) relative
    power: Array  # (K', nu) of inputs in bands


def differing(records: Sequence[Record], omega: Array, G: ComplexArray) -> str:
    """What says that a record's response is not that of the others; "" without such.

    Records are equidistant; ``G`` (K, ny, nu) is their response at ``omega`` (K,) [rad/s].
    """
    if len(records) < 2:
        return ""
    chosen = [omega[0]]
    for each in omega:
        if each > APART * chosen[-1]:
            chosen.append(each)
    bands = np.array(chosen)
    inputs, power = records[0].inputs, np.array([np.var(record.u, axis=0) for record in records])
    # Of its axis: other inputs follow it, or answer noise, and tell little by themselves.
    share = power / np.maximum(power.max(axis=0), np.finfo(float).tiny)
    excite = [
        [r for r, own in enumerate(share) if own[j] > max(EXCITED, MAIN * own.max())]
        for j in range(len(inputs))
    ]
    if max(map(len, excite)) < 2:
        return ""
    flat = np.ones((1, *G.shape[1:]), dtype=complex)
    own = [_own(record, bands, omega, (G, flat)) for record in records]
    moved = _moved(own, excite)
    direct = moved > DIRECT * moved.max(axis=1, keepdims=True)
    told: list[str] = []
    for j, name in enumerate(inputs):
        found = [
            (r, pairs)
            for r in excite[j]
            if (pairs := _pairs(bands, own, r, [s for s in excite[j] if s != r], j))
            # Couplings alone are more of what they meet than of a channel.
            and direct[list(pairs), j].any()
        ]
        if found:
            r, pairs = max(found, key=lambda each: max(one.size for one in each[1].values()))
            others = listed([repr(records[s].name) for s in excite[j] if s != r], 3)
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


def _moved(own: Sequence[tuple[_Own, ...]], excite: Sequence[Sequence[int]]) -> Array:
    """Power of every output after every input, (ny, nu), mean of the records that excite it."""
    power = [np.nansum(np.abs(one.gain) ** 2 * one.power[:, None], axis=0) for _, one in own]
    columns = [
        np.mean([power[r][:, j] for r in rows], axis=0) if rows else np.zeros(len(power[0]))
        for j, rows in enumerate(excite)
    ]
    return np.column_stack(columns)


def _own(
    record: Record, bands: Array, omega: Array, shapes: Sequence[ComplexArray]
) -> tuple[_Own, ...]:
    """A record's own gains over each of the shapes (K or 1, ny, nu) at ``omega`` (K,)."""
    shape = (len(bands), record.ny, record.nu)
    found = tuple(
        _Own(np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan), np.zeros(shape[::2]))
        for _ in shapes
    )
    dead = {*still([record], (*record.inputs, *record.outputs))}
    dead |= {name for name, y in zip(record.outputs, record.y.T, strict=True) if np.isnan(y).all()}
    columns = [k for k, name in enumerate(record.inputs) if name not in dead]
    rows = [k for k, name in enumerate(record.outputs) if name not in dead]
    if not rows or not columns:
        return found
    part = record.select([record.inputs[k] for k in columns], [record.outputs[k] for k in rows])
    apart = np.gradient(bands) if len(bands) > 1 else np.full(1, np.inf)
    for k, stretches in enumerate(lines_at([part], bands, 0)):
        if not stretches:
            continue
        lines = max(stretches, key=lambda each: len(each.omega))
        spacing = lines.omega[0]
        half = max(SHARE * bands[k], (len(columns) + EDGES + SPARE) / 2 * spacing)
        low = max(bands[k] - half, spacing / 2)
        at = (lines.omega > low) & (lines.omega < low + 2 * half)
        if at.sum() < len(columns) + EDGES + SPARE / 2 or bands[k] < 2 * spacing:  # two periods
            continue
        band = Lines(lines.omega[at], lines.U[at], lines.Y[at])
        # Wider ones overlap: the same lines tell of several frequencies.
        overlap = max(1.0, 2 * half / apart[k])
        where = np.ix_(rows, columns)
        G = [_between(omega, each, band.omega)[:, rows][:, :, columns] for each in shapes]
        gain, error = _gains(band, np.stack(G))
        for one, *values in zip(found, gain, error * np.sqrt(overlap), strict=True):
            one.gain[k][where], one.error[k][where] = values
            one.power[k, columns] = np.mean(np.abs(band.U) ** 2, axis=0)
    return found


def _between(omega: Array, G: ComplexArray, at: Array) -> ComplexArray:
    """A response between its frequencies; NaN beside such."""
    if len(G) == 1:
        return np.broadcast_to(G, (len(at), *G.shape[1:]))
    k = np.clip(np.searchsorted(omega, at) - 1, 0, len(omega) - 2)
    share = np.clip((at - omega[k]) / (omega[k + 1] - omega[k]), 0.0, 1.0)[:, None, None]
    return np.asarray((1 - share) * G[k] + share * G[k + 1])


def _gains(band: Lines, G: ComplexArray) -> tuple[ComplexArray, Array]:
    """Gains over shapes (s, m, ny, nu) on a band's lines, and relative errors, (s, ny, nu)."""
    known = np.asarray(np.isfinite(G).all(axis=(1, 3)))
    edges = np.linalg.qr(np.vander(band.omega - band.omega.mean(), EDGES))[0]
    M = np.moveaxis(np.where(known[:, None, :, None], G, 0.0), 1, 2) * band.U
    M = M - edges @ (edges.T @ M)  # (s, ny, m, nu)
    Y = (band.Y - edges @ (edges.T @ band.Y)).T[:, :, None]
    size = np.linalg.norm(M, axis=2)
    M /= np.where(size > 0, size, 1.0)[:, :, None]
    adjoint = M.conj().swapaxes(2, 3)
    N = adjoint @ M
    told = known & (np.linalg.eigvalsh(N)[..., 0] > APPROACH)
    inverse = np.linalg.inv(np.where(told[..., None, None], N, np.eye(N.shape[-1])))
    theta = inverse @ (adjoint @ Y)
    freedom = len(edges) - EDGES - M.shape[3]
    left = np.sum(np.abs(Y - M @ theta) ** 2, axis=(2, 3)) / (freedom - 1)  # Student's, of few
    spread = np.sqrt(left[..., None] * np.einsum("sijj->sij", inverse).real / 2)
    gain = theta[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(told[..., None], spread / np.abs(gain), np.nan)
        return np.where(told[..., None], gain / size, np.nan), error


def _pairs(
    bands: Array, own: Sequence[tuple[_Own, ...]], r: int, others: Sequence[int], j: int
) -> dict[int, Difference]:
    """Outputs whose response to an input surely differs from the others, and how."""
    if not others:
        return {}
    alike, flat = (_differences(bands, each, r, others, j) for each in zip(*own, strict=True))
    surely = {i: one for i, one in alike.items() if one.gained or one.late}
    return surely | {i: one for i, one in flat.items() if one.factor < 0}


def _differences(
    bands: Array, own: Sequence[_Own], r: int, others: Sequence[int], j: int
) -> dict[int, Difference]:
    """Of all outputs that are known well enough."""
    found: dict[int, Difference] = {}
    gain, error = (np.array([each[k][:, :, j] for each in own]) for k in range(2))
    power = np.array([each.power[:, j] for each in own])
    usable = np.isfinite(gain) & (np.abs(gain) > 0) & (error < KNOWN)
    usable &= (power > EXCITED * power[[r, *others]].max(axis=0))[:, :, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(usable, 1 / np.maximum(error, FLOOR) ** 2, 0.0)[list(others)]
        size = np.where(weight > 0, np.abs(gain[list(others)]), 1.0)
        total = weight.sum(axis=0)
        # Of unequal responses the mean of logarithms, phases by the mean direction.
        turn = np.where(weight > 0, gain[list(others)] / size, 0.0)
        phase = np.angle((weight * turn).sum(axis=0))
        mean = np.exp((weight * np.log(size)).sum(axis=0) / total + 1j * phase)
        variance = np.maximum(error[r], FLOOR) ** 2 + 1 / total
    for i in range(gain.shape[2]):
        at = usable[r, :, i] & (total[:, i] > 0)
        if at.sum() < FEWEST:
            continue
        one = _difference(bands[at], gain[r, at, i] / mean[at, i], variance[at, i])
        if one is not None:
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
    scatter = np.array([float(w @ (logs - gain) ** 2), misses]) / (freedom - 2)  # Student's
    grown = np.sqrt(np.maximum(1.0, scatter))
    mirrored = abs(gain) < MIRROR and other > misses + (SURE * grown[1]) ** 2
    if abs(delay) > LONGEST or (sign < 0 and not mirrored):
        return None
    return Difference(
        factor=sign * float(np.exp(gain)),
        factor_error=float(grown[0] / np.sqrt(w.sum())),
        delay=delay,
        delay_error=float(grown[1] / np.sqrt(w @ omega**2)),
    )
