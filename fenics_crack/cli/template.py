"""The command ``new``: the scene that it writes, and lines of it for a scene without a table.

Lines of the template that end in a mark, ``(--blade)``, are commented out, or in, where that is
asked for: a blade on a rotor in place of a plate, probes in its casing, a crack that is looked for.
"""

from __future__ import annotations

import os
import re
from argparse import Namespace
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from fenics_crack.errors import InputError
from fenics_crack.version import packaged
from fenics_crack.whole import write_whole

if TYPE_CHECKING:  # which loads MPI
    from fenics_crack.cli.console import Console

__all__ = ["lines_of", "new", "scene"]

COMMENTED = "cli/new_scene.toml"
KINDS = ("blade", "timing", "identify")
"""What ``new`` writes besides a plate."""
ASKED_FOR = ("curve", "growth", "identify", "rotation", "sweep", "tip_timing")
"""Tables that a scene may do without, and commands may not."""


def new(given: Namespace, _: None, console: Console) -> None:
    """Write a commented scene to start from."""
    from fenics_crack.parallel import on_root  # PETSc, which lines for an error do without

    path: Path = given.file
    kinds = [kind for kind in KINDS if vars(given)[kind]]
    if given.solid and kinds:
        raise InputError("--solid", f"with --{kinds[0]}", "asked for alone: the others are plates")
    rows = path.with_name(f"{path.stem}_measured.csv")
    if given.solid:
        files = {path: packaged("cli/new_solid.toml").replace("SCENE", path.name)}
    else:
        files = {path: scene(path.name, rows.name, kinds)}
    if "identify" in kinds:
        files[rows] = packaged("cli/new_measured.csv")

    def write() -> None:
        for file in files:
            if os.path.exists(file):  # False for a name too long, which writing will say
                raise InputError("scene", str(file), "a new file; there is one already")
        for file, text in files.items():
            write_whole(file, text, "scene")

    on_root(console.comm, write)
    console.note(f"{path}: a scene to start from; now: fenics-crack check {path}")
    if rows in files:
        console.note(f"{rows}: what was measured; then: fenics-crack identify {path} {rows}")


def scene(name: str, rows: str, kinds: Collection[str]) -> str:
    """The scene of some :data:`KINDS`, written under a name, beside a file of measurements."""
    marks = [f"(--{kind})" for kind in {*kinds, *(["blade"] if "timing" in kinds else [])}]
    lines = (
        _turned(line) if line.endswith(tuple(marks)) else line
        for line in packaged(COMMENTED).splitlines()
    )
    whole = "\n".join([*map(_without_mark, lines), ""])
    return whole.replace("SCENE", name).replace("MEASURED", rows)


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
