"""Values as tables: of a notebook, of the console, of a page."""

from collections.abc import Sequence
from functools import singledispatch

import jinja2
import numpy as np

from casid.bands import ResponseBand
from casid.bounds.compare import BoundsComparison
from casid.bounds.profiles import Profile
from casid.bounds.resampling import Ensemble
from casid.cover import Cover
from casid.design.plan import Design
from casid.display import Shown
from casid.distances import Distances
from casid.eigenmodes import modes
from casid.embedding import StructureError
from casid.envelope import Envelope
from casid.fit import Fit
from casid.frequency.response import FrequencyResponse
from casid.qualification import Qualification
from casid.record import Record
from casid.report.words import number, percent, prior
from casid.residuals import Residuals
from casid.samples import runs
from casid.subspace.blackbox import BlackBox
from casid.tabulation import markdown_table
from casid.validation import Validation

Cells = tuple[Sequence[str], Sequence[Sequence[str]]]  # heading and rows
PAGE = jinja2.Template(
    "<p><b>{{ kind }}</b> {{ headline }}</p><table><thead><tr>{% for cell in heading %}<th>"
    "{{ cell }}</th>{% endfor %}</tr></thead><tbody>{% for row in rows %}<tr>{% for cell in row %}"
    "<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</tbody></table>",
    autoescape=True,  # names come from users' files
)


def html(value: Shown) -> str:
    """Headline and table of a value, as HTML."""
    heading, rows = cells(value)
    kind = type(value).__name__
    return str(PAGE.render(kind=kind, headline=value.headline(), heading=heading, rows=rows))


def summary(value: Shown) -> str:
    """Headline and table of a value as text, in Markdown.

    Parameters
    ----------
    value : Record, FrequencyResponse, BlackBox, Fit, Validation, Residuals, BoundsComparison, \
Profile, Ensemble, Design and other results
        Of a fit: every parameter with its standard error, the Cramér-Rao bound, its bounds, and
        what holds it.
    """
    heading, rows = cells(value)
    return f"{value!r}\n\n{markdown_table(heading, rows)}"


@singledispatch
def cells(value: object) -> Cells:
    """Heading and rows of a value's table."""
    raise TypeError(f"a {type(value).__name__} has no table; expected a result of casid")


@cells.register
def _(value: Record) -> Cells:
    rows = []
    for name in (*value.inputs, *value.outputs):
        x = value.channel(name)
        there = x[np.isfinite(x)]
        figures = (there.min(), there.max(), there.std()) if len(there) else (np.nan,) * 3
        kind = "input" if name in value.inputs else "output"
        rows.append([name, kind, *map(_short, figures), f"{100 * (1 - len(there) / len(x)):.3g} %"])
    return ("channel", "kind", "least", "largest", "std. deviation", "missing"), rows


@cells.register
def _(value: Distances) -> Cells:
    bands = [f"{low:.2g}-{high:.2g} rad/s" for low, high in value.bands]
    rows = [
        [*pair, *(f"{row.structure:.2g}σ{'!' * row.fault}" for row in found)]
        for pair, found in value.by_pair().items()
    ]
    return ("output", "input", *bands), rows


