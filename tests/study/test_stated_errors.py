"""What every command states of its numbers: errors by modes, harmonics and mesh."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import DEMOS, ROOT, catch_error, changed, dense
from mpi4py import MPI
from reference_flow import size_of_motion
from surroundings import RunCommand

import fenics_crack as fc
from fenics_crack import InputError

MISSED = 4
"""Exit code of a result whose error is unknown or above the tolerance."""

NO_MESH = "error due to the mesh not included"
COARSE = {
    "mesh.size": 0.03, "mesh.lip_elements": 3, "reduction.modes": 10, "curve": None, "sweep": None,
}  # fmt: skip
SLENDER = """
geometry = { kind = "solid", width = 0.03, height = 0.09, thickness = 0.006 }
crack = { edge = "left", height = 0.03, length = 0.012, depth = 0.003, front = "straight" }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.005 }
excitation = { point = [0.0, 0.09, 0.003], force_sin = [0.0, 0.0, 0.1], frequency = 560.0 }
contact = { law = "unilateral" }
harmonic_balance = { tolerance = 1e-2 }
mesh = { layout = "graded", order = 2, size = 0.012, lip_elements = 2, error = false }
reduction = { modes = 12 }
"""
THROUGH = """
geometry = { kind = "solid", width = 0.02, height = 0.08, thickness = 0.006 }
crack = { edge = "left", height = 0.02, length = 0.008 }
material = { young = 7e10, poisson = 0.33, density = 2700.0 }
damping = { ratio = 0.01 }
excitation = { point = [0.0, 0.08, 0.003], force_sin = [1.0, 0.0, 0.0], frequency = 1064.758 }
contact = { law = "unilateral" }
harmonic_balance = { tolerance = 1e-2 }
mesh = { layout = "graded", order = 2, size = 0.006, lip_elements = 4 }
reduction = { modes = 20 }
"""
"""Its crack breathes in mode 2, at 2129.5 Hz; mode 1, across the plate, is at 754 Hz."""


@pytest.fixture(scope="module")
def scene() -> fc.Scene:
    """A plate of some 100 quadratic elements, 4 % below its resonance."""
    return fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(COARSE)


@pytest.fixture(scope="module")
def run(scene: fc.Scene) -> fc.Run:
    """Its vibration."""
    return fc.solve(scene, MPI.COMM_SELF)


def refined(scene: fc.Scene, factor: float) -> fc.Scene:
    """Elements so many times as short: counted along the lips, and all others follow."""
    lip_elements = scene.mesh.given("lip_elements")
    count = math.ceil(factor * lip_elements)
    return scene.replace(
        {"mesh.lip_elements": count, "mesh.size": scene.mesh.size * lip_elements / count}
    )


def numbers_of(run: fc.Run) -> dict[str, float]:
    """Some numbers of a run, by their names."""
    indicators, bilinear_frequencies = (
        run.result.indicators(),
        fc.bilinear_frequencies(run.structure),
    )
    numbers = {
        name: float(getattr(indicators, name)) for name in ("amplitude", "opening", "ratio_2_1")
    }
    first_omegas = bilinear_frequencies.omega_open[0], bilinear_frequencies.omega_bilinear[0]
    return numbers | dict(
        zip(("frequency_open_1", "frequency_bilinear_1"), first_omegas, strict=True)
    )


def changes(scene: fc.Scene, run: fc.Run) -> dict[str, float]:
    """Relative changes of a run's numbers in another scene."""
    values = numbers_of(fc.solve(scene, MPI.COMM_SELF))
    return {
        name: abs(values[name] / number_of_run - 1.0)
        for name, number_of_run in numbers_of(run).items()
    }


@pytest.mark.parametrize("frequency", [800.0, pytest.param(845.0, marks=pytest.mark.nightly)])
def test_true_errors_over_stated_ones(scene: fc.Scene, frequency: float) -> None:
    """On both sides of the resonance, beside a mesh four times finer with twice the modes: at most
    1.5 times the stated error, of opening and 2/1 3 times, and at least a fifth."""
    keys = {"excitation.frequency": frequency, "contact.friction_error": False}
    run = fc.solve(scene.replace(keys), MPI.COMM_SELF)
    finer_scene = refined(run.scene, 4.0).replace({"mesh.error": False})
    exact = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 40}
    true_changes = changes(finer_scene.replace(exact | {"reduction.modes": 20}), run)
    names = {"amplitude": 1.5, "frequency_open_1": 1.5, "frequency_bilinear_1": 1.5}
    for name, max_ratio in (names | {"opening": 3.0, "ratio_2_1": 3.0}).items():
        error, cause = run.errors.stated(name)
        assert 0.2 < true_changes[name] / error < max_ratio, name
        assert cause == "mesh"


