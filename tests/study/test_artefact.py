"""A prepared structure in a file: the answers of its scene, without a mesh."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SOLID, catch_error, changed
from mpi4py import MPI
from surroundings import RunCommand, main

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_drawn")

PLATE = """
[geometry]
width = 0.1
height = 0.3
thickness = 0.002
[crack]
edge = "left"
height = 0.15
length = 0.03
[material]
young = 2.1e11
poisson = 0.3
density = 7850.0
[damping]
ratio = 0.005
[excitation]
point = [0.1, 0.3]
force_sin = [10.0, 0.0]
frequency = 780.0
[contact]
law = "unilateral"
[harmonic_balance]
harmonics = 7
[mesh]
layout = "graded"
size = 0.03
lip_elements = 4
[reduction]
modes = 10
"""
CHANGES = {
    "excitation.frequency": 800.0,
    "excitation.force_sin": [20.0, 0.0],
    "excitation.force_mean": [3.0, 0.0],
    "damping.ratio": 0.01,
    "crack.clearance": 1e-8,
    "contact.friction_error": 0.3,
}
PROGRAM = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        others = ("matplotlib", "PIL", "pyvista", "jinja2")
        others += ("dolfinx", "ufl", "basix", "ffcx", "cffi", "gmsh", "vtkmodules")
        if name.split(".")[0] in others:
            raise ImportError(name + " is blocked")
sys.meta_path.insert(0, Blocked())
from fenics_crack.cli.command_line import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the plate."""
    path = tmp_path_factory.mktemp("prepared") / "plate.h5"
    fc.save_prepared(fc.prepare(fc.Scene.from_text(PLATE)), path)
    return path


def test_file_gives_the_answer_of_its_scene(file: Path) -> None:
    """Amplitude and stated errors under another load, frequency, damping and clearance."""
    own_run = fc.solve(fc.Scene.from_text(PLATE).replace(CHANGES))
    expected_errors = own_run.errors
    run = fc.solve(fc.load_prepared(file, CHANGES))
    assert not run.structure.whole.has_matrices
    assert set(run.errors.parts) == {"modes", "harmonics", "mesh", "friction"}
    assert run.errors.values == pytest.approx(expected_errors.values, rel=1e-6)
    for name in expected_errors.values:
        assert run.errors.stated(name)[0] == pytest.approx(
            expected_errors.stated(name)[0], rel=1e-4
        )


def test_solve_imports_no_mesher(file: Path, tmp_path: Path) -> None:
    """The command writes its files where neither DOLFINx nor gmsh can be imported."""
    words = ["solve", str(file), "--set", "excitation.frequency=790", "--output", str(tmp_path)]
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, check=False
    )
    assert process.returncode in (0, 4), process.stderr  # 4: the error of so coarse a mesh is large
    assert (tmp_path / "solution.h5").exists() and (tmp_path / "solution.json").exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mesh.size", 0.02),
        ("crack.length", 0.02),
        ("material.young", 7e10),
        ("excitation.point", [0.0, 0.3]),
        ("excitation.force_sin", [0.0, 1.0]),
        ("output.quantities", ["reaction_force"]),
    ],
)
def test_keys_of_the_mesh_are_refused(file: Path, key: str, value: object) -> None:
    """Each by its name, with what can be varied."""
    catch_error(lambda: fc.load_prepared(file, {key: value}), key, value)


@pytest.mark.drawn(4)
@pytest.mark.parametrize(
    "call",
    [
        lambda run: fc.solve_modes(run.structure.whole, 3),
        lambda run: fc.bilinear_frequencies(run.structure.whole),
        lambda run: fc.solve_linear(run.structure.whole, run.result.omega),
        lambda run: fc.reduce_structure(run.structure.whole, modes=5, method="free_interface"),
        lambda run: fc.integrate_central_difference(
            run.structure.whole, run.result.omega, run.contact, periods=2, steps_per_period=9
        ),
        lambda run: fc.stress_intensity(run),
        lambda run: fc.reaction(run),
        lambda run: run.structure.whole.tied(1e8),
        lambda run: run.result.amplitude(7),
    ],
)
def test_what_needs_matrices_is_refused(file: Path, call: Callable[[fc.Run], object]) -> None:
    """In one way."""
    run = fc.solve(fc.load_prepared(file))
    catch_error(lambda: call(run), "structure", "a file of a prepared structure")


def test_more_modes_than_the_file_has_are_refused(file: Path) -> None:
    """It is never silently wrong."""
    catch_error(
        lambda: fc.solve(fc.load_prepared(file, {"reduction.modes": 30})),
        "structure",
        "a file of a prepared structure",
        names="60 modes",
    )


