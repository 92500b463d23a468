"""Bad inputs, each with what its message must name: the culprit, and the remedy.

Every entry spoils a study that is in order (`small_study`): it edits or replaces one of its files.
"""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.io

CORPUS: dict[str, tuple[Callable[[Path], None], str, str]] = {}


def bad(name, spoil, culprit, remedy):
    assert name not in CORPUS, name
    CORPUS[name] = (spoil, culprit, remedy)


# ---- how a study is spoilt ---------------------------------------------------------------------


def content(file, data):
    return lambda folder: (folder / file).write_bytes(data)


def edited(file, old, new):
    def spoil(folder):
        text = (folder / file).read_text(encoding="utf-8")
        assert old in text, old
        (folder / file).write_text(text.replace(old, new), encoding="utf-8")

    return spoil


def study(old, new):
    return edited("study.toml", old, new)


def model(old, new):
    return edited("roll.py", old, new)


def within(table, line):
    """A line more under a heading of the study, which may be a new one at its end."""

    def spoil(folder):
        path = folder / "study.toml"
        text = path.read_text(encoding="utf-8")
        heading = f"[{table}]\n"
        if heading in text:
            path.write_text(text.replace(heading, heading + line + "\n"), encoding="utf-8")
        else:
            path.write_text(f"{text}\n{heading}{line}\n", encoding="utf-8")

    return spoil


def cells(change, file="sweep.csv"):
    """A flight whose table of cells, header first, is changed in place."""

    def spoil(folder):
        path = folder / file
        rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
        rows = change(rows) or rows
        path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")

    return spoil


def cell(row, column, value):
    def change(rows):
        rows[row][column] = value

    return cells(change)


def column(position, value, files=("sweep.csv",)):
    """A whole column: the same text, or a function of what stands there."""

    def change(rows):
        for row in rows[1:]:
            row[position] = value(row[position]) if callable(value) else value

    def spoil(folder):
        for file in files:
            cells(change, file)(folder)

    return spoil


def instead(old, make, new):
    """Another file that the study names in place of one of its own."""

    def spoil(folder):
        make(folder / new)
        study(f'"{old}"', f'"{new}"')(folder)

    return spoil


def recoded(file, encoding):
    def spoil(folder):
        text = (folder / file).read_text(encoding="utf-8")
        (folder / file).write_bytes(text.encode(encoding))

    return spoil


def scaled(factor):
    return lambda text: repr(float(text) * factor)


def mat(**changes):
    """The sweep as a MATLAB file, with variables changed or (None) left out."""

    def make(path):
        table = np.loadtxt(path.with_name("sweep.csv"), delimiter=",", skiprows=1)
        variables = dict(zip(("t", "lat", "p", "phi"), table.T, strict=True)) | changes
        scipy.io.savemat(path, {key: each for key, each in variables.items() if each is not None})

    return make


def raw(data):
    return lambda path: path.write_bytes(data)


def truncated(path):
    mat()(path)
    path.write_bytes(path.read_bytes()[:2000])


def sparse(size):
    """A file of a size that costs nothing on the disk."""

    def make(path):
        with path.open("wb") as file:
            file.truncate(size)

    return make


ALL = ("3211.csv", "sweep.csv", "random.csv")
RANDOM = np.random.default_rng(5).bytes(4000)
TOO_LARGE = 2**31 + 1

# ---- flights -----------------------------------------------------------------------------------

bad("an empty flight", content("sweep.csv", b""), "sweep.csv", "expected a header line")
bad("blank lines only", content("sweep.csv", b"\n\n\n"), "sweep.csv", "expected a header line")
bad("a header only", content("sweep.csv", b"t,lat,p,phi\n"), "no samples", "record it again")
bad("random bytes", content("sweep.csv", RANDOM), "sweep.csv", "comma-separated text in UTF-8")
bad("null bytes", content("sweep.csv", bytes(4000)), "sweep.csv", "comma-separated text in UTF-8")
bad("UTF-16", recoded("sweep.csv", "utf-16"), "sweep.csv", "comma-separated text in UTF-8")
bad("Latin-1", content("sweep.csv", "t,lat,p,phi,Höhe\n".encode("latin-1")), "sweep.csv",
    "comma-separated text in UTF-8")  # fmt: skip
