"""Fixtures of the tests of studies."""

from collections.abc import Callable
from typing import Any

import pytest
from helpers import wrap

import fenics_crack as fc
from fenics_crack.study.sharing import LAST_STRUCTURE_OR_EMPTY_LIST


@pytest.fixture
def meshes(monkeypatch: pytest.MonkeyPatch) -> list[fc.Scene]:
    """Scenes that are meshed from now on, with nothing kept in this process from before."""
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    meshed_scenes: list[fc.Scene] = []

    def note_scene(assemble: Callable[..., Any], scene: fc.Scene, *rest: Any) -> Any:
        meshed_scenes.append(scene)
        return assemble(scene, *rest)

    wrap(monkeypatch, "fenics_crack.fem.build.assemble_structure", note_scene)
    return meshed_scenes
