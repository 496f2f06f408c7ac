"""Sweeps: right numbers, the same on any number of ranks; nothing is lost when killed."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catch_error, changed, relative, wrap
from mpi4py import MPI
from ranks import HELD, LIMIT, command, environment, kill
from rotating import cracked

import fenics_crack as fc
import fenics_crack.fem.build
from fenics_crack import Scene, SweepResult, prepare, run_sweep
from fenics_crack.basics.errors import WriteError
from fenics_crack.fem.build import assemble_structure
from fenics_crack.sweep import case as sweep_case
from fenics_crack.sweep import file as sweep_file
from fenics_crack.sweep import jobs as sweep_jobs
from fenics_crack.sweep import result as sweep
from fenics_crack.sweep.file import UNIT_AND_NUMPY_TYPE_BY_COLUMN, SweepFile

Over = Mapping[str, Any]
SOFT = {"damping.ratio": 0.01, "contact.stiffness": 1e9}
GRADED = SOFT | {
    "mesh.layout": "graded", "mesh.columns": None, "mesh.rows": None, "mesh.size": 0.02,
    "mesh.lip_elements": 3, "damping.modes": 10, "contact.stiffness": 1e9,
    "reduction.method": "free_interface",
}  # fmt: skip
MASSLESS = GRADED | {"reduction.method": None, "crack.clearance": 1e-8}
FAST = {"excitation.omega": [1900.0, 2000.0], "harmonic_balance.harmonics": [3, 5]}


def swept(scene: fc.Scene, over: Over, changes: Over = SOFT) -> fc.Scene:
    """A scene with a sweep."""
    if "mesh.layout" in changes:
        mesh = {k.removeprefix("mesh."): v for k, v in changes.items() if k.startswith("mesh.")}
        changes = {k: v for k, v in changes.items() if not k.startswith("mesh.")}
        scene = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, **mesh))
    return scene.replace(dict(changes) | {"sweep.over": over})


def by_hand(scene: fc.Scene, values: Over) -> tuple[fc.Structure, fc.PeriodicSolution]:
    """One case on its own."""
    case = scene.replace({"sweep": None}).replace(dict(values))
    plate = prepare(case, MPI.COMM_SELF).structure
    solution = fc.solve_harmonic_balance(
        plate,
        case.excitation.omega,
        fc.contact_law(case.contact, plate),
        harmonics=case.harmonic_balance.harmonics,
        samples=case.harmonic_balance.samples,
    )
    return plate, solution


def assert_same(one: SweepResult, other: SweepResult) -> None:
    """All columns but the time agree to the bit, and so do the gaps."""
    assert one.shape == other.shape and one.complete and other.complete
    for name in ("state", *(name for name in UNIT_AND_NUMPY_TYPE_BY_COLUMN if name != "seconds")):
        np.testing.assert_array_equal(other[name], one[name], err_msg=name)
    for index in map(tuple, np.argwhere(one.converged)):
        np.testing.assert_array_equal(other.gap(index), one.gap(index))


@pytest.fixture(scope="module")
def fast(paper_scene: fc.Scene, tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    """Four cases; not to be changed."""
    return run_sweep(swept(paper_scene, FAST), tmp_path_factory.mktemp("fast") / "sweep.h5")


# --- numbers --------------------------------------------------------------------------------------


def values_at(result: SweepResult, index: tuple[int, ...]) -> dict[str, Any]:
    """Return the values of a case by their keys."""
    return {
        axis.key: axis.values[axis_index]
        for axis, axis_index in zip(result.axes, index, strict=False)
    }


def test_table_is_the_product_of_the_axes(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """Numbered with the last axis fastest; values, waves and solutions as solved by hand."""
    scene = swept(paper_scene, FAST | {"contact.stiffness": [1e9, 2e9, 4e9]})
    result = run_sweep(scene, tmp_path / "sweep.h5")
    assert result.shape == (2, 2, 3) and result.complete and result.failed_indices_and_reasons == []
    names, rows = result.table().columns, result.table().rows
    assert names[:5] == [
        "excitation.omega [rad/s]", "harmonic_balance.harmonics", "contact.stiffness [N/m]",
        "state", "response [m]",
    ]  # fmt: skip
    assert [row[:3] for row in rows[:4]] == [
        [1900.0, 3, 1e9], [1900.0, 3, 2e9], [1900.0, 3, 4e9], [1900.0, 5, 1e9],
    ]  # fmt: skip
    assert len(rows) == 12 and rows[7][4] == result["response"][1, 0, 1]
    for number, index in ((0, (0, 0, 0)), (4, (0, 1, 1)), (8, (1, 0, 2))):
        plate, solution = by_hand(scene, values_at(result, index))
        count = 1024 if number else 1 << 17  # by many instants, too
        time_, tolerance = solution.period * np.arange(count) / count, 1e-4 if number else 1e-8
        corner = plate.find_dof((0.1, 0.1), "x")
        motion, gap = solution.displacement(time_, [corner]), solution.gap(time_)
        force, indicators = solution.contact_force(time_), solution.indicators(corner)
        for name, exact, table_number in (
            ("response", indicators.amplitude, np.ptp(motion) / 2.0),
            ("opening", indicators.opening, -gap.min()),
            ("penetration", indicators.penetration, gap.max()),
            ("contact_force", indicators.contact_force, force.max()),
        ):
            assert result[name][index] == pytest.approx(exact, rel=1e-8)
            assert result[name][index] == pytest.approx(table_number, rel=tolerance)
        assert result["closed_share"][index] == pytest.approx(np.mean(force > 0), abs=1.5 / 1024)
        truncation = solution.report.truncation
        assert result["truncation_error"][index] == pytest.approx(truncation, rel=1e-6)
        for found in (result.gap(index), result.gap(number)):
            np.testing.assert_allclose(found, solution.gap_coefficients, atol=1e-9 * gap.max())
        stored_solution = result.solution(index)
        np.testing.assert_allclose(
            stored_solution.gap_coefficients, solution.gap_coefficients, atol=1e-14
        )
        np.testing.assert_allclose(
            stored_solution.displacement(time_, [corner]), motion, atol=1e-8 * np.ptp(motion)
        )
        assert stored_solution.report.truncation == result["truncation_error"][index]


LOADS = {"excitation.force_cos": [(0.0, 0.0), (30.0, 200.0)], "crack.clearance": [0.0, -1e-7]}
RIGID = {"contact.law": "unilateral", "contact.stiffness": None}


@pytest.mark.drawn(2)
@pytest.mark.parametrize(
    ("changes", "close"),
    [
        (GRADED | {"harmonic_balance.harmonics": 4}, 1e-4),  # unit loads make another basis
        (MASSLESS | {"harmonic_balance.harmonics": 6}, 1e-6),
        (MASSLESS | RIGID | {"harmonic_balance.harmonics": 6}, 1e-6),
    ],
    ids=["with mass", "massless", "rigid"],
)
def test_loads_and_clearances_are_swept_without_a_new_geometry(
    changes: Over, close: float, paper_scene: fc.Scene, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """In both directions and phases, and with a preload: as solved by hand."""
    scene, built = swept(paper_scene, LOADS, changes), []
    wrap(
        monkeypatch, "fenics_crack.sweep.case.prepare",
        lambda prepare, *given, **more: built.append(given) or prepare(*given, **more),
    )  # fmt: skip
    result = run_sweep(scene, tmp_path / "sweep.h5")
    assert len(built) == 1 and result.converged.all()
    for index in np.ndindex(2, 2):
        plate, solution = by_hand(scene, values_at(result, index))
        gap, stored_solution = solution.gap_coefficients, result.solution(index)
        np.testing.assert_allclose(result.gap(index), gap, atol=close * np.abs(gap).max())
        instants = solution.period * np.arange(1 << 14) / (1 << 14)
        components = [plate.find_dof((0.1, 0.1), component) for component in "xy"]
        motion = solution.displacement(instants, components)
        force = np.array([[100.0, 0.0], [30.0, 200.0]][index[0]])
        load_motion = motion @ force / np.linalg.norm(force)
        assert result["response"][index] == pytest.approx(np.ptp(load_motion) / 2.0, rel=close)
        for name, *more_arguments in (("gap",), ("contact_force",), ("displacement", components)):
            motion_by_hand, motion_of_file = (
                getattr(compared_solution, name)(instants, *more_arguments)
                for compared_solution in (solution, stored_solution)
            )
            np.testing.assert_allclose(
                motion_of_file, motion_by_hand, atol=10.0 * close * np.ptp(motion_by_hand)
            )
        assert stored_solution.structure.clearance[0] == LOADS["crack.clearance"][index[1]]
        assert stored_solution.contact == solution.contact
        if isinstance(plate, fc.MasslessStructure):
            reduction = pytest.approx(solution.report.reduction, rel=1e-3)
            assert 0.0 < result["reduction_error"][index] == reduction


@pytest.mark.parametrize("reduction", ["off", "free_interface", "massless"])
def test_a_case_leaves_the_solution_of_another_alone(paper_scene: fc.Scene, reduction: str) -> None:
    """Each has a structure of its own, with its load and clearance."""
    given = [(100.0, 0.0), (30.0, -1e-7)]
    cases = [
        paper_scene.replace(SOFT | {"reduction.method": reduction, "reduction.modes": 9}).replace(
            {"excitation.force_sin": (load, 0.0), "crack.clearance": clearance}
        )
        for load, clearance in given
    ]
    geometry = sweep_case.build_sweep_geometry(
        cases[1], MPI.COMM_SELF, sweep_case.SharedCaseOptions(has_unit_loads=True)
    )
    solutions = [sweep_case.CaseSolver(geometry).solve_at_given_frequency(case) for case in cases]
    for solution, (load, clearance) in zip(solutions, given, strict=True):
        structure = solution.structure
        assert structure.body is geometry.structure.body
        for part in (structure, structure.whole, getattr(structure, "reference", structure)):
            assert np.all(part.clearance == clearance)
            np.testing.assert_allclose(part.force[2], load * part.unvaried_structure.force[2])
        expected_solution = fc.solve_harmonic_balance(
            structure, solution.omega, solution.contact, harmonics=solution.harmonics
        )
        np.testing.assert_array_equal(solution.gap_coefficients, expected_solution.gap_coefficients)


@pytest.mark.parametrize("changes", [pytest.param(SOFT, marks=pytest.mark.nightly), MASSLESS])
def test_harmonics_follow_a_tolerance(paper_scene: fc.Scene, tmp_path: Path, changes: Over) -> None:
    """From case to case and from tolerance to tolerance; the table has each case's H and waves."""
    sweep_axes = {
        "excitation.omega": {"start": 1700.0, "stop": 2300.0, "count": 5},
        "harmonic_balance.tolerance": [0.3, 0.03],
    }
    result = run_sweep(swept(paper_scene, sweep_axes, changes), tmp_path / "sweep.h5")
    assert result.converged.all()
    assert np.all(result["truncation_error"] <= np.array([0.3, 0.03]))
    counts = result["harmonics"]
    assert np.all(counts >= 5) and np.all(counts[:, 1] >= counts[:, 0])
    assert len(np.unique(counts)) > 1
    for index in np.ndindex(*result.shape):
        assert len(result.gap(index)) == 2 * counts[index] + 1
    stored_solution = result.solution((4, 1))
    plate, time = stored_solution.structure, stored_solution.instants()
    assert stored_solution.harmonics == counts[4, 1]
    single_solution = fc.solve_harmonic_balance(
        plate,
        stored_solution.omega,
        stored_solution.contact,
        tolerance=0.03,
        initial=stored_solution,
        throw=False,
    )
    assert relative(stored_solution.gap(time), single_solution.gap(time)) < 0.06