bad("a picture", content("sweep.csv", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"), "sweep.csv", "UTF-8")
bad("a duplicate column", cell(0, 3, "p"), "column 'p' stands there 2 times", "rename one")
bad("a missing column", cell(0, 3, "bank"), "no column 'phi'", "it has t, lat, p, bank")
bad("semicolons", edited("sweep.csv", ",", ";"), "';'", "separate them by commas")
bad("tabs", edited("sweep.csv", ",", "\t"), "'\\t'", "separate them by commas")
bad("no header", edited("sweep.csv", "t,lat,p,phi\n", ""), "begins with numbers",
    "write the channel names in its first line")  # fmt: skip
bad("text in a cell", cell(99, 2, "fast"), "'fast'", "leave the cell of a missing sample empty")
bad("a complex number", cell(99, 2, "1+2j"), "'1+2j'", "leave the cell of a missing sample empty")
bad("a short row", cells(lambda rows: [*rows[:50], rows[50][:2], *rows[51:]]), "sweep.csv",
    "leave the cell of a missing sample empty")  # fmt: skip
bad("a file cut off", lambda f: os.truncate(f / "sweep.csv", 9005), "sweep.csv",
    "leave the cell of a missing sample empty")  # fmt: skip
bad(
    "a header without end",
    content("sweep.csv", b"x" * 3_000_000),
    "sweep.csv",
    "comma-separated text",
)
bad("a folder", instead("sweep.csv", Path.mkdir, "folder.csv"), "is a folder", "name a file")
bad("a pipe", instead("sweep.csv", os.mkfifo, "pipe.csv"), "no ordinary file", "name a file")
bad("no such flight", study('"sweep.csv"', '"swep.csv"'), "'swep.csv'", "no file matches")
bad("a flight of 2 GiB", lambda f: sparse(TOO_LARGE)(f / "sweep.csv"), "sweep.csv", "decimate")

bad("a single sample", cells(lambda rows: rows[:2]), "record 'sweep'", "N >= 2")
bad(
    "two samples",
    cells(lambda rows: rows[:3]),
    "record 'sweep' has 2 samples",
    "at least 16 are wanted",
)
bad("a constant input", column(1, "0", ALL), "input 'lat'", "add a record that excites it")
bad("a constant output",
    lambda f: (column(2, "0.1", ALL)(f), study("noise = true", "noise = false")(f)),
    "output 'p'", "look at its sensor")  # fmt: skip
bad("an output never measured", column(2, "", ALL), "output 'p'", 'detrend="mean"')
bad("1e300", cell(99, 2, "1e300"), "channel 'p' reaches 1e+300", "mark missing samples")
bad("1e30", cell(99, 2, "1e30"), "channel 'p' reaches 1e+30 at sample 98", "mark missing samples")
bad("a number beyond doubles", cell(99, 2, "1e999"), "output 'p' is inf", "NaN")
bad("denormal numbers", column(2, "5e-324"), "channel 'p'", "leave the channel out")
bad(
    "infinity in an input",
    cell(99, 1, "inf"),
    "input 'lat' is inf at sample 98",
    "mark a missing sample with NaN",
)
bad("an input without samples", column(1, "nan", ALL), "input 'lat' is missing nearly everywhere", "Record.join")  # noqa: E501  # fmt: skip
bad("time in ms", column(0, scaled(1000), ALL), "time column 't'", 't = "ms"')
bad("time that stands", column(0, "3.88"), "does not increase at sample 1", "drop repeated")
bad(
    "time in whole seconds",
    column(0, lambda t: t.split(".")[0]),
    "time does not increase",
    "more digits",
)
bad("time backwards", cells(lambda rows: [rows[0], *rows[:0:-1]]), "does not increase", "reverse")
bad("a gap in time", cell(99, 0, ""), "t[98] = nan", "time must be finite")
bad("angles in degrees", column(3, scaled(3000)), "'phi'", 'phi = "deg"')
bad("rates in degrees", column(2, scaled(3000)), "'p'", 'p = "deg/s"')
bad("two flights of one name",
    lambda f: ((f / "more").mkdir(), (f / "sweep.csv").rename(f / "more/3211.csv"),
               study('"sweep.csv"', '"more/3211.csv"')(f)),
    "'3211'", "rename one")  # fmt: skip

# ---- MATLAB files ------------------------------------------------------------------------------

SAVE = "save it again, as version 7"
bad("an empty MATLAB file", instead("sweep.csv", raw(b""), "a.mat"), "a.mat", SAVE)
bad("text named .mat", instead("sweep.csv", raw(b"t,lat\n" * 99), "a.mat"), "a.mat", SAVE)
bad("random bytes named .mat", instead("sweep.csv", raw(RANDOM), "a.mat"), "a.mat", SAVE)
bad("a MATLAB file cut off", instead("sweep.csv", truncated, "a.mat"), "a.mat", SAVE)
bad("HDF5 cut off", instead("sweep.csv", raw(b"\x89HDF\r\n\x1a\n" + bytes(500)), "a.mat"),
    "a.mat", SAVE)  # fmt: skip
bad("a variable missing", instead("sweep.csv", mat(phi=None), "a.mat"), "'phi'", "it has t, lat, p")
bad("text in a variable", instead("sweep.csv", mat(phi="level"), "a.mat"), "'phi'", "numbers")
bad("a cell array", instead("sweep.csv", mat(phi=np.array([{}, 1], dtype=object)), "a.mat"),
    "'phi'", "numbers")  # fmt: skip
bad("variables of two lengths", instead("sweep.csv", mat(phi=np.ones(7)), "a.mat"), "phi 7",
    "one length")  # fmt: skip
bad("a matrix for a channel", instead("sweep.csv", mat(phi=np.ones((750, 2))), "a.mat"), "'phi'",
    "column")  # fmt: skip
bad("a MATLAB file of 2 GiB", instead("sweep.csv", sparse(TOO_LARGE), "a.mat"), "a.mat", "decimate")

# ---- study files -------------------------------------------------------------------------------

bad("an empty study", content("study.toml", b""), "[model]", "which a study needs")
bad("a study of random bytes", content("study.toml", RANDOM), "study.toml", "text in UTF-8")
bad("a study in UTF-16", recoded("study.toml", "utf-16"), "study.toml", "text in UTF-8")
bad("a study of 5 MiB", content("study.toml", b"#" * 5 * 2**20), "study.toml", "right file")
bad("a study cut off", lambda f: os.truncate(f / "study.toml", 60), "not TOML", "Unterminated")
bad("brackets without end", content("study.toml", b"a = " + b"[" * 50_000), "study.toml",
    "not TOML")  # fmt: skip
bad("a key given twice", study("past = 6", "past = 6\npast = 7"), "not TOML", "line")
bad("an unknown table", study("[pbsid]", "[pbsidd]"), "'pbsidd'", "did you mean 'pbsid'")
bad("an unknown key", study("order = 3", "ordre = 3"), "'ordre'", "did you mean 'order'")
bad("no validation", study("[records.validation]", "[records.frequency]"), "'validation'",
    'files = ["..."]')  # fmt: skip
bad("a table where a name belongs", study('title = "Roll near hover"', "title = {}"), "title",
    "expected str")  # fmt: skip
bad("a list where a table belongs", study("[noise.std]\np = 0.002\nphi = 0.002", "std = [1]"),
    "std is [1]", "expected a table")  # fmt: skip
bad("a number where files belong", study('["random.csv"]', "7"), "files = 7", "expected list")
bad("files that are numbers", study('["random.csv"]', "[7]"), "files = [7]", "a list of names")
bad("an unknown unit", study('lat = "%"', 'lat = "furlong"'), "'furlong'", "deg/s")
bad("a unit of no channel", study('lat = "%"', 'latt = "%"'), "'latt'", "lat")
bad("a unit that is a number", study('lat = "%"', "lat = 3"), "lat = 3", "expected str")
bad("a channel that is the time", within("channels", 'time = "lat"'), "'lat' is the time",
    "name another column")  # fmt: skip
bad("an unknown hold", within("channels", 'hold = "soh"'), "'soh'", '"foh" or "zoh"')
bad("a hold of one input", within("channels", 'hold = {lat = "zoh"}'), "'zoh'", "for all inputs")
bad("inputs of another model", within("channels", 'inputs = ["lon"]'), "inputs are lon",
    "leave the key out")  # fmt: skip
bad("a trim from nowhere", study('detrend = "identification"', 'detrend = "frequency"'),
    "'frequency'", "must be given")  # fmt: skip
bad("every 0th sample", within("records.validation", "decimate = 0"), "decimate = 0", "1 or more")
bad("every 10000th sample", within("records.validation", "decimate = 10000"), "step=10000",
    "expected 1 to 749")  # fmt: skip
bad("noise without a seed", study("seed = 1", ""), "seed", "expected an integer")
bad("negative noise", study("p = 0.002", "p = -0.002"), "std of p", "0 or more")
bad("infinite noise", study("p = 0.002", "p = inf"), "std of p", "0 or more")
bad("noise that is no number", study("p = 0.002", "p = nan"), "std of p", "0 or more")
bad("bounds the wrong way round", within("model.bounds", "Lp = [0, -9]"), "Lp", "swap")
bad("huge bounds", within("model.bounds", "Lp = [-1e300, 1e300]"), "Lp", "narrow it")
bad(
    "bounds that are no numbers",
    within("model.bounds", "Lp = [nan, 0.0]"),
    "Lp",
    "expected two numbers",
)
bad("one bound", within("model.bounds", "Lp = [0]"), "Lp = [0]", "expected [lower, upper]")
bad(
    "bounds of no parameter",
    within("model.bounds", "Lq = [0, 1]"),
    "'Lq'",
    "known are Yv, Lv, Lp, Llat",
)
bad("a guess that is no number", within("model.values", "Lp = nan"), "Lp", "finite")
bad("a guess outside its bounds", within("model.values", "Lp = 5.0"), "Lp", "outside")
bad("a trim that is infinite", within("model.trim", "g = inf"), "inf", "finite")
bad(
    "all parameters fixed",
    within("model", 'fixed = ["Yv", "Lv", "Lp", "Llat"]'),
    "fixed",
    "free one",
)
bad("fixed and unknown", within("model", 'fixed = ["Lq"]'), "'Lq'", "Lp")
bad("no order", study("order = 3", "order = 0"), "order", "1")
bad(
    "an order past all data",
    study("order = 3", "order = 1000000"),
    "order = 1000000",
    "the longest record, '3211', has 750 samples; lower it",
)
bad("an order that is true", study("order = 3", "order = true"), "order = True", "a whole number")
bad("an order in words", study("order = 3", 'order = "three"'), "order = 'three'", "a whole number")
bad("a negative pole", study("pole = 4.0", "pole = -4.0"), "pole", "> 0 rad/s")
bad("a window of nothing", study("past = 6", "past = 0"), "past = 0", "at least 2")
bad("a window below nothing", study("past = 6", "past = -1"), "past = -1", "at least 2")
bad(
    "infinite regularisation",
    within("pbsid", "regularisation = inf"),
    "regularisation = inf",
    "and finite",
)
bad(
    "a mask of another shape",
    study("feedthrough = false", "feedthrough = [1.0]"),
    "feedthrough has shape (1,), expected (2, 1)",
    "p, phi",
)
bad(
    "a mask that is one truth",
    study("feedthrough = false", "feedthrough = [true]"),
    "feedthrough has shape (1,)",
    "their names",
)
bad(
    "feedthrough of no output",
    study("feedthrough = false", 'feedthrough = ["P"]'),
    "'P'",
    "did you mean 'p'",
)
bad(
    "a chance below zero",
    study("[match]\n", "[sufficiency]\nlevel = -1.0\n[match]\n"),
    "[sufficiency]: level=-1",
    "such as 0.01",
)
bad(
    "a chance of one and a half",
    study("[match]\n", "[sufficiency]\nlevel = 1.5\n[match]\n"),
    "[sufficiency]",
    "level=1.5: expected the chance of a false alarm",
)
bad(
    "a band backwards",
    study("[match]\n", "[sufficiency]\nband = [5.0, 1.0]\n[match]\n"),
    "band=(5, 1) rad/s",
    "lowest < highest",
)
bad("an unknown weight", within("match", 'weight = "x"'), "weight='x'", "reachable")
bad("a shift to the left", within("match", "shift = -3.0"), "shift=-3", "0 or more")
bad("an infinite shift", within("match", "shift = inf"), "shift=inf", "finite")
bad(
    "frequencies in no words",
    study("{ from = 0.5, to = 5, points = 20 }", '""'),
    "omega = ''",
    "frequencies > 0",
)
bad(
    "a covariance that is none",
    study("[match]\n", "[output_error]\nR = [[1.0, 2.0], [3.0, 4.0]]\n[match]\n"),
    "[output_error]",
    "covariance",
)
bad(
    "a tolerance above all",
    within("match.solver", "tolerance = 1.5"),
    "tolerance = 1.5",
    "at most 0.1",
)
bad("no seconds", within("match.solver", "max_seconds = 0"), "max_seconds = 0", "at least 1e-09")
bad("a grid backwards", study("from = 0.5, to = 5", "from = 5, to = 0.5"), "omega", "from < to")
bad("frequencies below zero", study("{ from = 0.5, to = 5, points = 20 }", "[-1.0, 2.0]"), "omega",
    "frequencies > 0")  # fmt: skip
bad("frequencies that are no numbers",
    study("{ from = 0.5, to = 5, points = 20 }", '["slow", "fast"]'), "omega",
    "frequencies > 0")  # fmt: skip
bad("a billion frequencies", study("points = 20", "points = 1000000000"), "points", "at most")
bad(
    "a negative tolerance",
    within("match.solver", "tolerance = -1.0"),
    "tolerance",
    "expected at least",
)
bad(
    "no iterations",
    within("match.solver", "max_iterations = -3"),
    "max_iterations",
    "expected at least 1",
)
bad("no time", within("match.solver", "max_seconds = nan"), "max_seconds", "expected a number")
bad("an option IPOPT does not know", within("match.solver", "ipopt = { mu_strat = 1 }"),
    "mu_strat", "IPOPT")  # fmt: skip
bad("targets unknown", study("[match]\n", '[match]\ntargets = ["sky"]\n'), "sky", "black box")
bad("results in a file", study("[study]\n", '[study]\noutput = "roll.py"\n'), "roll.py",
    "name a folder")  # fmt: skip
bad("results in a null character", study("[study]\n", '[study]\noutput = "a\\u0000b"\n'), "output",
    "name a folder")  # fmt: skip
bad("a flight with a null character", study('"random.csv"', '"ran\\u0000dom.csv"'), "ran",
    "no file matches")  # fmt: skip
bad("a flight outside that is none", study('"random.csv"', '"/etc/passwd"'), "/etc/passwd",
    "no column")  # fmt: skip
bad("a title of 5 MiB", study("Roll near hover", "R" * 5 * 2**20), "study.toml", "right file")

# ---- models ------------------------------------------------------------------------------------

bad("no model", study('file = "roll.py:Roll"', ""), "[model]", "file.py:ClassName")
bad("no such model file", study("roll.py:Roll", "rool.py:Roll"), "rool.py", "check the path")
bad("no such class", study("roll.py:Roll", "roll.py:Rol"), "'Rol'", "it has Roll")
bad("a class that is no name", study("roll.py:Roll", "roll.py:../Roll"), "../Roll",
    "file.py:ClassName")  # fmt: skip
bad("a class that is no model", study("roll.py:Roll", "roll.py:Rows"), "'Rows'", "it has Roll")
bad("a model file that is a folder",
    lambda f: ((f / "m.py").mkdir(), study("roll.py:Roll", "m.py:Roll")(f)), "m.py",
    "name a file")  # fmt: skip
bad("a model of 5 MiB", content("roll.py", b"#" * 5 * 2**20), "roll.py", "right file")
bad("an empty model", content("roll.py", b""), "'Roll'", "it has none")
bad("a model of random bytes", content("roll.py", RANDOM), "roll.py", "does not import")
bad("a model in Latin-1", content("roll.py", "x = 'Höhe'\n".encode("latin-1")), "roll.py",
    "does not import")  # fmt: skip
bad("a model that does not parse", model("def A(self)", "def A(self"), "roll.py, line",
    "SyntaxError")  # fmt: skip
bad("a model that raises", model("class Roll", "1 / 0\n\n\nclass Roll"), "roll.py, line 7",
    "ZeroDivisionError")  # fmt: skip
bad("a model that leaves", model("class Roll", "raise SystemExit(0)\n\n\nclass Roll"),
    "roll.py, line 7", "SystemExit")  # fmt: skip
bad("a model that loops", model("class Roll", "while True:\n    pass\n\n\nclass Roll"),
    "roll.py, line 7", "does a loop never end")  # fmt: skip
bad("a matrix that loops", model("return [[self.Yv", "while True:\n            pass\n        return [[self.Yv"), "Roll.A", "does a loop never end")  # noqa: E501  # fmt: skip
bad("a matrix that raises", model("return [[self.Yv", "1 / 0\n        return [[self.Yv"), "Roll.A",
    "ZeroDivisionError")  # fmt: skip
bad("a matrix that leaves", model("return [[self.Yv", "exit(0)\n        return [[self.Yv"),
    "Roll.A", "SystemExit")  # fmt: skip
bad("a matrix without end", model("return [[self.Yv", "self.A()\n        return [[self.Yv"),
    "Roll.A", "RecursionError")  # fmt: skip
bad("a matrix of nan", model("[self.Yv, 0, self.g]", "[self.Yv, float('nan'), self.g]"), "Roll.A",
    "check the guess and the formula")  # fmt: skip
bad("a matrix of infinity", model("[[0], [self.Llat], [0]]", "[[0], [self.Llat], [float('inf')]]"),
    "Roll.B", "check the guess and the formula")  # fmt: skip
bad("nan by arithmetic", model("self.Lv, self.Lp, 0", "self.Lv, self.Lp, 1 / (self.Lp + 1.5)"),
    "Roll.A", "check the guess and the formula")  # fmt: skip
bad("no matrix", model("return [[0], [self.Llat], [0]]", "pass"), "Roll.B", "expected a list")
bad("a matrix in words", model("return [[0], [self.Llat], [0]]", 'return "B"'), "Roll.B",
    "expected a list")  # fmt: skip
bad("rows of two lengths", model("[self.Lv, self.Lp, 0]", "[self.Lv, self.Lp]"), "Roll.A",
    "the others have 3")  # fmt: skip
bad("shapes that disagree", model("[[0], [self.Llat], [0]]", "[[0], [self.Llat]]"), "Roll.B",
    "expected (3, 1)")  # fmt: skip
bad("a name misspelt", model("self.Yv, 0", "self.Yw, 0"), "'Yw'", "which Roll does not declare")
bad("a method not called", model("[[0], [self.Llat], [0]]", "[[0], [self.A], [0]]"), "Roll.B",
    "add ()")  # fmt: skip
bad("two states of one name", model('("v", "p", "phi"),', '("v", "p", "p"),'), "'p' twice",
    "rename one")  # fmt: skip
bad("a path for a name", model('("p", "phi")\n', '("p", "../../phi")\n'), "'../../phi'",
    "use letters, digits and underscores")  # fmt: skip
bad("a name that does not print", model('("p", "phi")\n', '("p", "phi\\x1b[2J")\n'), "phi\\x1b",
    "use letters, digits and underscores")  # fmt: skip
bad(
    "a parameter named as a matrix",
    model("Yv: Scalar", "system: Scalar"),
    "Roll.system",
    "rename it",
)
bad("a guess outside", model("default=-1.5", "default=1.5"), "Lp", "move the guess or the bound")
bad(
    "a guess of nan",
    model("default=-1.5", "default=float('nan')"),
    "Lp",
    "move the guess or the bound",
)
bad("a parameter without unit", model(', unit="rad/s^2"', ""), "Llat", "unit=")
bad("bounds of 1e300", model("upper=50.0", "upper=1e300"), "Llat", "narrow it")
bad("bounds reversed", model("lower=-10.0, upper=0.0", "lower=0.0, upper=-10.0"), "Lp", "swap")
bad("a delay of no input", model("    def B(self)", "    def delays(self):\n        return {'lon': 0.1}\n\n    def B(self)"), "'lon'", "lat")  # noqa: E501  # fmt: skip
bad("a negative delay", model("    def B(self)", "    def delays(self):\n        return {'lat': -0.1}\n\n    def B(self)"), "'lat'", "0 or more")  # noqa: E501  # fmt: skip
