"""Files that are replaced whole, and folders that one run holds."""

from contextlib import suppress
from pathlib import Path

import pytest

from casid.folder import PARTIAL, at_once, claimed, replacing

NAMES = ("card", "picture")


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


def written(folder, *stale, ending=None):
    """Two files at once, the block ended as is said."""
    with at_once(*stale) as place:
        for name in NAMES:
            with replacing(place(folder / name)) as temporary:
                temporary.write_text("new")
        if ending is not None:
            raise ending


def seen(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_files_of_one_result_are_replaced_all_or_none(tmp_path):
    former = dict.fromkeys(("card", "picture", "script", "mine"), "old")
    for name, text in former.items():
        (tmp_path / name).write_text(text)
    stale = [tmp_path / name for name in ("picture", "script", "none")]
    for ending in (KeyboardInterrupt(), OSError(28, "No space left on device")):
        with pytest.raises(type(ending)):
            written(tmp_path, *stale, ending=ending)
        assert seen(tmp_path) == former
    written(tmp_path, *stale)
    assert seen(tmp_path) == {"card": "new", "picture": "new", "mine": "old"}
    (tmp_path / "card").write_text("of before")
    (tmp_path / "picture").unlink()
    (tmp_path / "picture").mkdir()
    with pytest.raises(IsADirectoryError, match="picture"):
        written(tmp_path)
    (tmp_path / "picture").rmdir()
    assert seen(tmp_path) == {"card": "of before", "mine": "old"}


@pytest.mark.parametrize("moves", range(3))
def test_nothing_stale_stands_beside_what_is_new_whenever_a_run_is_killed(
    moves, tmp_path, monkeypatch
):
    for name in NAMES:
        (tmp_path / name).write_text("old")
    left, real = [moves], Path.replace

    def replace(path, target):
        if target.parent == tmp_path and not target.name.startswith("."):
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
        return real(path, target)

    monkeypatch.setattr(Path, "replace", replace)
    with suppress(KeyboardInterrupt):
        written(tmp_path, tmp_path / "picture")
    assert (
        seen(tmp_path)
        == [{"card": "old"}, {"card": "new"}, {"card": "new", "picture": "new"}][moves]
    )


def test_a_failure_to_write_at_once_names_the_file(tmp_path):
    def full(temporary):
        raise OSError(28, "No space left on device", str(temporary))

    with pytest.raises(OSError, match="No space") as caught, at_once() as place:
        full(place(tmp_path / "file"))
    assert caught.value.filename == str(tmp_path / "file")
    assert not list(tmp_path.iterdir())


def test_a_failure_to_write_names_the_file_and_not_the_temporary_one(tmp_path):
    (tmp_path / "file").mkdir()
    with pytest.raises(OSError, match="file") as caught, replacing(tmp_path / "file") as temporary:
        temporary.write_text("x")
    assert caught.value.filename == str(tmp_path / "file")


def test_a_folder_is_held_by_one_run_and_cleared_of_what_a_killed_one_left(tmp_path):
    folder = tmp_path / "out"
    for depth in ("", "stages", "stages/choice"):
        (folder / depth).mkdir(parents=True, exist_ok=True)
        (folder / depth / f".fit.json.x{PARTIAL}").write_text("half")
    with claimed(folder):
        assert not list(folder.rglob(f".*{PARTIAL}"))
        with pytest.raises(ValueError, match="another run is writing there"), claimed(folder):
            pass
        with pytest.raises(ValueError, match=r"\); wait$"), claimed(folder, "wait"):
            pass
    with claimed(folder) as again:
        assert again == folder
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot write results there"), claimed(tmp_path / "file"):
        pass
