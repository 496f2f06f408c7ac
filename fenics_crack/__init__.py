"""Periodic vibration of structures with a crack that opens and closes.

Start with ``docs/cracked_blade.md`` or ``demos/paper_plate.py``; equations and conventions are in
``docs/theory.md``, and the reference is built from the docstrings (``docs/contributing.md``).

The names are those that ``__init__.pyi`` imports. Each is imported here when it is first used: who
brings matrices needs neither DOLFINx nor gmsh, and who draws nothing neither VTK nor matplotlib.
Of several ranks all start PETSc here, together: who calls a function on one of them waits for none.
Functions called by these names run one at a time (:mod:`fenics_crack.basics.machine`).
"""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    del sys.path[0]  # python -m fenics_crack: no library is the one in the working folder

import ast
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.machine import (
    check_debian_module_versions,
    is_started_by_mpirun,
    load_openblas,
    run_single_threaded,
)
from fenics_crack.version import VERSION

with suppress(ImportError):  # raised again where NumPy is used
    load_openblas()
if is_started_by_mpirun():
    with suppress(InputError):  # raised again where the package is used
        check_debian_module_versions()
        import_module("fenics_crack.basics.ranks")

_MODULE_BY_NAME = {
    alias.name: node.module
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom) and node.module
    for alias in node.names
}

__all__ = sorted(_MODULE_BY_NAME)
__version__ = VERSION


def __getattr__(name: str) -> Any:
    if name not in _MODULE_BY_NAME:
        from fenics_crack.basics.suggestions import replacement_question_text

        suggestion_text = replacement_question_text(name, __all__)
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}; {suggestion_text}".rstrip("; ")
        )
    check_debian_module_versions()
    with run_single_threaded():
        public_object = getattr(import_module(_MODULE_BY_NAME[name]), name)
    if isinstance(public_object, FunctionType):
        from fenics_crack.basics.suggestions import check_calls

        find_scene_keys = _suggest_scene_keys if "scene" in public_object.__annotations__ else None
        public_names = _MODULE_BY_NAME.keys() - {"ContactLaw"}  # which is what has its members
        public_object = run_single_threaded()(
            check_calls(public_object, find_scene_keys, public_names)
        )
        public_object.__module__ = __name__  # where pickle finds this one
    globals()[name] = public_object
    return public_object


def _suggest_scene_keys(name: str) -> list[str]:
    """Suggest scene keys for a misspelt name."""
    from fenics_crack.scene.keys import suggest_full_keys

    return suggest_full_keys(name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
