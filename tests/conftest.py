"""Settings shared by all tests."""

import os
import sys

import pytest
import scipy.linalg  # noqa: F401 - loads the libraries that are limited
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

collect_ignore = ["atheris_readers.py"]  # a script for a tool that only a campaign needs

patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}  # no test times
settings.register_profile("dev", max_examples=25, **patient)
settings.register_profile("ci", max_examples=200, derandomize=True, **patient)
settings.register_profile("fixed", max_examples=25, derandomize=True, **patient)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))

threadpool_limits(1)  # for what tests compute themselves; casid sets its own


@pytest.fixture(autouse=True)
def closed_figures():
    """No figure of a test stays open: the next one's pyplot would count it."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")
