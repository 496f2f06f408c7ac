"""Plane cracks in parts from CAD files, and in any plane of a box."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import catch_error, gmsh_model
from mpi4py import MPI
from surroundings import MPI_ENVIRONMENT, ROOT, RunCommand

import fenics_crack as fc
from fenics_crack import Scene
from fenics_crack.fem.solid_mesher import (
    STRAIGHT_CELL_DISTANCE_IN_ELEMENTS,
    TETRAHEDRON_EDGES,
    collect_nodes_and_groups,
    straighten_edges,
)
from fenics_crack.study.plausibility import remarks_on_scene

BOX = [0.03, 0.09, 0.006]
TEXT = """
geometry.kind = "solid"
geometry.file = "box.step"
geometry.faces = { clamp = [[0.015, 0.0, 0.003]], top = [[0.0151, 0.0901, 0.003]] }
crack.point = [0.015, 0.03, 0.006]
crack.normal = [0.0, 2.0, 0.0]
crack.direction = [1.0, 0.5, 0.0]
crack.radii = [0.008, 0.003]
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.09, 0.003], force_sin = [0.0, 0.0, 0.1], frequency = 560.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", size = 0.006, lip_elements = 2, error = false }
"""
SIDES = dict(zip(("geometry.width", "geometry.height", "geometry.thickness"), BOX, strict=True))
OF_PART = {"geometry.file": None, "geometry.faces": ()}
"""What a box does not have."""
THROUGH = {
    "crack.radii": None, "crack.front": "through", "crack.point": [0.012, 0.03, 0.003],
    "crack.direction": [1.0, 0.0, 0.0],
}  # fmt: skip


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with parts: a box, two boxes, a surface, a rod, and files that are none."""
    folder = tmp_path_factory.mktemp("parts")
    with gmsh_model() as model:
        for name, draw in DRAWN.items():
            model.add(name)
            draw(model.occ)
            model.occ.synchronize()
            write(str(folder / name))
            model.remove()
    (folder / "words.step").write_text("A script?\nMesh 3;\n")
    (folder / "cut.step").write_bytes((folder / "box.step").read_bytes()[:5000])
    return folder


def write(path: str) -> None:
    """Write gmsh's current model."""
    import gmsh

    gmsh.write(path)


def box(occ: Any) -> None:
    occ.addBox(0, 0, 0, *(1e3 * side for side in BOX))


def two(occ: Any) -> None:
    box(occ)
    occ.addBox(50, 0, 0, 10, 10, 10)


def holed(occ: Any) -> None:
    """Draw the box with a slot, which divides its faces z = 0 and z = thickness."""
    box(occ)
    occ.cut([(3, 1)], [(3, occ.addBox(-1, 40, -1, 32, 10, 3))])


def bored(occ: Any) -> None:
    """Draw the box with a hole of 8 mm through its middle."""
    box(occ)
    occ.cut([(3, 1)], [(3, occ.addCylinder(15, 45, -1, 0, 0, 8, 4))])


DRAWN: dict[str, Callable[[Any], Any]] = {
    "box.step": box,
    "box.brep": box,
    "two.step": two,
    "holed.step": holed,
    "bored.step": bored,
    "flat.step": lambda occ: occ.addRectangle(0, 0, 0, 10, 10),
    "rod.step": lambda occ: occ.addCylinder(0, 0, 0, 0, 200, 0, 10),
}


def part(parts: Path, **changes: Any) -> Scene:
    """The scene of the box in a STEP file."""
    scene = Scene.from_text(TEXT.replace("box.step", str(parts / "box.step")))
    return scene.replace({key.replace("__", "."): value for key, value in changes.items()})


def first_frequency(scene: Scene) -> float:
    """Of the open crack [rad/s]."""
    return float(fc.solve_modes(fc.build_structure(scene, MPI.COMM_SELF), 1).omega[0])


