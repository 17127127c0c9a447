# SPDX-License-Identifier: Apache-2.0
"""Numbers as an engineer writes them: significant digits, units, a dash where there is none."""

import math

from pneu_sysid.sensor_units import PASCAL, Unit

NONE = "–"

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PLAIN_FROM = -3  # decimal exponents written without a power of ten
_PLAIN_TO = 5


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with the given significant digits, as 1.23×10⁻⁸ where it is extreme.

    Args:
        value: The number.
        digits: How many significant digits.
    """
    if value is None:
        return NONE
    if value == 0:
        return "0"
    exponent = _exponent(value, digits)
    if _PLAIN_FROM <= exponent < _PLAIN_TO:
        return _fixed(value, digits - 1 - exponent)
    return f"{_fixed(value / 10.0**exponent, digits - 1)}{_power(exponent)}"


def with_error(value: float | None, error: float | None, unit: str | None = None) -> str:
    """Return value ± error with the digits that the error leaves; times below 0.1 s in ms.

    Args:
        value: The value.
        error: Its standard error.
        unit: The unit of both.
    """
    if value is None:
        return NONE
    if unit == "s" and abs(value) < 0.1:
        value, error, unit = 1e3 * value, error and 1e3 * error, "ms"
    tail = f" {pretty_unit(unit)}".rstrip()
    if error is None or not error > 0:
        return number(value, 4) + tail
    last = _exponent(error, 2) - 1  # place of the second digit of the error
    exponent = max(_exponent(value, 3), _exponent(error, 2)) if value else _exponent(error, 2)
    if _PLAIN_FROM <= exponent < _PLAIN_TO - 1 and last >= -6:
        return f"{_fixed(value, -last)} ± {_fixed(error, -last)}{tail}"
    scale = 10.0**exponent
    places = exponent - last
    mantissas = f"{_fixed(value / scale, places)} ± {_fixed(error / scale, places)}"
    return f"({mantissas}){_power(exponent)}{tail}"


def percent(fraction: float | None) -> str:
    """Return a fraction in per cent, one decimal below ten.

    Args:
        fraction: The fraction, 1 for 100 %.
    """
    if fraction is None:
        return NONE
    value = 100.0 * fraction
    return f"{_fixed(value, 1 if 0 < abs(value) < 9.95 else 0)} %"


def times(ratio: float | None) -> str:
    """Return a ratio as 1.23×.

    Args:
        ratio: The ratio.
    """
    if ratio is None:
        return NONE
    return f"{_fixed(ratio, 2 if ratio < 9.995 else 1 if ratio < 99.95 else 0)}×"


def kilopascal(pressure_pa: float | None, *, signed: bool = False) -> str:
    """Return a pressure difference in kPa to a pascal, or three digits where it is large.

    Args:
        pressure_pa: The difference, Pa.
        signed: Whether a positive one gets its sign.
    """
    return amount(pressure_pa, PASCAL, signed=signed)


def amount(error: float | None, unit: Unit, *, signed: bool = False) -> str:
    """Return an error of a sensor, without its unit, to three digits or more.

    Args:
        error: The error, in SI.
        unit: The sensor's unit.
        signed: Whether a positive one gets its sign.
    """
    if error is None:
        return NONE
    value = error * unit.drawn_scale
    text = _fixed(value, 3 if abs(value) < 9.9995 else 2 if abs(value) < 99.995 else 1)
    return f"+{text}" if signed and value > 0 else text


def milliseconds(time_s: float | None, *, signed: bool = False) -> str:
    """Return a time in ms.

    Args:
        time_s: The time, s.
        signed: Whether a positive one gets its sign.
    """
    if time_s is None:
        return NONE
    text = _fixed(1e3 * time_s, 2 if abs(time_s) < 0.1 else 0)
    return f"+{text}" if signed and time_s > 0 else text


def seconds(time_s: float | None) -> str:
    """Return a time in s with two decimals.

    Args:
        time_s: The time, s.
    """
    return NONE if time_s is None else _fixed(time_s, 2)


def pretty_unit(unit: str | None) -> str:
    """Return a unit with superscripts for powers (m^2 as m²) and none for pure numbers.

    Args:
        unit: The unit, powers after a caret.
    """
    if not unit or unit == "1":
        return ""
    parts = unit.split("^")
    out = parts[0]
    for part in parts[1:]:
        stop = 1 if part[:1] == "-" else 0
        while stop < len(part) and part[stop].isdigit():
            stop += 1
        out += part[:stop].translate(_SUPERSCRIPT) + part[stop:]
    return out


def _exponent(value: float, digits: int) -> int:
    """Decimal exponent of the value after rounding to the digits: 9.996 with three is 1e1."""
    return int(f"{abs(value):.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, places: int) -> str:
    """Fixed-point text; digits left of the point that mean nothing are rounded away."""
    if places < 0:
        scale = 10.0**-places
        value = math.floor(abs(value) / scale + 0.5) * scale * (1 if value >= 0 else -1)
        places = 0
    text = f"{value:.{places}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def _power(exponent: int) -> str:
    return f"×10{str(exponent).translate(_SUPERSCRIPT)}"
