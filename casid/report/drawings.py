"""The static figures of a report, put together from the ``plot_*`` functions."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from casid.arrays import Array, ComplexArray
from casid.bounds.compare import BoundsComparison
from casid.excitations import Excitation
from casid.fit import AnyFit
from casid.folder import replacing
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.qualification import Qualification
from casid.record import Record
from casid.report import figures
from casid.report.content import BLACK_BOX, Content, Drawing
from casid.report.layout import legend_above, place_axes, stacked
from casid.report.look import LOOK, WIDTH
from casid.report.prices import bounds_height, plot_bounds
from casid.subspace.pbsid import BlackBox
from casid.validation import Validation, state_space

Curves: TypeAlias = Mapping[str, tuple[StateSpace, ComplexArray]]  # with responses (K, ny, nu)
POINTS = 160  # of a model's response; matplotlib simplifies curves of 128 or more
PER_PAGE = 8  # outputs in a figure of time histories
LAGS = 100  # samples of the autocorrelation
ROWS = 16  # of the comparison of bounds
USUAL = (0.1, 20.0)  # rad/s
SLOW = 2.0  # 1/s, the reach of the enlarged plane of eigenvalues


def save(drawing: Drawing, svg: Path, png: Path | None = None) -> None:
    """Write a figure as SVG, and as PNG if a path is given."""
    with rc_context(LOOK):
        with replacing(svg) as file:
            drawing.figure.savefig(file, format="svg", metadata={"Date": None})
        if png is not None:
            with replacing(png) as file:
                drawing.figure.savefig(file, format="png", dpi=150, metadata={"Software": None})


def systems(content: Content) -> dict[str, StateSpace]:
    """Every model by name; a discrete one is left out of continuous figures."""
    found = {name: state_space(model) for name, model in content.models.items()}
    return {name: system for name, system in found.items() if system.dt is None}


def band(content: Content) -> tuple[float, float]:
    """Frequencies [rad/s] on which a match was made, or that the records excite."""
    certificates = [fit.certificate for fit in content.fits.values()]
    boxes = [each for each in content.models.values() if isinstance(each, BlackBox)]
    return next((each.band for each in (*certificates, *boxes) if each is not None), USUAL)


def with_states(system: StateSpace, states: Sequence[str]) -> StateSpace:
    """The same system with some of its states as outputs."""
    C = np.array([np.array(system.states) == state for state in states], dtype=float)
    C = C.reshape(len(states), len(system.states))  # of no states too
    D = np.zeros((len(states), system.nu))
    return replace(system, C=C, D=D, outputs=tuple(states))


def draw_responses(content: Content) -> Iterator[Drawing]:
    """Responses of every output, and of every state that is none, to every input."""
    structure = content.model
    hidden = tuple(name for name in structure.states if name not in structure.outputs)
    every = systems(content)
    inner = {name: with_states(s, hidden) for name, s in every.items() if name in content.fits}
    omega = np.geomspace(*band(content), POINTS)
    for shown, channels in ((every, structure.outputs), (inner, hidden)):
        curves = {name: (system, system.response(omega)) for name, system in shown.items()}
        for outputs in figures.output_groups(channels):
            for inputs in figures.input_pairs(structure.inputs):
                yield _response(outputs, inputs, partial(_responses, content, curves, omega))


def _response(
    outputs: Sequence[str], inputs: Sequence[str], draw: Callable[..., Figure]
) -> Drawing:
    name = f"response_{'_'.join(outputs)}_from_{'_'.join(inputs)}"
    caption = f"Frequency responses from {_list(inputs)} to {_list(outputs)}"
    return Drawing(name=name, caption=caption, draw=partial(draw, outputs, inputs))


def _responses(
    content: Content, shown: Curves, omega: Array, outputs: Sequence[str], inputs: Sequence[str]
) -> Figure:
    measured = _measured(content, outputs)
    heights = [3, 2] if measured is None else [3, 2, 1.1]
    rows = len(heights)
    figure = Figure(figsize=(WIDTH, 0.45 + 0.42 * sum(heights) * len(outputs)))
    axes = stacked(figure, heights * len(outputs), len(inputs))
    for ax in axes[-1]:  # before the curves, which would each look for limits
        ax.set(xscale="log", xlabel="ω [rad/s]")
        figures.frequency_axis(ax, omega[0], omega[-1])
    for i, output in enumerate(outputs):
        for j, channel in enumerate(inputs):
            column = list(axes[rows * i : rows * (i + 1), j])
            _pair(column, measured, shown, omega, (output, channel))
            column[0].set_title(f"{output} / {channel}", loc="left", fontweight="bold", pad=3)
    for ax in axes[:, 1:].flat:
        ax.set_ylabel("")
    legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def _measured(content: Content, outputs: Sequence[str]) -> FrequencyResponse | None:
    """The measured response that has these outputs, or states measured beside them."""
    found = (content.results.get(name) for name in ("frequency", "checked"))
    return next((each for each in found if each and {*outputs} <= {*each.outputs}), None)


def _pair(
    column: Sequence[Axes],
    measured: FrequencyResponse | None,
    shown: Curves,
    omega: Array,
    pair: tuple[str, str],
) -> None:
    output, channel = pair
    near: Array | None = None
    curves = {}
    for name, (system, G) in shown.items():
        curves[name] = G[:, system.outputs.index(output), system.inputs.index(channel)]
        near = figures.phase(curves[name]) if near is None else near
    if len(column) == 3 and measured is not None and near is not None:
        place = measured.outputs.index(output), measured.inputs.index(channel)
        figures.plot_measured(column[0], column[1], measured, place, near=(omega, near))
        figures.plot_coherence(column[2], measured, place)
    for name, G in curves.items():
        figures.plot_magnitude(column[0], omega, G, name=name, among=curves)
        figures.plot_phase(column[1], omega, G, name=name, near=near, among=curves)
    # The models set the limits: a band of two sigma has no lower end where coherence is lost.
    low, high = _span([figures.decibel(G) for G in curves.values()], least=20.0)
    column[0].set_ylim(low - 3, high + 3)
    figures.phase_axis(
        column[1], *_span([figures.phase(G, near) for G in curves.values()], least=60.0)
    )


def _span(curves: Sequence[Array], least: float) -> tuple[float, float]:
    low, high = float(np.min(curves)), float(np.max(curves))
    more = max(0.0, least - (high - low)) / 2
    return low - more, high + more


def draw_histories(validation: Validation, units: Mapping[str, str]) -> Iterator[Drawing]:
    """Every record, with what each model makes of its inputs."""
    for k, record in enumerate(validation.measured):
        for first in range(0, record.ny, PER_PAGE):
            names = record.outputs[first : first + PER_PAGE]
            told = f"{record.name}: inputs (deviations from trim), {_list(names)}"
            yield Drawing(
                name=f"history_{_file(record.name)}_{'_'.join(names)}",
                caption=told + _ahead(validation, k),
                draw=partial(_history, validation, k, names, units),
            )


def _history(found: Validation, k: int, names: Sequence[str], units: Mapping[str, str]) -> Figure:
    """Inputs and outputs of a record on one sheet of paper."""
    record = found.measured[k]
    heights = [0.46] * record.nu + [0.84] * len(names)
    figure = Figure(figsize=(WIDTH, 0.7 + sum(heights)))
    axes = stacked(figure, heights)
    t, axis = figures.elapsed(record.t)
    axes[-1, 0].set(xlabel=axis, xlim=(t[0], t[-1]))
    _inputs(list(axes[: record.nu, 0]), record, units)
    for ax, channel in zip(axes[record.nu :, 0], names, strict=True):
        i = record.outputs.index(channel)
        simulated = {name: y[k][:, i] for name, y in found.simulated.items()}
        figures.plot_history(ax, t, record.y[:, i], simulated, channel=channel, units=units)
    for ax in axes[:, 0]:
        ax.set_ylabel(ax.get_ylabel().replace(" [", "\n["))
    legend_above(figure, axes[-1, 0])
    return place_axes(figure, axes, lines=2)


def _ahead(validation: Validation, k: int) -> str:
    """How far ahead a record was predicted, if it was not simulated."""
    far = validation.horizon[k]
    return "" if np.isinf(far) else f"; predicted up to {far:.3g} s ahead, not simulated"


def _inputs(axes: Sequence[Axes], record: Record, units: Mapping[str, str]) -> None:
    """Every input; one that rests is a straight line, whatever its last digits do."""
    largest, t = float(np.ptp(record.u, axis=0).max()), figures.elapsed(record.t)[0]
    for ax, channel in zip(axes, record.inputs, strict=True):
        u = record.channel(channel)
        figures.plot_input(ax, t, u, channel=channel, units=units)
        ax.set_ylim(_span([u], least=0.2 * largest or 1.0))
        ax.yaxis.label.set_fontsize(6)


def draw_qualification(found: Qualification, units: Mapping[str, str]) -> Iterator[Drawing]:
    """Measured time histories with their tolerance bands, the model's inside or not."""
    for k, record in enumerate(found.validation.measured):
        yield Drawing(
            name=f"qualification_{_file(record.name)}",
            caption=f"{record.name}: tolerance bands around what was measured",
            draw=partial(_qualification, found, k, units),
        )


