"""What the fits of a comparison warned of, told when all are done: each text once, and whose it is.

A job keeps its warnings with its result, in whatever process it ran. Of trial fits that lost nobody
need know; of those that a comparison returns a user is told what each would have told by itself.
"""

import re
import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager

from casid.display import listed
from casid.errors import DataWarning, warn
from casid.jobs.store import Done

QUOTED = re.compile(r"((?<!\w)'[^']*')")  # names, whose digits are no figures
FIGURES = re.compile(
    r"\([^()]*\d[^()]*\)|(?<!response )(?<!\w)[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)"
)
SHARE = 0.1  # of draws that say the same, from which on it is not the noise of a few
FEWEST = 2


def kind(text: str) -> str:
    """The words of a text without its figures; names stay, and which response it is."""
    parts = QUOTED.split(text)
    return "".join(part if k % 2 else FIGURES.sub("#", part) for k, part in enumerate(parts))


def returned(done: Mapping[str, Done]) -> dict[str, tuple[str, ...]]:
    """What fits warned of, by name: of those that did not fail, of all where all did."""
    good = {name: each.warnings for name, each in done.items() if not each.reason}
    return good or {name: each.warnings for name, each in done.items()}


def sentences(said: Mapping[str, Sequence[str]], of: str = "case") -> list[str]:
    """Texts of fits by name, once each, with the names it is ``of`` unless it is of all.

    Texts that differ in figures alone count as one, of which the first stands.
    """
    return [_sentence(texts, len(said), of) for texts in _gathered(said)]


def tell(said: Mapping[str, Sequence[str]], of: str = "case", known: Collection[str] = ()) -> None:
    """Warn of `sentences`, but of texts that are known."""
    news = {name: [text for text in texts if text not in known] for name, texts in said.items()}
    for each in sentences(news, of):
        warn(each)


def tell_of_draws(said: Sequence[Sequence[str]], known: Collection[str] = ()) -> None:
    """Warn of what many of the fits to draws said, with how many; what is known stays out."""
    before = {kind(text) for text in known}
    for texts in _gathered({str(k): each for k, each in enumerate(said)}):
        first, text = next(iter(texts.items()))
        if len(texts) >= max(FEWEST, SHARE * len(said)) and kind(text) not in before:
            more = _differing(texts, f"draw {first}")
            warn(f"{len(texts)} of {len(said)} draws: {text}{more}")


@contextmanager
def heard() -> Iterator[list[str]]:
    """Within, warnings of data are told as ever, and afterwards stand in the list."""
    told: list[str] = []
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", DataWarning)
            yield told
    finally:
        told += [str(each.message) for each in caught]
        for each in caught:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


def _gathered(said: Mapping[str, Sequence[str]]) -> list[dict[str, str]]:
    """Texts of one kind by name; a fit that says two of a kind says two things."""
    found: dict[tuple[str, int], dict[str, str]] = {}
    for name, texts in said.items():
        before: Counter[str] = Counter()
        for text in dict.fromkeys(texts):
            words = kind(text)
            found.setdefault((words, before[words]), {})[name] = text
            before[words] += 1
    return list(found.values())


def _sentence(texts: Mapping[str, str], fits: int, of: str) -> str:
    names = [repr(name) for name in texts]
    whose = f"{of}{'s' * (len(names) > 1)} {listed(names)}: " * (len(names) < fits)
    return f"{whose}{next(iter(texts.values()))}{_differing(texts, f'{of} {names[0]}')}"


def _differing(texts: Mapping[str, str], first: str) -> str:
    """Whose figures stand in a text, where those of others are not the same."""
    return f" (figures of {first}; those of others differ)" * (len({*texts.values()}) > 1)
