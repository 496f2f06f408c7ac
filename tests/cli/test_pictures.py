"""Pictures of one vibration: its animation, harmonics and orbit; maps; and several ranks."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers import DEMOS, ROOT, catch_error, period_two_orbit
from mpi4py import MPI
from PIL import Image
from scipy.spatial import cKDTree

import fenics_crack as fc

ORANGE = (0xD5, 0x5E, 0x00)
"""Of Okabe and Ito's palette."""
PLATE = (slice(110, 530), slice(0, 530))
"""Rows and columns of the plate in the animation."""


@pytest.fixture(scope="module")
def small_scene(paper_scene: fc.Scene) -> fc.Scene:
    """Quadratic elements on a coarse grid."""
    return paper_scene.replace({"mesh.order": 2, "mesh.columns": 4, "mesh.rows": 4})


@pytest.fixture(scope="module")
def breathing(small_scene: fc.Scene) -> fc.PeriodicSolution:
    """Its vibration with contact, on one rank."""
    return vibration(small_scene, MPI.COMM_SELF)


def vibration(scene: fc.Scene, comm: Any) -> fc.PeriodicSolution:
    """The vibration of a scene's plate with a soft contact."""
    plate = fc.build_structure(scene, comm)
    return fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(1e9))


def pixels(path: Path, frame: int = 0) -> np.ndarray:
    """A picture's colours, (rows, columns, 3)."""
    with Image.open(path) as picture:
        picture.seek(frame)
        return np.asarray(picture.convert("RGB"))


def colours(picture: np.ndarray) -> int:
    """How many a picture has."""
    return len(np.unique(picture.astype(int) @ (1, 256, 256**2)))


def share(picture: np.ndarray, colour: tuple[int, ...]) -> float:
    """How much of a picture has exactly a colour."""
    return float(np.all(picture == colour, axis=2).mean())


def assert_drawn(path: Path, size: tuple[int, int]) -> None:
    """The picture has its size (width, height) and is neither blank nor noise."""
    picture = pixels(path)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.std() > 10.0
    assert colours(picture) > 20
    assert share(picture, (255, 255, 255)) > 0.1 or "map" in path.name


# --- the animation --------------------------------------------------------------------------------


@pytest.mark.parametrize("with_stress", [True, False])
def test_animation(
    small_scene: fc.Scene, breathing: fc.PeriodicSolution, tmp_path: Path, with_stress: bool
) -> None:
    """All frames, small; open and closed frames differ, and only closed ones mark contact."""
    path = tmp_path / "new" / "crack.gif"
    material = small_scene.material if with_stress else None
    magnification = fc.animate_period(breathing, path, frames=10, material=material)
    time = np.arange(10) * breathing.period / 10
    with Image.open(path) as picture:
        assert picture.n_frames == 10 and picture.size == (640, 740)
        assert picture.info["loop"] == 0 and picture.info["duration"] == 300
        comment = picture.info["comment"].decode("latin-1").rpartition("×")[2]
        assert float(comment) == pytest.approx(magnification, rel=5e-3)
    assert path.stat().st_size < 1e6
    gap = breathing.gap(time)[:, 0]
    open_frame, closed_frame = int(gap.argmin()), int(gap.argmax())
    assert gap[open_frame] < 0.0 < gap[closed_frame]
    plate_pixels = [pixels(path, frame)[PLATE] for frame in (open_frame, closed_frame)]
    assert np.mean(np.any(plate_pixels[0] != plate_pixels[1], axis=2)) > 0.05
    assert share(plate_pixels[0], ORANGE) == 0.0 < share(plate_pixels[1], ORANGE)
    for picture in plate_pixels:
        assert 0.05 < share(picture, (255, 255, 255)) < 0.8
    assert colours(plate_pixels[0]) > 20


def test_animation_of_twice_the_period_without_a_crack(
    small_scene: fc.Scene, tmp_path: Path
) -> None:
    """A plate without lips and pairs is drawn too, and a reduced structure as the whole one."""
    plate = fc.build_structure(small_scene.replace({"crack": None, "contact": None}))
    fc.animate_period(fc.solve_linear(plate, 2000.0), tmp_path / "plain.gif", frames=2)
    cracked_structure = fc.reduce_structure(fc.build_structure(small_scene))
    twice = fc.solve_harmonic_balance(
        cracked_structure, 2000.0, fc.UnilateralPenalty(1e9), harmonics=6, subharmonic=2
    )
    fc.animate_period(twice, tmp_path / "twice.gif", frames=2)
    for name in ("plain", "twice"):
        assert_drawn(tmp_path / f"{name}.gif", (640, 740))


