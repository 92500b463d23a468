"""Damaged inputs and what reading them may do: give a value, or raise a ValueError that says why.

Shared by the Hypothesis tests and the atheris harness.
"""

import json
import tempfile
from pathlib import Path

import numpy as np
import scipy.io
from click.testing import CliRunner
from hypothesis import strategies as st

from casid import Record, read_csv, read_frequency_csv, read_mat, write_csv, write_parquet
from casid.cli import main
from casid.exchange.formats import read_table
from casid.fit import Fit
from casid.jobs.store import Store
from casid.matlab import write_hdf
from casid.structure.modelfile import load_model
from casid.studies.study import read_records
from casid.studies.studyfile import read_study
from casid.textfile import read_json
from casid.values import content_digest
from truths.roll_study import MODEL, STUDY, write_study

_UNTIL_EXIT = tempfile.TemporaryDirectory(prefix="casid-fuzz-", ignore_cleanup_errors=True)
FOLDER = Path(_UNTIL_EXIT.name)
CHANNELS = {"inputs": ("lat",), "outputs": ("p", "phi")}
t = np.arange(40) * 0.04
PAIRS = {("p", "lat"): ("gain", "phase", "coherence")}
FLIGHT = Record(t, np.sin(t)[:, None], np.cos(np.outer(t, [1, 2])), **CHANNELS)


# ---- what is damaged ---------------------------------------------------------------------------


def _written(write, name, *arguments):
    write(FOLDER / name, *arguments)
    return (FOLDER / name).read_bytes()


VARIABLES = dict(zip(("t", "lat", "p", "phi"), [t, *FLIGHT.u.T, *FLIGHT.y.T], strict=True))
RESPONSE = b"omega,gain,phase,coherence\n" + b"".join(
    b"%g,%g,%g,0.9\n" % (w, 1 / w, -10 * w) for w in (0.5, 1, 2, 4, 8)
)
SOUND = {
    "csv": _written(write_csv, "sound.csv", FLIGHT),
    "mat": _written(scipy.io.savemat, "sound.mat", VARIABLES),
    "mat compressed": _written(
        lambda path, values: scipy.io.savemat(path, values, do_compression=True), "c.mat", VARIABLES
    ),
    "mat 4": _written(lambda path, values: scipy.io.savemat(path, values, format="4"), "4.mat",
                      VARIABLES),
    "mat 7.3": _written(write_hdf, "sound73.mat", VARIABLES),
    "parquet": _written(write_parquet, "sound.parquet", FLIGHT),
    "response": RESPONSE,
    "study": STUDY.encode(),
    "model": MODEL.encode(),
}  # fmt: skip
WORDS = {
    "csv": ["nan", "inf", "-", "1e999", "1e-320", ",", ",,", "\n", '"', "'", "\0", "\ufeff", "é",
            "0x1", "1_0", " ", "#", ";", "t", "phi", "1" * 400],
    "study": ["[", "]", "[[", "{", "}", "=", "\n", '"', "'", "nan", "inf", "-1", "0", "1e300",
              "true", "2020-01-01", "#", "\\u0000", "..", "/", "*", "**", "[model.bounds]\n",
              "[model.values]\n", "Lp = ", "hold = ", "decimate = ", "past", "order", "99999999"],
    "model": ["[", "]", "(", ")", ":", "\n", "    ", "0", "-1", "1e400", "float('nan')", "self",
              "self.", "Lp", "A", "None", "'", ",", "*", "/ 0", "parameter(", "default=", "lower=",
              "unit=", "def ", "return ", "lambda: ", "while True: pass\n", "class ", "{}", "()"],
    "json": ["null", "true", "1e999", "[", "]", "{", "}", ",", ":", '"', "-1", "NaN", "Infinity"],
}  # fmt: skip
WORDS["response"] = WORDS["csv"]


@st.composite
def damaged(draw, kind):
    """Bytes of a sound file after a few cuts, copies, insertions and flips."""
    data = bytearray(SOUND[kind])
    words = [word.encode() for word in WORDS.get(kind, ["\0", "\xff" * 8])]
    for _ in range(draw(st.integers(1, 6))):
        a = draw(st.integers(0, len(data)))
        b = min(len(data), a + draw(st.integers(0, 40)))
        match draw(st.sampled_from(["cut", "copy", "word", "bytes", "end"])):
            case "cut":
                del data[a:b]
            case "copy":
                data[a:a] = data[a:b]
            case "word":
                data[a:b] = draw(st.sampled_from(words))
            case "bytes":
                data[a:b] = draw(st.binary(max_size=16))
            case "end":
                del data[a:]
    return bytes(data)


