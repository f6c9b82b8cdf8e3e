"""Numbers as people read them."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"
THIN = "\N{NARROW NO-BREAK SPACE}"


def missing(value: Any) -> bool:
    """Whether there is no such number: ``None``, NA, NaN or not finite."""
    return value is None or value is pd.NA or (isinstance(value, float) and not math.isfinite(value))


def count(value: Any) -> str:
    """A whole number, its thousands apart; a dash for none."""
    return NONE if missing(value) else _signed(f"{round(value):,}".replace(",", THIN))


def measure(value: Any, digits: int = 3) -> str:
    """A number to ``digits`` significant digits, never in powers of ten between 0.0001 and a million."""
    if missing(value):
        return NONE
    value = float(value)
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if exponent < -4 or exponent >= 6:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        return _signed(f"{mantissa}\N{MULTIPLICATION SIGN}10^{int(power)}").replace(f"^-{abs(int(power))}",
                                                                                   f"^{MINUS}{abs(int(power))}")
    text = f"{value:,.{max(digits - 1 - exponent, 0)}f}"
    return _signed(text.replace(",", THIN))


def spread(mean: Any, sd: Any) -> str:
    """Mean and standard deviation, to the digits of the smaller of the two."""
    if missing(mean) or missing(sd):
        return measure(mean)
    return f"{measure(mean)} ± {measure(sd, 2)}"


def percent(share: Any) -> str:
    """A share in percent, without decimals from 10 on."""
    if missing(share):
        return NONE
    value = 100.0 * float(share)
    return f"{value:.0f}{THIN}%" if abs(value) >= 9.95 or value == 0 else f"{_signed(f'{value:.1f}')}{THIN}%"


def change(relative: Any) -> str:
    """A relative difference in percent, always with its sign."""
    if missing(relative):
        return NONE
    value = 100.0 * float(relative)
    text = f"{value:+,.0f}" if abs(value) >= 9.95 else f"{value:+.1f}"
    if float(text.replace(",", "")) == 0:
        return f"0{THIN}%"
    return f"{_signed(text.replace(',', THIN))}{THIN}%"


def difference(value: Any, digits: int = 2) -> str:
    """A difference with its sign."""
    if missing(value):
        return NONE
    return measure(value, digits) if value <= 0 else f"+{measure(value, digits)}"


def p_value(value: Any) -> str:
    """A p value; what is below 0.001 is only said to be."""
    if missing(value):
        return NONE
    return "< 0.001" if value < 0.001 else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def point(position: Any) -> str:
    """A position in mm."""
    return ", ".join(_signed(f"{float(value):.2f}") for value in position)


def _signed(text: str) -> str:
    return text.replace("-", MINUS)
