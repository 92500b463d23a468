"""What a MATLAB file holds, and the damage that would end SciPy's process."""

import zlib

import numpy as np
import pytest
import scipy.io

from casid import read_mat
from casid.matfile import numeric_variables


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
