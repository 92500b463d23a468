"""Coverage-guided fuzzing of the file readers: ``python tests/atheris_readers.py csv``.

Needs atheris (a wheel exists for CPython 3.11 to 3.13 on Linux); arguments after the reader's name
are libFuzzer's. An exception that is no ValueError ends it with a trace and the damaged file.
"""

import sys
import tempfile
import warnings
from pathlib import Path
from types import FunctionType

import atheris
from truths import fuzzing

import casid.files
import casid.limits
import casid.matlab
import casid.textfile

CHECKS = {
    "csv": fuzzing.check_csv,
    "mat": fuzzing.check_mat,
    "mat 4": fuzzing.check_mat,
    "mat 7.3": fuzzing.check_mat,
    "response": fuzzing.check_response,
}


def main():
    kind, options = sys.argv[1], sys.argv[2:]
    warnings.simplefilter("ignore")
    for module in (
        casid.files,
        casid.matlab,
        casid.textfile,
        casid.limits,
    ):  # SciPy would take minutes
        for name, each in list(vars(module).items()):
            if isinstance(each, FunctionType) and each.__module__ == module.__name__:
                setattr(module, name, atheris.instrument_func(each))
    corpus = Path(tempfile.mkdtemp(prefix="casid-corpus-"))
    (corpus / "sound").write_bytes(fuzzing.SOUND[kind])
    atheris.Setup([sys.argv[0], *options, str(corpus)], CHECKS[kind])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
