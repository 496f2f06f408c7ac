"""Crack lengths found from a frequency, kept beside the compiled forms in the user's cache.

A file holds a length [m] and what its frequency exceeds the one asked for by [rad/s]. Its name is a
digest of the tables of the scene on which both depend. Whoever reads it checks it: nothing rests on
the file but time.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from pathlib import Path

from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.whole import write_whole

__all__ = ["cache_folder", "keep_length", "kept_length"]


def cache_folder() -> Path:
    """Where the files are: ``$XDG_CACHE_HOME/fenics_crack``, by default in ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics_crack"


def kept_length(scene: Scene, comm: MPI.Comm) -> tuple[float, float] | None:
    """Length and excess kept for a scene; None if there are none (collective)."""

    def read() -> tuple[float, float] | None:
        try:
            length, excess = map(float, json.loads(_file(scene).read_text("utf-8")))
        except (OSError, RuntimeError, ValueError, TypeError):  # none, no home, or damaged
            return None
        return length, excess

    return on_root(comm, read)


def keep_length(scene: Scene, comm: MPI.Comm, length: float, excess: float) -> None:
    """Keep what was found, where that is possible (collective)."""

    def write() -> None:
        with contextlib.suppress(InputError, RuntimeError):
            write_whole(_file(scene), json.dumps((length, excess)))

    on_root(comm, write)


def _file(scene: Scene) -> Path:
    tables = repr((scene.geometry, scene.crack, scene.material, scene.mesh))
    return cache_folder() / f"length_{hashlib.sha256(tables.encode()).hexdigest()[:32]}.json"