def test_the_largest_force_is_that_of_the_exact_orbit(scene: fc.Scene) -> None:
    """Harmonics leave out some of its peak; twice as many do so, too, and say that all is well."""
    orbit_settings = {"mesh.error": False, "reduction.modes": 20, "mesh.lip_elements": 10}
    run = fc.solve(scene.replace(orbit_settings), MPI.COMM_SELF)
    orbit = fc.shoot(run.structure, run.result)
    time = np.linspace(0.0, orbit.period, 20_000, endpoint=False)
    exact = orbit.force_at(time).sum(axis=1).max()
    crack_force = run.result.indicators().crack_force
    assert run.errors is not None and crack_force / exact < 0.98
    part = run.errors.contributions("crack_force")["harmonics"]
    assert exact - crack_force == pytest.approx(part, rel=0.2)


@pytest.mark.nightly
def test_elements_longer_than_a_solid_is_thick() -> None:
    """The coarser mesh is coarser away from the crack, too: between a tenth and the whole of what
    is stated of natural frequencies is seen on a finer one (up to 11 times it was)."""
    scene = fc.Scene.from_text(SLENDER).replace({"crack.height": 0.06})
    finer_scene = scene.replace({"mesh.size": 0.004, "mesh.lip_elements": 5})
    true_omega = fc.modes(finer_scene, comm=MPI.COMM_SELF).result.omega
    for lips in (2, 3):
        changes = {"mesh.lip_elements": lips, "mesh.error": True}
        modes_run = fc.modes(scene.replace(changes), comm=MPI.COMM_SELF)
        for mode in (1, 2, 3):
            stated_error = modes_run.errors.stated(f"frequency_open_{mode}")[0]
            mesh_error = modes_run.result.omega[mode - 1] / true_omega[mode - 1] - 1.0
            assert 0.1 < mesh_error / stated_error < 1.0, (lips, mode)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("frequency", "amplitude", "opening"),
    [(1064.758, 1.921e-6, 2.477e-7), (1916.564, 4.624e-6, 7.159e-7)],
)
def test_a_solid_at_half_of_a_resonance_and_below_it(
    frequency: float, amplitude: float, opening: float
) -> None:
    """Its second harmonic meets mode 2, though mode 1 is nearer to the load: at most 1.5 times what
    is stated is true, and at least a fifth (2.3 times it was, and an eighth). What is right is that
    of a mesh of 41,784 dofs, 2.9 times finer (``benchmarks/stated_errors.py --only new_solids`` has
    more of the kind)."""
    scene = fc.Scene.from_text(THROUGH).replace({"excitation.frequency": frequency})
    run = fc.solve(scene, MPI.COMM_SELF)
    for name, true_number in {"amplitude": amplitude, "opening": opening}.items():
        true_error, (stated_error, cause) = (
            abs(true_number / run.errors.values[name] - 1.0),
            run.errors.stated(name),
        )
        assert cause == "mesh" and 0.2 < true_error / stated_error < 1.5, name


def test_a_plate_next_to_its_force(scene: fc.Scene) -> None:
    """Where the force is, two meshes show less than the next ones add, like log(1/h): at most 1.6
    times the mesh's part of the amplitude is true, and at least a fifth (4.3 times it was). What is
    right is that of a mesh three times finer, with as many modes and harmonics."""
    coarse_settings = {"mesh.size": 0.02, "mesh.lip_elements": 6, "reduction.modes": 20}
    crack = {"crack.length": 0.045, "crack.height": 0.243, "damping.ratio": 0.006}
    load = {"excitation.frequency": 428.8, "contact.friction_error": False}
    run = fc.solve(scene.replace(coarse_settings | crack | load), MPI.COMM_SELF)
    true_error = abs(4.945e-6 - run.errors.values["amplitude"])
    assert 0.2 < true_error / run.errors.contributions("amplitude")["mesh"] < 1.6


