"""How many wrong programs the tests notice: a fixed sample of mutants of the numerical packages.

    python -m benchmarks.mutants [--count 400] [--seed casid] [--processes 2] [PACKAGE ...]

A package is one such as bounds. Another seed draws another sample, of which no test has been told.

mutmut (its settings stand in pyproject.toml) breaks one expression at a time. Each such program has
to pass the tests of its module's own file, then those of its folder that reach the broken function,
the quickest first, as far as 20 seconds of processor time go. What fails is tried as the program
is. What was found is kept in mutants/ until the function changes, or, if it survived, the tests do:
a run may be stopped and started again. Survivors are listed with their change; those that no test
can tell from the original stand with the reason in mutants.toml beside this file. The table is
written to docs/mutants.md, if it is that of all packages and of the seed given there.
"""

import argparse
import contextlib
import fcntl
import hashlib
import importlib
import io
import json
import os
import re
import shutil
import signal
import sys
import time
import tomllib
from collections import Counter, defaultdict
from datetime import date
from functools import cache
from itertools import accumulate
from multiprocessing import get_context
from pathlib import Path

import pytest
from mutmut.__main__ import copy_also_copy_files, copy_src_dir, create_mutants
from mutmut.configuration import config
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.mutation.trampoline import set_mutant_under_test
from mutmut.state import state

ROOT = Path(__file__).parents[1]
WORK = ROOT / "mutants"
FOUND, REACH = WORK / "found.json", WORK / "reach"
SEED = "casid"
SECONDS = 20.0  # of processor time, for tests of other files than the module's
LIMIT = 60.0  # of processor time for tests to pass as the program is; a mutant has three times that
SURVIVED = {0: "survived", 4: "survived", 5: "no tests"}  # pytest's exit codes that notice nothing
PAGE = """# Do the tests notice?

On {day} the tests noticed {share} of a fixed sample of {count} of the {total} changes that
[mutmut](https://mutmut.readthedocs.io) makes to the numerical packages: an operator, a number, a
condition or an argument at a time. Functions with a decorator, messages of errors and what only
logs are left out.

Each such program has to pass the quick tests of its module's own file, then, for {seconds:.0f}
seconds, those of its folder that reach the change. What starts another program, such as the command
line's tests, is not among them, and a test that fails without the change, too, does not count. A
program that takes {limit:.0f} seconds counts as noticed. Changes that no test can tell from the
original stand with the reason in `benchmarks/mutants.toml`; they are no part of the share.

The sample are the first by a hash of the seed `{seed}` and their names, whatever else changes: a
smaller one is the beginning of a larger one. `make mutants` draws it and writes this page; it may
be stopped and goes on where it was.

| package | mutants | killed | survived | equivalent | share killed |
|---|---|---|---|---|---|
{rows}

## Survivors

{survivors}
"""


class Reach:
    """A plugin of pytest that finds the functions which a test that passes calls, and its time."""

    def __init__(self):
        self.found = {}

    def pytest_runtest_logstart(self):
        state()._stats.clear()
        self.start = time.process_time()

    def pytest_runtest_logreport(self, report):
        if report.when == "call" and report.passed:
            took = time.process_time() - self.start
            self.found[report.nodeid] = [took, sorted(state()._stats)]


def outcome(mutant, seconds, arguments, out, plugin=None):
    """Exit code of pytest in a process of its own with a mutant active, minus a signal's number."""
    child = os.fork()
    if not child:
        code = 3
        try:
            os.chdir(WORK)
            set_mutant_under_test(mutant)
            signal.setitimer(signal.ITIMER_PROF, seconds)  # of processor time
            signal.alarm(int(60 + 20 * seconds))  # where it only waits
            with Path(out).open("w", encoding="utf-8") as log:
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), 2)
            options = ["--rootdir=.", "-q", "--tb=line", *config().pytest_add_cli_args]
            code = pytest.main([*options, *arguments], plugin and [plugin])
            if plugin:
                Path(out).write_text(json.dumps(plugin.found), encoding="utf-8")
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@cache
def reach(file):
    """Processor time and functions reached of the tests of a file that pass as the program is."""
    known = REACH / f"{file.stem}-{digest(file)}-{program()}.json"
    with known.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # one process finds it, the others wait
        if not known.exists():
            made = known.with_suffix(".new")
            code = outcome("stats", 3600, [str(file.relative_to(WORK))], made, Reach())
            if code not in {0, 5}:
                print(f"{file}: {code}, tests that fail as the program is are left out", flush=True)
            made.replace(known)
    return json.loads(known.read_text(encoding="utf-8"))


