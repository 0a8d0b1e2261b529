"""Numbers as text: as many digits as the uncertainty bears, and the units that people read (arcsec, degrees) at the edge."""

from __future__ import annotations

import math

ARCSEC = 180 * 3600 / math.pi
MISSING = "–"
LARGEST_PLAIN, SMALLEST_PLAIN = 1e7, 1e-4


def number(value: float | None, digits: int = 4) -> str:
    """`digits` significant digits; whole numbers in full, very large and small ones with a power of ten."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == int(value) and abs(value) < LARGEST_PLAIN:
        return _signed(f"{int(value)}")
    size = math.floor(math.log10(abs(value)))
    if not SMALLEST_PLAIN <= abs(value) < LARGEST_PLAIN:
        return power_of_ten(value, digits - 1)
    return _signed(f"{value:.{max(digits - 1 - size, 0)}f}")


def stated(value: float) -> str:
    """A number that somebody set (a limit, an exposure): as it was given, without digits that nobody claimed."""
    return _signed(f"{value:.10g}")


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, whatever its size: an angle."""
    return _signed(f"{value:.{decimals}f}") if math.isfinite(value) else MISSING


def power_of_ten(value: float, decimals: int = 1) -> str:
    """1.2e-9 as 1.2 × 10⁻⁹; zero as 0."""
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{decimals}e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return _signed(f"{mantissa} × 10{raised}")


def rounded_like(value: float | None, uncertainty: float | None) -> str:
    """The value to the second digit of its uncertainty."""
    if value is None or not math.isfinite(value) or not _usable(uncertainty):
        return number(value)
    decimals = 1 - math.floor(math.log10(uncertainty))
    if decimals > 9:
        return number(value, 9)
    return _signed(f"{round(value, decimals):.{max(decimals, 0)}f}")


def sigma(uncertainty: float | None, times: int = 1) -> str:
    """`times` the 1-sigma uncertainty, two significant digits."""
    return number(times * uncertainty, 2) if _usable(uncertainty) else MISSING


def with_uncertainty(value: float | None, uncertainty: float | None) -> str:
    """value ± 1 sigma; of a figure that is exactly 0, because its square came out negative, the upper limit alone."""
    if value == 0 and _usable(uncertainty):
        return f"< {sigma(uncertainty)}"
    text = rounded_like(value, uncertainty)
    if text == MISSING or not _usable(uncertainty):
        return text
    decimals = max(1 - math.floor(math.log10(uncertainty)), 0)
    return f"{text} ± {uncertainty:.{decimals}f}" if decimals <= 9 else f"{text} ± {sigma(uncertainty)}"


def percent(share: float) -> str:
    return f"{number(100 * share, 3)} %"


def sentence(*parts: str) -> str:
    """Parts joined by semicolons, from a capital letter to a full stop."""
    text = "; ".join(part for part in parts if part)
    return f"{text[:1].upper()}{text[1:]}."


def plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _usable(uncertainty: float | None) -> bool:
    return uncertainty is not None and math.isfinite(uncertainty) and uncertainty > 0


def _signed(text: str) -> str:
    """With a true minus sign, which is as wide as a digit."""
    return text.replace("-", "−")
