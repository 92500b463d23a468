"""One rate or specific force next to what the other channels imply, judged and put into words."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.channels import FORCES, RATES
from casid.consistency.clock_skews import KNOWN, Apart
from casid.consistency.flightpath import LATE
from casid.consistency.instruments import OWN, Instruments
from casid.consistency.remarks import ROUGH, in_some, mistake
from casid.consistency.rigid import spoiled
from casid.consistency.signs import Signs, reversed_channels
from casid.consistency.voting import SIGNIFICANT, significant

SCALE, BIAS = 0.02, 0.1  # what matters: relative, of the channel's deviation

UNITS = dict.fromkeys(RATES, "rad/s") | dict.fromkeys(FORCES, "m/s^2")


@dataclass(frozen=True, kw_only=True)
class ChannelCheck:
    """What one rate or specific force is, next to what the other channels imply.

    Parameters
    ----------
    channel, unit : str
        Its name, and the unit of the bias.
    against : tuple of str
        Attitudes or velocities it was compared with.
    scale, skew, bias : float
        measured(t) = (1 + scale) true(t − skew [s]) + bias, its mean over records; NaN where the
        records do not tell.
    scale_error, skew_error, bias_error : float
        Their standard errors.
    biases : tuple of (str, float, float)
        Of each record: its name, the bias and its standard error.
    remarks : tuple of str
        What is wrong with it; empty if nothing is.
    """

    channel: str
    unit: str
    against: tuple[str, ...]
    scale: float
    scale_error: float
    skew: float
    skew_error: float
    bias: float
    bias_error: float
    biases: tuple[tuple[str, float, float], ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def determined(self) -> bool:
        """Whether the records tell anything about it."""
        return bool(np.isfinite(self.scale))


def judged(
    solution: Instruments,
    name: str,
    spread: float,
    rough: set[str],
    odd: Collection[str],
    labels: Collection[str],
    apart: Apart,
    signs: Signs,
) -> ChannelCheck:
    """What one channel is, of instruments found, and what is wrong with it.

    It moves by ``spread``; equations that are ``rough`` say less, and those that need something
    ``odd``, which does not follow, tell no skew and no scale but of known mistakes; ``labels`` are
    the records'.
    """
    i = solution.channels.index(name)
    gain, skew = map(float, solution.unknowns[i])
    errors = [float(error) for error in solution.errors[i]]
    against = solution.against[name]
    if OWN[name] in against:  # it stands in others too, but this one says most
        against = (OWN[name],)
    seen = 0 < errors[0] < KNOWN * abs(gain)
    limit = solution.limits.get(name)
    seen &= limit is None
    ended = seen and abs(skew) >= LATE
    if ended or not seen:
        gain, skew, *errors = [np.nan] * 4
    own, off = solution.biases[:, i] / gain, solution.bias_errors[:, i] / abs(gain)
    check = ChannelCheck(
        channel=name,
        unit=UNITS[name],
        against=against,
        scale=1 / gain - 1,
        scale_error=errors[0] / gain**2,
        skew=skew,
        skew_error=errors[1],
        bias=float(own.mean()),
        bias_error=float(np.hypot(np.sqrt(np.mean(off**2)), own.std() / np.sqrt(len(own)))),
        biases=tuple(zip(labels, map(float, own), map(float, off), strict=True)),
    )
    if limit:
        return replace(check, remarks=(limit.told(name, UNITS[name], OWN[name]),))
    holds = not any(spoiled(equation, odd) for equation in against)
    tolerance = ROUGH if rough & set(against) or not holds else SCALE
    if ended:
        said = (
            f"{name} is {LATE:g} s late or early against {against[0]}, the limit of the search, "
            "and perhaps more: "
        )
        return replace(check, remarks=(f"{said}look at the clocks of both",))
    if not seen:
        turned = name in reversed_channels(solution)
        said = f"{name} has the opposite sign of what {_implied(against)}; no scale is given"
        return replace(check, remarks=(said,) if turned else ())
    return replace(check, remarks=_remarks(check, tolerance, spread, apart, signs, holds=holds))


def _implied(against: Sequence[str]) -> str:
    return f"{' and '.join(against)} {'imply' if len(against) > 1 else 'implies'}"


def _remarks(
    check: ChannelCheck,
    tolerance: float,
    spread: float,
    apart: Apart,
    signs: Signs,
    *,
    holds: bool,
) -> tuple[str, ...]:
    said = []
    others = " and ".join(check.against)
    factor = 1 + check.scale
    known = signs.of(check.channel) or mistake(factor, check.channel)
    large = abs(check.scale) > max(tolerance, SIGNIFICANT * check.scale_error)
    if large and (holds or known):
        said.append(
            f"{check.channel} is {factor:.4g} ± {check.scale_error:.2g} times what "
            f"{_implied(check.against)}: {known or 'look at the scale factors of both'}"
        )
    late, error = apart.left[check.channel]
    if holds and significant(late, error):
        moved = ", once these have moved" if {*check.against} & {*apart.names} else ""
        said.append(
            f"{check.channel} is {abs(late):.3g} ± {error:.1g} s {'late' if late > 0 else 'early'} "
            f"against {others}{moved}: look at filters and the time stamps of both"
        )
    least = BIAS * spread
    biased = [each for each in check.biases if abs(each[1]) > max(least, SIGNIFICANT * each[2])]
    if biased:
        _, bias, error = max(biased, key=lambda each: abs(each[1]))
        upto = "up to " if np.ptp([each[1] for each in check.biases]) > least else ""
        said.append(
            f"{check.channel} has a bias of {upto}{bias:.3g} ± {error:.1g} {check.unit} against "
            f"{others}{in_some([name for name, *_ in biased], check.biases)}"
        )
    return tuple(said)
