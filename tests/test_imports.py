"""What is imported when: nothing that is not needed, and MPI before PETSc."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import DEMOS, ROOT
from ranks import LIMIT

HEAVY = ("dolfinx", "ufl", "basix", "ffcx", "gmsh", "pyvista", "vtk", "vtkmodules", "matplotlib")
ALL = (*HEAVY, "numpy", "scipy", "mpi4py", "petsc4py", "slepc4py", "h5py")


def fresh(program: str) -> str:
    """What a program says in a process of its own, without what this one has imported."""
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=LIMIT,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()


@pytest.mark.parametrize(
    "line", ["import fenics_crack", "from fenics_crack.cli import command_line"]
)
def test_the_package_alone_imports_nothing(line: str) -> None:
    """Neither meshes and pictures nor NumPy and MPI."""
    program = f"{line}\nimport sys\nprint([name for name in {ALL} if name in sys.modules])"
    assert fresh(program) == "[]"


def test_who_shares_the_tests_out_starts_no_mpi() -> None:
    """Its children, which run them, would take themselves for its ranks, and start none."""
    folders = [str(ROOT / "tests"), str(ROOT / "tests" / "acceptance")]
    program = f"""
import sys
for folder in {folders}:
    sys.path.insert(0, folder)
    sys.modules.pop("conftest", None)
    import conftest
print([name for name in ("mpi4py", "petsc4py", "dolfinx", "gmsh") if name in sys.modules])
"""
    assert fresh(program) == "[]"


@pytest.mark.parametrize("words", ["--help", "--version", "solve --help"])
def test_help_imports_nothing(words: str) -> None:
    """It answers at once."""
    program = f"""
import sys
from surroundings import main
try:
    main({words.split()})
except SystemExit as left:
    assert left.code == 0
print([name for name in {ALL} if name in sys.modules])
"""
    assert fresh(program).splitlines()[-1] == "[]"


REFUSED = {
    "a key": (["solve", "{plate}", "--set", "crack.lenght=0.02"], "did you mean crack.length"),
    "a value": (["check", "{plate}", "--set", "crack.length=-1"], "crack.length = -1"),
    "no scene": (["sweep", "none.toml"], "none.toml"),
    "no measurements": (["identify", "{plate}"], "measurements is missing"),
    "a measurement": (["identify", "{plate}", "{rows}"], "measurements.mode = 99"),
    "a point that there is not": (["identify", "{plate}", "{points}"], "measurements.point = 'tip"),
    "no [tip_timing]": (["timing", "{plate}", "{rows}"], "tip_timing is missing"),
    "arrivals": (
        ["timing", "{plate}", "{rows}", "--set", "tip_timing.probes=[0.0]",
         "--set", "tip_timing.tip_radius=1.0"],
        "a file with the column 'revolution'",
    ),
}  # fmt: skip


def test_bad_input_is_refused_before_all_is_loaded(tmp_path: Path) -> None:
    """Of the package a tenth and of the libraries NumPy: the rest takes longer than the answer."""
    rows = tmp_path / "rows.csv"
    rows.write_text("quantity,value,deviation,mode\nfrequency_open,100.0,1.0,99\n")
    points = tmp_path / "points.csv"
    points.write_text("quantity,value,deviation,frequency,point\nratio_2_1,0.1,0.01,50.0,tip.ux\n")
    places = {"points": str(points), "plate": str(DEMOS / "paper_plate.toml")}
    places["rows"] = str(rows)
    commands = [[word.format(**places) for word in words] for words, _ in REFUSED.values()]
    program = f"""
import sys
sys.stderr = sys.stdout
from surroundings import main
print([int(main(words)) for words in {commands}])
print([name for name in {ALL} if name in sys.modules])
print(sum(name.startswith("fenics_crack") for name in sys.modules))
"""
    *lines, codes, libraries, count = fresh(program).splitlines()
    lines = [line for line in lines if line.startswith("fenics-crack: ")]
    assert len(lines) == len(commands) and codes == str([2] * len(commands))
    for line, (_, reason) in zip(lines, REFUSED.values(), strict=True):
        assert reason in line
    assert libraries == "['numpy']" and int(count) <= 27


def test_another_numpy_is_refused_before_it_is_loaded(tmp_path: Path) -> None:
    """Than the one that install.sh has pinned; from Python and from the shell."""
    (tmp_path / "debian-pins.txt").write_text("cffi==1.15.1\nnumpy==1.24.2\nother<2\n")
    for place in ("numpy", "numpy-2.4.1.dist-info"):
        (tmp_path / place).mkdir()
    (tmp_path / "numpy" / "__init__.py").write_text("raise ImportError('not for this')\n")
    (tmp_path / "numpy-2.4.1.dist-info" / "METADATA").write_text("Name: numpy\nVersion: 2.4.1\n")
    program = f"""
import sys
sys.prefix = {str(tmp_path)!r}
sys.path.insert(0, sys.prefix)
sys.stderr = sys.stdout
from surroundings import main
import fenics_crack as fc
print(int(main(["check", {str(DEMOS / "paper_plate.toml")!r}])))
try:
    fc.Scene
except fc.basics.errors.InputError as error:
    print(error.key, error.value, "1.24.2" in error.allowed, sys.prefix in error.allowed)