def test_a_mesh_too_coarse_to_know_its_error(
    scene: fc.Scene, tmp_path: Path, run_command: RunCommand
) -> None:
    """The error of a number that the mesh changes by as much as it is is unknown, here next to a
    resonance of 0.02 % damping, and that of the resonance is not; with one element along the crack
    there is no coarser mesh."""
    changes = {"mesh.lip_elements": 2, "damping.ratio": 2e-4, "excitation.frequency": 830.0}
    coarse_scene = scene.replace(changes | {"contact.friction_error": False})
    run_command("solve", coarse_scene, "--output", tmp_path, "--quiet", code=MISSED)
    rows = {row["name"]: row for row in json.loads((tmp_path / "solution.json").read_text())}
    amplitude, resonance = rows["amplitude"], rows["over_bilinear"]
    assert amplitude["error [%]"] is None and amplitude["most by"] == "mesh"
    assert 0.1 < resonance["error [%]"] < 10.0
    stated_errors = fc.load_run(tmp_path / "solution.h5", MPI.COMM_SELF).stated
    assert stated_errors.contributions("amplitude")["mesh"] > stated_errors.values["amplitude"]
    assert stated_errors.stated("amplitude") == (math.inf, "mesh")
    few_errors = fc.modes(scene.replace({"mesh.lip_elements": 1}), comm=MPI.COMM_SELF).errors
    assert few_errors is not None and few_errors.unknown.keys() == {"mesh"}


@pytest.mark.nightly
def test_the_share_closed_is_counted_at_instants(run: fc.Run) -> None:
    """Its stated error has what counting leaves out: beside the orbit's own switching instants, or
    of a smooth law, without an orbit, one instant's part."""
    orbit = fc.shoot(run.structure, run.result)
    time = orbit.period * np.arange(200_000) / 200_000
    share_error = run.result.indicators().closed_share - np.mean(orbit.force_at(time) > 0.0)
    assert run.errors is not None and abs(share_error) > 5e-5
    part = run.errors.contributions("closed_share")["harmonics"]
    assert part == pytest.approx(abs(share_error), abs=2e-5)
    smooth_settings = {
        "contact.law": "smoothed",
        "contact.stiffness": 1e9,
        "contact.sharpness": 1e9,
    }
    error_settings = {"mesh.error": False, "contact.friction_error": False}
    smooth_errors = fc.solve(
        run.scene.replace(smooth_settings | error_settings), MPI.COMM_SELF
    ).errors
    assert (
        smooth_errors is not None
        and smooth_errors.contributions("closed_share")["harmonics"] >= 1.0 / 1024
    )


@pytest.mark.nightly
def test_a_crack_that_closes_pair_by_pair(scene: fc.Scene) -> None:
    """With a preload some of eight pairs never part, and a coarse mesh of few pairs says next to
    nothing by chance: the opening is known to within 1.6 times what is stated, 2/1 to within three
    times (3.2 times the opening was, with half of the harmonics)."""
    pressed_settings = {"crack.clearance": -2e-7, "crack.height": 0.2, "damping.ratio": 0.02}
    pressed_settings |= {"mesh.size": 0.02, "mesh.lip_elements": 4, "excitation.frequency": 1024.0}
    pressed_settings |= {"contact.friction_error": False}
    run = fc.solve(scene.replace(pressed_settings), MPI.COMM_SELF)
    finer_scene = refined(run.scene, 4.0).replace({"mesh.error": False})
    is_touching = run.result.contact_force(run.result.instants()) > 0.0
    assert 0 < is_touching.all(axis=0).sum() < 4
    exact = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 40}
    true_changes = changes(finer_scene.replace(exact), run)
    for name, most in (("opening", 1.6), ("ratio_2_1", 3.0)):
        assert 0.2 < true_changes[name] / run.errors.stated(name)[0] < most, name


