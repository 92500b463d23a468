"""A model as C source that steps it, and as a functional mock-up unit (FMI 3.0)."""

import re
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import chdir
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.channels import UNITS
from casid.checks import optional
from casid.exchange.delays import check_continuous, unused
from casid.exchange.equations import Equations, equations_of
from casid.exchange.stepping import steps_of, usual_steps
from casid.folder import replacing
from casid.linear import StateSpace
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold
from casid.textfile import write_texts

MOST = 10_000  # samples of a delay
SLOWEST = 3600.0  # s between samples
KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while"
)


def write_c(
    path: str | Path,
    system: StateSpace | NonlinearModel,
    *,
    dt: float,
    hold: Hold = "foh",
    steps: int | None = None,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write C source (C99, nothing to link but the mathematical library) that steps a model.

    The file ``model.c`` has two functions in the calling convention of CasADi's generated code,

        model_start(x0, u0) -> (z)  memory of the model at rest under u0, from the state x0
        model_step(z, u) -> (z, y)  outputs at this sample, memory for the next

    so that several models link together; exact for inputs that are held as said between samples
    and then delayed: as `StateSpace.simulate`. A nonlinear structure is integrated by the classical
    Runge-Kutta method, its delays exact too; total values then. Names, sizes and order of the
    channels stand in a comment.

    Parameters
    ----------
    path : path
        Ends in ``.c``; a header of the same name goes beside it.
    system : StateSpace or NonlinearModel
        Continuous; ``fit.model.system()`` of a fit, ``fit.model`` of a nonlinear one.
    dt : float
        Sampling interval [s].
    hold : {"foh", "zoh"}
        What inputs do between samples.
    steps : int
        Runge-Kutta steps a sampling interval of a nonlinear structure; unless given four within a
        radian of its fastest mode at the reference condition.
    units : mapping
        Of channels in others than their names or the structure say: ``fit.units``.

    Raises
    ------
    ValueError
        A discrete model, an interval that is not positive, a name that C does not take; a delay of
        more than 10,000 samples, all of which the memory would hold.
    """
    path = _taken(path, ".c")
    if not 0 < dt <= SLOWEST:
        raise ValueError(f"dt={dt}: expected a positive interval [s], {SLOWEST:g} at most")
    if steps is not None and steps < 1:
        raise ValueError(f"steps={steps}: expected a whole number above 0")
    linear = system.system() if isinstance(system, NonlinearModel) else system
    check_continuous(linear)
    if (longest := linear.delay.max(initial=0.0)) > MOST * dt:
        raise ValueError(
            f"dt={dt}: a delay of {longest:g} s takes a memory of {longest / dt:.3g} samples, more "
            f"than {MOST}; sample less often, or write without_delay(system, pade)"
        )
    if isinstance(system, NonlinearModel):
        count = steps or usual_steps(system, dt)
        (start, step), usual = steps_of(system, dt, hold, count), {**UNITS, **system.units}
        kind = f"total values; {count} Runge-Kutta steps a sample"
    else:
        (start, step), usual, kind = _steps(system, dt, hold), UNITS, "deviations from trim"
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        code = ca.CodeGenerator(path.stem, {"with_header": True, "cpp": False})
        for each in (start, step):  # named after the file, or two models would not link together
            given, names = each.sx_in(), (each.name_in(), each.name_out())
            code.add(ca.Function(f"{path.stem}_{each.name()}", given, each.call(given), *names))
        code.generate()
        source, header = (Path(f"{path.stem}.{end}").read_text("utf-8") for end in "ch")
    own = {**usual, **(units or {})}
    head = _comment(linear, (path.stem, dt, hold, kind), own, step.size1_in(0))
    write_texts({path: head + source, path.with_suffix(".h"): head + header})


def write_fmu(
    path: str | Path,
    system: StateSpace | NonlinearModel,
    *,
    pade: int | None = None,
    binary: bool = True,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write a model as an FMU for model exchange (FMI 3.0), by CasADi's exporter.

    Inputs and outputs have their names and units; a state that is an output too is called
    ``state_NAME``. A nonlinear structure has total values and starts at its reference condition.

    Parameters
    ----------
    path : path
        Ends in ``.fmu``.
    system : StateSpace or NonlinearModel
        Continuous; ``fit.model.system()`` of a fit, ``fit.model`` of a nonlinear one.
    pade : int
        Order of the Padé approximation of delays, see `without_delay`; needed where there are any.
    binary : bool
        Compile it for this machine; else it holds source only, for the importing tool to compile.
    units : mapping
        Of channels in others than their names or the structure say: ``fit.units``.

    Raises
    ------
    ValueError
        A discrete model, delays without ``pade``, a name that C does not take; a binary without
        FMPy (``pip install 'casid[fmu]'``: it has the interface's headers) or without a C compiler.
    """
    path = _taken(path, ".fmu")
    dae = _dae(path.stem, equations_of(system, pade, units))
    headers = _headers() if binary else ""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        files = dae.export_fmu({"no_warning": True, "with_serialization": False})
        _define_units(Path(next(name for name in files if name.endswith("modelDescription.xml"))))
        _answer_without_indicators(Path(f"{path.stem}_wrap.c"))
        if binary:
            try:
                files = dae.compile_fmu(files, {"include_dirs": [headers]})
            except RuntimeError as error:  # of a name such as exp, which only the compiler knows
                raise ValueError(
                    f"{path}: does not compile; expected a name that C takes and has no function "
                    "of, such as model.fmu, or a compiler that works"
                ) from error
        packed = Path(dae.pack_fmu(files, {"path": path.name})).read_bytes()
    with replacing(path) as temporary:
        temporary.write_bytes(packed)


def _taken(path: str | Path, suffix: str) -> Path:
    """A path whose stem may name functions in C; ValueError if not."""
    path = Path(path)
    valid = ca.Function.check_name(path.stem) and path.stem not in KEYWORDS.split()
    if path.suffix != suffix or not valid:
        raise ValueError(f"{path}: expected a name that C takes, such as model{suffix}")
    return path


def _steps(system: StateSpace, dt: float, hold: Hold) -> tuple[ca.Function, ca.Function]:
    """The functions ``start`` and ``step``.

    With x⁺ = A_d x + Σ_i W_i u_{k+1-i} and y = C x + Σ_i V_i u_{k-i} the memory is ξ = x - W_0 u,
    which needs no input of the next sample, and the inputs of the past.
    """
    W, V, Ad = _taps(system, dt, hold)
    past, nx = len(W) - 1, system.nx
    z = ca.SX.sym("z", nx + past * system.nu)
    u, x0 = ca.SX.sym("u", system.nu), ca.SX.sym("x0", nx)
    before = [z[nx + i * system.nu : nx + (i + 1) * system.nu] for i in range(past)]
    inputs = [u, *before]
    x = z[:nx] + _sparse(W[0]) @ u
    y = _sparse(system.C) @ x + sum(_sparse(V[i]) @ inputs[i] for i in range(len(V)))
    after = _sparse(Ad) @ x + sum(_sparse(W[i + 1]) @ inputs[i] for i in range(past))
    step = ca.Function(
        "step", [z, u], [ca.vertcat(after, *inputs[:past]), y], ["z", "u"], ["z_next", "y"]
    )
    rest = ca.vertcat(x0 - _sparse(W[0]) @ u, *[u] * past)
    return ca.Function("start", [x0, u], [rest], ["x0", "u0"], ["z"]), step


def _sparse(matrix: Array) -> ca.DM:
    return ca.sparsify(ca.DM(matrix))


def _taps(system: StateSpace, dt: float, hold: Hold) -> tuple[list[Array], list[Array], Array]:
    """W (nx, nu) and V (ny, nu) by the samples they look back, and A_d, from unit pulses."""
    reach = int(np.ceil(system.delay.max(initial=0.0) / dt)) + 2
    t = dt * np.arange(2 * reach + 2)
    pulses = np.zeros((system.nu, len(t), system.nu))
    pulses[:, 1] = np.eye(system.nu)
    found = [system.steps(t, u, hold) for u in pulses]
    forcing = [steps.forcing[: reach + 1] for steps in found]  # i samples before x[k + 1]: row i
    direct = [steps.direct[1 : reach + 2] for steps in found]
    W, V = (np.stack(each, axis=-1) for each in (forcing, direct))
    used = np.flatnonzero((W != 0).any(axis=(1, 2)) | (V != 0).any(axis=(1, 2)))
    last = int(used.max(initial=0)) + 1
    return list(W[:last]), list(V[:last]), found[0].maps[0]


def _comment(
    system: StateSpace, how: tuple[str, float, Hold, str], units: Mapping[str, str], memory: int
) -> str:
    """What a C programmer has to know; ``how``: name, interval, hold, what the values are."""
    name, dt, hold, kind = how

    def named(names: tuple[str, ...]) -> str:
        told = ", ".join(f"{name} [{units.get(name, '-')}]" for name in names)
        return told.replace("*/", "* /")  # which would end the comment

    return (
        f"/* Samples every {dt!r} s, inputs held as {hold}; delays of the inputs [s]: "
        f"{', '.join(f'{tau:g}' for tau in system.delay)}.\n"
        f"   x: {named(system.states)}\n   u: {named(system.inputs)}\n"
        f"   y: {named(system.outputs)}\n"
        f"   z: memory, {memory} numbers.\n"
        f"   {name}_start(x0, u0) -> z at the first sample;\n"
        f"   {name}_step(z, u) -> z of the next sample, y now.\n"
        f"   SI units and radians; {kind}. */\n"
    )


def _dae(name: str, system: Equations) -> ca.DaeBuilder:
    """The equations of a model without delays, variable by variable."""
    dae = ca.DaeBuilder(name)
    dae.add("time", "independent")
    taken = {*system.inputs, *system.outputs, "time"}

    def variable(label: str, causality: str, start: float = 0.0) -> ca.MX:
        unit = system.units.get(label.removeprefix("state_"), "")
        about: dict[str, Any] = {"unit": "" if unit == "-" else unit}
        if causality != "output":
            about["start"] = start
        if causality == "local":
            about["initial"] = "exact"
        made: ca.MX = dae.add(label, causality, "continuous", about)
        return made

    begin = zip(system.inputs, system.u0.tolist(), strict=True)
    u = ca.vertcat(*(variable(each, "input", start) for each, start in begin))
    states: list[str] = []
    for each in system.states:
        label = f"state_{each}" if each in taken else each
        states.append(unused(label, {*taken, *system.states, *states} - {each}))
    begin = zip(states, system.x0.tolist(), strict=True)
    each_x = [variable(label, "local", start) for label, start in begin]
    rates, values = system.function(ca.vertcat(*each_x), u)
    for i, state in enumerate(each_x):
        dae.eq(dae.der(state), rates[i])
    for i, label in enumerate(system.outputs):
        dae.eq(variable(label, "output"), values[i])
    return dae


def _define_units(path: Path) -> None:
    """Define the units that variables name, as the standard asks for; CasADi does not."""
    text = path.read_text("utf-8")
    names = sorted(set(re.findall(r'unit="([^"]+)"', text)))
    if names:
        defined = "".join(f'    <Unit name="{name}"/>\n' for name in names)
        units = f"  <UnitDefinitions>\n{defined}  </UnitDefinitions>\n"
        first = re.search(r"\s*<(DefaultExperiment|ModelVariables)\b", text)
        if first is None:
            raise RuntimeError(f"{path}: no variables in it; casid does not know this CasADi")
        at = first.start() + 1
        path.write_text(text[:at] + units + text[at:], "utf-8")


def _answer_without_indicators(path: Path) -> None:
    """Let a model without events say so; CasADi's is fatal, and FMPy's Euler always asks."""
    text = path.read_text("utf-8")
    refused = "  // No zero crossings\n  return fmi3Fatal;"
    if refused not in text:
        raise RuntimeError(f"{path}: no refusal of indicators; casid does not know this CasADi")
    path.write_text(text.replace(refused, refused.replace("Fatal", "OK")), "utf-8")


def _headers() -> str:
    """Folder of the interface's headers; a C compiler must be there too."""
    fmpy = optional("fmpy", "a compiled FMU", extra="fmu")
    if not (shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")):
        raise ValueError("no C compiler found: install one, or pass binary=False for source only")
    return str(Path(fmpy.__file__).parent / "c-code")
