"""Numbers as people read them."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"
THIN = "\N{NARROW NO-BREAK SPACE}"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def missing(value: Any) -> bool:
    """Whether there is no such number: ``None``, NA, NaN or not finite."""
    return value is None or value is pd.NA or (isinstance(value, float) and not math.isfinite(value))


def count(value: Any) -> str:
    """A whole number, its thousands apart; a dash for none."""
    return NONE if missing(value) else _signed(f"{round(value):,}".replace(",", THIN))


def several(n: int, noun: str, ending: str = "s") -> str:
    """So many of something."""
    return f"{count(n)} {noun}{'' if n == 1 else ending}"


def measure(value: Any, digits: int = 3) -> str:
    """A number to ``digits`` significant digits, with a power of ten below 0.0001 and from a million on."""
    if missing(value):
        return NONE
    value = float(value)
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if exponent < -4 or exponent >= 6:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        return f"{_signed(mantissa)}{THIN}\N{MULTIPLICATION SIGN}{THIN}10{str(int(power)).translate(_RAISED)}"
    text = f"{value:,.{max(digits - 1 - exponent, 0)}f}"
    return _signed(text.replace(",", THIN))


def spread(mean: Any, sd: Any) -> str:
    """A mean to three digits and its standard deviation, or error, to two; one that is rounding counts as none."""
    if missing(mean) or missing(sd):
        return measure(mean)
    if float(sd) < 1e-12 * abs(float(mean)):
        sd = 0.0
    return f"{measure(mean)} ± {measure(sd, 2)}"


def percent(share: Any) -> str:
    """A share in percent, without decimals from 10 on."""
    if missing(share):
        return NONE
    value = 100.0 * float(share)
    return f"{value:.0f}{THIN}%" if abs(value) >= 9.95 or value == 0 else f"{_signed(f'{value:.1f}')}{THIN}%"


def change(relative: Any) -> str:
    """A relative difference in percent with its sign; from tenfold on the factor instead."""
    if missing(relative):
        return NONE
    if relative >= 9.0:
        return f"\N{MULTIPLICATION SIGN}{THIN}{measure(1.0 + float(relative), 2 if relative < 99 else 3)}"
    value = 100.0 * float(relative)
    text = f"{value:+,.0f}" if abs(value) >= 9.95 else f"{value:+.1f}"
    if float(text.replace(",", "")) == 0:
        return f"0{THIN}%"
    return f"{_signed(text.replace(',', THIN))}{THIN}%"


def p_value(value: Any) -> str:
    """A p value; what is below 0.001 is only said to be."""
    if missing(value):
        return NONE
    return "< 0.001" if value < 0.001 else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def effect(value: Any) -> str:
    """An effect size between -1 and 1 with its sign; what rounds to nothing has none."""
    if missing(value):
        return NONE
    text = f"{value:+.2f}"
    return text[1:] if float(text) == 0 else _signed(text)


def point(position: Any) -> str:
    """A position in mm."""
    return ", ".join(_signed(f"{float(value):.2f}") for value in position)


def _signed(text: str) -> str:
    return text.replace("-", MINUS)