def test_parts_are_what_their_runs_say(scene: fc.Scene, run: fc.Run) -> None:
    """Each is that of a run made by hand."""
    errors = run.errors
    assert errors is not None and not errors.unknown
    natural_omega = [fc.bilinear_frequencies(run.structure).omega_bilinear[0]]
    twin_scene = run.scene.replace({"mesh.size": 0.045, "mesh.lip_elements": 2})
    twin = fc.prepare(twin_scene, MPI.COMM_SELF)
    natural_omega.append(fc.bilinear_frequencies(twin.structure).omega_bilinear[0])
    many_elements, few_elements = errors.counts["mesh"]
    meshes = [plate.structure.whole.nodes.cells for plate in (run, twin)]
    assert [many_elements, few_elements] == [*map(len, meshes)] and many_elements > few_elements
    resonance = errors.values[errors.resonance]
    frequency = errors.contributions("frequency_bilinear_1")["mesh"] / resonance
    assert frequency == pytest.approx(
        abs(natural_omega[1] / natural_omega[0] - 1.0)
        / ((many_elements / few_elements) ** 0.5 - 1.0),
        rel=1e-9,
    )

    def opening(structure: fc.Structure, omega: float, **how: Any) -> float:
        law = fc.contact_law(run.scene.contact, structure)
        solution = fc.solve_harmonic_balance(
            structure, omega, law, **how or {"tolerance": 1e-4, "throw": False}
        )
        return float(solution.indicators(0).opening)

    omega, parts = run.result.omega, errors.contributions("opening")
    own_opening, twin_opening = (
        opening(run.structure, omega),
        opening(twin.structure, omega * natural_omega[1] / natural_omega[0]),
    )
    both = []
    fourth_order_share, first_order_share = (
        1.0 / ((many_elements / few_elements) ** (order / 2.0) - 1.0) for order in (4.0, 1.0)
    )
    for share in np.linspace(fourth_order_share, first_order_share, 8):
        extrapolated_omega = natural_omega[0] + share * (natural_omega[0] - natural_omega[1])
        shifted_opening = opening(
            run.structure, float(omega * natural_omega[0] / extrapolated_omega)
        )
        both.append((share * (own_opening - twin_opening), shifted_opening - own_opening))
    largest_sum, smallest_part = (
        max(abs(sum(one)) for one in both),
        max(min(map(abs, one)) for one in both),
    )
    law = fc.contact_law(run.scene.contact, run.structure)
    kept_solution = fc.solve_harmonic_balance(
        run.structure, omega, law, harmonics=run.result.harmonics
    )
    is_touching = kept_solution.contact_force(kept_solution.instants()) > 0.0
    opening_range = np.ptp(kept_solution.gap(kept_solution.instants()).min(axis=0)) * np.ptp(
        is_touching.mean(axis=0)
    )
    step = 0.5 * opening_range / kept_solution.structure.n_pairs
    opening_change = opening(run.structure.varied(clearance=step), omega) - own_opening
    assert parts["mesh"] == pytest.approx(
        math.hypot(largest_sum, 0.1 * smallest_part, opening_change), rel=0.01
    )
    limit = opening(run.structure, omega, harmonics=16 * run.result.harmonics)
    exact = abs(limit - errors.values["opening"])
    assert parts["harmonics"] == pytest.approx(exact, rel=0.1)  # maxima at other instants
    modes = opening(run.structure.reference, omega, harmonics=16 * run.result.harmonics)
    assert parts["modes"] == pytest.approx(2.0 * abs(modes - limit), rel=0.1)
    stated_error, cause = errors.stated("opening")
    assert stated_error == pytest.approx(math.hypot(*parts.values()) / errors.values["opening"])
    rows = errors.to_dict()
    row = list(zip(rows["quantity"], rows["cause"], strict=True)).index(("opening", "mesh"))
    assert (rows["value_1"][row], rows["value_2"][row]) == pytest.approx(
        (own_opening, twin_opening), rel=3e-4
    )
    assert rows["count_1"][row] == many_elements and cause == "mesh"


