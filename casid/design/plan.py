"""Inputs to fly next: what `design_inputs` is asked and what it answers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from casid.arrays import Array
from casid.checks import checked_fields
from casid.design.criterion import KEPT, Criterion
from casid.design.injection import ardupilot_script, px4_script
from casid.display import Shown, in_minutes, listed
from casid.record import Record
from casid.tabulation import csv_text, markdown_table
from casid.values import seal, storable

Method = Literal["best", "steps", "multisine"]
HIGHEST = {"draws": 1000, "spread": 1.0}  # draws are models with their responses in memory
CLOSE = 0.9  # correlation from which two parameters are named together


def check_deviations(*groups: Mapping[str, float]) -> None:
    """Refuse limits that leave nothing to fly: ValueError."""
    for name, value in (pair for group in groups for pair in group.items()):
        if not value > 0:
            raise ValueError(
                f"the limit of {name!r} is {value}, which leaves nothing to fly; expected "
                "a deviation from trim above 0"
            )


def check_times(**times: float | None) -> None:
    """Refuse what is no length of time: ValueError by its name."""
    for name, value in times.items():
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} = {value:g} s: expected a time above 0")


@storable
@checked_fields
@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the next flight may not exceed, as deviations from trim, SI; kept in linear models.

    Parameters
    ----------
    sticks : mapping
        Of every input of the model; one that is not named is refused.
    rates : mapping
        Of inputs, per second.
    responses : mapping
        Of outputs and of states, as an airspeed that is not measured.
    """

    sticks: Mapping[str, float]
    rates: Mapping[str, float] = field(default_factory=dict)
    responses: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_deviations(self.sticks, self.rates, self.responses)
        if unbounded := [name for name, value in self.sticks.items() if not value < np.inf]:
            raise ValueError(
                f"the limit of stick {unbounded[0]!r} is infinite; expected the deviation from "
                "trim that may be flown"
            )
        if not self.sticks:
            raise ValueError("no stick may move: limits need sticks={name: deviation}")
        if lone := [name for name in self.rates if name not in self.sticks]:
            raise ValueError(f"the rate of {lone[0]!r} has a limit, its deviation has none")