def digest(*files):
    """A short digest of what files say."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


@cache
def program():
    """Digest of what every test depends on: the program and the tests' truths."""
    return digest(*sorted(ROOT.glob("casid/**/*.py")), *sorted(ROOT.glob("tests/truths/*.py")))


def closest(name):
    """The file of a mutant's module, where there is one, and the others of its folder."""
    *folders, module = name.split(".")[1:-1]
    place = WORK.joinpath("tests", *folders)
    own, chosen = place / f"test_{module}.py", config().pytest_add_cli_args_test_selection
    others = [f for f in sorted(place.glob("test_*.py")) if folders or f"tests/{f.name}" in chosen]
    return [own] * own.exists(), [f for f in others if f != own]


def tests_of(name, step):
    """Digest of the tests that a mutant may have to pass, up to a step."""
    own, others = closest(name)
    return digest(*own, *others * step)


def near(name):
    """Tests of the folder's other files that reach a mutant's function, the quickest first."""
    function = name.partition("__mutmut_")[0]
    found = [each for file in closest(name)[1] for each in reach(file).items()]
    tests = sorted((took, test) for test, (took, reached) in found if function in reached)
    spent = accumulate(took for took, _ in tests)
    return [test for (_, test), s in zip(tests, spent, strict=True) if s < SECONDS]


def sound(tests):
    """Whether tests pass as the program is, each time in the same way as with a mutant."""
    key = hashlib.sha256(" ".join([*tests, program()]).encode()).hexdigest()[:16]
    known = REACH / f"{key}.code"
    if not known.exists():
        code = outcome("", LIMIT, tests, os.devnull)
        known.write_text(str(code), encoding="utf-8")
    return known.read_text(encoding="utf-8") == "0"


def trial(task):
    """A mutant, the exit code of its tests of a step and the digest of all that it had to pass.

    The first step is the file of its module, the second the others that reach its function.
    """
    name, step = task
    log = WORK / "trials" / f"{name}-{step}.txt"
    tests = near(name) if step else [str(file.relative_to(WORK)) for file in closest(name)[0]]
    code, useless = 5, []
    while tests:
        code = outcome(name, 3 * LIMIT, ["-x", *tests, *useless], log)
        said = log.read_text(encoding="utf-8")
        failed = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", said, re.MULTILINE)
        if code in SURVIVED or sound(failed or tests):
            break
        print(f"{failed or tests}: not passed as the program is, and left out", flush=True)
        useless += [f"--deselect={test.partition('[')[0]}" for test in failed]
        code, tests = 0, [test for test in tests if failed and test not in failed]  # nor its file
    return name, code, tests_of(name, step)


def load():
    """What is known of mutants: exit code, digest of the function, digest of the tests."""
    return json.loads(FOUND.read_text(encoding="utf-8")) if FOUND.exists() else {}


def functions():
    """Digest of the function of every mutant."""
    found = {}
    for path in sorted(WORK.glob("casid/**/*.meta")):
        if (ROOT / path.relative_to(WORK)).with_suffix("").exists():
            meta = json.loads(path.read_text(encoding="utf-8"))
            for name in meta["exit_code_by_key"]:
                key = name.rpartition(".")[2].partition("__mutmut_")[0]
                found[name] = meta["hash_by_function_name"][key]
    return found


def package(name):
    """The package or module of a mutant: casid.frequency.spectra.x_... is of frequency."""
    return name.split(".")[1]


def sample(names, count, packages, seed=SEED):
    """The same mutants whatever else has changed: the first by a hash of their names."""
    chosen = [name for name in names if not packages or package(name) in packages]
    chosen.sort(key=lambda name: hashlib.sha256((seed + name).encode()).hexdigest())
    return chosen[:count]