@pytest.mark.parametrize(
    ("changes", "own"),
    [
        pytest.param(
            {},
            {"center": 0.015, "length": 0.016, "depth": 0.003, "front": "elliptical"},
            marks=pytest.mark.nightly,
        ),
        (THROUGH, {"edge": "left", "length": 0.012}),
    ],
    ids=["ellipse", "through"],
)
def test_a_box_from_a_file(parts: Path, changes: dict[str, Any], own: dict[str, Any]) -> None:
    """Its frequencies are those of the box that is made here, whose crack is given by its keys."""
    scene = part(parts, mesh__lip_elements=4).replace(changes)
    removed_keys = dict.fromkeys(
        f"crack.{key}" for key in ("point", "normal", "direction", "radii")
    )
    keys = {f"crack.{key}": value for key, value in ({"height": 0.03} | own).items()}
    box_scene = scene.replace(OF_PART | SIDES | removed_keys | {"crack.front": None} | keys)
    structures = [fc.build_structure(variant, MPI.COMM_SELF) for variant in (scene, box_scene)]
    for lips in ("open", "tied"):
        file_omega, box_omega = (
            fc.solve_modes(structure, 1, lips=lips).omega[0] for structure in structures
        )
        assert file_omega == pytest.approx(box_omega, rel=5e-4)


def test_a_file_without_a_unit(parts: Path) -> None:
    """A .brep file in mm and one in inches: all is 25.4 times as large."""
    scene = part(parts, geometry__file=str(parts / "box.brep"), geometry__unit="mm", crack=None)
    inch_keys = {
        "geometry.unit": "inch", "mesh.size": 25.4 * 0.006,
        "excitation.point": [0.0, 25.4 * 0.09, 25.4 * 0.003],
        "geometry.faces": {"clamp": [[25.4 * 0.015, 0.0, 25.4 * 0.003]]},
    }  # fmt: skip
    scene = scene.replace({"contact": None})
    assert first_frequency(scene.replace(inch_keys)) * 25.4 == pytest.approx(
        first_frequency(scene), rel=1e-3
    )


@pytest.mark.nightly
def test_an_inclined_crack_of_a_box(parts: Path) -> None:
    """That of a part and that of a box; its area is that of half of the ellipse."""
    tilt = {"crack.normal": [0.5, 1.0, 0.0], "crack.direction": [1.0, -0.5, 0.0]}
    scene = part(parts).replace(tilt)
    structures = [
        fc.build_structure(variant, MPI.COMM_SELF)
        for variant in (scene, scene.replace(OF_PART | SIDES))
    ]
    for structure in structures:
        assert structure.pair_areas is not None
        area = structure.pair_areas.sum()
        assert area == pytest.approx(0.5 * math.pi * 0.008 * 0.003, rel=0.06)  # of chords
    first_omegas = [fc.solve_modes(structure, 1).omega[0] for structure in structures]
    assert first_omegas[0] == pytest.approx(first_omegas[1], rel=5e-4)


@pytest.mark.nightly
def test_cracks_in_the_order_of_the_scene(parts: Path) -> None:
    """The upper one first, with a clearance of its own; named faces take loads."""
    upper_crack = {
        "crack.point": [0.0, 0.06, 0.006],
        "crack.radii": [0.006, 0.003],
        "crack.clearance": 1e-6,
    }
    lower_crack = {
        "point": [0.03, 0.03, 0.006],
        "normal": [0.0, 1.0, 0.0],
        "direction": [1.0, 0.0, 0.0],
    }
    lower_crack |= {"radii": [0.006, 0.003], "clearance": 2e-6}
    load = {"edge": "top", "pressure_cos": -1.0}
    scene = part(parts).replace(
        upper_crack | {f"cracks.1.{key}": value for key, value in lower_crack.items()}
        | {f"loads.1.{key}": value for key, value in load.items()}
    )  # fmt: skip
    for variant in (scene, scene.replace(OF_PART | SIDES)):
        structure = fc.build_structure(variant, MPI.COMM_SELF)
        points = structure.pairs.points
        assert points is not None
        np.testing.assert_array_equal(points[:, 1] > 0.045, structure.clearance < 1.5e-6)
    assert structure.force[1].sum() == pytest.approx(BOX[0] * BOX[2], rel=1e-9)


