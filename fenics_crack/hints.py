"""What may be meant by a name that there is not: one misspelt, or another program's word for it.

Whoever refuses a name asks here what to suggest: keys of a scene, commands, names of the package
and attributes of results.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

__all__ = ["Hinted", "in_other_words", "meant", "near", "no_attribute"]

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
    "fc.save(result, path, scene)": "save write dump export store hdf5",
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


def near(word: object, known: Iterable[str], likeness: float = 0.7) -> list[str]:
    """The known word that a misspelt one may stand for, or two that are as near; or none."""
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
    public = [other for other in known if not other.startswith("_")]
    others = [] if name.startswith("_") else in_other_words(name)
    alike = [other for other in near(name, public) if not any(other in text for text in others)]
    question = meant([*alike, *others])
    return AttributeError(f"{owner} has no attribute {name!r}; {question}".rstrip("; "))


class Hinted:
    """A class whose objects say what may be meant by an attribute that they do not have."""

    if not TYPE_CHECKING:  # else no misspelt attribute would be found before it runs

        def __getattr__(self, name: str) -> Any:
            if hasattr(type(self), name):  # a property in which an attribute is missing
                return object.__getattribute__(self, name)
            raise no_attribute(f"{type(self).__name__!r} object", name, dir(self))