def test_tolerance_beyond_the_file_is_said_to_be_missed(file: Path) -> None:
    """A solution has no more modes than the file, and states their error."""
    keys = {"harmonic_balance.tolerance": 1e-3, "harmonic_balance.harmonics": None}
    run = fc.solve(fc.load_prepared(file, keys | {"reduction.modes": None}))
    assert run.structure.n_modes == 10
    assert run.result.report.reduction > 1e-3 and "was requested" in run.result.status


def test_curve_of_a_file(file: Path) -> None:
    """The points of its scene's own curve."""
    keys = {"curve.start": 780.0, "curve.stop": 800.0, "curve.stability": False}
    own_curve, file_curve = (
        fc.curve(source_scene).result
        for source_scene in (fc.Scene.from_text(PLATE).replace(keys), fc.load_prepared(file, keys))
    )
    assert file_curve.omega == pytest.approx(own_curve.omega, rel=1e-6)
    assert file_curve.amplitude() == pytest.approx(own_curve.amplitude(), rel=1e-6)


def test_other_commands_make_a_mesh_of_their_own(file: Path) -> None:
    """A scene of the same mesh is not given the structure of a file."""
    prepared_scene = fc.load_prepared(file)
    assert fc.modes(prepared_scene.scene).structure.has_matrices


def omega_of(path: Path) -> np.ndarray:
    """Natural frequencies that a file holds."""
    structure = fc.load_prepared(path).structure
    return fc.reduce_structure(structure, modes=10, method="massless").omega


FORGERIES: dict[str, Callable[[Any], None]] = {
    "no modes": lambda file: file.pop("structure.receptances.0.squares"),
    "fewer modes": lambda file: shortened(file, "structure.receptances.0.squares", slice(-1)),
    "fewer sources": lambda file: shortened(
        file, "structure.receptances.0.compliance", slice(1, None)
    ),
    "pairs of another structure": lambda file: replaced(file, "structure.clearance", [0.0]),
    "dofs that are not there": lambda file: shortened(file, "structure.gap.indptr", slice(3)),
    "words": lambda file: replaced(file, "structure.receptances.0.modal", "words"),
    "more dofs than nodes": lambda file: replaced(
        file, "structure.gap.indptr", np.append(file["structure.gap.indptr"][()], 10**9)
    ),
    "dofs without nodes": lambda file: put_number(file, "structure.nodes.dofs", (0, 0), 10**9),
    "rows that are nan": lambda file: put_number(file, "structure.gap.data", 0, np.nan),
    "columns between two": lambda file: replaced(
        file, "structure.gap.indices", file["structure.gap.indices"][()] + 0.5
    ),
    "columns that are not there": lambda file: put_number(file, "structure.gap.indices", 0, 10**6),
    "columns before the first": lambda file: put_number(file, "structure.gap.indices", 0, -1),
    "rows that end too late": lambda file: put_number(file, "structure.gap.indptr", -1, 10**6),
    "a node that is not there": lambda file: put_number(
        file, "structure.nodes.cells", (0, 0), 10**6
    ),
    "a crack of another place": lambda file: put_number(file, "structure.pairs.cracks", 0, 10**12),
    "a place that is not there": lambda file: replaced(
        file, "structure", file["structure"].asstr()[()].replace('mouth": 0', 'mouth": 99')
    ),
    "a last row below the first": lambda file: put_number(file, "structure.gap.indptr", -1, -1),
    "fewer loads": lambda file: shortened(file, "structure.force", slice(0)),
    "negative squares": lambda file: put_number(file, "structure.receptances.0.squares", 0, -1.0),
    "infinite": lambda file: put_number(file, "structure.receptances.0.modal", (0, 0), np.inf),
    "another kind": lambda file: file.attrs.modify("kind", "solution"),
    "no scene": lambda file: file.attrs.pop("scene"),
    "no version": lambda file: file.attrs.pop("version"),
}
"""What may be wrong in a file whose digest is right."""


def replaced(file: Any, name: str, value: object) -> None:
    """Put another dataset in the place of one."""
    del file[name]
    file[name] = value


def shortened(file: Any, name: str, kept: slice) -> None:
    """Leave rows of a dataset out."""
    replaced(file, name, file[name][kept])


def put_number(file: Any, name: str, place: Any, number: float) -> None:
    """Put a number into a dataset."""
    values = file[name][()]
    values[place] = number
    replaced(file, name, values)


def test_solids_are_refused_by_name() -> None:
    """Their faces are not in a file."""
    keys = {"contact.law": "unilateral", "contact.stiffness": None, "reduction.modes": 4}
    catch_error(
        lambda: fc.save_prepared(fc.prepare(SOLID.replace(keys)), "solid.h5"),
        "geometry.kind",
        "solid",
    )


@pytest.mark.drawn(9)
@pytest.mark.parametrize("name", FORGERIES)
def test_forged_files_are_refused(name: str, file: Path, tmp_path: Path) -> None:
    """In one line that names the file."""
    forged_path = Path(shutil.copy(file, tmp_path / "forged.h5"))
    with changed(forged_path) as parts:
        FORGERIES[name](parts)
    assert "\n" not in str(
        catch_error(lambda: fc.solve(fc.load_prepared(forged_path)), "path", str(forged_path))
    )


