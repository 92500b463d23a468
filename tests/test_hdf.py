"""MATLAB files of version 7.3, byte by byte as their format says."""

import gc
import resource
import sys

import h5py
import numpy as np
import pytest

from casid.hdf import is_hdf, read_hdf, write_hdf


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
