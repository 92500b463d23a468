"""C source and FMUs: compiled, called, and compared with the simulation casid itself uses."""

import ctypes
import re
import shutil
import subprocess
import zipfile

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from truths.climbing import AIRCRAFT, X0, by_casid, commands
from truths.systems import stepped_input, unstable_plant

from casid import StateSpace, equations_of, without_delay, write_c, write_fmu

DT, N = 0.04, 80
COMPILER = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


class Library:
    """A compiled file, called by CasADi's convention: arrays of pointers, a return of zero."""

    def __init__(self, source, folder):
        place = folder / "model.so"
        options = ["-O2", "-fPIC", "-shared"]
        subprocess.run([COMPILER, *options, source, "-o", place, "-lm"], check=True)
        self._library = ctypes.CDLL(str(place))

    def __call__(self, name, *arguments, sizes):
        pointer = ctypes.POINTER(ctypes.c_double)
        given = [np.ascontiguousarray(each, dtype=float) for each in arguments]
        made = [np.zeros(size) for size in sizes]
        inputs = (pointer * len(given))(*(each.ctypes.data_as(pointer) for each in given))
        outputs = (pointer * len(made))(*(each.ctypes.data_as(pointer) for each in made))
        function = getattr(self._library, name)
        work = [getattr(self._library, f"{name}_work")]
        counts = [ctypes.c_longlong() for _ in range(4)]
        assert work[0](*map(ctypes.byref, counts)) == 0
        iw = (ctypes.c_longlong * max(1, counts[2].value))()
        w = (ctypes.c_double * max(1, counts[3].value))()
        assert function(inputs, outputs, iw, w, 0) == 0
        return made


@needs_compiler
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("delay", [(0.0, 0.0), (0.012, 0.0), (0.04, 0.09), (0.26, 0.013)])
def test_compiled_source_steps_as_the_simulation(tmp_path, hold, delay):
    plant = unstable_plant()
    system = StateSpace(
        plant.A, plant.B, plant.C, plant.D, None, plant.inputs, plant.outputs, (), np.array(delay)
    )
    write_c(tmp_path / "model.c", system, dt=DT, hold=hold)
    library = Library(tmp_path / "model.c", tmp_path)
    text = (tmp_path / "model.c").read_text("utf-8")
    memory = int(text.split("memory, ")[1].split(" ")[0])
    u, x0 = stepped_input(N, 2, np.random.default_rng(0), hold=5), np.arange(5.0) / 5
    (z,) = library("model_start", x0, u[0], sizes=[memory])
    y = np.empty((N, 3))
    for k in range(N):
        z, y[k] = library("model_step", z, u[k], sizes=[memory, 3])
    by_casid = system.simulate(DT * np.arange(N), u, x0, hold)
    np.testing.assert_allclose(y, by_casid, atol=1e-10 * np.abs(by_casid).max())


@needs_compiler
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_compiled_source_steps_a_nonlinear_structure(tmp_path, hold):
    write_c(tmp_path / "model.c", AIRCRAFT, dt=DT, hold=hold, steps=3)
    library = Library(tmp_path / "model.c", tmp_path)
    text = (tmp_path / "model.c").read_text("utf-8")
    assert "total values; 3 Runge-Kutta steps a sample" in text
    assert "V [m/s]" in text
    memory = int(text.split("memory, ")[1].split(" ")[0])
    u = commands()
    y = np.empty((len(u), 3))
    (z,) = library("model_start", X0, u[0], sizes=[memory])
    for k in range(len(u)):
        z, y[k] = library("model_step", z, u[k], sizes=[memory, 3])
    known = by_casid(AIRCRAFT, u, hold, 3)
    np.testing.assert_allclose(y, known, atol=1e-10 * np.abs(known).max())
    with pytest.raises(ValueError, match="steps=0"):
        write_c(tmp_path / "model.c", AIRCRAFT, dt=DT, steps=0)


@pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")
@needs_compiler
@pytest.mark.slow
def test_an_fmu_of_a_nonlinear_structure_starts_at_its_reference_condition(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    write_fmu(tmp_path / "aircraft.fmu", AIRCRAFT, pade=3)
    found = fmpy.simulate_fmu(
        str(tmp_path / "aircraft.fmu"), stop_time=3.0, output_interval=0.1,
        relative_tolerance=1e-11, start_values={"lon": 0.03}, output=list(AIRCRAFT.outputs),
    )  # fmt: skip
    own, u = equations_of(AIRCRAFT, 3), np.array([0.03, 3.6 / 8.2])
    known = scipy.integrate.solve_ivp(
        own.derivatives, (0, 3), own.x0, "DOP853", found["time"], args=(u,), rtol=1e-12, atol=1e-13
    )
    y = np.array([own.measurements(0.0, x, u) for x in known.y.T])
    for i, name in enumerate(AIRCRAFT.outputs):
        np.testing.assert_allclose(found[name], y[:, i], atol=1e-8 * np.abs(y).max())


@needs_compiler
def test_two_models_link_together(tmp_path):
    (tmp_path / "main.c").write_text(
        '#include "one.h"\n#include "two.h"\nint main(void) {return (int)(one_start_checkout() + '
        "two_start_checkout() + one_step_checkout() + two_step_checkout());}\n"
    )
    write_c(tmp_path / "one.c", unstable_plant(), dt=DT)
    write_c(tmp_path / "two.c", AIRCRAFT, dt=DT, steps=1)
    assert "two_step(z, u)" in (tmp_path / "two.h").read_text("utf-8")
    sources = [tmp_path / f"{name}.c" for name in ("main", "one", "two")]
    subprocess.run([COMPILER, *sources, "-o", tmp_path / "main", "-lm"], check=True)
    subprocess.run([tmp_path / "main"], check=True)


def test_the_comment_says_what_to_call(tmp_path):
    write_c(tmp_path / "roll.c", unstable_plant(), dt=DT)
    for end in ("c", "h"):
        text = (tmp_path / f"roll.{end}").read_text("utf-8")
        assert "u: a [-], b [-]" in text
        assert "Samples every 0.04 s, inputs held as foh" in text
    write_c(tmp_path / "odd.c", StateSpace([[-1]], [[1]], [[1]], [[0]], inputs=("a*/b",)), dt=DT)
    comment, _ = (tmp_path / "odd.c").read_text("utf-8").split("*/", 1)
    assert "SI units and radians" in comment


@needs_compiler
@pytest.mark.slow
def test_a_name_that_does_not_compile_is_told(tmp_path):
    pytest.importorskip("fmpy")
    with pytest.raises(ValueError, match=r"exp\.fmu: does not compile; expected a name"):
        write_fmu(tmp_path / "exp.fmu", unstable_plant())


def test_what_c_cannot_be_is_refused(tmp_path):
    plant = unstable_plant()
    discrete = StateSpace(plant.A, plant.B, plant.C, plant.D, 0.1)
    with pytest.raises(ValueError, match="a name that C takes"):
        write_c(tmp_path / "my model.c", plant, dt=DT)
    for name in ("double", "jac", "a__b"):
        with pytest.raises(ValueError, match=r"a name that C takes, such as model\.fmu"):
            write_fmu(tmp_path / f"{name}.fmu", plant, binary=False)
    with pytest.raises(ValueError, match="expected a positive interval"):
        write_c(tmp_path / "model.c", plant, dt=0.0)
    with pytest.raises(ValueError, match="convert it to continuous time"):
        write_c(tmp_path / "model.c", discrete, dt=DT)
    with pytest.raises(ValueError, match=r"such as model\.fmu"):
        write_fmu(tmp_path / "model.zip", plant)
    delayed = StateSpace(plant.A, plant.B, plant.C, plant.D, delay=(0.1, 0.0))
    with pytest.raises(ValueError, match=r"1e\+08 samples.*sample less often"):
        write_c(tmp_path / "model.c", delayed, dt=1e-9)
    with pytest.raises(ValueError, match="pass pade=3"):
        write_fmu(tmp_path / "model.fmu", delayed)


@pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")
@needs_compiler
@pytest.mark.slow
def test_an_fmu_runs_in_another_program(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    plant = unstable_plant()
    A = plant.A - 0.3 * np.eye(5)  # lightly damped: an error would not hide behind growth
    names = (("lat", "b"), ("p", *plant.outputs[1:]), ("p", "s2", "s3", "s4", "s5"))
    system = StateSpace(A, plant.B, plant.C, plant.D, None, *names, np.array([0.1, 0.0]))
    write_fmu(tmp_path / "plant.fmu", system, pade=3)
    x0 = np.arange(1.0, 6.0) / 5
    start = {name: float(x) for name, x in zip(("state_p", *names[2][1:]), x0, strict=True)}
    found = fmpy.simulate_fmu(
        str(tmp_path / "plant.fmu"), stop_time=4.0, output_interval=0.1, relative_tolerance=1e-11,
        start_values=start | {"lat": 0.5, "b": -0.2}, output=list(names[1]),
    )  # fmt: skip
    plain = without_delay(system, 3)  # constant inputs: the exponential of the augmented matrix
    M = np.block([[plain.A, plain.B], [np.zeros((2, plain.nx + 2))]])
    begin = np.concatenate([x0, np.zeros(plain.nx - 5), [0.5, -0.2]])
    states = np.array([scipy.linalg.expm(M * t) @ begin for t in found["time"]])
    y = states @ np.hstack([plain.C, plain.D]).T
    for i, name in enumerate(names[1]):
        np.testing.assert_allclose(found[name], y[:, i], atol=1e-8 * np.abs(y).max())


@needs_compiler
@pytest.mark.campaign
def test_inputs_that_change_reach_an_fmu_in_small_steps_of_euler_only(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    roll = StateSpace(
        [[-2.0, 0.0], [1.0, 0.0]], [[10.0], [0.0]], np.eye(2), np.zeros((2, 1)),
        inputs=("lat",), outputs=("p", "phi"), states=("p", "phi"),
    )  # fmt: skip
    write_fmu(tmp_path / "roll.fmu", roll)
    t = 0.02 * np.arange(1001)
    pulses = 0.1 * ((t > 1) & (t < 1.5)) - 0.1 * ((t >= 1.5) & (t < 2))
    u = pulses + 0.05 * np.sin(6 * t) * (t > 4)
    inputs = np.rec.fromarrays([t, u], names="time,lat")
    y = roll.simulate(t, u[:, None])

    def error(h, **ways):  # of the largest output; Euler also asks for event indicators: none
        found = fmpy.simulate_fmu(
            str(tmp_path / "roll.fmu"), stop_time=20.0, input=inputs, output_interval=h,
            output=["p", "phi"], **ways,
        )  # fmt: skip
        there = [np.interp(t, found["time"], found[name]) for name in roll.outputs]
        return np.max(np.abs(np.transpose(there) - y).max(axis=0) / np.abs(y).max(axis=0))

    half, whole = (error(h, solver="Euler", step_size=h) for h in (0.0005, 0.001))
    assert half < 0.002  # h |λ| + h max|u'| / max|u|, some 1e-3: of first order
    assert whole / half == pytest.approx(2, rel=0.1)
    assert error(0.0005) > 0.5


def test_an_fmu_of_source_holds_names_and_units(tmp_path):
    plant = unstable_plant()
    named = StateSpace(plant.A, plant.B, plant.C, plant.D, None, ("lat", "ped"), ("p", "r", "phi"))
    write_fmu(tmp_path / "plant.fmu", named, binary=False)
    with zipfile.ZipFile(tmp_path / "plant.fmu") as archive:
        about = archive.read("modelDescription.xml").decode()
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
    assert 'fmiVersion="3.0"' in about
    for text in ('name="lat"', 'name="phi"', "rad/s"):
        assert text in about


@pytest.mark.parametrize("states", [("state_p", "p"), ("p", "state_p")])
def test_variables_of_an_fmu_have_names_of_their_own(tmp_path, states):
    system = StateSpace(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), None, ("lat", "ped"),
                        ("p", "r"), states)  # fmt: skip
    write_fmu(tmp_path / "plant.fmu", system, binary=False)
    with zipfile.ZipFile(tmp_path / "plant.fmu") as archive:
        about = archive.read("modelDescription.xml").decode()
    found = re.findall(r'<Float64[^>]* name="([^"]+)"', about)
    assert {"p", "r", "state_p", "state_p_"} <= {*found}
    assert len(found) == len({*found})
