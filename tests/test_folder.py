"""Files that are replaced whole, and folders that one run holds."""

import pytest

from casid.folder import PARTIAL, claimed, replacing


def interrupted(path):
    """Half a file is written when Ctrl-C comes."""
    with replacing(path) as temporary:
        temporary.write_text("tw")
        raise KeyboardInterrupt


def test_a_file_is_replaced_whole_or_left_as_it_was(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    with replacing(path) as temporary:
        temporary.write_text("one")
        assert not path.exists()
    assert path.read_text() == "one"
    with pytest.raises(KeyboardInterrupt):
        interrupted(path)
    assert path.read_text() == "one"
    assert [each.name for each in path.parent.iterdir()] == ["file.txt"]


def test_a_failure_to_write_names_the_file_and_not_the_temporary_one(tmp_path):
    (tmp_path / "file").mkdir()
    with pytest.raises(OSError, match="file") as caught, replacing(tmp_path / "file") as temporary:
        temporary.write_text("x")
    assert caught.value.filename == str(tmp_path / "file")


def test_a_folder_is_held_by_one_run_and_cleared_of_what_a_killed_one_left(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    left = folder / f".fit.json.x{PARTIAL}"
    left.write_text("half")
    with claimed(folder):
        assert not left.exists()
        with pytest.raises(ValueError, match="another run is writing there"), claimed(folder):
            pass
    with claimed(folder) as again:
        assert again == folder
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot write results there"), claimed(tmp_path / "file"):
        pass
