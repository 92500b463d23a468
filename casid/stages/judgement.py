"""The stage that judges all models on unseen records."""

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from casid import report
from casid.eigenmodes import modes
from casid.envelope import balance_of, flight_condition
from casid.nonlinear.balance import balanced, unbalanced
from casid.nonlinear.conditions import Trim
from casid.nonlinear.model import NonlinearModel
from casid.report.answer import predictions_told, ranked
from casid.report.content import BLACK_BOX, OUTPUT_ERROR, Caution, Content, Section, enough, section
from casid.report.evidence import differences, disagreement, offsets, unexplained_records
from casid.report.verdicts import UNJUDGED, verdicts
from casid.report.words import fitted
from casid.stages.stage import Stage, Task
from casid.validation import Validation, validate

NAMES = {OUTPUT_ERROR: "refined model"}  # of what is delivered, in words


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Settings of the validation.

    Parameters
    ----------
    horizon : float
        As in `validate`: how far ahead models are predicted [s]; infinite, records are simulated
        whole even by unstable models, from the state that suits all of a record best.
    closed_loop : bool
        As there: whether a controller that flew the records kept outputs bounded.
    """

    horizon: float | None = None
    closed_loop: bool = False

    def __post_init__(self) -> None:
        if self.horizon is not None and not self.horizon > 0:
            raise ValueError(f"horizon = {self.horizon:g}, expected seconds above 0")


def _run(settings: Judgement, task: Task) -> Validation:
    return validate(
        task.models, task.records, horizon=settings.horizon, closed_loop=settings.closed_loop
    )


def _show(found: Validation, content: Content) -> Iterable[Section]:
    judged = verdicts(found, content)
    poor = [each for each in judged if each.word in ("poor", UNJUDGED)]
    said = [Caution(each, 3) for each in content.repeats.told()]
    said += [
        *unexplained_records(found, content),
        *disagreement(found, content),
        *differences(content),
        *offsets(found, content),
    ]
    said += [Caution(each.caution, 20 if each.noisy else 7) for each in poor]
    if found.predicted:
        # Where growth that a controller answers makes outputs poor, nothing else explains them.
        leads = found.adrift and any(not each.noisy for each in poor)
        said.append(Caution(f"Validation records: {found.predicted}", 6 if leads else 21))
    lead = _lead(found.records, content.repeats.seen)
    named = {"model": NAMES.get(content.delivered, content.delivered)}
    if judged:
        seen: Any = {"verdicts": ranked(judged), "compared": BLACK_BOX in found.models}
        seen |= named
        yield section(
            "answer",
            "",
            0,
            found,
            values=seen,
            answer=predictions_told(judged, found, enough=enough(content.results)),
        )
    shown: Any = {"verdicts": judged, "constants": _constants(found, content)}
    shown["fitted"] = fitted(found.outputs, found.unbiased)
    more: Any = {"values": shown | named, "lead": lead, "cautions": tuple(said)}
    yield section("verdicts", "Verdicts", 5, found, **more)
    yield from _compared(found, content)


def _constants(found: Validation, content: Content) -> dict[str, list[float]]:
    """Constants of each output that has any, one a record, of the delivered model."""
    if content.delivered not in found.biases:
        return {}
    pairs = zip(found.outputs, found.biases[content.delivered].T.tolist(), strict=True)
    return {name: own for name, own in pairs if name not in found.unbiased}


def _lead(names: Sequence[str], seen: Container[str]) -> str:
    """Which records it was judged on, those apart that are no new ones."""
    old = [name for name in names if name in seen]
    new = [name for name in names if name not in seen]
    copies = ", as far as casid recognises copies"
    said = {"estimations had seen": (old, ""), "no estimation had seen": (new, copies)}
    parts = [f"records that {who}{how} ({', '.join(x)})" for who, (x, how) in said.items() if x]
    return f"It was judged on {' and on '.join(parts)}."


def _compared(found: Validation, content: Content) -> Iterable[Section]:
    """All models side by side: modes, responses, time histories, errors, residuals.

    Modes and responses of nonlinear structures are those at the trim of the first record.
    """
    at, doubt = "", ""
    fit = content.fits.get(content.delivered)
    if isinstance(own := fit.model if fit else content.model, NonlinearModel):
        trim = flight_condition(own, found.measured[0])
        rest = balance_of(fit, trim) if fit else balanced(own, trim)
        at = f"the trim of record {found.records[0]}: {_values(rest.trim)}"
        if rest.found:
            at += f", {', '.join(rest.found)} so that the equations balance, dx/dt = 0"
        doubt = rest.doubt
        content = content.linear
    found_modes = {name: modes(fit.model.system()) for name, fit in content.fits.items()}
    said = (Caution(f"Modes: {unbalanced(content.model, [doubt])}", 6),) if doubt else ()
    values = {"modes": found_modes, "bands": content.bands, "at": at, "missed": content.missed}
    values["shares"] = [n for n in content.model.inputs if content.units.get(n) == "travel"]
    values["simulated"] = [k for k, far in enumerate(found.horizon) if math.isinf(far)]
    drawings = report.drawings
    histories = partial(drawings.draw_histories, found, content.units)
    for name, title, place, draw in (
        ("modes", "Modes", 40, partial(drawings.draw_poles, content)),
        ("responses", "Frequency responses", 50, partial(drawings.draw_responses, content)),
        ("histories", "Time histories of the validation records", 60, histories),
        ("rms", "RMS errors", 70, partial(drawings.draw_rms, found)),
        ("whiteness", "Residuals", 80, partial(drawings.draw_whiteness, found, content.delivered)),
    ):
        more: Any = {"cautions": said} if name == "modes" else {}
        yield section(name, title, place, found, values=values, draw=draw, **more)


def _values(trim: Trim) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in trim.values.items())


VALIDATION = Stage(
    name="validation",
    does="validation on unseen records",
    run=_run,
    table="validation",
    settings=Judgement(),
    role=("validation",),
    kept=False,
    show=_show,
)