def test_animation_refuses(breathing: fc.PeriodicSolution, tmp_path: Path) -> None:
    """Files other than GIF, and structures without a mesh."""
    for name in ("crack.mp4", "crack"):
        catch_error(partial(fc.animate_period, breathing, tmp_path / name), "path", names=r"\.gif")
    path = tmp_path / "crack.gif"
    for key, value in (("frames", 1.5), ("magnification", 0.0), ("material", 2e9)):
        catch_error(partial(fc.animate_period, breathing, path, **{key: value}), key, value)
    catch_error(
        lambda: fc.animate_period(period_two_orbit(3), path), "structure", "made from matrices"
    )
    assert not list(tmp_path.iterdir())


def test_picture_of_the_readme() -> None:
    """It is an animation, small enough for a page."""
    path = DEMOS.parent / "docs" / "pictures" / "breathing_crack.gif"
    assert path.stat().st_size < 1.5e6
    with Image.open(path) as picture:
        assert picture.n_frames == 50


# --- harmonics and orbits -------------------------------------------------------------------------


@pytest.mark.nightly
def test_spectrum_and_orbits(breathing: fc.PeriodicSolution, tmp_path: Path) -> None:
    """With one panel or two, of plates and of matrices, with twice the load's period or without."""
    dof = breathing.structure.find_dof((0.1, 0.1), "x")
    orbit = period_two_orbit(6)
    free_linear_solution = fc.solve_linear(
        fc.Structure.from_matrices(np.eye(1), np.eye(1), gap=None), 0.5
    )
    sizes = {"gap": (1050, 1020), "dof": (1050, 1020), "two": (1050, 1020), "free": (1050, 690)}
    for (name, size), solution, given in zip(
        sizes.items(),
        (breathing, breathing, orbit, free_linear_solution),
        (None, dof, 0, 0),
        strict=True,
    ):
        fc.draw_spectrum(solution, given, path=tmp_path / f"{name}.png", title="Harmonics")
        assert_drawn(tmp_path / f"{name}.png", size)
        fc.draw_orbits(solution, given, path=tmp_path / f"{name} orbit.png", title="Phase plane")
        panels = 2 if name in ("dof", "two") else 1
        assert_drawn(tmp_path / f"{name} orbit.png", (150 + 630 * panels, 660))
    contact = pixels(tmp_path / "dof orbit.png")
    assert share(contact, ORANGE) > 10.0 * share(pixels(tmp_path / "free orbit.png"), ORANGE)
    for draw in (fc.draw_spectrum, fc.draw_orbits):
        catch_error(partial(draw, free_linear_solution), "dof", None)


def test_rigid_lips_do_not_pass_through_each_other() -> None:
    """Nor in the picture of the orbit, though harmonics round off the kinks of the gap: lips
    without mass rest where they touch, and part with the velocity of the exact orbit."""
    many_harmonics = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 100}
    run = fc.solve(
        fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(many_harmonics), MPI.COMM_SELF
    )
    opening, speed = fc.draw_orbits(run.result).axes[0].lines[0].get_data()
    is_touching = opening > -1e-9 * np.ptp(opening)
    assert opening.max() < 1e-9 * np.ptp(opening) and 0.1 < is_touching.mean() < 0.9
    assert np.median(np.abs(speed[is_touching])) < 1e-6 * speed.max()
    time, pair = np.linspace(0.0, run.result.period, 4001), run.structure.first_watched_pair
    exact = np.gradient(fc.shoot(run.structure, run.result).gap_at(time)[:, pair], time)
    assert speed.max() == pytest.approx(exact.max(), rel=0.02)


# --- maps -----------------------------------------------------------------------------------------


