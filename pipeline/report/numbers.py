"""Numbers for people: few digits, no exponents where none are needed, no minus before a zero."""

from __future__ import annotations

import math


def fixed(value: float | None, digits: int) -> str:
    """So many decimals; nothing for None."""
    if value is None:
        return ""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def significant(value: float | None, digits: int = 3) -> str:
    """So many significant digits, without an exponent from 1e-6 to 1e6; nothing for None or what is not finite."""
    if value is None or not math.isfinite(value):
        return ""
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -7 < exponent < 6:
        return f"{value:.{digits - 1}e}"
    rounded = round(value, digits - 1 - exponent)
    if abs(rounded) >= 10 ** (exponent + 1):  # 0.9996 becomes 1.00
        exponent += 1
    return fixed(rounded, max(digits - 1 - exponent, 0))