def _qualification(found: Qualification, k: int, units: Mapping[str, str]) -> Figure:
    record = found.validation.measured[k]
    figure = Figure(figsize=(WIDTH, 0.7 + 1.0 * len(found.outputs)))
    axes = stacked(figure, [1.0] * len(found.outputs))
    t, axis = figures.elapsed(record.t)
    for j, (ax, name) in enumerate(zip(axes[:, 0], found.outputs, strict=True)):
        i, half = record.outputs.index(name), found.width[k][:, j]
        y = {found.model: found.validation.simulated[found.model][k][:, i]}
        low, high = record.y[:, i] - half, record.y[:, i] + half
        look: dict[str, Any] = {"color": "#000000", "alpha": 0.12, "linewidth": 0}
        ax.fill_between(t, low, high, label="tolerance", **look)
        figures.plot_history(ax, t, record.y[:, i], y, channel=name, units=units)
    axes[-1, 0].set(xlabel=axis, xlim=(t[0], t[-1]))
    legend_above(figure, axes[-1, 0])
    return place_axes(figure, axes)


def draw_rms(validation: Validation) -> Iterator[Drawing]:
    """RMS errors of every record, as bars."""
    far = "simulation" if not validation.predicted else "prediction"
    caption = f"RMS {far} error of each model, divided by the largest among the models"
    yield Drawing(name="rms", caption=caption, draw=partial(_rms, validation))