def test_the_report_and_the_stated_error_are_by_the_same_orbits(run: fc.Run) -> None:
    """Those with the modes kept and with the reference's, over the share that these have. The
    amplitude changes by less than the motion does."""
    solution, errors, dof = run.result, run.errors, run.watched_dof
    more_modes = solution.assessment.more_modes
    share, few_orbit, many_orbit = (
        solution.structure.error_share_removed_by_reference,
        more_modes.orbit_with_fewer_modes,
        more_modes.orbit,
    )
    time = few_orbit.period * np.arange(2000) / 2000
    own_motion, other = (
        orbit.structure.values_at(orbit.displacement_at(time), [dof])[:, 0]
        for orbit in (few_orbit, many_orbit)
    )
    modes_deviation = np.std(other - own_motion) / share
    assert abs(many_orbit.amplitude(dof) - few_orbit.amplitude(dof)) / share < 0.7 * modes_deviation
    assert errors.contributions("amplitude")["modes"] == pytest.approx(modes_deviation, rel=1e-2)
    gaps, other = few_orbit.period_samples.gaps, many_orbit.period_samples.gaps
    size = size_of_motion(gaps + solution.structure.clearance)
    assert solution.report.reduction == pytest.approx(np.linalg.norm(other - gaps) / size / share)


@pytest.mark.drawn(1)
@pytest.mark.parametrize(
    ("frequency", "force", "ratio"), [(625.75, 0.0, 0.0005), (2860.0, 0.1, 0.005)]
)
def test_modes_that_few_harmonics_do_not_reach(
    frequency: float, force: float, ratio: float
) -> None:
    """A blade that bends has modes far above the 6 to 25 harmonics that a tolerance takes, to which
    twice the modes make no difference, where the exact motion changes by up to 18 times as much.
    Four times the modes with 200 harmonics are the truth, of which an extreme may be by chance less
    far than the mean change that is stated."""

    def amplitude(scene: fc.Scene) -> float:
        return float(fc.solve(scene, MPI.COMM_SELF).result.indicators().amplitude)

    scene = fc.Scene.from_text(SLENDER).replace(
        {
            "excitation.frequency": frequency,
            "excitation.force_sin": (force, 0.0, 0.1),
            "damping.ratio": ratio,
        }
    )
    run = fc.solve(scene, MPI.COMM_SELF)
    assert run.errors is not None and run.result.harmonics <= 25
    exact = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 200}
    limit = amplitude(scene.replace(exact | {"reduction.modes": 48}))
    stated_error = run.errors.stated("amplitude")[0] * run.errors.values["amplitude"]
    assert 0.03 < abs(run.result.indicators().amplitude - limit) / stated_error < 1.5


