"""Settings shared by all tests."""

import os
import shutil
import signal
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 - loads the libraries that are limited
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits
from truths.roll_study import write_study

from casid import read_study, run_study

collect_ignore = ["atheris_readers.py"]  # a script for a tool that only a campaign needs

patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}  # no test times
settings.register_profile("dev", max_examples=25, **patient)
settings.register_profile("ci", max_examples=200, derandomize=True, **patient)
settings.register_profile("fixed", max_examples=25, derandomize=True, **patient)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))

BEGUN = {}  # generators of the tests' modules, and the states in which these were imported

signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
threadpool_limits(1)  # for what tests compute themselves; casid sets its own


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave to the campaigns what repeats with other parameters what the first ones show.

    And keep from where the modules' generators begin.
    """
    before = Counter()
    for module in {getattr(item, "module", None) for item in items} - {None}:
        drawn = [each for each in vars(module).values() if isinstance(each, np.random.Generator)]
        BEGUN[module] = [(each, each.bit_generator.state) for each in drawn]
    for item in items:
        mark = item.get_closest_marker("repeats")
        if mark and not item.get_closest_marker("campaign"):
            test = item.nodeid.partition("[")[0]
            before[test] += 1
            if before[test] > mark.args[0]:
                item.add_marker("campaign")


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The small study as it was run, once for all tests; to be read, or spoilt as `copy`."""
    return run_study(read_study(write_study(tmp_path_factory.mktemp("finished"))))


@pytest.fixture
def copy(finished, tmp_path):
    """A folder with the small study and its results, which `write_study` may change."""
    return Path(shutil.copytree(finished.report.parents[1], tmp_path / "study"))


@pytest.fixture
def undrawn(monkeypatch):
    """Reports stay empty: nothing is drawn that a test does not look at."""

    def write(_content, _sections, folder, _place):
        page = folder / "report.html"
        page.touch()
        return page

    monkeypatch.setattr("casid.report.write_report", write)


@pytest.fixture(autouse=True)
def own_draws(request):
    """Every test draws what it draws alone, whatever ran in its process before."""
    for generator, state in BEGUN.get(getattr(request.node, "module", None), ()):
        generator.bit_generator.state = state


@pytest.fixture(autouse=True)
def closed_figures():
    """No figure of a test stays open: the next one's pyplot would count it."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")
