"""What a MATLAB file holds, byte by byte as its format says, and the damage that ends SciPy."""

import gc
import resource
import sys
import zlib

import h5py
import numpy as np
import pytest
import scipy.io

from casid import read_mat
from casid.matlab import is_hdf, numeric_variables, read_hdf, write_hdf


@pytest.mark.parametrize("compressed", [False, True])
def test_variables_are_listed_with_what_they_are(tmp_path, compressed):
    content = {"t": np.arange(4.0), "n": np.int16([1, 2]), "z": np.array([1j]), "note": "level",
               "s": {"a": 1.0}}  # fmt: skip
    scipy.io.savemat(tmp_path / "a.mat", content, do_compression=compressed)
    wanted = {"t": True, "n": True, "z": False, "note": False, "s": False}
    assert numeric_variables(tmp_path / "a.mat") == wanted


@pytest.mark.parametrize("compressed", [False, True])
def test_a_matlab_file_whose_data_have_no_type_is_refused(tmp_path, compressed):
    file = tmp_path / "a.mat"
    scipy.io.savemat(file, {"t": np.arange(40.0), "note": "level", "z": np.array([1j])})
    data = bytearray(file.read_bytes())
    at = data.index(b"\x09\0\0\0" + (320).to_bytes(4, "little"))  # 40 doubles follow
    data[at : at + 4] = b"\x09\xfd\0\0"  # with such a type SciPy alone ends the process
    if compressed:
        packed = zlib.compress(data[128:])
        data[128:] = (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    file.write_bytes(data)
    with pytest.raises(ValueError, match=r"'t' has data of type 64777.*save it again"):
        read_mat(file, inputs=["t"], outputs=["t"], time=0.1)


def test_what_is_no_real_number_in_a_matlab_file_is_named(tmp_path):
    file = tmp_path / "a.mat"
    scipy.io.savemat(file, {"t": np.arange(4.0), "note": "level", "z": np.array([1j])})
    for name in ("note", "z"):
        with pytest.raises(ValueError, match=f"'{name}' holds no real array, expected numbers"):
            read_mat(file, inputs=["t"], outputs=[name], time=0.1)


@pytest.fixture
def complaints(monkeypatch):
    """What the interpreter could only print, because nobody was there to catch it."""
    found = []
    monkeypatch.setattr(sys, "unraisablehook", lambda each: found.append(str(each.exc_value)))
    return found


def test_a_file_of_version_7_3_is_what_matlab_expects(tmp_path):
    # MAT-File Format, "Level 7.3": 116 bytes of text, 8 of offset, version 0x0200, byte order;
    # HDF5 behind 512 bytes, arrays transposed, the class an attribute.
    path, table = tmp_path / "flight.mat", {"t": np.arange(5.0), "y": np.eye(5)[:, :2]}
    write_hdf(path, {name: np.asarray(each) for name, each in table.items()})
    head = path.read_bytes()[:520]
    assert head.startswith(b"MATLAB 7.3 MAT-file")
    assert head[124:128] == b"\x00\x02IM"
    assert head[512:520] == b"\x89HDF\r\n\x1a\n"
    with h5py.File(path) as file:
        assert file["y"].shape == (2, 5)
        assert file["y"].attrs["MATLAB_class"] == b"double"
    assert is_hdf(path)
    np.testing.assert_array_equal(read_hdf(path)["y"], table["y"])


def test_damage_and_text_are_refused_or_left_out(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file["x"], file["note"] = np.arange(3.0), "level"
    assert list(read_hdf(path)) == ["x"]
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(ValueError, match=r"cannot read it as a MATLAB file .*save it again"):
        read_hdf(path)


def test_a_full_disk_is_told_once_and_leaves_nothing(tmp_path, complaints):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"a\.mat"):
            write_hdf(tmp_path / "a.mat", {"M": np.arange(5000.0)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    gc.collect()
    assert not complaints
    assert not list(tmp_path.iterdir())