REFUSED: list[tuple[str, dict[str, Any], str | None]] = [
    ("geometry.file", {"geometry.file": "part.stl"}, r"\.step, \.stp or \.brep"),
    ("geometry.file", {"geometry.file": "words.step"}, None),
    ("geometry.file", {"geometry.file": "missing.step"}, None),
    ("geometry.file", {"geometry.file": "cut.step"}, None),
    ("geometry.file", {"geometry.file": "two.step"}, "2$"),
    ("geometry.file", {"geometry.file": "flat.step"}, "none$"),
    ("geometry.unit", {"geometry.unit": None, "geometry.file": "box.brep"}, "'mm', 'm' or 'inch'"),
    ("geometry.unit", {"geometry.unit": "mm"}, "STEP"),
    ("geometry.faces", {"geometry.faces": {}}, "clamp"),
    ("geometry.faces", {"geometry.faces": {"clamp": [[0.0, 0.0]]}}, None),
    ("geometry.faces", {"geometry.faces": {"clamp": [[0.0, -0.02, 0.0]]}},
     r"\(0, -0\.02, 0\) m of clamp is 20 mm"),
    ("geometry.width", {"geometry.width": 1.0}, r"geometry\.file"),
    ("mesh.size", {"mesh.size": 1e-5}, r"2e\+06 cells"),
    ("mesh.lip_elements", {"mesh.lip_elements": 5000}, r"2e\+06 cells"),
    ("crack.point", {"crack.point": None}, r"geometry\.file"),
    ("crack.point", {"crack.point": [0.0, 0.2, 0.0]}, None),
    ("crack.point", {"crack.point": [15.0, 30.0, 6.0]},
     r"\(0, 0, 0\) to \(0\.03, 0\.09, 0\.006\) m; .* not in mm"),
    ("crack.point", {"crack.point": [0.015, 0.03, 0.0095]},
     r"\(0, 0, 0\) to \(0\.03, 0\.09, 0\.006\) m$"),
    ("crack.point", {"crack.point": [0.015, 0.03, 0.00895], "crack.radii": [0.003, 0.003]},
     "too shallow .* raise mesh.lip_elements"),
    ("crack.point", THROUGH | {"geometry.file": "bored.step", "crack.length": 0.002,
                               "crack.point": [0.019, 0.045, 0.003]}, "2 pieces; .* give radii"),
    ("crack.length", THROUGH | {"crack.length": 5.0}, "cut the part in two"),
    ("crack.radii", {"crack.radii": [0.1, 0.1]}, None),
    ("crack.point", {"crack.point": [0.015, 0.0, 0.006]}, "lies in a face"),
    ("crack.point", {"geometry.file": "holed.step", "crack.point": [0.015, 0.045, 0.0],
                     "crack.normal": [0.0, 0.0, 1.0], "crack.radii": [0.012, 0.06]}, None),
    ("crack.point", {"crack.point": [0.0148, 0.03, 0.003], "crack.radii": [0.003, 0.003]}, None),
    ("crack.point", {"crack.radii": [0.008, 0.00599]}, None),
    ("cracks.1.point", {"cracks.1.point": [0.015, 0.03, 0.006], "cracks.1.normal": [1.0, 1.0, 0.0],
                        "cracks.1.direction": [0.0, 0.0, 1.0], "cracks.1.radii": [0.003, 0.003]},
     None),
    ("crack.normal", {"crack.normal": [0.0, 0.0, 0.0]}, None),
    ("crack.direction", {"crack.direction": [0.0, 1.0, 0.0]}, r"crack\.normal"),
    ("crack.direction", {"crack.direction": None}, None),
    ("crack.radii", {"crack.radii": None}, "front = 'through'"),
    ("crack.radii", {"crack.front": "through"}, "front = 'through'"),
    ("crack.height", {"crack.height": 0.03}, r"crack\.point"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "changes", "names"), REFUSED)
def test_refused(parts: Path, key: str, changes: dict[str, Any], names: str | None) -> None:
    """One line with the key, before the part is meshed."""
    if "geometry.file" in changes:
        changes = changes | {"geometry.file": str(parts / changes["geometry.file"])}
    catch_error(
        lambda: fc.build_structure(part(parts).replace(changes), MPI.COMM_SELF), key, names=names
    )


