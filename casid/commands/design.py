"""The command `design`: from a study to the next flight."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.text import Text

from casid.commands.columns import pairs
from casid.commands.study import OUTPUT, STUDY, VERBOSE
from casid.commands.terminal import caution, exits, logged, new_table
from casid.design.injection import check_axes, check_channels, is_own
from casid.design.inputs import design_inputs
from casid.design.loop import UnheldError
from casid.design.plan import Design
from casid.design.prior import check_trim, tells_noise
from casid.design.specification import DesignSettings, Limits
from casid.envelope import flight_condition
from casid.errors import ModelError, warn
from casid.fit import AnyFit, Fit
from casid.folder import at_once, claimed, replacing
from casid.free import free_parameters
from casid.model import Model
from casid.nonlinear.balance import balanced
from casid.nonlinear.conditions import Trim
from casid.nonlinear.coverage import airspeeds
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.stages.conditions import flight_conditions
from casid.studies.runner import kept_fit
from casid.studies.study import Study, read_records
from casid.studies.studyfile import read_study
from casid.studies.written import told_of_fit
from casid.textfile import write_text
from casid.values import digest

SHOWN = 12  # parameters in the table
DPI = 120
POOR = "poor"  # the verdict on an output that casts doubt on a design
SCRIPTS = ("card.lua", "inject.py")  # of ArduPilot, of PX4
BASELINE = "3-2-1-1"
PICTURES = {"design.png": False, "errors.png": True}  # whether of the standard errors
WRITTEN = ("card.csv", f"{BASELINE}.csv", *SCRIPTS, "design.md", *PICTURES)


def _scaled(text: str) -> tuple[str, float]:
    """``place:scale``."""
    place, _, scale = text.partition(":")
    return place, float(scale)


def _of_channel(text: str) -> tuple[int, float]:
    """``number:scale``."""
    place, scale = _scaled(text)
    return int(place), scale


def _given(
    flag: str, what: str, form: str = "NAME=NUMBER", read: Callable[[str], Any] = float
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(flag, multiple=True, callback=pairs(read), metavar=form, help=what)


@click.command()
@STUDY
@OUTPUT
@click.option("--duration", type=float, help="Duration of the manoeuvre [s], 60 unless given.")
@_given("--stick", "Largest deviation of an input, SI; the largest flown unless given.")
@_given("--rate", "Largest rate of an input, SI per second; free unless given.")
@_given("--response", "Largest deviation of an output, SI; the largest flown unless given.")
@_given("--feedback", "Gain of the loop that is flown: lat:p=0.15 is u_lat = r_lat - 0.15 p.")
@_given("--trim", "Total value of a state or input to fly a nonlinear structure at.")
@click.option("--matter", multiple=True, metavar="NAME", help="Parameter that counts; else all.")
@click.option("--method", help="best, steps or multisine.")
@click.option(
    "--spread", type=float, help="Share by which values may be wrong, lognormal; 0.2 unless given."
)
@_given(
    "--ardupilot",
    "RC channel of an input, µs a unit of the card (SI: fractions, rad): lat=1:500.",
    "NAME=CHANNEL:US",
    _of_channel,
)
@_given(
    "--px4",
    "Axis of MANUAL_CONTROL, its units a unit of the card (SI: fractions, rad): lat=y:1000.",
    "NAME=AXIS:UNITS",
    _scaled,
)
@VERBOSE
def design(
    study: Path,
    output: Path | None,
    duration: float | None,
    verbose: bool,
    **asked: Any,  # noqa: ANN401 - options by name
) -> None:
    """Design the next flight of a study: what is weak, what to fly, what it will buy.

    The fit that casid identify has kept is what is known before; without one the guess is taken,
    and the study's table [noise] says how noisy the outputs are. The study's table [design] holds
    what these options say, which come before it.

    \b
    The output folder then also holds
      design/card.csv    time and designed stick deviations, SI
      design/3-2-1-1.csv the card of the 3-2-1-1 that it is compared with
      design/card.lua    with --ardupilot, a script that flies them
      design/inject.py   with --px4, a program that sends them
      design/design.md   what is compared, and every standard error before and after
      design/design.png  sticks and predicted responses with their limits
      design/errors.png  predicted standard errors, parameter by parameter
    """  # noqa: D301
    with exits() as console, logged(console, verbose), _feedback_as_option():
        what = read_study(study, output)
        what.spare(*(f"design/{name}" for name in WRITTEN))
        model = _kept(what)
        structure = model.model if isinstance(model, Fit) else model
        wished = {**what.design.trim, **asked["trim"]}
        trim, flown = _condition(model, _flown(what), wished)
        limits, dt = _limits(what, flown, asked)
        settings = _settings(what, asked, model, dt)
        if channels := asked["ardupilot"]:
            check_channels(what.model.inputs, channels, settings.interval)
        if asked["px4"]:
            check_axes(what.model.inputs, asked["px4"])
        noise = None if isinstance(model, Fit) and tells_noise(model) else _noise(what)
        feedback = _feedback(what, asked["feedback"])
        with claimed(what.output, "wait for its end"):
            made = design_inputs(
                model, limits, what.design.duration if duration is None else duration,
                noise=noise, feedback=feedback, trim=trim, settings=settings,
            )  # fmt: skip
            doubts = _doubts(what, model)
            _say(console, made, structure, doubts)
            scripts = {}
            if channels:
                scripts[SCRIPTS[0]] = made.to_ardupilot(channels, doubts=doubts)
            if asked["px4"]:
                scripts[SCRIPTS[1]] = made.to_px4(asked["px4"], doubts=doubts)
            page = _page(made, settings, doubts)
            _write(what.output / "design", made, {"design.md": page, **scripts})
        _say_cards(console, made, what.output / "design")


def _say_cards(console: Console, made: Design, folder: Path) -> None:
    """Where the card is, and that of the 3-2-1-1 where that is what to fly."""
    for said, name in (("Card", "card"), *([] if made.gains else [(BASELINE, BASELINE)])):
        path = str((folder / f"{name}.csv").resolve())
        console.print(Text(f"{said}: ").append(path, style="bold"))


def _write(folder: Path, made: Design, texts: Mapping[str, str]) -> None:
    """Write cards, texts and pictures together: nothing stands beside the card of another."""
    former = [folder / name for name in WRITTEN if name != "card.csv"]
    stale = [each for each in former if each.name not in SCRIPTS or is_own(each)]
    with at_once(*stale) as place:
        write_text(place(folder / "card.csv"), made.to_csv())
        write_text(place(folder / f"{BASELINE}.csv"), made.to_csv(BASELINE))
        for name, text in texts.items():
            write_text(place(folder / name), text)
        for name, errors in PICTURES.items():
            figure = np.ravel(made.plot(errors=errors))[0].figure
            with replacing(place(folder / name)) as file:
                figure.savefig(file, format="png", dpi=DPI, bbox_inches="tight")


def _settings(
    study: Study, asked: Mapping[str, Any], model: AnyFit | Model, dt: float
) -> DesignSettings:
    """The study's, but for what was asked for; what neither says is as in its identification."""
    own = study.design.held(study.fixed, study.bounds)
    if study.design.settings.fixed is None and isinstance(model, Fit):
        held = [*study.fixed, *(row.name for row in model.parameters if row.fixed)]
        own = replace(own, fixed=tuple(dict.fromkeys(held)))
    said = {name: asked[name] for name in ("matter", "method") if asked[name]}
    if asked["spread"] is not None:
        said["spread"] = asked["spread"]
    return replace(own, dt=dt if own.dt is None else own.dt, **said)