def test_map(tmp_path: Path) -> None:
    """Cells without a value are grey; colours are logarithmic over large ranges."""
    x, y = np.linspace(1500.0, 4000.0, 8), np.linspace(0.02, 0.06, 5)
    words = {"title": "t", "x_label": "x", "y_label": "y", "value_label": "v [m]"}
    column_numbers = np.outer(np.ones(5), np.arange(1.0, 9.0))
    steep, holes = 10.0**column_numbers, column_numbers.copy()
    holes[1:3, 2] = np.nan
    for name, values in (("map", column_numbers), ("map holes", holes), ("map steep", steep)):
        fc.draw_map(x, y, values, path=tmp_path / f"{name}.png", **words)
        assert_drawn(tmp_path / f"{name}.png", (1050, 630))
    grey = (0xB5, 0xB5, 0xB5)
    plain_pixels, pierced_pixels, logarithmic = (
        pixels(tmp_path / f"{name}.png") for name in ("map", "map holes", "map steep")
    )
    assert share(plain_pixels, grey) < 0.001
    assert share(pierced_pixels, grey) > 0.01
    # On a linear scale seven of the eight columns would be darkest.
    assert share(logarithmic, (68, 1, 84)) < 0.15


@pytest.mark.parametrize(
    ("key", "array", "value"),
    [
        ("x", np.array([1.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0])),
        ("y", np.array([1.0]), np.array([1.0])),
        ("values", np.ones((3, 2)), (3, 2)),
        ("values", np.full((2, 3), np.nan), "nan"),
    ],
)
def test_map_refuses(key: str, array: np.ndarray, value: Any) -> None:
    """Axes that do not rise, other shapes, and nothing but nan."""
    arrays = {"x": np.arange(3.0), "y": np.arange(2.0), "values": np.ones((2, 3))} | {key: array}
    catch_error(
        lambda: fc.draw_map(**arrays, x_label="x", y_label="y", value_label="v"), key, value
    )


# --- several ranks --------------------------------------------------------------------------------


def write_on_ranks(scene: fc.Scene, folder: str, comm: Any) -> float:
    """Write the period and its animation."""
    solution, target = vibration(scene, comm), Path(folder)
    fc.animate_period(solution, target / "crack.gif", frames=4, material=scene.material)
    return fc.write_period(solution, target / "crack.pvd", frames=4, material=scene.material)


@pytest.mark.nightly
@pytest.mark.mpi
def test_two_ranks_write_the_same(
    small_scene: fc.Scene, on_ranks: Callable[..., Any], tmp_path: Path
) -> None:
    """Series, script, numbers of every node and pictures, though the nodes are in another order."""
    folder = tmp_path / "crack"
    magnification = write_on_ranks(small_scene, str(folder), MPI.COMM_SELF)
    single_folder = tmp_path / "alone"
    shutil.move(folder, single_folder)
    assert on_ranks(write_on_ranks, small_scene, str(folder)) == pytest.approx(magnification)
    assert (folder / "crack.pvd").read_text() == (single_folder / "crack.pvd").read_text()
    scripts = [(place / "crack_paraview.py").read_text() for place in (folder, single_folder)]
    scripts = [[line for line in text.split("\n") if "Rescale" not in line] for text in scripts]
    assert scripts[0] == scripts[1]  # but for the rounded end of the colours
    for frame in range(4):
        first_grid, two = (
            pyvista.read(place / "crack" / f"frame_{frame:04d}.vtu")
            for place in (single_folder, folder)
        )
        assert first_grid.n_points == two.n_points == 85 and first_grid.n_cells == two.n_cells == 16
        assert set(first_grid.celltypes) == set(two.celltypes) == {70}  # nine nodes
        assert set(first_grid.point_data) == set(two.point_data)
        # Where the lips touch, their nodes are told apart by their stresses.
        scale = np.abs(first_grid["stress"]).max()
        keys = [
            np.column_stack([grid.points, 0.1 * grid["stress"] / scale])
            for grid in (first_grid, two)
        ]
        distance, partner = cKDTree(keys[1]).query(keys[0])
        assert distance.max() < 1e-6 and len(set(partner)) == first_grid.n_points
        for name in first_grid.point_data:
            size = max(float(np.abs(first_grid[name]).max()), 1e-300)
            assert np.abs(first_grid[name] - two[name][partner]).max() <= 1e-6 * size, name
    for frame in range(4):
        first_pixels, second = (
            pixels(place / "crack.gif", frame) for place in (folder, single_folder)
        )
        assert np.mean(np.any(first_pixels != second, axis=2)) < 0.01, frame
