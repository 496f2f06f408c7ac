"""The scene that ``new`` writes, and the lines of it that a scene without a table can be given.

Lines of the template that end in a mark, ``(--blade)``, are commented out, or in, where that is
asked for: a blade on a rotor in place of a plate, probes in its casing, a crack that is looked for.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from fenics_crack.version import packaged

__all__ = ["KINDS", "lines_of", "measured", "scene", "solid"]

COMMENTED = "cli/new_scene.toml"
KINDS = ("blade", "timing", "identify")
"""What ``new`` writes besides a plate."""
ASKED_FOR = ("curve", "growth", "identify", "rotation", "sweep", "tip_timing")
"""Tables that a scene may do without, and commands may not."""


def scene(name: str, rows: str, kinds: Collection[str]) -> str:
    """The scene of some :data:`KINDS`, written under a name, beside a file of measurements."""
    marks = [f"(--{kind})" for kind in {*kinds, *(["blade"] if "timing" in kinds else [])}]
    lines = (
        _turned(line) if line.endswith(tuple(marks)) else line
        for line in packaged(COMMENTED).splitlines()
    )
    whole = "\n".join([*map(_without_mark, lines), ""])
    return whole.replace("SCENE", name).replace("MEASURED", rows)


def solid(name: str) -> str:
    """The scene of a solid, written under a name."""
    return packaged("cli/new_solid.toml").replace("SCENE", name)


def measured() -> str:
    """Measurements of the plate: a CSV file for ``identify``."""
    return packaged("cli/new_measured.csv")


def lines_of(table: str) -> str:
    """The lines by which the template gives a scene a table of :data:`ASKED_FOR`; else empty."""
    if table not in ASKED_FOR:
        return ""
    for block in packaged(COMMENTED).split("\n\n"):
        lines = block.splitlines()
        for place, line in enumerate(lines):
            if line.removeprefix("# ").startswith((f"[{table}]", f"[{table}.")):
                asleep = line.startswith("#")
                chosen = (one for one in lines[place:] if one.startswith("#") == asleep)
                return "\n".join(_without_mark(_turned(one) if asleep else one) for one in chosen)
    raise KeyError(table)


def _without_mark(line: str) -> str:
    return re.sub(r"\s+(# )?\(--\w+\)$", "", line)


def _turned(line: str) -> str:
    """A line without the ``#`` that it begins with, or with one; its remark stays in place."""
    if line.startswith("# "):
        return line.removeprefix("# ").replace("  #", "    #", 1)
    return "# " + line.replace("    #", "  #", 1)
