"""Settings shared by all tests."""

import os

from hypothesis import settings

collect_ignore = ["atheris_readers.py"]  # a script for a tool that only a campaign needs

settings.register_profile("dev", max_examples=25, deadline=None)
settings.register_profile("ci", max_examples=200, deadline=None, derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))