def test_a_rounded_point(parts: Path) -> None:
    """A half ellipse whose middle is 0.1 um inside the part is meshed like one at its face."""
    scene = part(parts, crack__point=[0.015, 0.03, 0.006 - 1e-7])
    structure = fc.build_structure(scene, MPI.COMM_SELF)
    assert structure.pair_areas is not None
    area = structure.pair_areas.sum()
    assert area == pytest.approx(0.5 * math.pi * 0.008 * 0.003, rel=0.06)  # of chords


def test_remarks_before_the_mesh(tmp_path: Path, run_command: RunCommand) -> None:
    """A young's modulus in GPa is remarked on before the part's file turns out to be none."""
    scene = tmp_path / "scene.toml"
    scene.write_text(TEXT.replace("box.step", str(tmp_path / "missing.step")))
    messages = run_command("check", scene, sets=["material.young=210.0"], code=2).err
    assert messages.index("in GPa?") < messages.index("No such file")


def test_a_load_near_the_surface(parts: Path) -> None:
    """It acts on the nearest node, which a remark names; one in the mesh acts where it is."""
    scene = part(parts, excitation__point=[0.0, 0.0902, 0.003], crack=None, contact=None)
    structure = fc.build_structure(scene, MPI.COMM_SELF)
    remarks = [str(remark) for remark in remarks_on_scene(scene, structure)]
    assert any(
        "the force acts on the nearest node, at (0, 0.09, 0.003)" in remark for remark in remarks
    )
    assert np.count_nonzero(structure.force[2]) == 1
    catch_error(
        lambda: fc.build_structure(scene.replace({"excitation.point": [0.0, 0.12, 0.003]})),
        "excitation.point",
        (0.0, 0.12, 0.003),
    )
    scene = scene.replace({"excitation.point": [0.001, 0.0895, 0.003]})
    structure = fc.build_structure(scene, MPI.COMM_SELF)
    assert not any("nearest" in str(remark) for remark in remarks_on_scene(scene, structure))


def on_these_ranks(scene: Scene, comm: MPI.Comm) -> np.ndarray:
    """First frequencies (collective)."""
    return fc.solve_modes(fc.build_structure(scene, comm), 3).omega


@pytest.mark.nightly
@pytest.mark.mpi
def test_two_ranks(on_ranks: Callable[..., Any], parts: Path) -> None:
    """The mesh is made once, and is the same."""
    serial = on_these_ranks(part(parts), MPI.COMM_SELF)
    np.testing.assert_allclose(on_ranks(on_these_ranks, part(parts)), serial, rtol=1e-8)


def test_a_new_scene(parts: Path, tmp_path: Path, run_command: RunCommand) -> None:
    """``new --cad`` proposes what ``check`` accepts, and draws the faces."""
    scene = tmp_path / "rod.toml"
    run_command("new", scene, "--cad", parts / "rod.step")
    assert (tmp_path / "rod_faces.png").stat().st_size > 1000
    text = scene.read_text()
    assert "# face_3 = " in text and "# face_4 = " not in text
    coarse_settings = ["mesh.error=false", "mesh.lip_elements=2", "mesh.size=0.02"]
    report = run_command("check", scene, sets=coarse_settings).out
    [clamp] = [line for line in report.splitlines() if line.startswith("face clamp")]
    assert float(clamp.split()[2]) == pytest.approx(100.0 * math.pi, rel=0.01)
    [crack] = [line for line in report.splitlines() if line.startswith("the crack front")]
    assert "mm deep" in crack and "of material straight ahead" in crack
    assert "crack.point" in report