@checked_fields
@dataclass(frozen=True, kw_only=True)
class DesignSettings:
    """How inputs are designed.

    Parameters
    ----------
    method : {"best", "steps", "multisine"}
        What is optimised: multi-step sequences on all axes at once, orthogonal multisines, or both,
        of which the better is taken.
    criterion : {"A", "D", "E", "MV"}
        What is to be small of the standard errors over those of a single 3-2-1-1 an axis: the mean
        square, the geometric mean (of the determinant), the largest of any combination of
        parameters, the mean fourth power, which weighs the largest.
    matter : tuple of str
        Parameters that count, in what is told of the design, too; all free ones unless given.
    fixed : tuple of str or None
        Parameters that are known; those that a fit held fixed unless given.
    bounds : mapping
        Of parameters, as in `Estimator.fit`; a fit's own and the structure's unless given.
    dt : float or None
        Sampling interval of the records to come [s], to which the noise refers; 0.02 unless given.
    band : (float, float) or None
        Of multisines and sweeps [rad/s]; from two periods in the duration to three times the
        fastest mode unless given.
    step : float or None
        Time between the changes of a multi-step sequence, on average [s]. A quarter period of the
        band's upper edge unless given.
    unit : float or None
        Of the 3-2-1-1 to compare with [s]; of several the best unless given.
    rest : float
        Of trim before anything moves [s].
    iterations : int
        Of the optimisation.
    seed : int
        Of the sequence that it starts from.
    spread : float or None
        Relative error of the prior that limits are to be kept with, 1 at most; 0.2 unless given.
    draws : int
        Models drawn from the prior that the optimisation keeps within limits; twice as many, which
        it does not see, judge it.
    """

    method: Method = "best"
    criterion: Criterion = "A"
    matter: tuple[str, ...] = ()
    fixed: tuple[str, ...] | None = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    dt: float | None = None
    band: tuple[float, float] | None = None
    step: float | None = None
    unit: float | None = None
    rest: float = 2.0
    iterations: int = 150
    seed: int = 0
    spread: float | None = None
    draws: int = 48

    def __post_init__(self) -> None:
        for name in ("rest", "iterations", "spread", "draws"):
            value, most = getattr(self, name), HIGHEST.get(name, np.inf)
            if value is not None and not (0 <= value <= most and value < np.inf):
                end = f", {most:g} at most" * (most < np.inf)
                raise ValueError(f"{name} = {value:.7g}: expected a finite number, 0 or more{end}")
        check_times(dt=self.dt, step=self.step, unit=self.unit)
        if self.band is not None and not 0 < self.band[0] < self.band[1]:
            raise ValueError(
                f"band = {self.band}: expected (lowest, highest), 0 < lowest < highest"
            )

    @property
    def interval(self) -> float:
        """Between samples [s]: ``dt``, or what is usual."""
        return 0.02 if self.dt is None else self.dt


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class Alternative:
    """One way to use the flight time, as large as the limits let it be."""

    name: str  # "3-2-1-1", "sweeps", "multisine", "steps"
    r: Array  # (N, nu) designed deviations of the sticks
    std_errors: Array  # (nf,) predicted

    def __post_init__(self) -> None:
        seal(self)


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Design(Shown):
    """Inputs for the next flight and what they will buy.

    Parameters
    ----------
    kind : str
        Name of the alternative that was taken.
    inputs, outputs : tuple of str
        Channels.
    t, r : (N,), (N, nu) array
        The designed deviations of the sticks; what feedback does comes on top.
    u, y : (N, nu), (N, ny) array
        Sticks and outputs that the model predicts, without noise.
    names, values : tuple of str, (nf,) array
        Free parameters and what is believed of them.
    covariance : (nf, nf) array
        Predicted, with what was known before.
    before : (nf,) array
        Standard errors before the flight; infinite if nothing was known.
    alternatives : tuple of Alternative
        What else could be flown in that time, the first 3-2-1-1 on one axis after the other, as
        many as there is time for.
    used, used_at_worst : mapping
        Share of each limit that is used, by ``"lat"``, ``"lat rate"``, ``"phi"``: if the model is
        right, and by those of an ensemble or drawn from the prior, and held, that use most of it.
    instead : float
        Time [s] of 3-2-1-1, one after the other, after which standard errors would be as small in
        the geometric mean; infinite if never.
    plausible, unheld : int
        Models drawn from the prior, and those of them that the feedback does not hold, or that need
        one where none was given: they keep no limits.
    spread : float
        Standard deviation, relative, by which their values are scattered.
    untold : tuple of str
        Parameters that no input tells, or only together with others. Nothing of what is compared
        counts them.
    blind : tuple of str
        What the inputs cannot tell apart, in words.
    matter : tuple of str
        Parameters that count; all unless named. Nothing of what is compared counts others.
    """

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    t: Array
    r: Array
    u: Array
    y: Array
    names: tuple[str, ...]
    values: Array
    covariance: Array
    before: Array
    alternatives: tuple[Alternative, ...]
    used: Mapping[str, float]
    used_at_worst: Mapping[str, float]
    instead: float = np.nan
    plausible: int = 0
    unheld: int = 0
    spread: float = 0.0
    untold: tuple[str, ...] = ()
    blind: tuple[str, ...] = ()
    matter: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        seal(self)

    def headline(self) -> str:
        """What is flown, and how much better it is, if it is."""
        _, mean, worst, name = next(row for row in self.ratios() if row[0] == self.kind)
        of = f"of {listed(self.matter)} " * bool(self.matter)
        parts = [
            f"{self.kind} on {listed(self.inputs)}, {self.t[-1]:.4g} s: standard errors {of}"
            f"{mean:.2g} times those of 3-2-1-1 (geometric mean), {worst:.2g} at worst ({name})",
            self._gain(mean),
            f"without {listed(self.untold)}, which no input tells apart" * bool(self.untold),
            self.warning(),
        ]
        return "; ".join(filter(None, parts))

    def _gain(self, mean: float) -> str:
        """The flight time that is saved; what to do where there is no gain."""
        if mean >= 1:
            return "no better than the 3-2-1-1: fly that, or give more iterations or flight time"
        if self.instead == np.inf:
            return f"{in_minutes(self.t[-1])} of flight for what no time of 3-2-1-1 tells"
        if not self.instead > self.t[-1]:
            return ""
        return f"{in_minutes(self.t[-1])} of flight instead of {in_minutes(self.instead)}"

    def warning(self) -> str:
        """For how many plausible aircraft limits do not hold; nothing if for all."""
        if not self.unheld:
            return ""
        why = "not held by the feedback given"
        if np.allclose(self.r, self.u):
            why = "too unstable to be flown without feedback"
        return (
            f"{self.unheld} of {self.plausible} plausible aircraft are {why}: limits do not hold "
            "for them"
        )

    @property
    def std_errors(self) -> Array:
        """Predicted standard errors, (nf,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlations(self) -> Array:
        """Of the errors, (nf, nf)."""
        return np.asarray(self.covariance / np.outer(self.std_errors, self.std_errors))

    def correlated(self, least: float = CLOSE) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters whose errors are correlated by ``least`` or more, closest first."""
        C = self.correlations
        pairs = np.argwhere(np.triu(np.abs(C) >= least, 1))
        found = [(self.names[i], self.names[j], float(C[i, j])) for i, j in pairs]
        return tuple(sorted(found, key=lambda row: -abs(row[2])))

    def record(self) -> Record:
        """The flight as the model predicts it, without noise."""
        return Record(self.t, self.u, self.y, self.inputs, self.outputs, name=self.kind)

    def ratios(self) -> tuple[tuple[str, float, float, str], ...]:
        """Of each alternative: name, geometric mean and worst ratio to the 3-2-1-1, and whose.

        Parameters that count are compared, those that no input tells apart are not.
        """
        counts = np.isin(self.names, self.matter or self.names)
        rows, told = [], np.flatnonzero(counts & ~np.isin(self.names, self.untold))
        for each in self.alternatives:
            ratio = (each.std_errors / self.alternatives[0].std_errors)[told]
            worst = int(np.argmax(ratio))
            mean = float(np.exp(np.log(ratio).mean()))
            rows.append((each.name, mean, float(ratio[worst]), self.names[told[worst]]))
        return tuple(rows)

    @property
    def overlap(self) -> float:
        """Largest correlation between the designed deviations of two sticks; 0 of one stick."""
        size = np.maximum(np.linalg.norm(self.r, axis=0), 1e-300)
        return float(np.abs(np.triu(self.r.T @ self.r / np.outer(size, size), 1)).max())

    def comparison(self) -> str:
        """Candidates side by side, standard errors over those of the 3-2-1-1, in Markdown."""
        rows = [[name, f"{mean:.3f}", f"{most:.3f}", of] for name, mean, most, of in self.ratios()]
        return markdown_table(("input", "geometric mean", "worst", "of"), rows)

    def rows(self, digits: int = 3) -> list[list[str]]:
        """Of each parameter: name, value, standard error before, after 3-2-1-1, after this."""
        columns = (self.values, self.before, self.alternatives[0].std_errors, self.std_errors)
        rows = [[n, *(f"{c[k]:.{digits}g}" for c in columns)] for k, n in enumerate(self.names)]
        for row in rows:
            row[3:] = ["not told"] * 2 if row[0] in self.untold else row[3:]
        return rows

    def to_markdown(self) -> str:
        """One row a parameter, as `rows` gives them."""
        heading = ("parameter", "value", "std. error before", "with 3-2-1-1", "with this")
        return markdown_table(heading, self.rows())

    def shares(self) -> str:
        """Share of each limit that is used, if the model is right and at worst, in Markdown."""
        rows = [
            [name, f"{100 * self.used[name]:.0f} %", f"{100 * share:.0f} %"]
            for name, share in self.used_at_worst.items()
        ]
        table = markdown_table(("limit", "used", "at worst"), rows)
        told = (table, self.margin(), self.on_the_card(), self.warning())
        return "\n\n".join(filter(None, told))

    def margin(self) -> str:
        """Which aircraft limits are kept with; nothing if no other than the model was asked."""
        if not self.plausible:
            return ""
        beside = " beside the errors of the fit" if np.isfinite(self.before).any() else ""
        held = ""
        if self.unheld:
            kept = KEPT * (1 - self.unheld / self.plausible)
            held = f" and that are held, {kept:.0%} of all with such values"
        return (
            f"Limits are kept with nine in ten aircraft whose values are scattered by "
            f"{self.spread:.0%}{beside} about those believed{held}. One that is further off may "
            "exceed them: if you know yours less well, say so (spread, or an ensemble)."
        )

    def on_the_card(self) -> str:
        """How far the card itself goes, if feedback moves the sticks beside it; else nothing."""
        if np.allclose(self.r, self.u):
            return ""
        most = zip(self.inputs, np.abs(self.r).max(axis=0), np.abs(self.u).max(axis=0), strict=True)
        told = [f"{name} {card:.3g} instead of {stick:.3g}" for name, card, stick in most]
        return (
            "Limits are those of the sticks with feedback; the card, which feedback adds to, "
            f"deviates from trim by {listed(told)} at most."
        )

    def to_csv(self) -> str:
        """The card: time and designed stick deviations, one row a sample."""
        rows = (np.column_stack([self.t, self.r]).round(9) + 0.0).tolist()  # no -0
        return csv_text(["t", *self.inputs], rows)

    def to_ardupilot(self, channels: Mapping[str, tuple[int, float]]) -> str:
        """Lua script that adds the card to the pilot's sticks while a switch is held.

        Parameters
        ----------
        channels : mapping
            RC channel of each input and µs a unit of the input, ``{"lat": (1, 500.0)}``.

        Raises
        ------
        ValueError
            Inputs without a channel, samples that are no whole milliseconds apart, scales that move
            a stick beyond its end, 500 µs.
        """
        return ardupilot_script(self.t, self._columns(), channels, self.headline(), self.to_csv())

    def to_px4(self, axes: Mapping[str, tuple[str, float]]) -> str:
        """Python program that sends the card as a joystick does, by MAVLink's MANUAL_CONTROL.

        Parameters
        ----------
        axes : mapping
            Axis x, y, z or r of each input and its units a unit of the input,
            ``{"lat": ("y", 1000.0)}``.

        Raises
        ------
        ValueError
            Inputs without an axis, other axes, scales that move a stick beyond its end, 1000.
        """
        return px4_script(self._columns(), axes, self.headline(), self.to_csv())

    def _columns(self) -> dict[str, Array]:
        return dict(zip(self.inputs, self.r.T, strict=True))
