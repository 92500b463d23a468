"""Tables that know their place: what is not there is named with what was meant."""

import pytest

from casid.tables import Table, read_toml


@pytest.mark.parametrize(
    ("take", "told"),
    [
        (lambda t: t.only(["ways"]), r"study \[way\]: unknown key 'wayz'; did you mean 'ways'"),
        (lambda t: t.take("wayz", str), r"study \[way\]: wayz = 3, expected str"),
        (lambda t: t.take("wayz", (str, list)), "expected str or list"),
        (lambda t: t.take("flag", int), "flag = True, expected int"),
        (lambda t: t.names("wayz"), "wayz = 3, expected list or str"),
        (lambda t: t.names("mixed"), "expected a list of names"),
        (lambda t: t.table("wayz"), "wayz is 3, expected a table"),
        (lambda t: t.table("none", needed=True), r"there is no table \[none\]"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(take, told):
    table = Table({"way": {"wayz": 3, "flag": True, "mixed": ["a", 1]}}, "study:").table("way")
    with pytest.raises(ValueError, match=told):
        take(table)


def test_what_is_right_is_taken():
    table = Table({"a": "x", "b": ["y", "z"], "n": {"p": 1, "q": 2.5}}, "study:")
    assert (table.names("a"), table.names("b"), table.names("c", ["d"])) == (
        ("x",), ("y", "z"), ("d",),
    )  # fmt: skip
    assert table.numbers("n") == {"p": 1.0, "q": 2.5}
    assert table.take("missing", int, 4) == 4


@pytest.mark.parametrize(
    ("content", "told"), [(b"[a", "not TOML"), (b"a = '\xff'", "save it as text in UTF-8")]
)
def test_a_file_that_is_no_toml_is_refused(content, told, tmp_path):
    (tmp_path / "study.toml").write_bytes(content)
    with pytest.raises(ValueError, match=told):
        read_toml(tmp_path / "study.toml")
