"""A small study, run once for all tests of the report."""

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study
from casid.report import write_report


@pytest.fixture(scope="session")
def study_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="session")
def content(study_folder):
    """What the runner hands to the report at the end of a small study."""
    kept = []

    def keeping(content, sections, folder, place):
        kept.append(content)
        return write_report(content, sections, folder, place)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("casid.report.write_report", keeping)
        run_study(
            read_study(
                write_study(
                    study_folder,
                    (
                        "[records.validation]",
                        "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n"
                        "[records.validation]",
                    ),
                    ("[match]", "[frequency]\nomega = {from=0.6, to=5, points=20}\n\n[match]"),
                )
            )
        )
    return kept[0]


@pytest.fixture(scope="session")
def page(content, study_folder):  # noqa: ARG001 - the study is run once, by content
    return study_folder / "out" / "report.html"