def test_the_same_without_its_crack(parts: Path, tmp_path: Path, run_command: RunCommand) -> None:
    """A scene of ``new --cad`` asks for K, which is left out without a crack, in one remark. The
    first frequency is that of a beam [Hz], 6 mm thick, to 5 %: E / (1 - nu^2) would be 5 % more."""
    scene = tmp_path / "box.toml"
    run_command("new", scene, "--cad", parts / "box.step")
    assert "K_max" in scene.read_text()
    few_options = ["mesh.error=false", "mesh.size=0.012", "crack=none", "contact=none"]
    answer = run_command("modes", scene, "--output", tmp_path / "out", sets=few_options)
    assert answer.err.count("remark: output.quantities") == 1
    assert "left out without a crack: K_max" in answer.err
    [first] = [line for line in answer.out.splitlines() if line.split()[:1] == ["1"]]
    beam = 1.875104**2 * math.sqrt(2.1e11 / 12.0 / 7850.0) * 0.006 / 0.09**2 / (2.0 * math.pi)
    assert beam * 0.99 < float(first.split()[2]) < beam * 1.05
    every_quantity = 'output.quantities=["K_max", "friction_loss"]'
    answer = run_command("check", scene, sets=[*few_options, every_quantity])
    assert "left out without a crack: K_max, friction_loss" in answer.err
    removed = fc.Scene.load(scene).replace({"crack": None, "contact": None})
    assert removed.quantities == ("amplitude", "ratio_2_1")


def environment() -> dict[str, str]:
    """Of a command."""
    return dict(os.environ) | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)}


@pytest.mark.nightly
def test_killed_while_it_meshes(parts: Path) -> None:
    """No process and no file is left, and the next run succeeds."""
    script = "import fenics_crack as fc; fc.build_structure(fc.Scene.from_text({!r}))"
    text = TEXT.replace("box.step", str(parts / "box.step")).replace(
        "size = 0.006", "size = 0.0006"
    )
    program = subprocess.Popen([sys.executable, "-c", script.format(text)], env=environment())
    meshers: list[int] = []
    while not meshers and program.poll() is None:
        time.sleep(0.2)
        meshers = [child for reader in children(program.pid) for child in children(reader)]
    time.sleep(0.5)
    program.send_signal(signal.SIGKILL)
    program.wait()
    deadline = time.monotonic() + 20.0
    while any(map(is_running, meshers)) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert meshers and not any(map(is_running, meshers))
    assert fc.build_structure(part(parts), MPI.COMM_SELF).n_pairs > 0


def children(process: int) -> list[int]:
    """Processes that a process has started."""
    try:
        lines = Path(f"/proc/{process}/task/{process}/children").read_text()
    except OSError:
        return []
    return [int(number) for number in lines.split()]


def is_running(process: int) -> bool:
    """True unless a process has ended."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def test_cells_near_a_front_are_straight() -> None:
    """In a ball away from the origin, cells with a corner near a point of a front have straight
    edges, as the distances say; the surface stays curved elsewhere."""
    with gmsh_model() as model:
        model.occ.addSphere(3.0, 0.0, 0.0, 1.0)
        model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        model.mesh.generate(3)
        model.mesh.setOrder(2)
        contents = collect_nodes_and_groups([(3, 1, "solid", [1])])
        front = {"points": [[3.0, 0.0, 1.0]], "shortest": 0.2, "length": 0.0}
        positions, count = straighten_edges(contents, [front])
    positions_before = contents["positions"]
    order = np.argsort(contents["numbers"])
    cells = order[np.searchsorted(contents["numbers"], contents["nodes"], sorter=order)]
    cells = cells.reshape(-1, 10)
    centres = positions_before[cells[:, TETRAHEDRON_EDGES]].mean(axis=2)
    distances = np.linalg.norm(positions_before[cells[:, :4]] - front["points"][0], axis=2).min(
        axis=1
    )
    is_near = distances < STRAIGHT_CELL_DISTANCE_IN_ELEMENTS * 0.2
    is_curved = np.abs(positions_before[cells[:, 4:]] - centres).max(axis=(1, 2)) > 1e-9
    assert count == np.sum(is_near & is_curved) and 0 < count < np.sum(is_curved)
    assert np.allclose(positions[cells[is_near, 4:]], centres[is_near], atol=1e-12)
    far_nodes = np.setdiff1d(np.arange(len(positions_before)), np.unique(cells[is_near, 4:]))
    assert np.array_equal(positions[far_nodes], positions_before[far_nodes])
