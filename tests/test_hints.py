"""Names that there are, and what is said of those that there are not."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import pytest

import fenics_crack as fc

SHORT = ("solve", "curve", "integrate", "modes", "run_sweep", "verify", "campbell", "load", "save")


def test_a_property_that_fails_says_what_failed() -> None:
    """Not that it is missing."""

    class Broken(fc.Scene):
        @property
        def mine(self) -> Any:
            return self.theirs  # type: ignore[attr-defined]

    with pytest.raises(AttributeError, match="no attribute 'theirs'"):
        _ = object.__new__(Broken).mine


def test_short_names_after_every_folder_is_loaded() -> None:
    """Python puts a folder that is loaded under its name: none may hide a function."""
    for module in pkgutil.walk_packages(fc.__path__, "fenics_crack."):
        if not module.name.endswith(("__main__", "kernel.build")):
            importlib.import_module(module.name)
    for name in SHORT:
        assert callable(getattr(fc, name)), name


def test_what_tab_shows() -> None:
    """The public names, and none that the file itself uses."""
    assert [name for name in dir(fc) if not name.startswith("__")] == sorted(fc.__all__)
