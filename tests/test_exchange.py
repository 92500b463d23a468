"""What goes to other tools comes back, or does there what it does here."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import control
import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import scipy.linalg
import scipy.signal
from truths.roll_study import write_study

from casid import FrequencyResponse, Record, StateSpace, read_frequency_csv
from casid.exchange.formats import (
    frequency_table,
    in_si,
    pairs_of,
    read_parquet,
    read_record,
    read_table,
    write_fit_mat,
    write_frequency,
    write_mat,
    write_parquet,
    write_table,
)
from casid.exchange.objects import (
    from_control,
    from_dataframe,
    from_scipy,
    to_control,
    to_dataframe,
    to_scipy,
    without_delay,
)
from casid.exchange.standalone import write_module
from casid.files import read_mat
from casid.fit import Fit, parameter_table
from casid.model import free_parameters
from casid.structure.modelfile import load_model

OMEGA = np.geomspace(0.1, 20, 15)
LETTERS = "ABCD"


@pytest.fixture
def system():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((3, 3)) - 2 * np.eye(3)
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))
    return StateSpace(A, B, C, D, None, ("lat", "ped"), ("p", "r"), ("a", "b", "c"))


@pytest.fixture
def record():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.01, 0.03, 50))
    y = rng.standard_normal((50, 2))
    y[7, 1] = np.nan
    u = rng.standard_normal((50, 1))
    raw = Record(t, u, y, ("lat",), ("p", "phi"), "a flight", "zoh")
    return raw.detrend({"lat": 0.5, "p": 0.01, "phi": -0.02})


def same(a, b):
    for attribute in ("t", "u", "y"):
        np.testing.assert_array_equal(getattr(a, attribute), getattr(b, attribute))
    names = ("inputs", "outputs", "hold", "trim")
    assert [getattr(a, name) for name in names] == [getattr(b, name) for name in names]


# ---- systems -----------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [None, 0.02])
def test_python_control_keeps_matrices_names_and_interval(system, dt):
    there = to_control(replace(system, dt=dt))
    back = from_control(there)
    for letter in LETTERS:
        np.testing.assert_array_equal(getattr(back, letter), getattr(system, letter))
    assert (back.dt, back.inputs, back.outputs, back.states) == (
        dt, system.inputs, system.outputs, system.states,
    )  # fmt: skip
    assert there.isdtime(strict=True) == (dt is not None)


@pytest.mark.parametrize("dt", [None, 0.02])
def test_scipy_keeps_matrices_and_interval(system, dt):
    names = {"inputs": system.inputs, "outputs": system.outputs, "states": system.states}
    back = from_scipy(to_scipy(replace(system, dt=dt)), **names)
    for letter in LETTERS:
        np.testing.assert_array_equal(getattr(back, letter), getattr(system, letter))
    assert (back.dt, back.inputs) == (dt, system.inputs)


def test_a_transfer_function_of_scipy_becomes_a_system():
    lag = from_scipy(scipy.signal.lti([2.0], [0.5, 1.0]), inputs=["lat"], outputs=["p"])
    np.testing.assert_allclose(lag.response(OMEGA)[:, 0, 0], 2 / (1 + 0.5j * OMEGA), rtol=1e-12)


def test_a_transfer_function_of_control_becomes_a_system():
    lag = from_control(control.ss(control.tf([2.0], [0.5, 1.0])), delay=[0.1])
    expected = 2 / (1 + 0.5j * OMEGA) * np.exp(-0.1j * OMEGA)
    np.testing.assert_allclose(lag.response(OMEGA)[:, 0, 0], expected, rtol=1e-12)


def test_delays_are_never_dropped_in_silence(system):
    with pytest.raises(ValueError, match=r"delays \(ped 0.1 s\).*pade=3"):
        to_control(replace(system, delay=[0.0, 0.1]))
    assert to_control(replace(system, delay=())).nstates == 3


def test_a_pade_approximation_is_all_pass_and_right_in_phase_within_its_band(system):
    late = replace(system, delay=[0.05, 0.1])
    plain = without_delay(late, pade=3)
    assert (plain.nx, plain.inputs, plain.outputs) == (9, late.inputs, late.outputs)
    low = OMEGA[OMEGA < 15]
    # The error of the (3, 3) approximation is (ω τ)^7 / 1e5: 2e-4 at ω τ = 1.5.
    np.testing.assert_allclose(plain.response(low), late.response(low), rtol=5e-4, atol=1e-4)


def test_delays_of_a_discrete_model_become_states_exactly(system):
    late = replace(system, dt=0.02, delay=[0.04, 0.0])
    plain = without_delay(late)
    assert plain.nx == 5
    np.testing.assert_allclose(plain.response(OMEGA), late.response(OMEGA), rtol=1e-12)
    with pytest.raises(ValueError, match="no multiple"):
        without_delay(replace(late, delay=[0.05, 0.0]))


def test_a_discrete_system_without_interval_is_refused():
    with pytest.raises(ValueError, match="without a sampling interval"):
        from_control(control.ss(0.5, 1, 1, 0, True))


# ---- records -----------------------------------------------------------------------------------


def test_a_dataframe_gives_the_record_back(record):
    frame = to_dataframe(record)
    assert list(frame.columns) == ["lat", "p", "phi"]
    back = from_dataframe(frame)
    same(back, record)
    assert back.name == "a flight"


def test_a_foreign_frame_needs_names_and_takes_units(record):
    frame = to_dataframe(record).reset_index()
    frame.attrs = {}
    with pytest.raises(ValueError, match="which columns are inputs"):
        from_dataframe(frame)
    found = from_dataframe(frame, inputs=["lat"], outputs=["p"], units={"p": "deg/s"})
    np.testing.assert_allclose(found.channel("p"), np.radians(record.channel("p")), rtol=1e-14)
    with pytest.raises(ValueError, match="no column 'psi'; it has t, lat, p, phi"):
        from_dataframe(frame, inputs=["lat"], outputs=["psi"])
    frame["p"] = "fast"
    with pytest.raises(ValueError, match="'p' holds no numbers"):
        from_dataframe(frame, inputs=["lat"], outputs=["p"])


def test_an_index_of_time_deltas_is_time_in_seconds(record):
    frame = to_dataframe(record)
    frame.index = pd.to_timedelta(np.arange(50) * 20, unit="ms")
    np.testing.assert_allclose(from_dataframe(frame).t, 0.02 * np.arange(50), rtol=1e-12)


def test_parquet_gives_the_record_back(record, tmp_path):
    write_parquet(tmp_path / "flight.parquet", record)
    same(read_parquet(tmp_path / "flight.parquet"), record)


def test_a_small_file_of_many_numbers_is_refused_before_they_are_read(tmp_path, monkeypatch):
    write_table(tmp_path / "zeros.parquet", {"t": np.zeros(10_000), "p": np.zeros(10_000)})
    monkeypatch.setattr("casid.exchange.formats.TABLE_BYTES", 20_000)
    assert (tmp_path / "zeros.parquet").stat().st_size < 20_000
    with pytest.raises(ValueError, match=r"zeros\.parquet.*more than the"):
        read_table(tmp_path / "zeros.parquet")


def test_a_matlab_file_holds_total_values_as_csv_does(record, tmp_path):
    write_mat(tmp_path / "flight.mat", record)
    back = read_record(tmp_path / "flight.mat", inputs=["lat"], outputs=["p", "phi"])
    np.testing.assert_array_equal(back.t, record.t)
    # Trim was subtracted and is added again: two roundings.
    np.testing.assert_allclose(back.y, record.y + np.array([0.01, -0.02]), rtol=0, atol=1e-15)


def test_matlab_files_of_both_versions_read_alike(record, tmp_path):
    table = {"t": record.t, "lat": record.u[:, 0], "p": record.y[:, 0]}
    write_table(tmp_path / "five.mat", table)
    write_table(tmp_path / "seven.mat", table, version="7.3")
    for file in ("five.mat", "seven.mat"):
        back = read_mat(tmp_path / file, inputs=["lat"], outputs=["p"])
        np.testing.assert_array_equal(back.y[:, 0], record.y[:, 0])
        found = read_table(tmp_path / file)
        assert set(found) == set(table)
        np.testing.assert_array_equal(found["lat"], record.u[:, 0])


def test_a_file_of_version_7_3_is_what_matlab_expects(record, tmp_path):
    # MAT-File Format, "Level 7.3": 116 bytes of text, 8 of offset, version 0x0200, byte order;
    # HDF5 behind 512 bytes, arrays transposed, the class an attribute.
    write_mat(tmp_path / "flight.mat", record, version="7.3")
    head = (tmp_path / "flight.mat").read_bytes()[:520]
    assert head.startswith(b"MATLAB 7.3 MAT-file")
    assert head[124:128] == b"\x00\x02IM"
    assert head[512:520] == b"\x89HDF\r\n\x1a\n"
    with h5py.File(tmp_path / "flight.mat") as file:
        assert set(file) == {"t", "lat", "p", "phi"}
        assert file["lat"].shape == (1, record.N)
        assert file["lat"].attrs["MATLAB_class"] == b"double"
    back = read_record(tmp_path / "flight.mat", inputs=["lat"], outputs=["p", "phi"])
    np.testing.assert_allclose(back.y, record.y + np.array([0.01, -0.02]), rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match="version='6': expected one of 5"):
        write_mat(tmp_path / "flight.mat", record, version="6")


@pytest.mark.parametrize("suffix", ["csv", "mat", "parquet"])
def test_tables_survive_every_format_bit_by_bit(suffix, tmp_path):
    rng = np.random.default_rng(1)
    table = {"t": np.arange(30) / 7, "p": rng.standard_normal(30) * 1e-7, "q": np.full(30, np.nan)}
    write_table(tmp_path / f"table.{suffix}", table)
    back = read_table(tmp_path / f"table.{suffix}")
    for name, column in table.items():
        np.testing.assert_array_equal(back[name], column)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_name_that_would_rule_the_terminal_is_refused(suffix, tmp_path):
    table = {"t": np.arange(3.0), "p\x1b[2J": np.zeros(3)}
    write_table(tmp_path / f"table.{suffix}", table)
    with pytest.raises(ValueError, match=r"'p\\x1b\[2J' does not print; rename it"):
        read_table(tmp_path / f"table.{suffix}")


def test_units_are_converted_by_name():
    table = in_si({"t": np.zeros(2), "p": np.array([0.0, 180.0])}, {"p": "deg/s"})
    np.testing.assert_allclose(table["p"], [0, np.pi])
    with pytest.raises(ValueError, match="no column 'q'"):
        in_si(table, {"q": "deg/s"})
    with pytest.raises(ValueError, match="unknown unit"):
        in_si(table, {"p": "furlong"})


def test_what_is_no_table_says_why(tmp_path):
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 nothing")
    with pytest.raises(ValueError, match="cannot read it as Parquet"):
        read_table(tmp_path / "bad.parquet")
    with pytest.raises(ValueError, match=r"unknown suffix '\.xls'"):
        read_table(tmp_path / "a.xls")
    with pytest.raises(ValueError, match="no variable 'a-b'; rename"):
        write_table(tmp_path / "a.mat", {"a-b": np.zeros(2)})
    scipy.io.savemat(tmp_path / "two.mat", {"t": np.arange(3), "p": np.arange(4)})
    with pytest.raises(ValueError, match="vectors of one length; there are: t 3, p 4"):
        read_table(tmp_path / "two.mat")


@pytest.mark.parametrize("missing", ["pandas", "pyarrow"])
def test_a_missing_package_is_named_with_the_remedy(missing, record, tmp_path, monkeypatch):
    real = __import__("importlib").import_module

    def without(name, *rest):
        if name == missing:
            raise ImportError(f"No module named {name!r}")
        return real(name, *rest)

    monkeypatch.setattr("importlib.import_module", without)
    with pytest.raises(ValueError, match=rf"needs {missing}.*pip install 'casid\[tables\]'"):
        write_parquet(tmp_path / "a.parquet", record)
    assert not (tmp_path / "a.parquet").exists()


# ---- frequency responses -----------------------------------------------------------------------


@pytest.fixture
def response(system):
    G = system.response(OMEGA)
    G[3, 0, 1] = np.nan
    shape = G.shape
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.where(np.isnan(G), np.nan, 0.9),
        random_error=np.full(shape, 0.05), inputs=system.inputs, outputs=system.outputs,
        input_std=np.ones(2), output_std=np.ones(2),
    )  # fmt: skip


def test_a_response_survives_csv(response, tmp_path):
    write_frequency(tmp_path / "frf.csv", response)
    back = read_frequency_csv(tmp_path / "frf.csv", pairs=pairs_of(response))
    # Through dB and degrees and back: rounding, times the turns of the phase.
    np.testing.assert_allclose(back.G, response.G, rtol=1e-12)
    np.testing.assert_array_equal(back.coherence, response.coherence)
    assert list(frequency_table(response))[:3] == ["omega", "p_lat_dB", "p_lat_deg"]


def test_matlab_has_the_response_as_frd_wants_it(response, tmp_path):
    write_frequency(tmp_path / "frf.mat", response)
    found = scipy.io.loadmat(tmp_path / "frf.mat", simplify_cells=True)
    np.testing.assert_array_equal(np.moveaxis(found["response"], 2, 0), response.G)
    assert list(found["inputs"]) == ["lat", "ped"]
    write_frequency(tmp_path / "frf.json", response)
    np.testing.assert_array_equal(FrequencyResponse.load(tmp_path / "frf.json").G, response.G)


# ---- fitted models -----------------------------------------------------------------------------


@pytest.fixture
def fit(tmp_path):
    write_study(tmp_path)
    model = load_model("roll.py:Roll", tmp_path)()
    free = free_parameters(model)
    values = free.guess
    rows = parameter_table(free, values, np.zeros(len(values)), np.full(len(values), 0.1))
    return Fit(model=model, parameters=rows, cost=1.0, status="", success=True, iterations=1,
               seconds=0.0, method="output error", free_names=free.names)  # fmt: skip


def test_matlab_has_the_fit_with_names(fit, tmp_path):
    write_fit_mat(tmp_path / "fit.mat", fit)
    found = scipy.io.loadmat(tmp_path / "fit.mat", simplify_cells=True)
    system = fit.model.system()
    np.testing.assert_array_equal(found["A"], system.A)
    assert list(found["states"]) == list(system.states)
    assert list(found["parameters"]) == [row.name for row in fit.parameters]
    np.testing.assert_array_equal(found["value"], [row.value for row in fit.parameters])


RUN = """
import json, sys
sys.path.insert(0, {folder!r})
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("casid", "scipy", "casadi", "control", "pandas"):
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
import numpy as np
import model
data = np.load({data!r})
y = model.simulate(data["t"], data["u"], data["x0"], {hold!r})
np.save({out!r}, y)
print(json.dumps([model.STATES, model.INPUTS, model.OUTPUTS, model.UNITS, list(model.DELAY)]))
"""


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("regular", [True, False])
def test_the_module_without_casid_simulates_what_casid_does(system, hold, regular, tmp_path):
    late = replace(system, delay=[0.0, 0.137])
    rng = np.random.default_rng(2)
    t = np.arange(300) * 0.02 if regular else np.cumsum(rng.uniform(0.01, 0.03, 300))
    u, x0 = rng.standard_normal((300, 2)), rng.standard_normal(3)
    write_module(tmp_path / "model.py", late, title='A "hostile" """ title\n\\')
    np.savez(tmp_path / "data.npz", t=t, u=u, x0=x0)
    names = {"folder": str(tmp_path), "data": str(tmp_path / "data.npz"), "hold": hold,
             "out": str(tmp_path / "y.npy")}  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", RUN.format(**names)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    expected = late.simulate(t, u, x0, hold)
    # Another exponential and another order of additions: rounding of a sum of 300 terms.
    np.testing.assert_allclose(np.load(tmp_path / "y.npy"), expected, rtol=0,
                               atol=1e-12 * np.abs(expected).max())  # fmt: skip
    states, inputs, outputs, units, delay = json.loads(run.stdout)
    assert (states, inputs, outputs) == (["a", "b", "c"], ["lat", "ped"], ["p", "r"])
    assert units == {"lat": "travel", "ped": "travel", "p": "rad/s", "r": "rad/s"}
    assert delay == [0.0, 0.137]


def test_the_exponential_of_the_module_is_that_of_scipy(system, tmp_path):
    write_module(tmp_path / "model.py", system)
    namespace = {}
    exec(compile(Path(tmp_path / "model.py").read_text(), "model", "exec"), namespace)
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 0.1, 3.0, 40.0):
        M = size * rng.standard_normal((8, 8)) / 8
        expected = scipy.linalg.expm(M)
        np.testing.assert_allclose(namespace["matrix_exponential"](M), expected, rtol=0,
                                   atol=1e-12 * np.abs(expected).max())  # fmt: skip


def test_a_module_must_be_importable_and_continuous(system, tmp_path):
    with pytest.raises(ValueError, match="name that Python imports"):
        write_module(tmp_path / "my-model.py", system)
    with pytest.raises(ValueError, match=r"discrete with an interval of 0\.02 s"):
        write_module(tmp_path / "model.py", replace(system, dt=0.02))
    assert list(tmp_path.iterdir()) == []
