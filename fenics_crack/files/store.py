"""Results on disk: HDF5 files that describe themselves.

A file has the attributes ``kind`` (what is in it), ``program`` and ``version``, ``versions`` of
what it was computed with, and, where there is one, the ``scene`` as TOML text; its datasets are
numbers and words, with the attributes ``unit`` and ``about``. Nothing in it is pickled, and nothing
of it is ever executed.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from slepc4py import SLEPc

from fenics_crack.errors import InputError
from fenics_crack.files.units import about
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.version import VERSION
from fenics_crack.whole import write_whole

__all__ = [
    "check_meshes",
    "kind_of",
    "opened",
    "read_scene",
    "reading",
    "scene_text",
    "versions",
    "write",
    "write_header",
]

PROGRAM = "fenics_crack"


def write(
    parts: Mapping[str, Any],
    path: str | Path,
    kind: str,
    scene: Scene | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> None:
    """Write a file, whole or not at all (collective; rank 0 writes).

    Parameters
    ----------
    parts : mapping
        Datasets by their names: arrays, numbers, words, lists of words; None is left out.
    path : path
        The file; an older one is replaced once the new one is complete.
    kind : str
        What is in it, for example "response curve".
    scene : Scene, optional
        Its scene.

    Raises
    ------
    InputError
        The file cannot be written.
    """

    def work() -> None:
        # In memory: HDF5 itself cannot be trusted with a disk that may be full.
        with h5py.File(path, "w", driver="core", backing_store=False, block_size=2**20) as file:
            write_header(file, kind, scene)
            for name, value in parts.items():
                if value is not None:
                    packed = {"compression": "gzip"} if np.size(value) > 1000 else {}
                    dataset = file.create_dataset(name, data=value, **packed)
                    dataset.attrs.update(about(name, parts))
            file.flush()
            image = file.id.get_file_image()
        write_whole(path, image)

    on_root(comm, work)


def write_header(file: h5py.File, kind: str, scene: Scene | None) -> None:
    """Write the attributes: what is in the file, what made it, and from which scene."""
    file.attrs["kind"] = kind
    file.attrs["program"] = PROGRAM
    file.attrs["version"] = VERSION
    file.attrs["versions"] = versions()
    if scene is not None:
        file.attrs["scene"] = scene_text(scene)
        file.attrs["meshes"] = "\n".join(_digest(path) for _, path in scene.files)


def versions() -> str:
    """Versions of what the program uses; of DOLFINx and gmsh where they are loaded."""
    found = {
        name: ".".join(map(str, library.Sys.getVersion()))
        for name, library in (("PETSc", PETSc), ("SLEPc", SLEPc))
    }
    for name, module in (("NumPy", "numpy"), ("DOLFINx", "dolfinx"), ("gmsh", "gmsh")):
        if module in sys.modules:
            found[name] = sys.modules[module].__version__
    return ", ".join(f"{name} {version}" for name, version in found.items())


def scene_text(scene: Scene) -> str:
    """The scene as it stands in a file: TOML, with the full paths of its files."""
    return scene.with_files(lambda path: str(Path(path).absolute())).as_toml()


def check_meshes(file: h5py.File, scene: Scene) -> None:
    """Raise InputError if a file of the scene, of its mesh or matrices, has changed."""
    digests = str(file.attrs.get("meshes", "")).split()
    for (key, path), digest in zip(scene.files, digests, strict=False):
        if _digest(path) != digest:
            allowed = f"the file with which {file.filename} was computed; it has changed or gone"
            raise InputError(key, path, allowed)


def _digest(path: str) -> str:
    """SHA-256 of a file, or "missing"."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return "missing"


@contextlib.contextmanager
def reading(path: str | Path, kind: str) -> Iterator[dict[str, Any]]:
    """Datasets of a file by their names: arrays, numbers and words.

    Raises
    ------
    InputError
        As :func:`opened`, or a dataset is missing or not of the kind expected in the ``with``
        block.
    """
    with opened(path, kind) as file:
        parts = {n: _value(item) for n, item in file.items() if isinstance(item, h5py.Dataset)}
    try:
        yield parts
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError("path", str(path), f"a {kind} written by save ({error})") from None


def kind_of(path: str | Path) -> str:
    """Kind of result in a file; raises as :func:`opened`."""
    with opened(path) as file:
        return str(file.attrs["kind"])


def read_scene(path: str | Path) -> Scene | None:
    """The scene in a file, or None.

    Raises
    ------
    InputError
        As :func:`opened`, its scene cannot be used, or a file of its mesh or matrices has changed.
    """
    with opened(path) as file:
        if "scene" not in file.attrs:
            return None
        scene = Scene.from_text(str(file.attrs["scene"]), str(path))
        check_meshes(file, scene)
    return scene


@contextlib.contextmanager
def opened(path: str | Path, kind: str | None = None) -> Iterator[h5py.File]:
    """Open a result file for reading, without a lock: a sweep may be writing it.

    Raises
    ------
    InputError
        The file cannot be read, is not one of this program, or is of another kind.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            if file.attrs.get("program") != PROGRAM or "kind" not in file.attrs:
                raise InputError("path", str(path), f"a result file of {PROGRAM}")
            found = file.attrs["kind"]
            if kind not in (None, found):
                allowed = f"a file with a {kind}; in this one is a {found}"
                raise InputError("path", str(path), allowed)
            yield file
    except FileNotFoundError:
        raise InputError("path", str(path), "a file that exists") from None
    except (OSError, KeyError, RuntimeError) as error:
        kinds = "one of the .h5 files that solve, curve and the other commands write"
        raise InputError("path", str(path), f"a readable result file, {kinds}") from error


def _value(item: h5py.Dataset) -> Any:
    if h5py.check_string_dtype(item.dtype) is None:
        value = item[()]
        return value if np.ndim(value) else value.item()
    words = item.asstr()[()]
    return words if isinstance(words, str) else [str(word) for word in words]
