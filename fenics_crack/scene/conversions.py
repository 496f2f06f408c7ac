"""Numbers as people write them, "0,03" and "210 GPa", as what a key of a scene holds."""

from __future__ import annotations

import re
from collections.abc import Iterator

__all__ = ["candidates", "converted", "written"]

PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "": 1.0, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
OTHERS = {
    ("g/cm^3", "kg/m^3"): 1e3,
    ("kg/dm^3", "kg/m^3"): 1e3,
    ("t/m^3", "kg/m^3"): 1e3,
    ("t/mm^3", "kg/m^3"): 1e12,
    ("N/mm^2", "Pa"): 1e6,
    ("N/m^2", "Pa"): 1.0,
    ("N/mm", "N/m"): 1e3,
    ("N/mm^3", "N/m^3"): 1e9,
    ("g", "m/s^2"): 9.80665,
    ("%", ""): 1e-2,
}
"""Units of others: a key's unit in them."""
SPELLINGS = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "³": "^3", "·": " "})
NUMBER = re.compile(r"([+-]?\d*(?:[.,]\d*)?(?:[eE][+-]?\d+)?) *([^\d].*)?")


def converted(text: str, unit: str) -> float | None:
    """A number with a decimal comma, or in another unit than a key's, in that of the key."""
    found = NUMBER.fullmatch(text.strip()[:100].translate(SPELLINGS))
    try:
        value = float(found[1].replace(",", ".")) if found else None
    except ValueError:
        return None
    if found is None or value is None:
        return None
    given = re.sub(r"([a-z])([23])\b", r"\1^\2", (found[2] or unit).strip())
    if given == unit:
        return value
    factor = OTHERS.get((given, unit))
    if factor is None and unit and given.endswith(unit):
        factor = PREFIXES.get(given.removesuffix(unit))
    return None if factor is None else float(f"{value * factor:.12g}")  # no 0.30000000000000004


def candidates(value: object, unit: str) -> Iterator[object]:
    """What may be meant by a value that is no number, or no list of numbers; or nothing."""
    if isinstance(value, str):
        number = converted(value, unit)
        yield number
        if number is not None and number.is_integer():
            yield int(number)
        value = value.strip("[] ").split(",")
    if isinstance(value, list | tuple):
        yield [converted(one, unit) if isinstance(one, str) else one for one in value]


def written(value: object) -> str:
    """A value as a scene has it, numbers in short: "2.1e+11"."""
    short = f"{value:g}" if isinstance(value, float) else ""
    return short if short and float(short) == value else repr(value)