@cells.register
def _(value: StructureError) -> Cells:
    edges = [0, len(value.omega) // 2, -1]
    heading = ("pair", *(f"std at {value.omega[k]:.2g} rad/s" for k in edges))
    rows = [
        [f"{output}/{channel}", *map(_short, value.std[edges, i, j])]
        for i, output in enumerate(value.outputs)
        for j, channel in enumerate(value.inputs)
    ]
    return heading, rows


@cells.register
def _(value: FrequencyResponse) -> Cells:
    rows = []
    for i, output in enumerate(value.outputs):
        usual = value.coherence[:, i] >= 0.6
        rows.append([output, *(_spans(value.omega, column) for column in usual.T)])
    return ("coherence ≥ 0.6, rad/s", *value.inputs), rows


@cells.register
def _(value: BlackBox) -> Cells:
    system = value.continuous().system
    found = modes(system)
    rows = [[_pole(mode.pole), mode.words, _seen(mode.observable)] for mode in found]
    return ("eigenvalue [1/s]", "mode", "seen"), rows


@cells.register
def _(value: Fit) -> Cells:  # type: ignore[type-arg] # the dispatch reads the class alone
    rows = []
    for row in value.parameters:
        held = "fixed" if row.fixed else "on bound" if row.active else prior(row)
        figures = map(number, (row.value, row.std_error, row.cramer_rao, row.lower, row.upper))
        name, *rest = (row.name, *figures)
        rows.append([name, rest[0], row.unit, rest[1], percent(row), *rest[2:], held])
    heading = ("parameter", "value", "unit", "std. error", "%", "Cramér-Rao", "lower", "upper")
    return (*heading, "held"), rows


@cells.register
def _(value: Validation) -> Cells:
    rows = []
    for name in value.models:
        for k, record in enumerate(value.records):
            rows.append([name, record, *(f"{x:.3g}" for x in value.fit[name][k])])
    return ("fit [%] of", "record", *value.outputs), rows


@cells.register
def _(value: BoundsComparison) -> Cells:
    rows = []
    for case in value.cases:
        if case.reason:
            rows.append([case.name, f"failed: {case.reason}", *[""] * 4])
            continue
        figures = (case.cost, case.increase, case.predicted, case.p_value)
        rows.append([case.name, *(number(x, 6) for x in figures), str(case.held)])
    return ("case", "cost", "increase", "predicted", "p", "held"), rows


@cells.register
def _(value: Profile) -> Cells:
    rows = [
        [name, *map(_short, (value.fit[name].value, *value.intervals[name]))]
        for name in value.names
    ]
    return ("parameter", "estimate", f"{100 * value.level:.3g} %, low", "high"), rows


@cells.register
def _(value: Ensemble) -> Cells:
    limits, claimed = value.interval(), np.nanmean(value.std_errors, axis=0)
    columns = (value.reference, value.bias, value.scatter, claimed, *limits.T)
    rows = [[name, *(_short(c[k]) for c in columns)] for k, name in enumerate(value.names)]
    heading = ("parameter", "reference", "bias", "scatter", "mean std. error", "2.5 %", "97.5 %")
    return heading, rows


@cells.register
def _(value: Residuals) -> Cells:
    inside = value.inside()
    rows = [
        [name, _short(value.rms[i]), *(f"{100 * share:.0f} %" for share in inside[i])]
        for i, name in enumerate(value.outputs)
    ]
    return ("output", "RMS", "white", *(f"no trace of {name}" for name in value.inputs)), rows


@cells.register
def _(value: ResponseBand) -> Cells:
    wide = 100 * np.median(value.magnitude_std, axis=0)
    rows = [[o, *(f"{x:.2g} %" for x in row)] for o, row in zip(value.outputs, wide, strict=True)]
    return ("1σ of the magnitude, median", *value.inputs), rows


@cells.register
def _(value: Qualification) -> Cells:
    rows = [
        [record, *(f"{'pass' if x <= 1 else 'FAIL'} {x:.2g}" for x in value.largest[k])]
        for k, record in enumerate(value.records)
    ]
    return ("error / half the band", *value.outputs), rows


@cells.register
def _(value: Envelope) -> Cells:
    rows = [
        [f"{speed:.4g}", *(f"{x:.3g} ± {e:.2g}" for x, e in zip(row, std, strict=True))]
        for speed, row, std in zip(value.speed, value.values, value.std_error, strict=True)
    ]
    return ("speed [m/s]", *value.names), rows


@cells.register
def _(value: Design) -> Cells:
    usual = value.alternatives[0].std_errors
    columns = (value.values, value.before, usual, value.std_errors)
    rows = [[name, *(_short(c[k]) for c in columns)] for k, name in enumerate(value.names)]
    return ("parameter", "value", "std. error before", "with 3-2-1-1", "with this"), rows


@cells.register
def _(value: Cover) -> Cells:
    poles = [["pole [1/s]", _pole(pole)] for pole in value.weight.poles() if pole.imag >= 0]
    figures = (("excess, mean", value.excess), ("margin, least", value.margin))
    return ("weight", "value"), [*poles, *([name, f"{x:.4g}"] for name, x in figures)]


def _short(value: float) -> str:
    return number(float(value))


def _seen(observable: bool) -> str:
    return "yes" if observable else "no"


def _pole(pole: complex) -> str:
    turn = f" ± {pole.imag:.3g}j" if pole.imag else ""
    return f"{pole.real:.3g}{turn}"


def _spans(omega: np.ndarray, usual: np.ndarray) -> str:
    """The longest run of usable frequencies [rad/s]."""
    found = runs(usual)
    if not len(found):
        return "–"
    first, last = found[np.argmax(found[:, 1] - found[:, 0])]
    return f"{omega[first]:.3g} to {omega[last - 1]:.3g}"