def test_a_killed_writer_leaves_the_whole_file(file: Path, tmp_path: Path) -> None:
    """The one before, or the new one, whenever kill -9 comes."""
    path = Path(shutil.copy(file, tmp_path / "plate.h5"))
    program = (
        "import sys, fenics_crack as fc\n"
        "from fenics_crack.files.store import read_result_file, write_result_file\n"
        f"stored = read_result_file({str(file)!r})\n"
        "print('x', end='', flush=True)\n"
        "while True:\n"
        f"    write_result_file(stored.datasets, {str(path)!r}, stored.kind, stored.scene())\n"
    )
    writer = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert writer.stdout is not None and writer.stdout.read(1)
    time.sleep(0.03)
    writer.kill()
    writer.communicate()
    assert np.array_equal(omega_of(path), omega_of(file))


def test_files_of_the_scene_may_have_gone(tmp_path: Path) -> None:
    """Of mesh and load; changed ones are refused."""
    mesh, wave, path = (tmp_path / name for name in ("plate.msh", "wave.csv", "plate.h5"))
    scene = fc.Scene.from_text(PLATE)
    fc.write_msh(scene, mesh)
    wave.write_text("t,fx,fy\n0,5,0\n0.5,5,0\n0.5,-5,0\n1,-5,0\n")
    of_mesh = {"mesh.layout": "file", "mesh.file": str(mesh), "mesh.order": 2}
    of_mesh |= dict.fromkeys(("geometry.width", "geometry.height"))
    of_mesh |= {"mesh.size": None, "mesh.lip_elements": None, "crack.edge": None}
    of_mesh |= {"crack.height": None, "crack.length": None}
    of_wave = {"excitation.wave": str(wave), "excitation.wave_harmonics": 3}
    scene = scene.replace(of_mesh | of_wave)
    fc.save_prepared(fc.prepare(scene), path)
    changes = {"excitation.frequency": 800.0}
    expected_amplitude = fc.solve(scene.replace(changes)).amplitude(None)
    mesh.unlink(), wave.unlink()
    assert fc.solve(fc.load_prepared(path, changes)).amplitude(None) == pytest.approx(
        expected_amplitude
    )
    wave.write_text("t,fx,fy\n0,1,0\n1,-5,0\n")
    catch_error(lambda: fc.load_prepared(path), "excitation.wave")


def test_command_writes_the_file_that_is_named(tmp_path: Path, run_command: RunCommand) -> None:
    """Other commands than solve and curve say what takes it."""
    scene, path = tmp_path / "plate.toml", tmp_path / "there" / "kept.h5"
    scene.write_text(PLATE)
    assert (
        "a file name that ends in .h5"
        in run_command("reduce", str(scene), "--output", str(tmp_path / "kept"), code=2).err
    )
    assert main(["reduce", str(scene), "--output", str(path)]) == 0
    assert omega_of(path).size and [*path.parent.iterdir()] == [path]
    for command in ("check", "sweep", "modes", "verify", "grow"):
        (line,) = run_command(command, str(path), code=2).err.splitlines()[-1:]
        assert f"a scene (.toml) for the command {command}; only solve and curve take a" in line


def amplitude_of(path: str, comm: MPI.Comm = MPI.COMM_WORLD) -> float:
    """That at another frequency."""
    run = fc.solve(fc.load_prepared(path, {"excitation.frequency": 800.0}, comm), comm)
    return run.amplitude(None)


def refused_by_all(path: str, comm: MPI.Comm = MPI.COMM_WORLD) -> str:
    """Return the text of the error of a forged file, the same on all ranks (collective)."""
    error = catch_error(lambda: fc.load_prepared(path, comm=comm), "path", path)
    assert len({*comm.allgather(str(error))}) == 1
    return str(error)


@pytest.mark.mpi
def test_forged_sizes_are_refused_on_both_ranks(
    file: Path, tmp_path: Path, on_ranks: Callable[..., Any]
) -> None:
    """By one error."""
    forged_path = Path(shutil.copy(file, tmp_path / "forged.h5"))
    with changed(forged_path) as parts:
        FORGERIES["more dofs than nodes"](parts)
    assert "wrong shape" in on_ranks(refused_by_all, str(forged_path))


@pytest.mark.mpi
def test_two_ranks_read_one_file(file: Path, on_ranks: Callable[..., Any]) -> None:
    """With one answer."""
    parallel, single_amplitude = (
        on_ranks(amplitude_of, str(file)),
        amplitude_of(str(file), MPI.COMM_SELF),
    )
    assert parallel == pytest.approx(single_amplitude, rel=1e-9)
