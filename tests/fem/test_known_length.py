"""A crack length found before is kept, and taken only if it still gives its frequency."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import DEMOS
from mpi4py import MPI

from fenics_crack import Scene, Structure
from fenics_crack.fem import build


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Scene:
    monkeypatch.setattr(build, "cache_folder", lambda: tmp_path / "cache")
    coarse = {"mesh.size": 0.03, "mesh.lip_elements": 3, "mesh.order": 1}
    return Scene.load(DEMOS / "breathing_plate.toml").replace(coarse)


def test_a_kept_length_is_found_with_one_plate(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = build.find_crack_length(scene, MPI.COMM_SELF)
    assemble, tried = build.assemble, list[float | None]()

    def counted(given: Scene, comm: MPI.Comm) -> Structure:
        tried.append(given.crack.length if given.crack else None)
        return assemble(given, comm)

    monkeypatch.setattr(build, "assemble", counted)
    assert build.find_crack_length(scene, MPI.COMM_SELF) == first
    assert tried == [first]
    # Another frequency is another length.
    other = scene.replace({"crack.first_omega": 2500.0})
    assert build.find_crack_length(other, MPI.COMM_SELF) < first


@pytest.mark.parametrize("text", ["[0.05, 0.0]", "[0.2, 0.0]", "[1e-9, 0.0]", "{}", "no number"])
def test_a_wrong_file_is_not_believed(scene: Scene, text: str) -> None:
    first = build.find_crack_length(scene, MPI.COMM_SELF)
    (file,) = build.cache_folder().iterdir()
    file.write_text(text)
    assert build.find_crack_length(scene, MPI.COMM_SELF) == first


def test_where_nothing_can_be_kept(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "cache_folder", lambda: Path("/dev/null/cache"))
    build._keep_length(scene, MPI.COMM_SELF, 0.04, 0.0)
    assert build._kept_length(scene, MPI.COMM_SELF) is None
