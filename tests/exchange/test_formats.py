"""What goes into other tools' files comes back."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy.io
import scipy.linalg
import scipy.signal
from truths.roll_study import write_study
from truths.systems import same

from casid import FrequencyResponse, read_frequency_csv
from casid.errors import DataWarning
from casid.estimates import parameter_table
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
from casid.files import read_mat
from casid.fit import Fit
from casid.free import free_parameters
from casid.structure.modelfile import load_model
from models.lateral_directional import LateralDirectional

OMEGA = np.geomspace(0.1, 20, 15)


def test_parquet_gives_the_record_back(record, tmp_path):
    write_parquet(tmp_path / "flight.parquet", record)
    same(read_parquet(tmp_path / "flight.parquet"), record)


@pytest.mark.parametrize("since", [np.datetime64("2026-03-01T12:00:00"), np.timedelta64(3, "s")])
@pytest.mark.parametrize("indexed", [True, False])
def test_dates_of_a_parquet_file_are_read_as_seconds(tmp_path, since, indexed):
    times = since + (20 * np.arange(50)).astype("m8[ms]")
    frame = pd.DataFrame({"t": times, "lat": np.arange(50.0), "p": np.ones(50)})
    frame = frame.set_index("t") if indexed else frame
    frame.to_parquet(tmp_path / "a.parquet")
    wanted = 0.02 * np.arange(50) + (3.0 if since.dtype.kind == "m" else 0.0)
    read = read_parquet(tmp_path / "a.parquet", inputs=["lat"], outputs=["p"]).t
    for found in (read_table(tmp_path / "a.parquet")["t"], read):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


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
    told = {name: np.ones(1) for name in ("time_ms", "q [deg/s]", "r_deg/s", "r", "w_1")}
    changed = in_si(told, {"time_ms": "ms", "q [deg/s]": "deg/s", "r_deg/s": "deg/s"})
    assert list(changed) == ["time", "q", "r_deg/s", "r", "w_1"]
    assert changed["time"] == 1e-3
    pulses = {"lat_us": np.array([1500.0]), "p_deg/s": np.ones(1), "p [deg/s]": np.ones(1)}
    changed = in_si(pulses, {"lat_us": "us", "p_deg/s": "deg/s", "p [deg/s]": "deg/s"})
    assert changed["lat"] == in_si({"lat": np.array([1500.0])}, {"lat": "us"})["lat"] == 1.5
    assert len(changed) == 3
    assert list(in_si({"Stick [us]": np.array([1500.0])}, {"Stick [us]": "pwm"})) == ["Stick"]
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


@pytest.fixture
def response(system):
    G = system.response(OMEGA)
    G[3, 0, 1] = np.nan
    shape = G.shape
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.where(np.isnan(G), np.nan, 0.9),
        random_error=np.full(shape, 0.05), inputs=system.inputs, outputs=system.outputs,
        resolution=np.where(np.isnan(G), 0.0, 0.03 * OMEGA[:, None, None]),
        input_std=np.ones(2), output_std=np.ones(2),
    )  # fmt: skip


def test_a_response_survives_csv(response, tmp_path):
    write_frequency(tmp_path / "frf.csv", response)
    back = read_frequency_csv(tmp_path / "frf.csv", pairs=pairs_of(response))
    # Through dB and degrees and back: rounding, times the turns of the phase.
    np.testing.assert_allclose(back.G, response.G, rtol=1e-12)
    np.testing.assert_array_equal(back.coherence, response.coherence)
    np.testing.assert_array_equal(back.error, response.error)
    np.testing.assert_array_equal(back.resolution, response.resolution)
    assert list(frequency_table(response))[:3] == ["omega", "p_lat_dB", "p_lat_deg"]


def test_an_error_of_zero_is_written_as_none(response, tmp_path):
    exact = replace(response, random_error=np.zeros(response.G.shape))
    write_frequency(tmp_path / "frf.csv", exact)
    back = read_frequency_csv(tmp_path / "frf.csv", pairs=pairs_of(exact))
    assert np.isnan(back.error).all()


def test_matlab_has_the_response_as_frd_wants_it(response, tmp_path):
    write_frequency(tmp_path / "frf.mat", response)
    found = scipy.io.loadmat(tmp_path / "frf.mat", simplify_cells=True)
    np.testing.assert_array_equal(np.moveaxis(found["response"], 2, 0), response.G)
    assert list(found["inputs"]) == ["lat", "ped"]
    write_frequency(tmp_path / "frf.json", response)
    np.testing.assert_array_equal(FrequencyResponse.load(tmp_path / "frf.json").G, response.G)


@pytest.fixture
def fit(tmp_path):
    write_study(tmp_path)
    model = load_model("roll.py:Roll", tmp_path)()
    free = free_parameters(model)
    values = free.guess
    rows = parameter_table(free, values, np.zeros(len(values)), np.full(len(values), 0.1))
    return Fit(model=model, parameters=rows, cost=1.0, status="", success=True, iterations=1,
               seconds=0.0, method="output error", notes=None, free_names=free.names)  # fmt: skip


def test_matlab_has_the_fit_with_names(fit, tmp_path):
    write_fit_mat(tmp_path / "fit.mat", fit)
    found = scipy.io.loadmat(tmp_path / "fit.mat", simplify_cells=True)
    system = fit.model.system()
    np.testing.assert_array_equal(found["A"], system.A)
    assert list(found["states"]) == list(system.states)
    assert list(found["parameters"]) == [row.name for row in fit.parameters]
    np.testing.assert_array_equal(found["value"], [row.value for row in fit.parameters])


@pytest.mark.slow
def test_octave_simulates_the_fit_of_the_matlab_file_delays_exactly(fit, octave, tmp_path):
    late = replace(fit, model=LateralDirectional(tau_ped=0.13))
    write_fit_mat(tmp_path / "fit.mat", late)
    system = late.model.system()
    assert len(np.unique(system.delay)) > 1
    t, rng = 0.1 * np.arange(10), np.random.default_rng(2)
    u = rng.uniform(-0.1, 0.1, (len(t), system.nu))
    rates, outputs = "@(x, u) A * x + B * u", "@(x, u) C * x + D * u"
    y = octave(
        f"load fit.mat; y = simulate({rates}, {outputs}, t, u, zeros(rows(A), 1), delay);",
        t=t[:, None],
        u=u,
    )
    np.testing.assert_allclose(y, system.simulate(t, u), atol=1e-8 * np.abs(y).max(), rtol=0)


def test_pairs_whose_names_join_alike_are_kept_apart(response, tmp_path):
    alike = replace(response, inputs=("lat_x", "x"), outputs=("p", "p_lat"))
    write_frequency(tmp_path / "frf.csv", alike)
    back = read_frequency_csv(tmp_path / "frf.csv", pairs=pairs_of(alike))
    np.testing.assert_allclose(back.G, alike.G, rtol=1e-12)


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_points_to_distrust_are_told_where_a_file_does_not_hold_them(suffix, response, tmp_path):
    write_frequency(tmp_path / f"plain{suffix}", replace(response, flags={}))
    flagged = replace(response, flags={"inputs move together": (0, 1), "few periods": (1,)})
    with pytest.warns(DataWarning, match=r"2 frequencies to distrust, inputs move together, few"):
        write_frequency(tmp_path / f"flagged{suffix}", flagged)
    write_frequency(tmp_path / "flagged.json", flagged)