def _feedback(study: Study, asked: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """The study's, with the gains that were asked for."""
    found = {stick: dict(gains) for stick, gains in study.design.feedback.items()}
    for name, gain in asked.items():
        stick, _, channel = name.partition(":")
        if not channel:
            raise ValueError(
                f"--feedback {name}={gain:g} names no output: expected INPUT:OUTPUT=GAIN, such as "
                f"{stick}:{study.model.outputs[0]}={gain:g}"
            )
        found.setdefault(stick, {})[channel] = gain
    return found


@contextmanager
def _feedback_as_option() -> Iterator[None]:
    """Of an aircraft that is not held the feedback that may hold it is told as the option."""
    try:
        yield
    except UnheldError as error:
        pairs = [(j, i, gain) for j, gains in error.example.items() for i, gain in gains.items()]
        said = " ".join(f"--feedback {stick}:{output}={gain:g}" for stick, output, gain in pairs)
        raise ValueError(str(error).replace(f"feedback={error.example}", said)) from error


def _noise(study: Study) -> Mapping[str, float]:
    """Standard deviations of the outputs, which the study has to say where no fit does."""
    if study.noise is None:
        raise ValueError(
            "the noise of the outputs is not known: run casid identify with output error, whose "
            "residuals show it (a filter's do not hold turbulence), or give the study the tables "
            "[noise], with seed = 0, and [noise.std], with "
            f"{', '.join(f'{name} = ...' for name in study.model.outputs)}"
        )
    return study.noise.std


def _kept(study: Study) -> Any:  # noqa: ANN401 - a fit, or a model without one
    """The fit of the study's last identification, if there is one, else its guess.

    One of other records or settings is told, one that is not what was kept refused: ValueError.
    """
    path = study.output / "fit.json"
    if not path.exists():
        return study.model
    try:
        found = Fit.load(path, model=type(study.model))
    except ModelError as error:
        raise ModelError(f"{error}; if it has changed, run casid identify again") from error
    kept = kept_fit(study)
    if kept is None:
        warn(f"{path} is of earlier records, settings or casid; run casid identify to renew it")
    elif digest(kept) != digest(found):
        raise ValueError(f"{path} is not the fit that was kept in stages; run casid identify")
    return found


def _doubts(study: Study, known: AnyFit | Model) -> tuple[str, ...]:
    """What the study itself said against the fit that a design is made from; () of a sound one."""
    if not isinstance(known, Fit):
        return ()
    said = [] if known.success else ["its estimation did not converge"]
    if (told := told_of_fit(study)) is not None:
        said += [each for each, good in told.headlines.items() if good is False]
        if poor := [each.output for each in told.verdicts if each.word == POOR]:
            said.append(f"it predicts {', '.join(poor)} of unseen records poorly")
    if not said:
        return ()
    return (
        f"the fit that this card was designed from is not sound: {'; '.join(said)}. Responses, "
        "their limits and standard errors are as wrong as it is: read the report, mend structure "
        "or data and design again, or fly the card with margins of your own",
    )


def _flown(study: Study) -> list[Record]:
    """What the study identifies from, with the channels of its structure."""
    records = read_records(study)["identification"]
    return [record.select(study.model.inputs, study.model.outputs) for record in records]


def _condition(
    known: AnyFit | Model, records: list[Record], asked: Mapping[str, float]
) -> tuple[Trim | None, list[Record]]:
    """Where a nonlinear structure is to be flown, and its records from there, about their trims."""
    model, began = (known.model, known.initial_states) if isinstance(known, Fit) else (known, None)
    check_trim(model, asked)
    if not isinstance(model, NonlinearModel):
        return None, records
    named = airspeeds(model, (*model.states, *model.inputs))
    places = (
        flight_conditions(model, records)
        if named
        else [(flight_condition(model, records[0]), records)]
    )
    speeds = [place.speed for place, _ in places]
    wanted = [value for name, value in asked.items() if name in named]
    if len(places) > 1 and not wanted:
        told = ", ".join(f"{speed:.4g}" for speed in speeds)
        raise ValueError(
            f"the records were flown at {len(places)} speeds, {told} m/s: say at which to fly, "
            f"--trim {named[0]}={speeds[0]:.4g}"
        )
    nearest = int(np.argmin(np.abs(np.array(speeds) - wanted[0]))) if wanted else 0
    place, flown = places[nearest]
    wished = replace(place, values={**place.values, **asked})
    rest = balanced(model, wished, held={*named, *asked}, flown=began)
    return replace(rest.trim, moves={}), [record.total().detrend("first") for record in flown]


def _limits(
    study: Study, flown: list[Record], asked: dict[str, dict[str, float]]
) -> tuple[Limits, float]:
    """What was asked for, else what records have reached; and their interval."""
    limits = Limits(
        sticks={**_reached(flown, study.model.inputs), **study.design.sticks, **asked["stick"]},
        rates={**study.design.rates, **asked["rate"]},
        responses={
            **_reached(flown, study.model.outputs),
            **study.design.responses,
            **asked["response"],
        },
    )
    return limits, float(np.median([record.dt for record in flown]))


def _reached(records: Sequence[Record], names: Sequence[str]) -> dict[str, float]:
    """Largest deviation of each channel in any record."""
    return {n: max(float(np.nanmax(np.abs(r.channel(n)))) for r in records) for n in names}


def _say(console: Console, made: Design, structure: Model, doubts: Sequence[str]) -> None:
    """What is compared, what is weak and what becomes of it.

    Weak is what has a large error beside its value, or its typical size where that is zero. What no
    input tells is named behind, and in no order.
    """
    console.print(Text(made.headline()))
    table = new_table("Standard errors over those of 3-2-1-1", "input", "mean", "worst", "of")
    for name, mean, worst, parameter in made.ratios():
        table.add_row(name, f"{mean:.3f}", f"{worst:.3f}", Text(parameter))
    console.print(table)
    table = new_table("Weakest parameters", "parameter", "value", "before", "3-2-1-1", "this")
    weak = np.where(np.isfinite(made.before), made.before, made.alternatives[0].std_errors)
    typical = dict(zip(structure.parameter_names(), free_parameters(structure).scale, strict=True))
    usual = np.array([typical[name] for name in made.names])
    weak = weak / np.where(made.values == 0.0, usual, np.abs(made.values))
    rows = made.rows(digits=2)
    for k in [k for k in np.argsort(-weak) if made.names[k] not in made.untold][:SHOWN]:
        table.add_row(made.names[k], f"{made.values[k]:.4g}", *rows[k][2:])
    console.print(table)
    if beside := made.on_the_card():
        console.print(Text(beside))
    for line in (*doubts, *made.exceeded(), *made.blind):
        caution(console, line)


def _page(made: Design, settings: DesignSettings, doubts: Sequence[str]) -> str:
    close = [f"- {a} and {b}: {c:+.2f}" for a, b, c in made.correlated()]
    blind = [
        "## What this flight does not distinguish",
        "\n".join(f"- {line}" for line in made.blind),
    ]
    chosen = (
        f"Of steps and multisine, {made.kind} was chosen by the criterion {settings.criterion}, "
        "relative to errors of one 3-2-1-1 per axis; the ratios of this table may suggest the "
        "other."
    )
    overlap = [made.overlap] if len(made.inputs) > 1 else []
    parts = [
        f"# {made.headline()}", *(f"Doubted: {each}." for each in doubts),
        "## What could be flown", made.comparison(),
        *([chosen] if settings.method == "best" else []),
        *(f"Largest correlation between two sticks of the card: {x:.2g}." for x in overlap),
        "## Standard errors", made.to_markdown(), "## Share of each limit", made.shares(),
        "## Correlated errors", "\n".join(close) or "None above 0.9.",
        *(blind if made.blind else []),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"
