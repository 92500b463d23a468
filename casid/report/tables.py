"""Values as tables: of a notebook, of the console, of a page."""

from functools import singledispatch
from typing import NamedTuple

import jinja2
import numpy as np

from casid.arrays import Array
from casid.bands import ModeBand, ResponseBand
from casid.bandwidth import HandlingBand
from casid.baseline.handling import HandlingQualities
from casid.baseline.loes import TransferFunction
from casid.bounds.compare import BoundsComparison
from casid.bounds.profiles import Profile
from casid.bounds.resampling import Ensemble
from casid.consistency.kinematics import KinematicCheck
from casid.cover import Cover
from casid.design.plan import Design
from casid.display import Cells, Shown, Tabled, digits_beside_one
from casid.distances import Distances
from casid.eigenmodes import modes
from casid.envelope import Envelope
from casid.excitations import Excitation
from casid.fit import Fit
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.qualification import Qualification
from casid.record import Record
from casid.report.words import number, percent, prior
from casid.residuals import Residuals
from casid.samples import runs
from casid.structure.identifiability import Identifiability
from casid.subspace.blackbox import BlackBox
from casid.tabulation import markdown_table
from casid.undermodelling import Undermodelling
from casid.validation import Validation


class Share(NamedTuple):
    """Of one input from outside: its band [rad/s], median, at most, least, and where [rad/s]."""

    name: str
    low: float
    high: float
    share: float
    most: float
    least: float
    at: float


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
    rows = [[*pair, *(row.cell for row in found)] for pair, found in value.by_pair().items()]
    return ("output", "input", *bands), rows


@cells.register
def _(value: Undermodelling) -> Cells:
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
    return cells(value.continuous().system)


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
def _(value: Tabled) -> Cells:
    return value.cells()


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
        [record, *(_judged(x) for x in value.largest[k])] for k, record in enumerate(value.records)
    ]
    return ("error / half the band", *value.outputs), rows


def _judged(largest: float) -> str:
    if np.isnan(largest):
        return "not judged"
    return f"{'pass' if largest <= 1 else 'FAIL'} {largest:.{digits_beside_one(largest, 2)}g}"


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


@cells.register
def _(value: StateSpace) -> Cells:
    if value.dt is None:
        rows = [
            [_pole(mode.pole), mode.words, "yes" if mode.observable else "no"]
            for mode in modes(value)
        ]
        return ("eigenvalue [1/s]", "mode", "seen"), rows
    return ("eigenvalue [-]",), [[_pole(pole)] for pole in value.poles() if pole.imag >= 0]


@cells.register
def _(value: Excitation) -> Cells:
    rows = [
        [row.name, f"{row.low:.2g} to {row.high:.2g}", *(f"{x:.0%}" for x in row[3:6])]
        for row in shares(value)
    ]
    return ("input", "band [rad/s]", "from outside", "at most", "least"), rows


def shares(found: Excitation) -> list[Share]:
    """Share of every input that moves from outside, over its band."""
    rows = []
    for i, name in enumerate(found.inputs):
        inside = found.within[:, i]
        omega, lower, upper = found.omega[inside], found.lower[inside, i], found.upper[inside, i]
        if len(omega):
            middle, most, k = np.median(lower), np.median(upper), int(lower.argmin())
            rows.append(Share(name, omega[0], omega[-1], middle, most, lower[k], omega[k]))
    return rows


@cells.register
def _(value: KinematicCheck) -> Cells:
    rows = []
    for each in value.channels:
        found = ["not determined", "", ""]
        if each.determined:
            found = [
                f"{100 * each.scale:+.2f} ± {100 * each.scale_error:.2g}",
                f"{1000 * each.skew:+.1f} ± {1000 * each.skew_error:.2g}",
                f"{each.bias:+.2g} ± {each.bias_error:.1g}",
            ]
        rows.append([each.channel, ", ".join(each.against), *found, each.unit])
    return ("channel", "against", "scale [%]", "late [ms]", "bias", "unit"), rows


@cells.register
def _(value: Identifiability) -> Cells:
    rows = [[n, _short(x)] for n, x in zip(value.names, value.inflation, strict=True)]
    return ("parameter", "its error grows, as the others are unknown, by"), rows


@cells.register
def _(value: HandlingQualities) -> Cells:
    figures = (
        ("ω180 [rad/s]", value.omega_180),
        ("bandwidth [rad/s]", value.bandwidth),
        ("by phase [rad/s]", value.bandwidth_phase),
        ("by gain [rad/s]", value.bandwidth_gain),
        ("phase delay [s]", value.phase_delay),
        ("crossover [rad/s]", value.crossover),
        ("phase margin [deg]", value.phase_margin),
        ("gain margin [dB]", value.gain_margin),
    )
    remarks = [["remark", remark] for remark in value.remarks]
    return ("reading", "value"), [*([n, _short(x)] for n, x in figures if np.isfinite(x)), *remarks]


@cells.register
def _(value: TransferFunction) -> Cells:
    errors = iter(value.std_error)
    top = [(f"numerator s^{k}", x) for k, x in _powers(value.numerator)]
    bottom = [(f"denominator s^{k}", x) for k, x in _powers(value.denominator)[1:]]
    rows = [
        [n, _short(x), _short(next(errors))] for n, x in (*top, *bottom, ("delay [s]", value.delay))
    ]
    return ("coefficient", "value", "std. error"), rows


@cells.register
def _(value: ModeBand) -> Cells:
    mode = value.mode
    rows = [
        ("real part [1/s]", mode.pole.real, value.real_std),
        ("imaginary part [1/s]", mode.pole.imag, value.imag_std),
        ("frequency [rad/s]", mode.frequency, value.frequency_std),
        ("damping [-]", mode.damping, value.damping_std),
    ]
    return (mode.name, "value", "std. deviation"), [[n, _short(x), _short(s)] for n, x, s in rows]


@cells.register
def _(value: HandlingBand) -> Cells:
    rows = [
        ("bandwidth [rad/s]", value.bandwidth, value.bandwidth_std),
        ("phase delay [s]", value.phase_delay, value.phase_delay_std),
    ]
    told = [[n, _short(x), _short(s)] for n, x, s in rows if np.isfinite(x)]
    remarks = [["remark", remark, ""] for remark in value.remarks]
    return ("reading", "value", "std. deviation"), [*told, *remarks]


def _powers(coefficients: Array) -> list[tuple[int, float]]:
    """Powers of s, falling, with their coefficients."""
    return list(zip(range(len(coefficients) - 1, -1, -1), coefficients, strict=True))


def _short(value: float) -> str:
    return number(float(value))


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
