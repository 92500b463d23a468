"""Inputs to fly next: what `design_inputs` answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import Array
from casid.checks import check_known
from casid.design.criterion import KEPT
from casid.design.injection import ardupilot_script, px4_script
from casid.display import Shown, in_minutes, listed
from casid.record import Record
from casid.tabulation import csv_text, markdown_table
from casid.values import seal, storable

CLOSE = 0.9  # correlation from which two parameters are named together


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
        right, and by those of an ensemble or drawn from the prior, and held, that use most of it;
        without noise.
    used_by_noise, used_with_noise : mapping
        Share of the limits of sticks and their rates that nine in ten flights stay below if the
        model is right: of what feedback makes of the noise alone, and of that and the card
        together. Empty if feedback hears no noise.
    instead : float
        Time [s] of 3-2-1-1, one after the other, after which standard errors would be as small in
        the geometric mean; infinite if never.
    plausible, unheld, untrimmed : int
        Models drawn from the prior, and those of them that the feedback does not hold, or that need
        one where none was given: they keep no limits. Of a nonlinear structure they are those that
        it is flown with, and those without a trim near that of the design.
    spread : float
        Standard deviation of the logarithms of their values.
    untold : tuple of str
        Parameters that no input tells, or only together with others. Nothing of what is compared
        counts them.
    blind : tuple of str
        What the inputs cannot tell apart, in words.
    matter : tuple of str
        Parameters that count; all unless named. Nothing of what is compared counts others.
    limits : mapping
        That were asked for, deviations from trim, by the names of ``used``.
    trim : mapping
        Total values of states, inputs and outputs of a nonlinear structure in its trim.
    linearised : bool
        Of a nonlinear structure at a trim with unknowns limits and errors are those of its
        linearisation there.
    unfelt : tuple of str
        Parameters of which the linearisation at the trim, by which errors are stated where the trim
        has unknowns, feels nothing.
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
    used_by_noise: Mapping[str, float] = field(default_factory=dict)
    used_with_noise: Mapping[str, float] = field(default_factory=dict)
    instead: float = np.nan
    plausible: int = 0
    unheld: int = 0
    untrimmed: int = 0
    spread: float = 0.0
    untold: tuple[str, ...] = ()
    blind: tuple[str, ...] = ()
    matter: tuple[str, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    trim: Mapping[str, float] = field(default_factory=dict)
    linearised: bool = False
    unfelt: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        seal(self)

    def headline(self) -> str:
        """What is flown, and how much better it is, if it is."""
        mean, worst, name = self._ratio()
        of = f"of {listed(self.matter)} " * bool(self.matter)
        before = ", each with what is known before" * bool(np.isfinite(self.before).any())
        parts = [
            f"{self.kind} on {listed(self.inputs)}, {self.t[-1]:.4g} s: standard errors "
            f"{of}{mean:.3g} times those of 3-2-1-1 (geometric mean), {worst:.3g} at worst "
            f"({name}){before}",
            self._gain(),
            f"without {listed(self.untold)}, which no input identifies" * bool(self.untold),
            self.warning(),
        ]
        return "; ".join(filter(None, parts))

    def _ratio(self) -> tuple[float, float, str]:
        return next(row[1:] for row in self.ratios() if row[0] == self.kind)

    @property
    def gains(self) -> bool:
        """Whether it tells more than the 3-2-1-1, in the geometric mean."""
        return self._ratio()[0] < 1

    def _gain(self) -> str:
        """The flight time that is saved; what to do where there is no gain."""
        if not self.gains:
            return (
                'no better than the 3-2-1-1: fly that, to_csv("3-2-1-1"), or allow more iterations '
                "or flight time"
            )
        if self.instead == np.inf:
            return f"{in_minutes(self.t[-1])} of flight for what no time of 3-2-1-1 identifies"
        if not self.instead > self.t[-1]:
            return ""
        own, other = in_minutes(float(self.t[-1])), in_minutes(self.instead)
        return f"{own} of flight instead of {other}" if own != other else ""

    def warning(self) -> str:
        """For how many plausible aircraft limits do not hold, and in what motions errors do not."""
        said = []
        if self.unheld:
            why = "not held by the feedback given"
            if np.allclose(self.r, self.u):
                why = "too unstable to be flown without feedback"
            said.append(
                f"{self.unheld} of {self.plausible} plausible aircraft are {why}: limits do not "
                "hold for them"
            )
        if self.untrimmed:
            said.append(
                f"{self.untrimmed} of {self.plausible} plausible aircraft have no trim near that "
                "of the design: they were not flown"
            )
        if self.unfelt:
            said.append(
                "standard errors are those of small motions, where the linearisation at the trim "
                f"does not depend on {listed(self.unfelt)}; in large motions the errors of the "
                "others may be larger; with a trim without unknowns they would be those of the "
                "nonlinear flight"
            )
        return "; ".join(said)

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
        names = (self.inputs, self.outputs)
        return Record(self.t, self.u, self.y, *names, name=self.kind, trim=self.trim)

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
        """Share of each limit that is used, if the model is right and at worst, in Markdown.

        Where feedback hears noise, also of noise alone and with it, if the model is right.
        """
        columns = {"used": self.used, "at worst": self.used_at_worst}
        if self.used_by_noise:
            columns |= {"noise alone": self.used_by_noise, "with noise": self.used_with_noise}
        rows = [
            [name, *(f"{100 * c[name]:.0f} %" if name in c else "" for c in columns.values())]
            for name in self.used_at_worst
        ]
        table = markdown_table(("limit", *columns), rows)
        told = (table, self.margin(), self.noise(), self.on_the_card(), self.warning())
        return "\n\n".join(filter(None, told))

    def noise(self) -> str:
        """What sensor noise does to the sticks through the feedback; "" if nothing."""
        if not self.used_by_noise:
            return ""
        said = (
            "Used and at worst do not include noise. Feedback also passes sensor noise, white "
            "from sample to sample, on to the sticks, beside the card: if the model is right, "
            "nine flights in ten stay below the last two columns."
        )
        return " ".join((said, *self.exceeded()))

    def exceeded(self) -> tuple[str, ...]:
        """Limits that noise takes sticks beyond, alone or with the card, and what to do."""
        shares = self.used_with_noise.items()  # to the percent, as they are told
        over = {name: share for name, share in shares if round(share, 2) > 1.0}
        alone = [name for name in over if self.used_by_noise[name] > 1.0]
        lines = []
        for names, remedy in (
            (alone, "No card avoids that: filter the feedback signals"),
            (
                [n for n in over if n not in alone],
                "Filter the feedback signals, fly a smaller card",
            ),
        ):
            told = [f"{n} {over[n]:.0%} (alone {self.used_by_noise[n]:.0%})" for n in names]
            if told:
                lines.append(
                    "Sensor noise, passed on by the feedback, drives sticks beyond their limits; "
                    f"nine flights in ten stay below: {listed(told)}. {remedy}, or let the limit "
                    "apply to the card alone."
                )
        return tuple(lines)

    def margin(self) -> str:
        """For which aircraft limits are kept; "" if only the model was considered."""
        if not self.plausible:
            return ""
        beside = " beside the errors of the fit" if np.isfinite(self.before).any() else ""
        kept_so = "Without noise limits are kept" if self.used_by_noise else "Limits are kept"
        held, lost = "", self.unheld + self.untrimmed
        if lost:
            kept, trim = (
                KEPT * (1 - lost / self.plausible),
                "have a trim and " * bool(self.untrimmed),
            )
            held = f" and that {trim}stay under control, {kept:.0%} of all with such values"
        kept_so += ", in small motions about the trim," * self.linearised
        flown = " They are flown in the nonlinear structure, each from a trim of its own."
        return (
            f"{kept_so} by nine in ten aircraft whose values are scattered, lognormally, by "
            f"{self.spread:.0%}{beside} about the values given{held}.{flown * bool(self.trim)} "
            "One that is further off may exceed them: if you know your aircraft less well, say so "
            "(spread, or an ensemble)."
        )

    def on_the_card(self) -> str:
        """How far the card itself goes, if feedback moves the sticks beside it; else nothing."""
        peaks = ([f"{most:.3g}" for most in np.abs(x).max(axis=0)] for x in (self.r, self.u))
        told = [
            f"{name} {card} instead of {stick}"
            for name, card, stick in zip(self.inputs, *peaks, strict=True)
            if card != stick
        ]
        return bool(told) * (
            "Limits apply to the sticks, feedback included; the card, to which feedback adds, "
            f"deviates from trim by at most {listed(told)}."
        )

    def to_csv(self, kind: str | None = None) -> str:
        """The card: time and designed stick deviations, one row a sample.

        Of an alternative by its name, as the ``"3-2-1-1"``; ValueError if there is none.
        """
        cards = {each.name: each.r for each in self.alternatives}
        if kind is not None:
            check_known("the alternatives have no", [kind], cards)
        r = self.r if kind is None else cards[kind]
        rows = (np.column_stack([self.t, r]).round(9) + 0.0).tolist()  # no -0
        return csv_text(["t", *self.inputs], rows)

    def to_ardupilot(
        self, channels: Mapping[str, tuple[int, float]], *, doubts: Sequence[str] = ()
    ) -> str:
        """Lua script that adds the card to the pilot's sticks while a switch is held.

        Parameters
        ----------
        channels : mapping
            RC channel of each input and µs a unit of the card, ``{"lat": (1, 500.0)}``.
        doubts : sequence of str
            What speaks against the card, told in the script's head.

        Raises
        ------
        ValueError
            Inputs without a channel, channels that there are not, samples that are no whole
            milliseconds apart, scales that move a stick beyond its end, 500 µs.
        """
        told = (self.headline(), self.to_csv(), doubts)
        return ardupilot_script(self.t, self._columns(), channels, *told)

    def to_px4(self, axes: Mapping[str, tuple[str, float]], *, doubts: Sequence[str] = ()) -> str:
        """Python program that sends the card as a joystick does, by MAVLink's MANUAL_CONTROL.

        Parameters
        ----------
        axes : mapping
            Axis x, y, z or r of each input and its units a unit of the card,
            ``{"lat": ("y", 1000.0)}``.
        doubts : sequence of str
            What speaks against the card, told in the program's head.

        Raises
        ------
        ValueError
            Inputs without an axis, other axes, scales that move a stick beyond its end, 1000.
        """
        told = (self.headline(), self.to_csv(), doubts)
        return px4_script(self.t, self._columns(), axes, *told)

    def _columns(self) -> dict[str, Array]:
        return dict(zip(self.inputs, self.r.T, strict=True))
