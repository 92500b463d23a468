"""Numbers as a reader wants them."""

import re
from collections.abc import Collection, Mapping, Sequence
from textwrap import shorten

import numpy as np

from casid.display import listed
from casid.fit import ParameterEstimate

TWO_LINES = 190  # letters on a terminal
SENTENCES = re.compile(r"(?<=\.) (?=[A-Z])")


def brief(caution: str) -> str:
    """A caution's first sentence, in two lines at most; the report has all of it."""
    return shorten(SENTENCES.split(caution)[0], TWO_LINES, placeholder=" …")


def number(value: float | None, digits: int = 4) -> str:
    """Four digits unless told otherwise, no needless exponent, a dash for NaN."""
    if value is None or np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        plain = 0 <= int(exponent) < 4  # 100 %, not 1e2 %
        text = f"{float(text):.0f}" if plain else f"{mantissa}e{int(exponent)}"
    return text.replace("-", "−")


def fitted(outputs: Sequence[str], unbiased: Collection[str]) -> str:
    """What follows every record of a validation."""
    if not unbiased:
        return "initial state and constant biases fitted"
    if not (rest := [name for name in outputs if name not in unbiased]):
        return "initial state fitted, no constant, as in the estimation"
    return f"initial state and constant biases of {listed(rest)} fitted, as in the estimation"


def percent(row: ParameterEstimate) -> str:
    """Standard error in percent of the value."""
    if not np.isfinite(row.std_error) or row.value == 0 or row.fixed:
        return "–"
    share = 100 * row.std_error / abs(row.value)
    return f"{share:.1f}" if share < 999.5 else "> 999"


def prior(row: ParameterEstimate) -> str:
    """Prior value of a parameter and its deviation, if it has one."""
    return "" if np.isnan(row.prior) else f"prior {number(row.prior)} ± {number(row.prior_std, 2)}"


def price(row: ParameterEstimate) -> str:
    """Price of the bound a parameter lies on."""
    return number(row.multiplier, 3) if row.active else ""


def costliest(shares: Mapping[str, float], count: int = 3) -> list[str]:
    """Names of the largest shares above zero."""
    dear = [name for name, share in shares.items() if share > 0]
    return sorted(dear, key=lambda name: -shares[name])[:count]
