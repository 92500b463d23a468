"""Text and JSON files: whole or not at all, and back as they were."""

import json

import numpy as np
import pytest

from casid.textfile import read_json, stored_number, write_json, write_result, write_text
from casid.values import check_digest


def test_json_is_plain_and_keeps_nan_and_infinity(tmp_path):
    file = tmp_path / "new" / "a.json"
    content = {"a": np.eye(2), "b": (np.nan, np.inf, -np.inf), "c": np.float64(2), "d": {3: None}}
    write_json(file, content)
    read = read_json(file)
    assert read["a"] == [[1, 0], [0, 1]]
    assert read["d"] == {"3": None}
    np.testing.assert_array_equal([stored_number(v) for v in read["b"]], [np.nan, np.inf, -np.inf])
    assert stored_number(read["c"]) == 2.0
    json.loads(file.read_text())  # no NaN literals, which are not JSON


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    file = tmp_path / "a.json"
    write_text(file, "old")
    with pytest.raises(TypeError):
        write_json(file, {"a": object()})
    with pytest.raises(UnicodeEncodeError):
        write_text(file, "\ud800")
    assert file.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_json_that_is_none_is_told(tmp_path):
    (tmp_path / "a.json").write_text("{")
    (tmp_path / "b.json").write_text("[1]")
    for name, message in (
        ("a", "cannot read it as JSON"),
        ("b", "expected a JSON object, found list"),
        ("c", "cannot read it as JSON"),
    ):
        with pytest.raises(ValueError, match=f"{name}.json: {message}"):
            read_json(tmp_path / f"{name}.json")


def test_a_result_tells_any_change_but_of_its_layout(tmp_path):
    file = tmp_path / "result.json"
    write_result(file, {"casid": "fit", "cost": np.inf, "R": np.array([[0.1, np.nan]])})
    content = read_json(file)
    check_digest(content, file)
    with pytest.raises(ValueError, match="changed after casid wrote it"):
        check_digest(content | {"cost": "-inf"}, file)
    check_digest({"casid": "fit"}, file)  # of before there were any
    with pytest.raises(ValueError, match="changed after casid wrote it"):
        check_digest({"casid": "result"}, file)  # which always had one