def generate(processes):
    """Write the mutants beside copies of the tests and of what they need."""
    shutil.rmtree(WORK / "tests", ignore_errors=True)
    for folder in (REACH, WORK / "trials"):
        folder.mkdir(parents=True, exist_ok=True)
    with contextlib.redirect_stdout(io.StringIO()):
        copy_src_dir()
        copy_also_copy_files()
        create_mutants(processes)
    sys.path[:] = [str(WORK), *(p for p in sys.path if Path(p).resolve() != ROOT)]


def run(chosen, processes):
    """Exit codes of all mutants chosen."""
    digests, known = functions(), load()

    def settled(name, step):
        code, function, tests = known.get(name, (0, None, None))
        same = code not in SURVIVED or tests in {tests_of(name, s) for s in range(step, 2)}
        return function == digests[name] and same

    program()
    for module in ("casadi", "hypothesis", "scipy.signal", *map(module_of, chosen)):
        importlib.import_module(module)  # once, not for every mutant
    with get_context("fork").Pool(processes) as pool:
        for step in range(2):
            left = [(name, step) for name in chosen if not settled(name, step)]
            for name, code, tests in pool.imap_unordered(trial, left):
                known[name] = code, digests[name], tests
                FOUND.write_text(json.dumps(known, indent=1), encoding="utf-8")
                print(f"{step} {code:4} {name}", flush=True)
    return {name: known[name][0] for name in chosen}


def module_of(name):
    """The module of a mutant."""
    return name.rpartition(".")[0]


def change(name):
    """Lines a mutant takes away and adds."""
    lines = get_diff_for_mutant(name).splitlines()
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def survivors(codes):
    """Those of no use, and those that no test can tell from the original, by mutants.toml."""
    listed = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    reasons = {tuple(each["change"]) for each in listed["equivalent"]}
    alive = {name: change(name) for name, code in codes.items() if code in SURVIVED}
    same = {
        n for n, lines in alive.items() if tuple(x[0] + x[1:].strip() for x in lines) in reasons
    }
    return {name: lines for name, lines in alive.items() if name not in same}, same


def table(codes, alive, equivalent):
    """A row for each package and one for all."""
    rows = defaultdict(Counter)
    for name in codes:
        kind = "survived" if name in alive else "equivalent" if name in equivalent else "killed"
        for place in (package(name), "all"):
            rows[place][kind] += 1
    lines = []
    for place in sorted(rows, key=lambda each: (each == "all", each)):
        found = rows[place]
        told = found["killed"] + found["survived"]
        share = f"{100 * found['killed'] / told:.0f} %" if told else "–"
        counts = found.total(), found["killed"], found["survived"], found["equivalent"]
        lines.append("| " + " | ".join(map(str, (place, *counts, share))) + " |")
    return "\n".join(lines)


def listing(alive):
    """Names and changes of survivors, for the page."""
    blocks = ("\n".join(["```diff", f"# {name}", *lines, "```"]) for name, lines in alive.items())
    return "\n\n".join(blocks) or "None."


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--seed", default=SEED)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("packages", nargs="*")
    wanted = parser.parse_args()
    os.chdir(ROOT)
    os.environ |= {"HYPOTHESIS_PROFILE": "fixed", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    generate(wanted.processes)
    names = list(functions())
    chosen = sample(names, wanted.count, wanted.packages, wanted.seed)
    codes = run(chosen, wanted.processes)
    alive, equivalent = survivors(codes)
    for name, lines in alive.items():
        print(name, *lines, sep="\n    ")
    rows = table(codes, alive, equivalent)
    print(rows)
    if not wanted.packages and wanted.seed == SEED:
        share = rows.rpartition("|")[0].rpartition("|")[2].strip()
        said = {"count": len(codes), "total": len(names), "share": share, "seed": SEED}
        said["survivors"] = listing(alive)
        limits = {"seconds": SECONDS, "limit": 3 * LIMIT}
        page = PAGE.format(rows=rows, day=date.today(), **said, **limits)
        (ROOT / "docs" / "mutants.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