def test_a_coarser_mesh_that_cannot_be_made(
    scene: fc.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody chose to leave its part out, so no error is stated, and the result says why."""

    def fails(*_: object, **__: object) -> None:
        raise InputError("crack.length", 0.1, "meshed")

    monkeypatch.setattr("fenics_crack.study.meshes.prepare", fails)
    errors = fc.solve(scene, MPI.COMM_SELF).errors
    assert errors is not None and np.isnan(errors.stated("amplitude")[0])
    assert errors.doubt("amplitude") == "a run with another mesh is refused because of crack.length"
    assert errors.contributions("amplitude")["harmonics"] > 0.0


def test_without_the_mesh(scene: fc.Scene) -> None:
    """Where it is not asked for, or there is one mesh, that is said."""
    bare_errors = fc.solve(scene.replace({"mesh.error": False}), MPI.COMM_SELF).errors
    assert bare_errors is not None and bare_errors.unknown == {"mesh": "mesh.error = false"}
    assert (
        bare_errors.omitted_causes_text == NO_MESH
        and 0.0 < bare_errors.stated("amplitude")[0] < 2e-2
    )
    open_lips, cause = bare_errors.stated(
        "frequency_open_1"
    )  # modes and harmonics do not change it
    assert np.isnan(open_lips) and not cause
    soft_settings = {
        "contact.stiffness": 1e9,
        "damping.ratio": 0.05,
    }  # whose orbit is found at once
    for demo, changes in (("chain", {}), ("inclined_crack", {}), ("paper_plate", soft_settings)):
        few_harmonics = {"harmonic_balance.harmonics": 3, "curve": None} | changes
        run = fc.solve(fc.Scene.load(DEMOS / f"{demo}.toml").replace(few_harmonics), MPI.COMM_SELF)
        assert run.errors.unknown.keys() - {"friction"} == {"mesh"}
    uncracked_errors = fc.solve(
        scene.replace({"crack": None, "contact": None}), MPI.COMM_SELF
    ).errors
    assert (
        uncracked_errors is not None
        and not uncracked_errors.unknown
        and uncracked_errors.absent.keys() == {"harmonics"}
    )
    assert set(uncracked_errors.values) == {
        "amplitude",
        *(f"frequency_open_{n}" for n in (1, 2, 3)),
    }
    assert fc.integrate(scene.replace({"integration.periods": 2}), MPI.COMM_SELF).errors is None


@pytest.mark.nightly
@pytest.mark.parametrize("frequency", [2.98e4, 3e4, 3.01e4])
def test_far_too_few_harmonics(frequency: float, tmp_path: Path) -> None:
    """What 5 and 10 of them say of bricks that chatter may be the same by chance, to 0.5 % at 30
    kHz, where 80 say a third more: the error is not known, or about that."""
    for path in (ROOT / "tests" / "exchange" / "plate").iterdir():
        shutil.copy(path, tmp_path)
    few_scene = fc.Scene.from_mapping(
        {
            "structure": {
                "mass": str(tmp_path / "plate.mas"), "stiffness": str(tmp_path / "plate.sti"),
                "model": str(tmp_path / "plate.inp"),
            },
            "damping": {"ratio": 0.002},
            "excitation": {
                "point": [0.0, 0.02, 0.005], "force_cos": [1.0, 0.0, 0.0], "frequency": frequency
            },
            "contact": {"law": "unilateral"},
            "reduction": {"modes": 20},
        }
    )  # fmt: skip
    own_run, fine_run = (
        fc.solve(few_scene.replace({"harmonic_balance.harmonics": harmonics}), MPI.COMM_SELF)
        for harmonics in (5, 80)
    )
    exact, value = (run.errors.values["amplitude"] for run in (fine_run, own_run))
    error, cause = own_run.errors.stated("amplitude")
    true_error = abs(exact / value - 1.0)
    assert true_error > 0.08
    if np.isnan(error):
        assert own_run.errors.unknown.keys() & {"modes", "harmonics"}
    else:
        assert cause == "harmonics" and 0.5 < error / true_error < 2.0


def test_two_files_of_one_part(scene: fc.Scene, run: fc.Run, tmp_path: Path) -> None:
    """The coarser one says of the other what the meshes of a scene say of each other."""
    twin = refined(scene, 0.5)
    for name, made in (("own", scene), ("coarse", twin)):
        fc.write_msh(made, tmp_path / f"{name}.msh")
    files = scene.replace(
        {
            "geometry.width": None, "geometry.height": None, "mesh.size": None,
            "mesh.layout": "file", "mesh.file": str(tmp_path / "own.msh"),
            "mesh.coarser": str(tmp_path / "coarse.msh"), "mesh.lip_elements": None, "crack": None,
        }
    )  # fmt: skip
    errors = fc.solve(files, MPI.COMM_SELF).errors
    assert errors is not None and not errors.omitted_causes_text
    for name, value in errors.values.items():
        assert value == pytest.approx(run.errors.values[name], rel=1e-6)
        assert errors.stated(name)[0] == pytest.approx(run.errors.stated(name)[0], rel=1e-3)
    catch_error(
        lambda: fc.solve(
            files.replace({"mesh.coarser": str(tmp_path / "none.msh")}), MPI.COMM_SELF
        ),
        "mesh.coarser",
        str(tmp_path / "none.msh"),
    )

    def why_unknown(name: str) -> str:
        """Return why the error by the mesh is unknown with a coarser file."""
        coarser_scene = files.replace({"mesh.coarser": str(tmp_path / name)})
        return str(fc.modes(coarser_scene, 1, MPI.COMM_SELF).errors.unknown["mesh"])

    assert why_unknown("own.msh") == "a coarser mesh has as many elements: refine the mesh"
    larger_settings = {
        "geometry.height": 2.0 * scene.geometry.height,
        "mesh.size": 2.0 * scene.mesh.size,
    }
    fc.write_msh(twin.replace(larger_settings), tmp_path / "other.msh")
    assert "another part" in why_unknown("other.msh")
    crack, few_scene = scene.given("crack"), refined(scene, 0.25)
    second = {"edge": "right", "height": 0.5 * crack.height, "length": crack.length}
    for other_crack in (
        {"crack.length": 0.5 * crack.length}, {"crack.height": 0.5 * crack.height},
        {f"cracks.1.{key}": value for key, value in second.items()},
    ):  # fmt: skip
        fc.write_msh(few_scene.replace(other_crack), tmp_path / "cracks.msh")
        assert "mesh.coarser has another" in why_unknown("cracks.msh")


def test_of_modes_and_of_a_curve(scene: fc.Scene, run: fc.Run) -> None:
    """Natural frequencies by the mesh alone; of a curve the largest response, whose frequency
    moves with the resonance."""
    modes = fc.modes(scene, 3, MPI.COMM_SELF)
    assert modes.errors is not None and run.errors is not None and modes.errors.causes == ("mesh",)
    name = "frequency_open_1"
    assert modes.errors.stated(name)[0] == pytest.approx(run.errors.stated(name)[0], rel=1e-6)
    range_ = {"curve.start": 820.0, "curve.stop": 845.0, "curve.parameter": "frequency"}
    curve = fc.curve(scene.replace(range_ | {"curve.stability": False}), MPI.COMM_SELF)
    largest_amplitude = curve.result.amplitude(curve.watched_dof).max()
    assert curve.errors.values["amplitude"] == pytest.approx(largest_amplitude, rel=1e-4)
    assert curve.errors.stated("amplitude")[0] < run.errors.stated("amplitude")[0]
    peak, single_peak = curve.peak(), curve.result.peak()
    stated_shares = [curve.errors.stated(name)[0] for name in ("amplitude", "frequency_bilinear_1")]
    assert [peak.error, peak.omega_error] == stated_shares and not peak.without
    assert peak.amplitude == single_peak.amplitude and peak.error != single_peak.error
    assert single_peak.without == NO_MESH and single_peak.without in str(single_peak)
    assert "of the frequency 0.00" in str(peak) and "not included" not in str(peak)
    catch_error(run.peak, names="'Run' object has no attribute 'peak'", kind=AttributeError)


@pytest.mark.drawn(2)
@pytest.mark.parametrize(
    "change",
    [
        lambda kept: kept.pop("values"),
        lambda kept: kept["counts"].pop("mesh"),
        lambda kept: kept["counts"].update(mesh=[1]),
        lambda kept: kept["parts"]["mesh"]["opening"].update(order="large"),
        lambda kept: kept["units"].pop("opening"),
        lambda kept: kept.update(values=7),
    ],
)
def test_strange_files(run: fc.Run, tmp_path: Path, change: Callable[[Any], object]) -> None:
    """What does not fit is refused."""
    error_table = json.loads(run.errors.to_json())
    path = tmp_path / "solution.h5"
    replace(run, stated=run.errors).save(path)
    stored_errors = fc.load_run(path, MPI.COMM_SELF).stated
    assert (
        stored_errors is not None and stored_errors.to_dict().keys() == run.errors.to_dict().keys()
    )
    np.testing.assert_equal(stored_errors.totals().rows, run.errors.totals().rows)
    change(error_table)
    with changed(path) as file:
        del file["verification"]
        file["verification"] = json.dumps(error_table)
    catch_error(lambda: fc.load_run(path, MPI.COMM_SELF), "path")


def test_three_natural_frequencies_are_stated() -> None:
    """Those of the three lowest modes of the open chain, by its matrices."""
    run = fc.solve(fc.Scene.load(DEMOS / "chain.toml"))
    whole_structure = run.structure.whole
    squares = scipy.linalg.eigvalsh(dense(whole_structure.stiffness), dense(whole_structure.mass))
    frequencies = [run.errors.values[f"frequency_open_{mode}"] for mode in (1, 2, 3)]
    assert frequencies == pytest.approx(np.sqrt(squares[:3]) / (2.0 * np.pi), rel=1e-6)


def test_a_steady_load_has_errors_of_frequencies(scene: fc.Scene) -> None:
    """Nothing vibrates: its amplitude 0 has no relative error."""
    steady_load = {"excitation.force_sin": [0.0, 0.0], "excitation.force_mean": [1.0, 0.0]}
    errors = fc.solve(scene.replace(steady_load), MPI.COMM_SELF).errors
    assert errors is not None and "mesh" in errors.parts
    assert errors.stated("frequency_open_1")[0] > 0.0 and "amplitude" not in errors.values
