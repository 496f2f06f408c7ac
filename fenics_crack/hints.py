"""What may be meant by a name that there is not, misspelt or another program's word for it, and by
a number with a decimal comma or in another unit.

Whoever refuses one asks here what to suggest: keys and values of a scene, commands, names of the
package and attributes of results.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

SAME_WORD = 0.85
"""Likeness of two forms of a word, as "eigenfrequency" and "eigenfrequencies"."""
WORDS = {
    "fc.solve(scene)": "solve steady periodic stationary forced vibration balance hbm run compute",
    "fc.curve(scene)": "curve frf frequency response continuation nlfr path resonance",
    "fc.curve(scene).peak()": "peak max maximum largest highest resonance resonant argmax damping",
    "fc.integrate(scene)": "time transient simulate simulation march newmark ode history dynamics",
    "fc.modes(scene)": "modal modes eigen eigenmodes eigenfrequencies eigenvalues natural",
    "fc.run_sweep(scene)": "sweep study parameter parametric batch scan map campaign",
    "fc.load_run(path)": "load read open import restore",
    "fc.save(result, path, scene), or run.save(path)": "save write dump export store hdf5",
    ".to_dataframe(), .to_csv(path) or .to_dict()": "dataframe frame pandas csv excel dict numpy",
    "fc.draw_curve(curve, ax=ax), fc.draw_waves(...), ...": "plot draw figure picture chart axes",
    '.indicators().ratio_2_1, of a sweep ["ratio_2_1"]': "ratio harmonic harmonics superharmonic "
    "second indicator",
    ".stability.verdict, or curve.verdicts": "stable stability unstable floquet verdict lyapunov",
    "fc.write_period(solution, path, material=scene.material)": "stress stresses mises tip sif "
    "intensity strain vtk paraview",
    ".report": "error errors accuracy residual uncertainty",
}
"""What to write, by the words that other programs and people have for it."""


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


def near(word: object, known: Iterable[str], likeness: float = 0.7) -> list[str]:
    """The known word that a misspelt one may stand for, or two that are as near; or none."""
    import difflib  # takes a while, and mistakes alone need it

    by_lower, lower = {name.lower(): name for name in known}, str(word).lower()[:100]
    found = difflib.get_close_matches(lower, by_lower, 2, likeness)
    alike = [difflib.SequenceMatcher(None, name, lower).ratio() for name in found]
    return [by_lower[name] for name, ratio in zip(found, alike, strict=True) if ratio == alike[0]]


def in_other_words(name: str) -> list[str]:
    """What to write for a name in the words of others: what has most of its words, or none."""
    parts = re.findall("[a-z0-9]+", re.sub("([A-Z])", r"_\1", name[:100]).lower())
    counts = {
        written: sum(bool(near(part, words.split(), SAME_WORD)) for part in parts)
        for written, words in WORDS.items()
    }
    most = max(counts.values())
    return [written for written, count in counts.items() if count == most > 0]


def meant(names: Sequence[str]) -> str:
    """A question after what may be meant, with a space behind it; empty if there is nothing."""
    return f"did you mean {' or '.join(names[:3])}? " if names else ""


def no_attribute(owner: str, name: str, known: Iterable[str]) -> AttributeError:
    """The error of a name that an owner does not have, with what may be meant."""
    question = ""
    if not name.startswith("_"):  # notebooks and test programs ask for such names of anything
        others = in_other_words(name)
        public = (other for other in known if not other.startswith("_"))
        alike = near(name, public, SAME_WORD if others else 0.7)
        alike = [other for other in alike if not any(other in text for text in others)]
        question = meant([*alike, *others])
    return AttributeError(f"{owner} has no attribute {name!r}; {question}".rstrip("; "))


class Hinted:
    """A class whose objects say what may be meant by an attribute that they do not have."""

    if not TYPE_CHECKING:  # else no misspelt attribute would be found before it runs

        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # Python asks, of each object that is copied
                raise AttributeError(name)
            if hasattr(type(self), name):  # a property in which an attribute is missing
                return object.__getattribute__(self, name)
            raise no_attribute(f"{type(self).__name__!r} object", name, dir(self))


# --- numbers --------------------------------------------------------------------------------------


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
    if factor is None or not math.isfinite(value * factor):
        return None
    return float(f"{value * factor:.12g}")  # no 0.30000000000000004


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