def _rms(validation: Validation) -> Figure:
    records = validation.records
    figure = Figure(figsize=(WIDTH, 0.6 + 1.8 * len(records)))
    axes = stacked(figure, [1.0] * len(records))
    for k, ax in enumerate(axes[:, 0]):
        figures.plot_rms(ax, validation, record=k)
        ax.grid(visible=False, axis="x")
        if len(records) > 1:
            ax.set_title(records[k], loc="left")
    legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def draw_whiteness(validation: Validation, model: str) -> Iterator[Drawing]:
    """Autocorrelations of the residuals of black box and delivered model, where simulated."""
    for k, record in enumerate(validation.measured):
        if np.isfinite(validation.horizon[k]):
            continue
        yield Drawing(
            name=f"whiteness_{_file(record.name)}",
            caption=f"Autocorrelation of the residuals, record {record.name}; grey: the band that "
            "holds 99 % of a white sequence's",
            draw=partial(_whiteness, validation, model, k),
        )


def _whiteness(validation: Validation, model: str, k: int) -> Figure:
    names = [name for name in (BLACK_BOX, model) if name in validation.models]
    record = validation.measured[k]
    rows = (record.ny + 1) // 2
    figure = Figure(figsize=(WIDTH, 0.6 + 1.25 * rows))
    axes = stacked(figure, [1.0] * rows, 2)
    for ax in axes.flat[record.ny :]:
        ax.set_visible(False)
    for i, (ax, output) in enumerate(zip(axes.flat, record.outputs, strict=False)):
        for name in names:
            residual = record.y[:, i] - validation.simulated[name][k][:, i]
            if np.isinf(validation.rms[name][k, i]):  # what is left before a model runs away
                residual = np.full(record.N, np.nan)
            lags = min(LAGS, record.N // 2)
            figures.plot_autocorrelation(ax, residual, record.dt, name=name, lags=lags)
        ax.set_title(output, loc="left", fontweight="bold", pad=3)
    for ax in axes[:, 1]:
        ax.set_ylabel("")
    for ax in axes[-1]:
        ax.set_xlabel("lag [s]")
    legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def draw_match_error(fit: AnyFit) -> Iterator[Drawing]:
    """Singular values of the error of a match, if it has a certificate."""
    if fit.certificate is not None:
        draw = partial(_single, (0.8 * WIDTH, 2.6), figures.plot_match_error, fit)
        caption = "Singular values of the weighted error over the band; dots: the points matched"
        yield Drawing(name="match_error", caption=caption, interactive=False, draw=draw)


def draw_singular_values(black_box: BlackBox) -> Iterator[Drawing]:
    """Singular values that the order of a black box was read from."""
    draw = partial(_single, (0.6 * WIDTH, 2.4), figures.plot_singular_values, black_box)
    caption = "Singular values of the predicted future; dotted: the order taken"
    yield Drawing(name="singular_values", caption=caption, interactive=False, draw=draw)


def draw_excitation(found: Excitation) -> Iterator[Drawing]:
    """How much of every input comes from outside, frequency by frequency."""
    caption = "Share of each input from outside over its band; dotted: below, it is doubted"
    draw = partial(_excitation, found)
    yield Drawing(name="excitation", caption=caption, interactive=False, draw=draw)


def _excitation(found: Excitation) -> Figure:
    figure = Figure(figsize=(WIDTH, 0.9 + 1.3 * len(found.inputs)))
    axes = stacked(figure, [1.0] * len(found.inputs))
    for i, ax in enumerate(axes[:, 0]):
        figures.plot_excitation(ax, found, i)
        figures.frequency_axis(ax, *found.omega[found.within.any(axis=1)][[0, -1]].tolist())
    legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def _single(size: tuple[float, float], plot: Callable[[Axes, Any], Axes], value: object) -> Figure:
    figure = Figure(figsize=size)
    axes = figure.subplots(1, 1, squeeze=False)
    plot(axes[0, 0], value)
    axes[0, 0].grid(which="both")
    if axes[0, 0].get_legend_handles_labels()[1]:
        legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def draw_poles(content: Content) -> Iterator[Drawing]:
    """Eigenvalues of all models, the slow ones enlarged."""
    caption = "Eigenvalues; right: the slow ones, enlarged"
    yield Drawing(name="poles", caption=caption, draw=partial(_poles, content))


def _poles(content: Content) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.0))
    axes, drawn = figure.subplots(1, 2, squeeze=False), systems(content)
    for ax in axes.flat:
        figures.plot_poles(ax, drawn)
    growing = [pole.real for each in drawn.values() for pole in each.poles() if abs(pole) <= SLOW]
    axes[0, 1].set(xlim=(-SLOW, max(0.4 * SLOW, 1.1 * max(growing, default=0.0))))
    axes[0, 1].set(ylim=(-SLOW, SLOW))
    legend_above(figure, axes[0, 0])
    return place_axes(figure, axes)


def draw_bounds(comparison: BoundsComparison) -> Iterator[Drawing]:
    """Values and intervals of the parameters whose bounds have the largest prices."""
    caption = (
        "Values with 95 % intervals within the bounds of each case, the largest prices first; "
        "filled: held by a bound"
    )
    yield Drawing(
        name="bounds", caption=caption, interactive=False, draw=partial(_bounds, comparison)
    )


def _bounds(comparison: BoundsComparison) -> Figure:
    size = WIDTH, bounds_height(comparison, ROWS)
    figure = Figure(figsize=size, layout="constrained")
    plot_bounds(figure.subplots(), comparison, rows=ROWS)
    return figure


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else names[0]


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