leaves = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8),
    st.sampled_from(["inf", "-inf", "nan", "casid", "BlackBox", "StateSpace", "os:system", "array",
                     "casid.textfile:write_text", "value", "tuple", "mapping", "float"]),
)  # fmt: skip
trees = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.sampled_from(["casid", "result", "value", "fields", "array", "kind",
                                       "shape", "tuple", "mapping", "float", "x"]), inner,
                      max_size=4),
    max_leaves=12,
)  # fmt: skip


@st.composite
def altered(draw, sound):
    """JSON content with a few values, somewhere in it, replaced or left out."""
    content = json.loads(json.dumps(sound))
    for _ in range(draw(st.integers(1, 4))):
        where = content
        while True:
            keys = list(where) if isinstance(where, dict) else list(range(len(where)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            inside = where[key]
            if isinstance(inside, dict | list) and inside and draw(st.booleans()):
                where = inside
                continue
            if draw(st.booleans()):
                where[key] = draw(trees)
            else:
                del where[key]
            break
    return content


# ---- what reads it -----------------------------------------------------------------------------


def refused(read, *arguments, **options):
    """Why it is refused as bad input, if it is; all but a value or a ValueError gets through."""
    try:
        read(*arguments, **options)
    except ValueError as error:
        return str(error)
    return None


def _file(name, data):
    path = FOLDER / name
    path.write_bytes(data)
    return path


def check_csv(data):
    assert refused(read_csv, _file("fuzz.csv", data), **CHANNELS, detrend="first") != ""


def check_mat(data):
    assert refused(read_mat, _file("fuzz.mat", data), **CHANNELS) != ""


def check_response(data):
    assert refused(read_frequency_csv, _file("response.csv", data), pairs=PAIRS) != ""


def check_json(data):
    assert refused(read_json, _file("fuzz.json", data)) != ""


def check_fit(content):
    path = _file("fit.json", json.dumps(content).encode())
    assert refused(Fit.load, path, model=_structure()) != ""


def check_table(data):
    assert refused(read_table, _file("table.csv", data)) != ""


def check_parquet(data):
    assert refused(read_table, _file("table.parquet", data)) != ""


def check_convert(content):
    """From the command line, whatever a file of results says: done, or refused."""
    source = _file("results.json", json.dumps(content).encode())
    target = FOLDER / ("results.mat" if content.get("casid") == "fit" else "results.csv")
    result = CliRunner().invoke(
        main, ["convert", str(source), str(target), "--model", str(_study() / "roll.py:Roll")]
    )
    assert result.exit_code in (0, 2), result.exc_info


def check_simulate(content):
    """A saved fit on a record, likewise."""
    fit, folder = _file("simulated.json", json.dumps(content).encode()), _study()
    model = f"{folder / 'roll.py'}:Roll"
    command = ["simulate", str(fit), str(folder / "3211.csv"), "--model", model, "--unit", "lat=%"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code in (0, 2), result.exc_info


def check_stage(content):
    stages = FOLDER / "stages"
    stages.mkdir(exist_ok=True)
    if isinstance(content, dict):
        content["digest"] = content_digest(content)
    (stages / "pbsid.json").write_text(json.dumps(content), encoding="utf-8")
    Store(stages, (_structure(),)).get("pbsid", "k")  # a result or None, whatever is there


def check_study(data):
    folder = _study()
    (folder / "fuzz.toml").write_bytes(data)
    assert refused(lambda: read_records(read_study(folder / "fuzz.toml"))) != ""


def check_model(data):
    folder = FOLDER / "models"
    folder.mkdir(exist_ok=True)
    (folder / "fuzz.py").write_bytes(data)
    assert refused(lambda: load_model("fuzz.py:Roll", folder)().system()) != ""


def _study():
    folder = FOLDER / "study"
    if not folder.exists():
        folder.mkdir()
        write_study(folder)
    return folder


def _structure():
    return load_model("roll.py:Roll", _study())
