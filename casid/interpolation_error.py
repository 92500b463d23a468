"""What inputs lose that are read at other instants than they were sampled at.

Between samples an input is a straight line or a step. On other instants a step inside an interval
begins with the next sample; of a filtered input, which is smooth, straight lines cut the corners;
samples that are left out take with them where a step was. All pass for a delay or a lag of the
aircraft, larger than estimates' errors tell.
"""

from collections.abc import Mapping
from typing import Literal, Protocol, TypeVar

import numpy as np

from casid.arrays import Array
from casid.errors import warn
from casid.regridding import smoothed
from casid.samples import SLOWER, at_instants

MOVED = 0.02  # of an input's deviation: what steps may lose
BENT = 0.015  # what straight lines may lose of a filtered input
LEFT_OUT = 0.03  # of an input's deviation: what samples left out may hold


class Flown(Protocol):
    """What a record is to this module."""

    @property
    def name(self) -> str:
        """Name of the manoeuvre."""

    @property
    def t(self) -> Array:
        """Instants (N,) [s]."""

    @property
    def u(self) -> Array:
        """Inputs (N, nu)."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Their names."""

    @property
    def hold(self) -> Literal["foh", "zoh"]:
        """What they are between samples."""


R = TypeVar("R", bound=Flown)


def with_steps_told(after: R, before: Flown, lag: Mapping[str, float]) -> R:
    """The record, with a warning of inputs of ``before`` whose steps fall on none of its instants.

    Inputs are ``lag`` [s] later by will.
    """
    if not before.hold == after.hold == "zoh":
        return after
    wrong = []
    for channel, x in zip(before.inputs, before.u.T, strict=True):
        new = after.u[:, after.inputs.index(channel)]
        read = at_instants(after.t, new, before.t + lag.get(channel, 0.0), "zoh")
        known = np.isfinite(read) & np.isfinite(x)
        if known.any() and np.std((read - x)[known]) > MOVED * np.std(x[known]):
            wrong.append(channel)
    if wrong:
        dt = float(np.median(np.diff(after.t)))
        warn(
            f"record {after.name!r}: {', '.join(wrong)} {'is' if len(wrong) == 1 else 'are'} "
            "held in steps that do not fall on the record's new instants and count only from the "
            f"next: delays are off by up to {dt:g} s, whatever their stated errors. Move the "
            "outputs the other way instead, or by whole samples; resample to an interval all "
            "steps fall on"
        )
    return after


def lost_between(after: Flown, before: Flown) -> dict[str, float]:
    """Share of its deviation that an input loses with samples left out of ``before``, if it does.

    Inputs of which what is left tells nearly all are not named.
    """
    lost = {}
    for channel, x, new in zip(before.inputs, before.u.T, after.u.T, strict=True):
        off = at_instants(after.t, new, before.t, after.hold) - x
        known = np.isfinite(off)
        if known.any() and (share := np.std(off[known]) / max(np.std(x[known]), 1e-300)) > LEFT_OUT:
            lost[channel] = float(share)
    return lost


def with_rest_told(after: R, before: Flown) -> R:
    """A record of some samples of ``before``, with a warning of inputs that moved between these."""
    if lost := lost_between(after, before):
        dt = float(np.median(np.diff(before.t)))
        warn(
            f"record {after.name!r}: between the samples that are kept {', '.join(lost)} "
            f"{'moves' if len(lost) == 1 else 'move'} otherwise, by up to "
            f"{max(lost.values()):.1%}, which is lost: a step may be off by {dt:g} s, and "
            "delays, lags and gains by several stated errors. Resample instead, which filters "
            "outputs alike, or keep all samples"
        )
    return after


def warn_of_corners(record: Flown, dt: float) -> None:
    """Warn of inputs that are no straight lines between samples every ``dt`` [s] once filtered."""
    t = record.t
    own = float(np.median(np.diff(t)))
    if dt < SLOWER * own:  # nothing is filtered
        return
    even, own = np.linspace(t[0], t[-1], round((t[-1] - t[0]) / own) + 1, retstep=True)
    grid = np.arange(t[0], t[-1], dt)
    lost = {}
    for channel, x in zip(record.inputs, record.u.T, strict=True):
        fast = at_instants(t, x, even, record.hold)
        if np.isnan(fast).any():  # beside gaps: judged where there are none
            continue
        (smooth,) = smoothed(fast[:, None], dt / own).T
        inside = even <= grid[-1]
        lines = np.interp(even, grid, at_instants(even, smooth, grid, "smooth"))
        lost[channel] = float(np.std((smooth - lines)[inside]) / max(np.std(smooth), 1e-300))
    wrong = [channel for channel, share in lost.items() if share > BENT]
    if wrong:
        are = "is no straight line" if len(wrong) == 1 else "are no straight lines"
        warn(
            f"record {record.name!r}: between samples every {dt:g} s {', '.join(wrong)} {are}, "
            f"and up to {max(lost.values()):.1%} is lost: gains, lags and delays may be off by "
            "as much, several stated errors. Resample to a shorter interval, or keep the samples"
        )
