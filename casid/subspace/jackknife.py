"""Whether a record is what the model of all the others predicts, or a channel of it a multiple.

A channel of another sign or unit spoils the model of all records and may make another record look
wrong. So a record that this model does not explain, and the one that moves its channel most, are
left out one after the other, and compared with what the rest predicts: the jackknife.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.linear import StateSpace
from casid.subspace import modal as modes
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.fourier import Spectrum
from casid.subspace.likelihood import Factors, all_factors, forced, without_transients
from casid.subspace.refinement import refined_system
from casid.subspace.weighing import smoothed

UNEXPLAINED = 0.3  # of a channel's power in a record, above which that is left out
MOVED = 0.3  # of the most that a channel moves in any record, above which it is looked at
FOLLOWS = 0.8  # of a channel's power that the others' model explains, but for a gain
REST = 0.5  # of the power of its other channels, less than that must be left: else it is the air
APART = 2.0  # at least, or at most its inverse: such a gain
CLEAR = 2.5  # errors by which it differs from one, and from none
ROUGHLY = 0.7  # of these thresholds, for what a model that is not refined says
BETTER = 0.3  # nepers of power, over all outputs, that a clearly better model leaves less
BAND = 0.3  # in natural logarithms of ω


@dataclass(frozen=True, kw_only=True)
class Gain:
    """A channel of a record as a multiple of what the model of the others says it is."""

    record: int
    channel: str
    gain: float
    error: float
    evidence: float  # power that it explains, in units of what the others' model leaves of them


@dataclass(frozen=True, eq=False, kw_only=True)
class Jackknife:
    """Models of a campaign without one of its records, refined up to ``top`` [rad/s].

    Where a subspace estimate of the rest fails they begin at ``system``, that of all records.
    """

    system: StateSpace
    campaign: Campaign
    pole: float
    top: float
    windows: Windows
    _models: dict[int, modes.Modal | None] = field(default_factory=dict, repr=False)

    @cached_property
    def data(self) -> list[tuple[Spectrum, ...]]:
        """Transforms of every record."""
        each = [slice(i, i + 1) for i in range(len(self.campaign.records))]
        return [self.campaign.spectra(self.pole, self.top, one) for one in each]

    def rest(self, *without: int) -> list[Spectrum]:
        """Transforms of all records but some."""
        return [s for i, lines in enumerate(self.data) if i not in without for s in lines]

    def start(self, k: int) -> StateSpace:
        """What the model without a record is refined from."""
        try:
            return self.campaign.subspace(self.system.nx, self.windows, [k]).system
        except (ValueError, np.linalg.LinAlgError):
            return self.system

    def model(self, k: int) -> modes.Modal | None:
        """The model without a record; None where too little is left for one."""
        if k not in self._models:
            scales = self.campaign.su, self.campaign.sy, self.campaign.mask
            try:
                found = refined_system(self.start(k), self.rest(k), *scales, self.pole, rough=True)
                self._models[k] = modes.to_modal(found, *scales)
            except (ValueError, np.linalg.LinAlgError):
                self._models[k] = None
        return self._models[k]

    def other_gain(self) -> Gain | None:
        """The channel of another sign or unit that explains most; None where all agree."""
        likely = [k for k in _suspects(self) if self._may_differ(k)]
        found = [gain for k in likely for gain in _gains(self, k, self.model(k))]
        return max(found, key=lambda each: each.evidence, default=None)

    def _may_differ(self, k: int) -> bool:
        """Whether the model without a record says so roughly before it is refined, which costs."""
        scales = self.campaign.su, self.campaign.sy, self.campaign.mask
        try:
            start = modes.to_modal(self.start(k), *scales)
        except ValueError:
            return True
        return any(_gains(self, k, start, ROUGHLY))

    def rival(self, k: int, channel: str) -> int | None:
        """The other record that moves the same input most, if it may as well be the wrong one.

        It may unless the model without record k explains the rest clearly better.
        """
        records = self.campaign.records
        std = np.array([record.u.std(axis=0) for record in records])
        relative = std / np.maximum(np.delete(std, k, axis=0).max(axis=0), 1e-100)
        names = records[k].inputs
        j = names.index(channel) if channel in names else int(np.argmax(relative[k]))
        flown = relative[:, j] ** 2 / np.linalg.norm(relative, axis=1)  # most, and not by feedback
        r = int(np.argmax(np.where(np.arange(len(records)) == k, -1.0, flown)))
        common, models = self.rest(k, r), [self._settled(i) for i in (r, k)]
        if not common or not all(models):
            return r
        omega = np.log(np.concatenate([s.omega for s in common]))
        left = [np.abs(np.vstack(without_transients(m, common))) ** 2 for m in models if m]
        spectra = [np.log(smoothed(omega, omega, power)) for power in left]
        return None if np.mean(spectra[0] - spectra[1], axis=0).sum() > BETTER else r

    def _settled(self, k: int) -> modes.Modal | None:
        """The model without a record after one more round, which two of them are compared by."""
        rough, scales = self.model(k), (self.campaign.su, self.campaign.sy, self.campaign.mask)
        if rough is None:
            return None
        start = modes.from_modal(rough, *scales[:2], self.system)
        found = refined_system(start, self.rest(k), *scales, self.pole, rough=True)
        return modes.to_modal(found, *scales)


def _suspects(jackknife: Jackknife) -> list[int]:
    """Records of which the model of all leaves much, and those that move the same channel most."""
    data, campaign = jackknife.data, jackknife.campaign
    modal = modes.to_modal(jackknife.system, campaign.su, campaign.sy, campaign.mask)
    size, left = (np.zeros((len(data), len(campaign.sy))) for _ in range(2))
    for i, lines in enumerate(data):
        if lines:
            Y, P = _measured(modal, lines), _predicted(modal, lines).sum(axis=2)
            power, off = (np.mean(np.abs(each) ** 2, axis=0) for each in (Y, Y - P))
            size[i] = np.maximum(power, np.mean(np.abs(P) ** 2, axis=0))
            left[i] = off > UNEXPLAINED * power
    wrong = (left > 0) & (size > MOVED**2 * size.max(axis=0))
    found: dict[int, None] = {}
    for k, o in np.argwhere(wrong):
        most = int(np.argmax(np.where(np.arange(len(data)) == k, 0.0, size[:, o])))
        found |= {int(k): None, most: None}
    return list(found)


def _gains(
    jackknife: Jackknife, k: int, modal: modes.Modal | None, part: float = 1.0
) -> Iterator[Gain]:
    """The gains of a record's channels that are clearly others, seen from the rest's model.

    Thresholds are taken down to a ``part``.
    """
    own, rest = jackknife.data[k], jackknife.rest(k)
    if modal is None or not own or not rest:
        return
    record = jackknife.campaign.records[k]
    omega, others = (np.log(np.concatenate([s.omega for s in part])) for part in (own, rest))
    left = np.abs(np.vstack(without_transients(modal, rest))) ** 2
    w = 1 / np.sqrt(smoothed(omega, others, left))
    Y, P = w * _measured(modal, own), w[:, :, None] * _predicted(modal, own)
    band = np.floor((omega - omega.min()) / BAND)
    E = Y - P.sum(axis=2)
    for o, name in enumerate(record.outputs):
        alone = np.arange(len(record.outputs)) == o
        a, error, evidence = _regressed(alone * Y, alone * P.sum(axis=2), band, part)
        off, power = (np.sum(np.abs(each[:, ~alone]) ** 2) for each in (E, Y))
        if evidence and off < REST / part * power:
            yield Gain(record=k, channel=name, gain=a, error=error, evidence=evidence)
    for j, name in enumerate(record.inputs):
        a, error, evidence = _regressed(E + P[:, :, j], P[:, :, j], band, part)
        if evidence:  # what it does is a times as large as it is: it is too small by that
            off = error / a**2
            yield Gain(record=k, channel=name, gain=1 / a, error=off, evidence=evidence)


def _regressed(
    y: ComplexArray, x: ComplexArray, band: Array, part: float = 1.0
) -> tuple[float, float, float]:
    """Gain of y on x, its error from bands left out, and the power it explains, 0 if not clear."""
    which = band == np.unique(band)[:, None]
    xx, xy = which @ np.sum(np.abs(x) ** 2, axis=1), which @ np.sum((x.conj() * y).real, axis=1)
    size = max(float(xx.sum()), 1e-100)
    a = float(xy.sum()) / size
    leverage = np.minimum(xx / size, 0.99)
    error = float(np.linalg.norm((xy - a * xx) / (1 - leverage))) / size
    follows = a**2 * size > part * FOLLOWS * float(np.sum(np.abs(y) ** 2))
    clear = abs(a) > part * CLEAR * error and not APART**-part < a < APART**part
    return a, error, a**2 * size if follows and clear else 0.0


def _measured(modal: modes.Modal, lines: Sequence[Spectrum]) -> ComplexArray:
    """Outputs (K, ny) of a record but for transients."""
    pairs = zip(lines, all_factors(modal, lines), strict=True)
    return np.vstack([_off_transients(f, s.Y) for s, f in pairs])


def _predicted(modal: modes.Modal, lines: Sequence[Spectrum]) -> ComplexArray:
    """What every input makes of the outputs (K, ny, nu), but for what transients explain of it."""
    found = []
    for s, f in zip(lines, all_factors(modal, lines), strict=True):
        alone = (replace(s, U=unit * s.U) for unit in np.eye(modal.D.shape[1]))
        made = [_off_transients(f, s.Y - forced(modal, each, f)) for each in alone]
        found.append(np.stack(made, axis=2))
    return np.vstack(found)


def _off_transients(f: Factors, X: ComplexArray) -> ComplexArray:
    """Part of signals (K, n) that no transient of any initial state makes, each for itself."""
    (Q, _), both = f.orthogonal, modes.stacked(X)
    real, imag = np.split(both - Q @ (Q.T @ both), 2)
    return np.asarray(real + 1j * imag)
