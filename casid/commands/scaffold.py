"""A first model file, commented, for a user to change."""

import importlib.util
import keyword
import sys
from pathlib import Path

from casid.textfile import write_text

TEMPLATE = Path(__file__).with_name("structure.py.txt")


def new_model(name: str) -> tuple[Path, str]:
    """Write a model file that checks; its path and the name of its class.

    The name is ``my_roll``, ``my_roll.py`` or a path with folders that are there; the class is then
    ``MyRoll``. ValueError: no name for Python, a file that is there, a folder that is not.
    """
    path = Path(name)
    if not path.name:
        raise ValueError("a model file needs a name, such as my_roll")
    path = path if path.suffix == ".py" else path.with_name(f"{path.name}.py")
    stem = path.stem
    if not stem.isidentifier() or not stem.isascii() or keyword.iskeyword(stem):
        raise ValueError(
            f"{name!r}: a model file needs a name that Python imports, such as my_roll "
            "(letters, digits and _, a letter first)"
        )
    words = "".join(word[:1].upper() + word[1:] for word in stem.split("_"))
    if not words[:1].isalpha() or words == "Model":
        raise ValueError(f"{name!r}: no class can be named after it; try my_{stem.strip('_')}")
    text = TEMPLATE.read_text(encoding="utf-8").format(title=words, name=words, file=path)
    if path.exists():
        raise ValueError(f"{path} is there already and is left as it is; choose another name")
    if stem in sys.stdlib_module_names or importlib.util.find_spec(stem) is not None:
        raise ValueError(f"{name!r}: Python has a module {stem} that it would hide; try my_{stem}")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}; make it first")
    write_text(path, text)
    return path, words
