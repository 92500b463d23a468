"""A structure laid open: matrices with names and numbers, modes, what is seen and told apart."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casid.display import counted
from casid.eigenmodes import Mode, modes
from casid.free import Free, free_parameters
from casid.linear import StateSpace
from casid.model import Bounds, Model
from casid.nonlinear.expressions import operations
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import Records, several
from casid.structure.identifiability import Identifiability, identifiability

WIDEST = 48  # characters of a formula in a printed matrix

ALONE = ", of the linearisation at the reference condition alone"


@dataclass(frozen=True, eq=False, kw_only=True)
class Overview:
    """What `describe` found; ``str()`` of it is the text that ``casid check`` prints."""

    model: Model
    free: Free
    entries: dict[str, list[list[str]]]
    system: StateSpace
    modes: tuple[Mode, ...]
    constraints: tuple[str, ...]
    identifiability: Identifiability
    excitation: str

    def __str__(self) -> str:
        """All of it, as text."""
        system, cls = self.system, type(self.model)
        rows = {"A": system.states, "B": system.states, "C": system.outputs, "D": system.outputs}
        columns = {"A": system.states, "B": system.inputs, "C": system.states, "D": system.inputs}
        parts = [
            f"{cls.__name__}: {counted(system.nx, 'state')}, {counted(system.nu, 'input')}, "
            f"{counted(system.ny, 'output')}, "
            f"{len(self.free.index)} free parameters"
        ]
        if isinstance(self.model, NonlinearModel):
            parts.append(equations_text(self.model))
        for letter in "ABCD":
            numbers = [
                [f"{value:.4g}" if text != "." else "." for value, text in zip(*pair, strict=True)]
                for pair in zip(getattr(system, letter), self.entries[letter], strict=True)
            ]
            formulas = [[t if len(t) <= WIDEST else "..." for t in r] for r in self.entries[letter]]
            for title, cells in (("", formulas), (" at the guess", numbers)):
                parts.append(_grid(f"{letter}{title}", rows[letter], columns[letter], cells))
        parts += [self._parameters(), self._modes()]
        if self.constraints:
            parts.append("constraints\n" + "\n".join(f"  {line}" for line in self.constraints))
        found = str(self.identifiability).replace("\n", "\n  ")
        if self.excitation.endswith(ALONE):
            found = found.replace(
                "fix or drop", "fix or drop what has no effect where you fly, either"
            )
        parts.append(f"identifiability from {self.excitation}\n  {found}")
        return "\n\n".join(parts)

    def _parameters(self) -> str:
        infos, held = self.model.infos(), self.free.model
        cells = []
        for i, (name, info) in enumerate(infos.items()):
            low, high = self.free.lower[i], self.free.upper[i]
            state = "free" if i in self.free.index else "fixed"
            value = getattr(held, name)
            cells.append([f"{value:.4g}", f"{low:.4g}", f"{high:.4g}", info.unit, state])
        table = _grid("parameters", tuple(infos), ("guess", "lower", "upper", "unit", ""), cells)
        taus = zip(self.system.inputs, self.system.delay, strict=True)
        delays = ", ".join(f"{name} {tau:.3g} s" for name, tau in taus if tau > 0)
        return f"{table}\n\ndelays at the guess: {delays or 'none'}"

    def _modes(self) -> str:
        lines = []
        for mode in self.modes:
            value = mode.pole
            sign = f" ± {value.imag:.3g}j" if value.imag > 0 else ""
            flaws = [
                word
                for word, good in (
                    ("NOT OBSERVABLE", mode.observable),
                    ("NOT CONTROLLABLE", mode.controllable),
                )
                if not good
            ]
            tail = f"  {', '.join(flaws)}" if flaws else ""
            text = f"{value.real:.3g}{sign}"
            lines.append(f"  {text:<18} {mode.words:<32} {', '.join(mode.states)}{tail}")
        return "\n".join(["eigenvalues at the guess", *lines])


def describe(
    model: Model,
    records: Records | None = None,
    *,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
) -> Overview:
    """Lay a structure open at its guess; ModelError for whatever is wrong with its file."""
    # Identifiability is judged for the records, one 3-2-1-1 a control unless given.
    free = free_parameters(model, fixed, bounds)
    system = free.model.system()
    flown = one_3211_each(system) if records is None else several(records)
    told = "one 3-2-1-1 a control" if records is None else ", ".join(r.name for r in flown)
    judged = free.model
    if records is None and isinstance(judged, NonlinearModel):
        judged = judged.at({})  # the response is that of small deviations
        told += ALONE
    return Overview(
        model=model,
        free=free,
        entries=_entries(model),
        system=system,
        modes=tuple(sorted(modes(system), key=lambda mode: (-mode.pole.real, mode.pole.imag))),
        constraints=tuple(
            f"{item.lower:g} <= {item.name} = {float(item.value):.4g} <= {item.upper:g}"
            for item in free.model.constraints()
        ),
        identifiability=identifiability(judged, flown, fixed=fixed, bounds=bounds),
        excitation=told,
    )


def equations_text(model: NonlinearModel) -> str:
    """Equations with names, the reference condition and dx/dt there, operations with kinks."""
    x, u, lam = (
        ca.vertcat(*map(ca.SX.sym, names))
        for names in (model.states, model.inputs, model.parameter_names())
    )
    f, h = model.equations()(x, u, lam)
    named = [f"d{name}/dt" for name in model.states], [f"{name} measured" for name in model.outputs]
    lines, kinks = ["equations, total values"], []
    for names, column in zip(named, (f, h), strict=True):
        for name, value in zip(names, ca.vertsplit(column), strict=True):
            lines.append(f"  {name} = {value}")
            kinks += [f"{name} ({used})" for used in operations(value)]
    x0, u0 = model.operating_point()
    rates = model.equations()(x0, u0, model.vector())[0].full().ravel()
    lines += ["", "reference condition, where the linearisation below holds"]
    lines += [
        f"  {name} = {at:.4g}" + f" {model.units.get(name, '')}".rstrip() + f", d/dt {rate:.3g}"
        for name, at, rate in zip(model.states, x0, rates, strict=True)
    ]
    lines += [f"  {name} = {at:.4g}" for name, at in zip(model.inputs, u0, strict=True)]
    if kinks:
        lines += ["", "values or slopes that may jump: " + ", ".join(kinks)]
    return "\n".join(lines)


def one_3211_each(system: StateSpace, unit: float = 0.7, dt: float = 0.02) -> list[Record]:
    """3-2-1-1 on each control, of 5 % of its travel, 16 s, and the model's response to it."""
    # The response is the one that stays bounded, over and over again, less its mean: how large it
    # is must not depend on how fast a guess diverges.
    t = dt * np.arange(round(16 / dt))
    edges = 2 + unit * np.array([0, 3, 5, 6, 7])
    signal = 0.05 * np.array([0, 1, -1, 1, -1, 0])[np.searchsorted(edges, t, side="right")]
    spectrum = np.fft.rfft(signal)[1:, None]
    G = system.response(2 * np.pi * np.fft.rfftfreq(len(t), dt)[1:])
    records = []
    for i, name in enumerate(system.inputs):
        u = np.zeros((len(t), system.nu))
        u[:, i] = signal
        Y = np.vstack([np.zeros(system.ny), G[:, :, i] * spectrum])
        y = np.fft.irfft(Y, n=len(t), axis=0)
        records.append(Record(t, u, y, system.inputs, system.outputs, f"3-2-1-1 {name}"))
    return records


def _entries(model: Model) -> dict[str, list[list[str]]]:
    """Every entry as a formula of parameter names and trim numbers, "." for a structural zero."""
    names = model.parameter_names()
    symbols = [ca.SX.sym(name) for name in names]
    parts = model.matrices()(ca.vertcat(*symbols))[:4]
    return {
        letter: [[_formula(part, i, j) for j in range(part.shape[1])] for i in range(part.shape[0])]
        for letter, part in zip("ABCD", parts, strict=True)
    }


def _formula(part: ca.SX, i: int, j: int) -> str:
    if not part.sparsity().has_nz(i, j):
        return "."
    text = str(part[i, j])
    return text[1:-1] if text.startswith("(") and text.count("(") == 1 else text


def _grid(
    title: str, rows: Sequence[str], columns: Sequence[str], cells: Sequence[Sequence[str]]
) -> str:
    """Text table: a title, column names, and a name before every row."""
    table = [["", *columns], *([name, *row] for name, row in zip(rows, cells, strict=True))]
    width = [max(len(row[j]) for row in table) for j in range(len(table[0]))]
    lines = ["  " + "  ".join(c.rjust(w) for c, w in zip(row, width, strict=True)) for row in table]
    return "\n".join([title, *lines])
