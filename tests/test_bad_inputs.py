"""Whatever is wrong with an input: exit code 2, and a message that names culprit and remedy."""

import shutil

import pytest
from click.testing import CliRunner
from truths.bad_inputs import CORPUS
from truths.roll_study import write_study

from casid import limits
from casid.cli import main


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    write_study(folder)
    return folder


def test_the_corpus_is_large_enough():
    assert len(CORPUS) >= 60


def test_the_study_that_is_spoilt_is_in_order(sound):
    assert CliRunner().invoke(main, ["check", str(sound / "study.toml")]).exit_code == 0


@pytest.mark.parametrize("name", CORPUS, ids=lambda name: name.replace(" ", "-"))
def test_a_bad_input_gives_code_two_and_names_culprit_and_remedy(
    name, sound, tmp_path, monkeypatch
):
    spoil, culprit, remedy = CORPUS[name]
    folder = tmp_path / "study"
    shutil.copytree(sound, folder)
    spoil(folder)
    monkeypatch.setattr(limits, "USER_SECONDS", 0.3)
    result = CliRunner().invoke(main, ["identify", str(folder / "study.toml")])
    said = " ".join(result.stderr.split())
    assert result.exit_code == 2, (result.exception, result.output)
    assert said.startswith("Bad input: ")
    assert culprit in said
    assert remedy in said
