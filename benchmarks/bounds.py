"""What twelve cases of the UH-60 output error cost, measured in cold cases.

The cases are the structure's own bounds and eleven bands about the linearised derivatives, from
±200 % to ±20 %; the records and options those of examples/uh60/study.toml: all of them as flown,
and those of its output error alone. The cold case is the first of them alone, from the structure's
own guess. Both are timed whole: processes started, data sent, tables made.

    python -m benchmarks.bounds
"""

import os
import resource
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from compare_bounds import linearised  # noqa: E402 - found through the line above

from casid import compare_bounds  # noqa: E402
from casid.studies.study import read_records  # noqa: E402
from casid.studies.studyfile import read_study  # noqa: E402
from casid.threads import cores  # noqa: E402

WIDTHS = (200, 150, 120, 100, 80, 70, 60, 50, 40, 30, 20)  # % of the linearised values
LIMIT = 2.0


def spent() -> float:
    """Processor seconds of this process and of those it has waited for."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def timed(cases, *arguments, **settings):
    begin, before = time.perf_counter(), spent()
    found = compare_bounds(*arguments, cases=cases, **settings)
    return found, time.perf_counter() - begin, spent() - before


def ladder(model, records, shared):
    """Print what twelve cases cost beside the first of them alone."""
    cases = {"free": {}} | {f"±{width} %": f"±{width} %" for width in WIDTHS}
    alone, cold, cold_cpu = timed({"free": {}}, model, records, **shared)
    found, wall, cpu = timed(cases, model, records, **shared)
    assert not any(case.reason for case in found.cases)
    assert found["free"].cost == alone["free"].cost  # the same fit in any process
    for case in found.cases:
        print(f"  {case.name:8s} {case.fit.iterations:3d} iterations   +{case.increase:8.1f}"
              f", +{case.predicted:8.1f} predicted, {case.held} held")  # fmt: skip
    print(f"  one cold case {cold:.1f} s, twelve {wall:.1f} s on {cores()} processors")
    print(f"  processor time: {cold_cpu:.1f} s and {cpu:.1f} s: {cpu / cold_cpu:.1f} x")
    print(f"  twelve cases against a cold one (at most {LIMIT:g} x): {wall / cold:.1f} x")


def main() -> None:
    study = read_study(ROOT / "examples/uh60/study.toml")
    records = read_records(study)
    model = linearised(study.model)
    estimator = study.settings["output_error"]
    shared = {"start": study.model, "estimator": estimator}
    print("all eight records at 50 Hz:")
    ladder(model, records["identification"], shared)
    print("the four 3-2-1-1 records at 25 Hz, where processes take as long to start as a case:")
    ladder(model, records["refinement"], shared)


if __name__ == "__main__":
    main()