def test_a_tolerance_out_of_reach(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """Such a case says what its error stays above; the next one is solved without it."""
    sweep_axes = {"excitation.omega": [1700.0, 1800.0], "harmonic_balance.tolerance": [1e-12, 0.03]}
    result = run_sweep(swept(paper_scene, sweep_axes, SOFT), tmp_path / "sweep.h5")
    assert result.converged.tolist() == [[False, True], [False, True]]
    for reason in dict(result.failed_indices_and_reasons).values():
        assert re.search(r"truncation error, .* with H = \d+, stays above 1e-12", reason)


def test_constraint(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """No verdict on stability; the solution carries its weight."""
    changes = {"damping.ratio": 0.01, "contact.stiffness": None, "contact.law": "unilateral"}
    scene = swept(paper_scene, {"excitation.omega": [1900.0, 2000.0]}, changes)
    result = run_sweep(scene, tmp_path / "sweep.h5")
    assert result.converged.all()
    assert result["verdict"].tolist() == ["", ""] and np.isnan(result["multiplier"]).all()
    solution = by_hand(scene, {"excitation.omega": 2000.0})[1]
    stored_solution = result.solution(1)
    instants = np.linspace(0.0, solution.period, 100)
    force = solution.contact_force(instants)
    np.testing.assert_allclose(
        stored_solution.contact_force(instants), force, atol=1e-7 * force.max()
    )
    assert result["contact_force"][1] == pytest.approx(force.max(), rel=1e-2)


def test_without_a_crack(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """The linear plate: a response without columns of contact."""
    base = paper_scene.replace({"crack": None, "contact": None, "damping.ratio": 0.01})
    scene = swept(base, {"excitation.omega": [2000.0, 3000.0]}, {})
    result = run_sweep(scene, tmp_path / "sweep.h5")
    plate = prepare(scene.replace({"sweep": None})).structure
    row = fc.solve_linear(plate, 3000.0).coefficients_at([plate.find_dof((0.1, 0.1), "x")])
    assert result["response"][1] == pytest.approx(np.hypot(*row[1:3, 0]), rel=1e-4)
    assert np.isnan(result["opening"]).all() and result.gap(0).shape[1] == 0
    assert result.solution(1).displacement_coefficients.shape[1] == plate.n_dofs


def test_crack_length_found_and_pairs_of_several_geometries(
    paper_scene: fc.Scene, tmp_path: Path
) -> None:
    """The waves of every geometry have its own pairs; a length follows from a frequency."""
    sweep_axes = {"mesh.lip_elements": [2, 4], "contact.pairs": ["mouth", "all"]}
    changes = GRADED | {"crack.length": None, "crack.first_omega": 2400.0}
    result = run_sweep(swept(paper_scene, sweep_axes, changes), tmp_path / "sweep.h5")
    assert result.converged.all()
    pairs = [result.gap(number).shape[1] for number in range(4)]
    assert pairs == [1, 2, 1, 4]
    assert np.all((result["crack_length"] > 0.03) & (result["crack_length"] < 0.06))
    solution = result.solution((1, 1))
    assert fc.solve_modes(solution.structure.whole, 1).omega[0] == pytest.approx(2400.0, rel=1e-3)


# --- what fails -----------------------------------------------------------------------------------


def test_failures_are_recorded_and_the_others_go_on(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """A crack longer than the plate, one off the grid, a load on the clamp."""
    sweep_axes = {"crack.length": [0.05, 0.2, 0.03], "excitation.point": [(0.1, 0.1), (0.1, 0.0)],
            "excitation.omega": [2000.0, 2100.0]}  # fmt: skip
    result = run_sweep(swept(paper_scene, sweep_axes), tmp_path / "sweep.h5")
    assert result.complete
    assert result.converged[0, 0].all() and np.count_nonzero(result.converged) == 2
    reasons = dict(result.failed_indices_and_reasons)
    assert len(reasons) == 10
    assert "shorter than the plate" in reasons[1, 0, 0]
    assert "whole number of grid cells" in reasons[2, 1, 1]
    assert "not clamped" in reasons[0, 1, 0]
    assert np.isnan(result["response"][1, 0, 0])
    names, rows = result.table().columns, result.table().rows
    assert rows[4][names.index("state")] == "failed" and "0.2" in rows[4][-1]
    catch_error(lambda: result.gap((1, 0, 0)), "index", (1, 0, 0))
    catch_error(lambda: result.solution((7, 0, 0)), "index", (7, 0, 0))


def test_refused(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """No sweep, nothing that can be used, a structure that stays large."""
    fine_settings = SOFT | {"mesh.columns": 16, "mesh.rows": 24, "reduction.method": "off"}
    for scene, key, names in (
        (paper_scene, "sweep", "sweep is missing"),
        (swept(paper_scene, {"crack.length": [0.03, 0.04]}), "sweep.over", r"= 0\.03: .* 0\.05 m"),
        (swept(paper_scene, FAST, fine_settings), "reduction.method", "= 'off': .*832"),
    ):
        catch_error(partial(run_sweep, scene, tmp_path / "a.h5"), key, names=names)
    assert list(tmp_path.iterdir()) == []


def test_files_that_cannot_be_used(fast: SweepResult, tmp_path: Path) -> None:
    """Another scene's, something else, one that cannot be written, one that is being written: of a
    complete one nothing is."""
    scene, path = fast.scene, Path(shutil.copy(fast.path, tmp_path))
    content = path.read_bytes()
    for changes, expected_text in (
        ({"damping.ratio": 0.037}, f"damping.ratio = {scene.damping.ratio}"),
        ({"output.quantities": ["amplitude"]}, "output.quantities = none"),
        ({"sweep.over": {"excitation.omega": [1900.0]}}, "sweep.over.excitation.omega = "),
    ):
        catch_error(
            partial(run_sweep, scene.replace(changes), path),
            "path",
            names=rf"begun with {expected_text}",
        )
    other_curve = {"curve.start": 1000.0, "curve.stop": 1500.0, "integration.periods": 7}
    assert run_sweep(scene.replace(other_curve), path).complete  # no case depends on these
    with h5py.File(path, "r+"):
        assert run_sweep(scene, path).complete
    assert path.read_bytes() == content
    partial_path = str(shutil.copy(path, tmp_path / "partial.h5"))
    with h5py.File(partial_path, "r+") as file:
        file["checksum"][...] = 0  # of no case that is complete
        catch_error(lambda: run_sweep(scene, partial_path), "path", partial_path)
    other_path = tmp_path / "other.h5"
    other_path.write_text("no HDF5")
    for wrong_path in (other_path, tmp_path, other_path / "sweep.h5"):
        catch_error(partial(run_sweep, scene, wrong_path), "path", str(wrong_path))
    catch_error(
        lambda: SweepResult.load(tmp_path / "missing.h5"), "path", str(tmp_path / "missing.h5")
    )
    with h5py.File(other_path, "w") as file:
        file.attrs["kind"] = "response curve"
    catch_error(lambda: SweepResult.load(other_path), "path", str(other_path))
    with changed(path) as file:
        file.attrs["version"] = "0.0.1"
    catch_error(lambda: run_sweep(scene, path), "path", str(path), names=r"0\.0\.1")


def test_two_programs_that_begin_at_once(
    paper_scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file of the quicker one stays, and the other is refused by its lock."""
    scene, path = swept(paper_scene, FAST), tmp_path / "sweep.h5"
    quicker = SweepFile(path, scene, 5, 1)
    monkeypatch.setattr(Path, "exists", lambda self: False)  # as it was a moment before
    catch_error(lambda: SweepFile(path, scene, 5, 1), "path", str(path))
    quicker.close()
    assert [file.name for file in tmp_path.iterdir()] == ["sweep.h5"]


def test_what_is_told_of_a_verdict_is_kept(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """Behind the longest way to a solution."""
    way = "; then ".join(["full Newton steps: failed (28 iterations)"] * 4)
    reason = "no exact orbit was found next to it: " + 150 * "x"
    text_by_verdict = {
        "undecided": f"{way}; undecided: {reason}",
        "stable": f"{way}; yet it leaves",
    }
    waves = {name: np.ones((11, 1)) for name in ("gap", "force")}
    cases = [
        waves | {"harmonics": 5, "verdict": v, "status": text}
        for v, text in text_by_verdict.items()
    ]
    scene, path = swept(paper_scene, {"excitation.omega": [1900.0, 2000.0]}), tmp_path / "new.h5"
    file = SweepFile(path, scene, 5, 1)
    file.write_cases_unless_already_stored(np.arange(2), cases)
    file.close()
    stored_sweep = SweepResult.load(path)
    assert stored_sweep.undecided_indices_and_reasons == [
        ((0,), reason)
    ] and stored_sweep.cases_contradicted_by_more_modes == [((1,), "it leaves")]


def test_a_file_from_before_an_observable(
    paper_scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is there is read, of a number at points and one of faces; the others are nan."""
    points = {"output.points": {"tip": [0.1, 0.1]}}
    scene = swept(paper_scene, {"excitation.omega": [1900.0, 2000.0]}, SOFT | points)
    number, path = {"harmonics": 5, "response": 1e-3, "tip.ux.mean": 2e-3}, tmp_path / "old.h5"
    later = {"response", "opening", "tip.ux.harmonic_1", "omega_open"}
    columns_function = sweep_file.unit_and_type_by_column

    def before(scene: fc.Scene) -> dict[str, tuple[str, str]]:
        return {
            name: column for name, column in columns_function(scene).items() if name not in later
        }

    monkeypatch.setattr(sweep_file, "unit_and_type_by_column", before)
    file = SweepFile(path, scene, 5, 1)
    waves = {name: np.ones((11, 1)) for name in ("gap", "force")}
    file.write_cases_unless_already_stored(np.arange(1), [number | waves])
    file.close()
    monkeypatch.undo()
    stored_sweep = SweepResult.load(path)
    assert (
        stored_sweep.converged.tolist() == [True, False] and stored_sweep["tip.ux.mean"][0] == 2e-3
    )
    assert all(np.isnan(stored_sweep[name]).all() for name in later)
    assert stored_sweep.gap(0).shape == (11, 1) and len(stored_sweep.table().rows) == 2
    catch_error(lambda: run_sweep(scene, path), "path", str(path))


EACH = len(UNIT_AND_NUMPY_TYPE_BY_COLUMN) + 3
"""What is written of each chunk: columns, waves, states."""


@pytest.mark.drawn(2)
@pytest.mark.parametrize("limit", [5, EACH - 1, EACH + 5, 2 * EACH - 1])
def test_full_disk(
    fast: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    """At any number of a chunk: the file stays valid with what was in it, and the rest follows."""
    scene, path = fast.scene, tmp_path / "sweep.h5"
    write_column, calls = SweepFile._write_column, list[str]()

    def full(self: SweepFile, name: str, *given: Any) -> None:
        calls.append(name)
        if len(calls) > limit:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write_column(self, name, *given)

    monkeypatch.setattr(SweepFile, "_write_column", full)
    catch_error(lambda: run_sweep(scene, path), "path", str(path), kind=WriteError)
    assert len(calls) == limit + 1
    if limit < EACH:
        assert not path.exists()  # nothing was in it
    else:
        assert np.count_nonzero(SweepResult.load(path)["state"]) == 2
    monkeypatch.undo()
    assert_same(fast, run_sweep(scene, path))


@pytest.mark.parametrize("replaced", [False, True])
def test_removed_while_it_runs(
    paper_scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, replaced: bool
) -> None:
    """Told at the next write; what has taken its place is left alone."""
    path, write = tmp_path / "sweep.h5", SweepFile.write_cases
    writes = []

    def removing(self: SweepFile, *given: Any) -> None:
        write(self, *given)
        writes.append(given)
        path.unlink()
        if replaced:
            path.write_text("another")

    monkeypatch.setattr(SweepFile, "write_cases", removing)
    catch_error(
        lambda: run_sweep(swept(paper_scene, FAST), path), "path", str(path), kind=WriteError
    )
    assert len(writes) == 1
    assert [file.read_text() for file in tmp_path.iterdir()] == replaced * ["another"]


def test_cases_are_named_by_whole_numbers(fast: SweepResult) -> None:
    """Nothing is cut off, and nothing is counted from the end."""
    np.testing.assert_array_equal(fast.gap(1), fast.gap((0, 1)))
    for wrong_index in ((0.9, 1.2), (-1, -1), -1, (0,), (0, 99), "a"):
        catch_error(partial(fast.gap, wrong_index), "index", wrong_index)  # type: ignore[arg-type]


def test_file_holds_numbers_and_words_only(fast: SweepResult) -> None:
    """No objects, no references, no filters; contiguous datasets whose place is fixed."""
    with h5py.File(fast.path, "r") as file:
        assert set(file) == {
            "state",
            "gap",
            "force",
            "checksum",
            "waves_checksum",
            *UNIT_AND_NUMPY_TYPE_BY_COLUMN,
        }
        for item in file.values():
            assert item.dtype.kind in "fiuS" and item.chunks is item.compression is None
            assert item.id.get_offset() is not None
        assert all(isinstance(value, str) for value in file.attrs.values())
        assert file["gap"].attrs["unit"] == "m"
    assert fc.Scene.from_text(fast.scene.as_toml()) == fast.scene


def test_a_complete_sweep_is_not_computed_again(
    fast: SweepResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither is a chunk that is there; the others are solved."""
    first, scene, path = fast, fast.scene, Path(shutil.copy(fast.path, tmp_path))
    with h5py.File(path, "r+") as file:
        file["state"][1, 1] = 0  # of a chunk of two, along the frequency
        file["response"][1, 1] = 7.0
    assert not SweepResult.load(path).complete and np.isnan(
        SweepResult.load(path)["response"][1, 1]
    )
    chunks = []
    solve_chunk = sweep_jobs.solve_chunk
    monkeypatch.setattr(
        sweep_jobs,
        "solve_chunk",
        lambda *given, **how: chunks.append(1) or solve_chunk(*given, **how),
    )
    written = []
    write = sweep.SweepFile.write_cases
    monkeypatch.setattr(
        sweep.SweepFile, "write_cases", lambda *given: written.append(given[1]) or write(*given)
    )
    assert_same(run_sweep(scene, path), first)
    assert len(chunks) == 1 and [places.tolist() for places in written] == [[3]]
    monkeypatch.setattr(sweep_case, "prepare", None)
    assert_same(run_sweep(scene, path, progress=True), first)


# --- ranks ----------------------------------------------------------------------------------------

RANKS_OVER = {"excitation.omega": {"start": 1500.0, "stop": 2600.0, "count": 20},
              "crack.length": [0.05, 0.06], "contact.stiffness": [1e8, 1e9]}  # fmt: skip


def sweep_on(scene: fc.Scene, path: Path, comm: MPI.Comm) -> None:
    """Run a sweep (collective)."""
    result = run_sweep(scene, path, comm)
    assert result.complete and result.converged.any()


@pytest.mark.nightly
@pytest.mark.mpi
@pytest.mark.parametrize("kind", [GRADED, MASSLESS], ids=["with mass", "massless"])
def test_ranks_give_the_same_table(
    paper_scene: fc.Scene, tmp_path: Path, on_ranks: Callable[..., Any], kind: Over
) -> None:
    """1 and 2 to the bit, also where one has more to do."""
    sweep_axes = RANKS_OVER | {"excitation.omega": {"start": 1500.0, "stop": 2600.0, "count": 3}}
    scene = swept(paper_scene, sweep_axes, kind)
    alone_sweep = run_sweep(scene, tmp_path / "alone.h5")
    assert alone_sweep.converged.all()
    on_ranks(sweep_on, scene, tmp_path / "shared.h5")
    assert_same(alone_sweep, SweepResult.load(tmp_path / "shared.h5"))


def refused_and_broken(folder: Path, refused: fc.Scene, good: fc.Scene, comm: MPI.Comm) -> Any:
    """Return what each rank is told of something unforeseen on the other rank (collective).

    Check what it is told of input that cannot be used, and of a full disk.
    """
    catch_error(lambda: run_sweep(refused, folder / "sweep.h5", comm), "sweep", None)
    solve_case, calls, meeting_path = (
        sweep_case.CaseSolver.solve_at_given_frequency,
        [],
        folder / "met",
    )

    def broken(*given: Any) -> Any:
        calls.append(given)
        if comm.rank == 1 and len(calls) > 10:  # after its first chunk
            meeting_path.touch()
            raise KeyError("unforeseen")
        deadline = time.monotonic() + LIMIT
        while (
            comm.rank == 0 and not meeting_path.exists()
        ):  # until the other one has done something
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return solve_case(*given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep_case.CaseSolver, "solve_at_given_frequency", broken)
        failure = catch_error(lambda: run_sweep(good, folder / "sweep.h5", comm), kind=RuntimeError)
    write_column, written = SweepFile._write_column, list[str]()

    def full(self: SweepFile, name: str, *given: Any) -> None:
        written.append(name)
        if written.count("state") > 2:  # of the first cases twice: pending, then done
            raise OSError(errno.ENOSPC, "full")
        write_column(self, name, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SweepFile, "_write_column", full)
        path = folder / "full.h5"
        catch_error(
            lambda: run_sweep(good, path, comm), "path", str(path), names="full", kind=WriteError
        )
    return comm.allgather(str(failure))


@pytest.mark.mpi
def test_errors_reach_every_rank(
    paper_scene: fc.Scene, tmp_path: Path, on_ranks: Callable[..., Any]
) -> None:
    """Input that is refused; something unexpected on the other rank, with its traceback; and a disk
    that is full."""
    scenes = paper_scene, swept(paper_scene, RANKS_OVER)
    for failure in on_ranks(refused_and_broken, tmp_path, *scenes):
        assert "KeyError: 'unforeseen'" in failure
    stored_sweep = SweepResult.load(tmp_path / "sweep.h5")
    assert 0 < np.count_nonzero(stored_sweep["state"]) < stored_sweep["state"].size


# --- interruptions --------------------------------------------------------------------------------

LONG_OVER = {"excitation.omega": {"start": 1000.0, "stop": 4000.0, "count": 30},
             "harmonic_balance.harmonics": [20, 21]}  # fmt: skip  # 60 cases, 15 at a time


PROGRAM = """
import os, sys
import fenics_crack as fc
from mpi4py import MPI
path = Path(sys.argv[1])
path.with_suffix(f".{{MPI.COMM_WORLD.rank}}").write_text(str(os.getpid()))
fc.run_sweep(fc.Scene.load(path.with_suffix(".toml")), path)
"""
"""Source of a program that runs a sweep, with its process numbers beside the file."""


@pytest.mark.nightly
@pytest.mark.mpi
def test_killed_at_any_moment(paper_scene: fc.Scene, tmp_path: Path) -> None:
    """kill -9 on one rank, then on two: the file opens, goes on where it was, and is whole in the
    end."""
    scene, path, source = swept(paper_scene, LONG_OVER), *map(tmp_path.joinpath, ("s.h5", "s.py"))
    path.with_suffix(".toml").write_text(scene.as_toml())
    source.write_text(HELD.format(cases=45, go="never") + PROGRAM.format())
    random, done = np.random.default_rng(1), [0]
    for ranks in (1, 2):
        program = subprocess.Popen(
            [*command(source, ranks), str(path)], env=environment(), stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        deadline, count = time.monotonic() + LIMIT, 0
        while count <= min(done[-1], 44):
            assert time.monotonic() < deadline and program.poll() is None
            time.sleep(0.05)  # each look starts a reader
            count = np.count_nonzero(SweepResult.load(path)["state"]) if path.exists() else 0
        time.sleep(random.uniform(0.0, 0.3))
        kill(program, [int(file.read_text()) for file in tmp_path.glob("s.[01]")])
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until the ranks have let go of it
        done.append(int(np.count_nonzero(SweepResult.load(path)["state"])))
    assert done == sorted(done) and 0 < done[1] and done[2] < 60
    assert_same(run_sweep(scene, tmp_path / "undisturbed.h5"), run_sweep(scene, path))


def test_stops_at_ctrl_c(
    paper_scene: fc.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cases at hand are finished and kept; the next call resumes."""
    scene, path = swept(paper_scene, FAST), tmp_path / "sweep.h5"

    def interrupted(record: Callable[..., None], *given: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        record(*given)

    with monkeypatch.context() as patch:
        wrap(
            patch,
            "fenics_crack.sweep.file.SweepFile.write_cases_unless_already_stored",
            interrupted,
        )
        stopped_sweep = run_sweep(scene, path)
    assert not stopped_sweep.complete and 0 < np.count_nonzero(stopped_sweep["state"]) < 4
    assert_same(run_sweep(scene, tmp_path / "whole.h5"), run_sweep(scene, path))


def test_speeds_share_a_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over the rotor's speed, with an engine order, the plate is meshed once for each length; every
    case is that of a scene of its own."""
    meshed = []

    def counted(scene: Scene, comm: MPI.Comm) -> fc.Structure:
        meshed.append(scene)
        return assemble_structure(scene, comm)

    coarse_settings = {"mesh.size": 0.02, "mesh.lip_elements": 2, "reduction.modes": 4}
    coarse_settings["harmonic_balance.harmonics"] = 5
    coarse_settings |= {"curve.parameter": "rpm", "curve.start": 5000.0, "curve.stop": 6000.0}
    scene = cracked(600.0, -250.0).replace({"excitation.order": 12, **coarse_settings})
    sweep_axes = {"crack.length": [0.005, 0.006], "rotation.speed": [580.0, 600.0, 620.0]}
    monkeypatch.setattr(fenics_crack.fem.build, "assemble_structure", counted)
    speed_sweep = fc.run_sweep(scene.replace({"sweep.over": sweep_axes}), tmp_path / "sweep.h5")
    assert len(meshed) == 2
    case = scene.replace({"crack.length": 0.006, "rotation.speed": 600.0})
    study = fc.prepare(case, MPI.COMM_SELF)
    solution = fc.solve_harmonic_balance(study.structure, 7200.0, study.contact, harmonics=5)
    assert speed_sweep["omega"][1, 1] == 7200.0
    expected_amplitude = solution.amplitude(study.watched[0].dof)
    assert speed_sweep["response"][1, 1] == pytest.approx(expected_amplitude, rel=1e-5)


@pytest.mark.nightly
def test_sweeps_leave_no_memory(tmp_path: Path) -> None:
    """PETSc frees what Python has deleted when it is asked to, of a communicator that is still
    there: each sweep left its last plate, of 15 MB."""

    def resident() -> float:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    coarse_settings = {"mesh.size": 0.003, "mesh.lip_elements": 4, "reduction.modes": 8}
    scene = cracked(600.0, -250.0).replace(coarse_settings | {"curve": None})
    sizes = []
    for round_index in range(5):
        sweep_axes = {"excitation.frequency": [900.0 + round_index, 950.0]}
        fc.run_sweep(
            scene.replace({"sweep.over": sweep_axes}),
            tmp_path / f"{round_index}.h5",
            verdicts=False,
        )
        sizes.append(resident())
    assert sizes[-1] - sizes[1] < 12.0
