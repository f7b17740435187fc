"""Numbers as text: significant digits, a dash for a missing value."""

from __future__ import annotations

import math

from drivers.core.text import DASH as DASH
from drivers.core.text import percent_text, percentage_text
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MOST_DECIMALS = 9


def number(value: float | None, digits: int = 4) -> str:
    """A number with `digits` significant digits; powers of ten below 0.001 and from 100 000 on."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    mantissa, exponent = _split(value, digits)
    if -3 <= exponent < 5:
        return _minus(f"{value:.{max(0, digits - 1 - exponent)}f}")
    return f"{_minus(mantissa)}{_power(exponent)}"


def percent(ratio: float | None, digits: int = 3) -> str:
    """A ratio in percent, unit included."""
    return _minus(percent_text(ratio, digits))


def percentage(value: float | None, digits: int = 3) -> str:
    """A percentage without its unit."""
    return _minus(percentage_text(value, digits))


def whole(value: float | None) -> str:
    """An integer with its thousands apart."""
    return DASH if value is None or not math.isfinite(value) else f"{value:,.0f}".replace(",", "\u202f")


def with_error(value: float | None, std: float | None) -> str:
    """A value ± half its 95 % interval, cut at the second digit of the error."""
    if value is None or not math.isfinite(value):
        return DASH
    if std is None or not math.isfinite(std) or std <= 0:
        return f"{number(value)} ± {DASH}"
    half = WITHIN_95_PERCENT * std
    exponent = _split(max(abs(value), half), 4)[1]
    if not -3 <= exponent < 5:
        scale = 10.0**exponent
        return f"({_digits(value / scale, half / scale)}){_power(exponent)}"
    return _digits(value, half)


def half_interval(std: float | None) -> float | str:
    """Half the 95 % interval of a standard deviation; nothing where it is not known."""
    return "" if std is None or not math.isfinite(std) else WITHIN_95_PERCENT * std


def setting(value: float | int | str | bool | list[float] | None) -> str:
    """An option's or a setting's value."""
    if value is None:
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    return _minus(f"{value:.6g}") if isinstance(value, float) else str(value)


def _digits(value: float, half: float) -> str:
    decimals = min(MOST_DECIMALS, max(0, 1 - _split(half, 2)[1]))
    return f"{_minus(f'{value:.{decimals}f}')} ± {half:.{decimals}f}"


def _split(value: float, digits: int) -> tuple[str, int]:
    """Mantissa and exponent after rounding, so that 9.9996 becomes 1.000·10¹."""
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return mantissa, int(exponent)


def _power(exponent: int) -> str:
    return f"·10{str(exponent).translate(SUPERSCRIPTS)}"


def _minus(text: str) -> str:
    return text.replace("-", "−")
