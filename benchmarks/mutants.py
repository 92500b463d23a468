"""How many wrong programs the tests notice: a fixed sample of mutants of the numerical packages.

    python benchmarks/mutants.py [--count 400] [MODULE ...]     such as linear frequency

mutmut (its settings stand in pyproject.toml) breaks one expression at a time and runs tests that
reach it: those of its module first, then of its package, then others, the quickest first, as far as
half a minute goes. What was done before is kept in mutants/ until the function changes, so a run
may be stopped and started again; survivors are tried again, for there may be new tests. They are
listed with their change; those that no test can tell from the original stand with the reason in
mutants.toml beside this file. The table is written to docs/mutants.md.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from itertools import accumulate
from pathlib import Path

from mutmut.stats import status_by_exit_code

ROOT = Path(__file__).parents[1]
WORK = ROOT / "mutants"
STATS = WORK / "mutmut-stats.json"
SEED = "casid"
SECONDS = 30.0  # of tests for a mutant
PAGE = """# Do the tests notice?

A fixed sample of {count} changes to the numerical packages, drawn by
[mutmut](https://mutmut.readthedocs.io): an operator, a number, a condition or an argument at a
time, each run against half a minute of quick tests, those of its module and package first.
Functions with a decorator, messages of errors and what only logs are left out. Changes that no test
can tell from the original stand with the reason in `benchmarks/mutants.toml` and are not counted.
Made by `make mutants`.

| package | mutants | killed | survived | equivalent | share killed |
|---|---|---|---|---|---|
{rows}
"""


def mutmut(*arguments, **options):
    """Run the tool in the repository; returns what it printed, if that is captured."""
    run = [sys.executable, "-m", "mutmut", *arguments]
    return subprocess.run(run, cwd=ROOT, text=True, check=False, **options).stdout


def results():
    """Exit code of the tests by mutant, None where they have not been run."""
    found = {}
    for path in sorted(WORK.rglob("*.meta")):
        found |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return found


def package(name):
    """The package or module of a mutant: casid.frequency.spectra.x_... is of frequency."""
    return name.split(".")[1]


def sample(names, count, modules):
    """The same mutants whatever else has changed: the first by a hash of their names."""
    chosen = [name for name in names if not modules or package(name) in modules]
    return sorted(chosen, key=lambda name: hashlib.sha256((SEED + name).encode()).hexdigest())[
        :count
    ]


def keep_closest_tests():
    """Leave each function the tests that are closest to it, the quickest first."""
    stats = json.loads(STATS.read_text(encoding="utf-8"))
    reached, took = stats["tests_by_mangled_function_name"], stats["duration_by_test"]
    for function, tests in reached.items():
        *folders, module = function.split(".")[1:-1]
        places = (
            "/".join(["tests", *folders, f"test_{module}.py"]),
            "/".join(["tests", *folders, ""]),
        )

        def far(test, places=places):
            return [not test.startswith(place) for place in places], took.get(test, 0.0)

        near = sorted(tests, key=far)
        spent = accumulate(took.get(test, 0.0) for test in near)
        reached[function] = [t for t, s in zip(near, spent, strict=True) if s < SECONDS] or near[:1]
    STATS.write_text(json.dumps(stats), encoding="utf-8")


def change(name):
    """Lines a mutant takes away and adds."""
    lines = mutmut("show", name, stdout=subprocess.PIPE).splitlines()
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def table(chosen, codes, equivalent):
    """A row for each package and one for all."""
    rows = defaultdict(Counter)
    for name in chosen:
        status = status_by_exit_code[codes[name]]
        kind = "equivalent" if name in equivalent else status
        kind = kind if kind in {"equivalent", "survived", "no tests"} else "killed"
        for place in (package(name), "all"):
            rows[place][kind] += 1
    lines = []
    for place in sorted(rows, key=lambda each: (each == "all", each)):
        found, lived = rows[place], rows[place]["survived"] + rows[place]["no tests"]
        share = 100 * found["killed"] / max(found["killed"] + lived, 1)
        cells = (
            place,
            found.total(),
            found["killed"],
            lived,
            found["equivalent"],
            f"{share:.0f} %",
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("modules", nargs="*")
    wanted = parser.parse_args()
    # Writes the mutants and finds which tests reach what; "nothing matches" is the end of it.
    mutmut("run", "none", stderr=subprocess.DEVNULL)
    chosen = sample(results(), wanted.count, wanted.modules)
    keep_closest_tests()
    codes, alive = results(), {"not checked", "survived", "no tests"}
    left = [name for name in chosen if status_by_exit_code[codes[name]] in alive]
    if left:
        mutmut("run", "--max-children", str(wanted.processes), *left)
    codes = results()
    listed = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    reasons = {"\n".join(each["change"]): each["reason"] for each in listed["equivalent"]}
    equivalent = set()
    for name in chosen:
        if status_by_exit_code[codes[name]] in {"survived", "no tests"}:
            lines = change(name)
            if "\n".join(line[0] + line[1:].strip() for line in lines) in reasons:
                equivalent.add(name)
            else:
                print(name, *lines, sep="\n    ")
    rows = table(chosen, codes, equivalent)
    print(rows)
    if not wanted.modules:
        page = PAGE.format(count=len(chosen), rows=rows)
        (ROOT / "docs" / "mutants.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