"""
    line, code, message = fresh(program).splitlines()
    assert line.startswith("fenics-crack: numpy = '2.4.1': must be 1.24.2") and code == "2"
    assert message == "numpy 2.4.1 True True"


def test_what_was_stopped_ends_without_noise() -> None:
    """Not even that of a library which ends after Ctrl-C, in the middle of a step."""
    program = f"""
import atexit, sys, tomllib
from surroundings import main
def interrupted(*_):
    atexit.register(lambda: 1 / 0)
    raise KeyboardInterrupt
tomllib.loads = interrupted
sys.stderr = sys.stdout
assert main(["check", {str(DEMOS / "paper_plate.toml")!r}]) == 130
"""
    assert fresh(program) == "fenics-crack: stopped"


def test_what_takes_longer_after_mpi_is_loaded_before_it() -> None:
    """gmsh, where a scene has a mesh; and UFL comes without setuptools, which tells its version."""
    program = f"""
import sys
from surroundings import main
assert main(["check", {str(DEMOS / "paper_plate.toml")!r}, "--quiet", "--fresh"]) == 0
places = [[*sys.modules].index(name) for name in ("gmsh", "mpi4py.MPI", "petsc4py.PETSc", "ufl")]
print(places == sorted(places), "pkg_resources" in sys.modules)
"""
    assert fresh(program).splitlines()[-1] == "True False"


@pytest.mark.drawn(1)
@pytest.mark.parametrize(
    "line",
    [
        "from fenics_crack.model import structure",
        "import fenics_crack as fc; fc.Structure",
        "from fenics_crack.time.march import TimeHistory",
        "from fenics_crack.fem import compat",
        "import fenics_crack.files.store",
    ],
)
def test_mpi_allows_several_threads(line: str) -> None:
    """PETSc, were it first, would start MPI for one; a sweep's rank 0 needs more."""
    program = f"""
{line}
import sys
from petsc4py import PETSc
from mpi4py import MPI
print(PETSc.Sys.isInitialized(), MPI.Query_thread() == MPI.THREAD_MULTIPLE)
"""
    assert fresh(program) == "True True"


def chain_without(blocked: tuple[str, ...]) -> str:
    """The beginning of a program that may not import some libraries: a chain of one's own matrices,
    and its solution."""
    return f"""
import sys, tempfile

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {blocked}:
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Blocked())
import numpy as np
import fenics_crack as fc

n = 12
springs = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
gap, force = np.zeros(n), np.zeros(n)
gap[4], gap[5], force[-1] = 1.0, -1.0, 1.0
whole = fc.Structure.from_matrices(
    np.eye(n), springs, gap=gap, force_sin=force, damping=fc.ModalDamping(0.05)
)
structure, law = fc.reduce_structure(whole, modes=6), fc.UnilateralPenalty(2.0)
solution = fc.solve_harmonic_balance(structure, 0.3, law, harmonics=7)
"""


def test_own_matrices_need_no_meshes_and_no_pictures() -> None:
    """From matrices to a curve, a motion in time and a file, with those imports blocked."""
    program = f"""{chain_without(HEAVY)}
assert fc.floquet(structure, solution).verdict == "stable"
curve = fc.continue_frequency(structure, 0.3, 0.31, law, harmonics=5)
history = fc.integrate_events(structure, 0.3, law, periods=3)
with tempfile.TemporaryDirectory() as folder:
    for number, result in enumerate((solution, curve, history)):
        fc.save(result, f"{{folder}}/{{number}}.h5")
        again = fc.load(f"{{folder}}/{{number}}.h5", structure, law)
        assert type(again) is type(result)
print("done")
"""
    assert fresh(program) == "done"


def test_arrivals_need_neither_meshes_nor_structures() -> None:
    """An order in times that are computed here, with the other libraries blocked."""
    program = f"""
import sys
for name in {(*HEAVY, "h5py", "slepc4py")}:
    sys.modules[name] = None
import numpy as np
from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import fit_order

probes, turns = np.array([0.1, 0.9, 2.3, 4.0]), 2.0 * np.pi * np.arange(31)
angles = turns[:-1, None] + probes
times = (angles - 1e-3 * np.cos(3.0 * angles)) / 100.0
times += 1e-9 * np.random.default_rng(1).standard_normal(times.shape)
print(fit_order(ArrivalTimes(times, turns / 100.0, probes, 0.5), range(1, 6)).order)
print(sorted({{name.split(".")[1] for name in sys.modules if name.startswith("fenics_crack.")}}))
"""
    order, folders = fresh(program).splitlines()
    assert order == "3.0" and folders == "['arrivals', 'basics', 'numerics', 'version']"


@pytest.mark.nightly
def test_pictures_of_own_matrices_need_no_meshes() -> None:
    """Spectra, orbits and curves come without DOLFINx and VTK; files for ParaView, which want
    a mesh, are refused without DOLFINx."""
    libraries = ("dolfinx", "ufl", "basix", "ffcx", "gmsh", "pyvista")
    program = f"""{chain_without(libraries)}
fc.draw_spectrum(solution)
fc.draw_orbits(solution)
fc.draw_curve(fc.continue_frequency(structure, 0.3, 0.31, law, harmonics=5), n - 1)
assert "vtkmodules" not in sys.modules
with tempfile.TemporaryDirectory() as folder:
    try:
        fc.write_period(solution, f"{{folder}}/period.pvd")
    except fc.InputError as error:
        print(error)
"""
    requirement = "must be a structure made from a mesh, as fc.build_structure(scene) returns"
    assert f"structure = 'made from matrices': {requirement}" in fresh(program)
