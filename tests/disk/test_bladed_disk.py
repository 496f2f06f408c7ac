"""Bladed disks from scenes: what is printed, drawn, swept and timed, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error
from surroundings import main
from wheels import BRIEF, SOLID, ring

import fenics_crack as fc
from fenics_crack.monitoring.scene_timing import find_tip_factor_by_dof

PATTERN: dict[str, Any] = {"disk__deviation": 0.01, "disk__seed": 3}
PROBES = [0.0, 17.0, 41.0, 58.0, 86.0, 113.0, 140.0, 178.0, 205.0, 251.0]


@pytest.fixture(scope="module")
def run() -> fc.Run[fc.PeriodicSolution]:
    """Next to the resonance of the cracked blade."""
    return fc.solve(ring(**PATTERN, excitation__frequency=1270.0).replace(BRIEF))


def written(scene: fc.Scene, folder: Path) -> str:
    """The file of a scene."""
    file = folder / "ring.toml"
    file.write_text(scene.as_toml(), encoding="utf-8")
    return str(file)


def test_blades(run: fc.Run[fc.PeriodicSolution]) -> None:
    """The watched blade's numbers are those of the solution; mistuning is that of the scene."""
    blades = fc.blades(run)
    assert blades.amplitude[0] == pytest.approx(run.result.amplitude(run.watched_dof), rel=1e-12)
    assert blades.cracked == (1,)
    assert blades.mistuning == pytest.approx(np.random.default_rng(3).normal(0.0, 0.01, 6))
    assert blades.second_harmonic_ratio[0] > 5.0 * blades.second_harmonic_ratio[3]
    table = blades.table()
    assert len(table.rows) == 6 and table.columns[1] == "amplitude [m]"
    # Far below all resonances the blades follow their loads, 2 x 60 degrees apart.
    slow_blades = fc.blades(fc.solve(run.scene.replace({"excitation.frequency": 60.0})))
    steps = np.degrees(np.diff(slow_blades.phase)) % 360.0
    assert steps == pytest.approx(120.0, abs=1.0)


def test_blades_of_a_curve() -> None:
    """Each where it moves most."""
    keys = {"parameter": "frequency", "start": 1250.0, "stop": 1290.0, "stability": False}
    scene = ring(**{f"curve__{key}": value for key, value in keys.items()})
    curve = fc.curve(scene.replace(BRIEF))
    blades, dof = fc.blades(curve), curve.watched_dof
    assert blades.amplitude[0] == pytest.approx(curve.amplitude(dof).max(), rel=1e-3)
    assert blades.omega[0] == pytest.approx(curve.omega[int(np.argmax(curve.amplitude(dof)))])


def test_results_come_back(run: fc.Run[fc.PeriodicSolution], tmp_path: Path) -> None:
    """Solutions and modes of a wheel from their files."""
    run.save(tmp_path / "solution.h5")
    stored_run = fc.load_run(tmp_path / "solution.h5")
    assert fc.blades(stored_run).amplitude == pytest.approx(fc.blades(run).amplitude, rel=1e-9)
    modes = fc.modes(run.scene, 3)
    modes.save(tmp_path / "modes.h5")
    stored_modes = fc.load_run(tmp_path / "modes.h5").result
    assert stored_modes.shapes == pytest.approx(modes.result.shapes, abs=1e-9)


def test_nodal_diameters() -> None:
    """Engine orders fold at N/2."""
    diagram = fc.nodal_diameters(ring(excitation__order=10))
    assert diagram.omega.shape == (4, 3) and diagram.excited == 2
    assert diagram.to_dict()["engine_orders"] == ["6", "1 5 7", "2 4 8", "3 9"]
    assert np.all(np.diff(diagram.omega, axis=1) > 0.0)


def test_amplification() -> None:
    """Never above Whitehead's bound; of no mistuning 1; the same as solutions of the pattern."""
    scene = ring(excitation__frequency=1390.0).replace(BRIEF)
    amplification = fc.amplification(scene, 4, 0.01, seed=5)
    assert (
        1.0
        < amplification.factor.max()
        <= amplification.bound
        == pytest.approx(0.5 * (1.0 + np.sqrt(6.0)))
    )
    assert fc.amplification(scene, 2, 0.0).factor == pytest.approx(1.0, abs=1e-3)
    place = int(np.argmax(amplification.factor))
    pattern_settings = {
        "disk.deviation": 0.01,
        "disk.seed": amplification.to_dict()["seed"][place],
        "disk.cracked": [],
    }
    pattern_settings["excitation.omega"] = amplification.omega[place]
    blades = fc.blades(fc.solve(scene.replace(pattern_settings)))
    assert int(np.argmax(blades.amplitude)) + 1 == amplification.blade[place]
    assert blades.amplitude.max() == pytest.approx(
        amplification.factor[place] * amplification.tuned, rel=1e-4
    )


def test_patterns_are_swept(tmp_path: Path) -> None:
    """Cases of a sweep over the seed are solutions of their own patterns."""
    sweep_axes = {"disk.seed": [1, 2]}
    scene = ring(**PATTERN, excitation__frequency=1270.0, sweep__over=sweep_axes).replace(BRIEF)
    sweep = fc.run_sweep(scene, tmp_path / "sweep.h5", verdicts=False, judged=False)
    single_run = fc.solve(scene.replace({"disk.seed": 2, "sweep": None}))
    size = single_run.result.amplitude(single_run.watched_dof)
    assert sweep["response"][1] == pytest.approx(size, rel=1e-3)
    assert abs(sweep["response"][0] - size) > 0.01 * size


def test_tips_are_timed() -> None:
    """The amplitude of every blade within three standard errors of its fit, also from the record
    that is written."""
    timing = {"probes": PROBES, "tip_radius": 0.18, "noise": 1e-8, "revolutions": 60}
    changes = {f"tip_timing__{key}": value for key, value in timing.items()}
    scene = ring(**PATTERN, excitation__frequency=1380.0, **changes).replace(BRIEF)
    arrivals, run = fc.arrivals_of_blades(scene)
    wheel = run.structure.whole
    for blade, blade_arrivals in arrivals.items():
        fit = fc.fit_order(blade_arrivals, [2], harmonics=2)
        shares = find_tip_factor_by_dof(scene.given("tip_timing"), run, blade)
        assert {wheel.blade_and_sector_dof_of(dof)[0] for dof in shares} == {blade}
        rows = run.structure.values_at(run.result.displacement_coefficients, [*shares])
        a, b = (rows[row] @ np.array([*shares.values()]) for row in (1, 2))
        assert abs(fit.amplitudes[0] - np.hypot(a, b)) < 3.0 * fit.amplitude_errors[0]
        # The first harmonic over the rotor's angle, from the blade's place at the mark.
        coefficient = complex(fit.coefficients[1], -fit.coefficients[2])
        assert abs(coefficient - complex(a, -b)) < 4.0 * fit.amplitude_errors[0]


def test_record_of_all_blades(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command writes one record, and finds the same in it."""
    timing = {"probes": PROBES, "tip_radius": 0.18, "noise": 1e-8, "revolutions": 20}
    changes = {f"tip_timing__{key}": value for key, value in timing.items()}
    scene = ring(**PATTERN, excitation__frequency=1380.0, **changes).replace(BRIEF)
    file = written(scene, tmp_path)
    tables = []
    for more_options in ([], [str(tmp_path / "first" / "arrivals.csv")]):
        folder = tmp_path / ("again" if more_options else "first")
        words = [
            "timing",
            file,
            *more_options,
            "--output",
            str(folder),
            "--format",
            "json",
            "--quiet",
        ]
        assert main(words) == 0
        tables.append(json.loads(capsys.readouterr().out))
    assert [row["blade"] for row in tables[0]] == [1, 2, 3, 4, 5, 6]
    for first_row, second_row in zip(*tables, strict=True):
        assert second_row["amplitude [m]"] == pytest.approx(first_row["amplitude [m]"], rel=1e-6)


@pytest.mark.usefixtures("not_drawn")
def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene of new --disk is checked and solved; its diameters are printed and drawn."""
    file = str(tmp_path / "disk.toml")
    assert main(["new", file, "--disk"]) == 0
    coarse_options = [
        "--set",
        "mesh.size=0.012",
        "--set",
        "mesh.error=false",
        "--set",
        "disk.sectors=6",
    ]
    coarse_options += ["--set", "mesh.lip_elements=4", "--output", str(tmp_path / "out")]
    coarse_options += [
        "--set",
        "harmonic_balance.error=false",
        "--set",
        "harmonic_balance.harmonics=5",
    ]
    coarse_options += ["--set", "harmonic_balance.tolerance=none"]
    assert main(["disk", file, *coarse_options, "--patterns", "2"]) == 0
    output = capsys.readouterr()
    assert "nodal diameter 2" in output.err and "Whitehead" in output.err
    assert {"disk.png", "amplification.png"} <= {f.name for f in (tmp_path / "out").iterdir()}
    assert main(["solve", file, *coarse_options]) in (0, 4)
    assert "blade" in capsys.readouterr().err
    assert main(["plot", str(tmp_path / "out" / "solution.h5")]) == 0
    assert (tmp_path / "out" / "solution_wheel.png").exists()
    assert (
        catch_error(lambda: main(["new", file, "--disk", "--nonsense"]), kind=SystemExit).code == 2
    )
    assert main(["new", str(tmp_path / "b.toml"), "--disk", "--solid"]) == 2


@pytest.mark.nightly
def test_new_scene_is_right_by_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is remarked on the scene of new --disk, and it is solved to its tolerance."""
    file = str(tmp_path / "disk.toml")
    assert main(["new", file, "--disk"]) == 0
    assert main(["solve", file, "--output", str(tmp_path / "out")]) == 0
    messages = capsys.readouterr().err
    assert "remark" not in messages and "warning" not in messages
    tolerance = fc.Scene.load(file).harmonic_balance.tolerance
    stated_percent = re.search(r"half peak-to-peak, estimated error ([0-9.]+) %", messages)
    assert stated_percent and tolerance and float(stated_percent[1]) < 100.0 * tolerance


@pytest.mark.nightly
@pytest.mark.parametrize("count", range(7, 15))
def test_many_elements_along_the_crack(
    count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wheel's few coordinates have a mass that is small for its many crack faces."""
    file = written(ring(mesh__lip_elements=count, **PATTERN), tmp_path)
    assert main(["check", file]) == 0
    assert "crack faces bonded" in capsys.readouterr().out


@pytest.mark.nightly
@pytest.mark.usefixtures("not_laid_out")
def test_pictures(run: fc.Run[fc.PeriodicSolution], tmp_path: Path) -> None:
    """Every picture is made; a solution of a plate is refused."""
    fc.draw_wheel(run.result, path=tmp_path / "wheel.png")
    diagram = fc.nodal_diameters(ring(rotation__rpm=3000.0, excitation__frequency=None))
    figure = fc.draw_nodal_diameters(diagram, families=2, path=tmp_path / "diameters.png")
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert labels[:2] == ["family 1", "family 2"] and "engine orders at 3000 rpm" in labels
    modes = fc.modes(run.scene, 2).result
    fc.draw_modes(modes, path=tmp_path / "modes.png")
    fc.write_modes(modes, tmp_path / "modes")
    assert len(list(tmp_path.glob("*.png"))) == 3


@pytest.mark.nightly
def test_solid_wheel_is_drawn(tmp_path: Path) -> None:
    """In colours, from a corner."""
    run = fc.solve(fc.Scene.from_mapping(SOLID))
    fc.draw_wheel(run.result, path=tmp_path / "wheel.png")
    assert (tmp_path / "wheel.png").stat().st_size > 10_000


def test_sector_file(tmp_path: Path) -> None:
    """A mesh file of one sector with its sides named gives what the built-in one gives; one whose
    sides do not match, or have no names, is refused."""
    scene = ring().replace(BRIEF)
    fc.write_msh(scene, tmp_path / "sector.msh")
    text = (tmp_path / "sector.msh").read_text(errors="surrogateescape")
    names = ("left", "edge"), ("right", "far"), ("rim_left", "left"), ("rim_right", "right")
    for old_name, new_name in names:
        text = text.replace(f'"{old_name}"', f'"{new_name}"')
    named_file = tmp_path / "named.msh"
    named_file.write_text(text, errors="surrogateescape")
    removed_settings = dict.fromkeys(
        (
            "geometry.width", "geometry.height", "mesh.size", "mesh.lip_elements",
            "disk.inner_radius", "disk.outer_radius", "crack",
        )
    )  # fmt: skip
    file_settings = {"mesh.layout": "file", "mesh.file": str(named_file)}
    file = scene.replace(removed_settings | file_settings | {"disk.center": [0.006, -0.1]})
    own_omega, other_omega = (
        fc.nodal_diameters(sector_scene).omega for sector_scene in (scene, file)
    )
    assert other_omega == pytest.approx(own_omega, rel=1e-9)
    sizes = [fc.blades(fc.solve(sector_scene)).amplitude for sector_scene in (scene, file)]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-6)
    catch_error(
        lambda: fc.build_structure(file.replace({"disk.sectors": 7})),
        "mesh.file",
        str(named_file),
        names="360/7 degrees",
    )
    named_file.write_text(text.replace('"right"', '"other"'), errors="surrogateescape")
    catch_error(lambda: fc.build_structure(file), "mesh.file", str(named_file), names="'right'")


WRONG: list[tuple[str, Any, dict[str, Any], str | None]] = [
    ("disk.sectors", 2, {}, "3 to 1000"),
    ("disk.cracked", [7], {}, r"1 to disk\.sectors = 6"),
    ("disk.cracked", [0], {}, "from 1,"),
    ("disk.mistuning", [0.1, 0.0], {}, "6 sectors"),
    ("disk.deviation", 0.5, {}, r"0 to 0\.1"),
    ("disk.seed", -1, {}, ">= 0"),
    ("disk.inner_radius", 0.2, {}, r"disk\.outer_radius"),
    ("disk.outer_radius", None, {}, None),
    ("disk.center", [0.0, 0.0], {}, None),
    ("disk.outer_radius", 0.1, {"disk.sectors": 100}, r"0\.012 m"),
    ("excitation.order", None, {}, None),
    ("excitation.omega", None, {"excitation.frequency": None}, None),
    ("excitation.frequency", 1381.8, {"rotation.rpm": 100.0}, r"excitation\.order = 2"),
    (
        "rotation.hub_radius", 0.1,
        {"rotation.rpm": 100.0, "rotation.hub_radius": 0.1, "excitation.frequency": None},
        None,
    ),
    ("reduction", "a table", {"reduction.modes": 5}, r"\[disk\]"),
    ("base", "a table", {"base.acceleration_sin": [1.0, 0.0]}, r"\[disk\]"),
    (
        "curve.parameter", "rpm",
        {
            "curve.parameter": "rpm", "curve.start": 1.0, "curve.stop": 2.0,
            "rotation.rpm": 1.0, "excitation.frequency": None,
        },
        None,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value", "changes", "names"), WRONG)
def test_refused(key: str, value: Any, changes: dict[str, Any], names: str | None) -> None:
    """With the key and what is allowed; it is set to this value, or others are changed."""
    catch_error(lambda: ring().replace(changes or {key: value}), key, value, names=names)


def test_refused_later() -> None:
    """What a disk has no Campbell diagram, growth, tips or modes for."""
    catch_error(lambda: fc.solve(ring(disk__families=9999)), "families", 9999, names=r"at most \d+")
    rotor_scene = ring(rotation__rpm=3000.0, excitation__frequency=None)
    catch_error(
        lambda: fc.campbell(rotor_scene, [100.0, 200.0]), "disk", "a table", names="nodal_diameters"
    )
    catch_error(
        lambda: ring(output__quantities=["K_max"]), "output.quantities", "K_max", names=r"\[disk\]"
    )
    plate = fc.Scene.load(ROOT / "demos/paper_plate.toml")
    catch_error(lambda: fc.draw_wheel(fc.solve(plate).result), "structure", names=r"\[disk\]")


def test_at_rest() -> None:
    """The same frequency and phases without rotation."""
    rotor_scene = ring(rotation__rpm=3000.0, excitation__frequency=None)
    resting_scene = rotor_scene.without_rotation()
    assert (
        resting_scene.excitation.omega == rotor_scene.excitation.omega
        and resting_scene.excitation.order == 2
    )


def test_scene_is_written_and_read() -> None:
    """With a random pattern, and with numbers."""
    for pattern in (PATTERN, {"disk__mistuning": [0.01, 0.0, -0.01, 0.0, 0.02, 0.0]}):
        scene = ring(**pattern)
        assert fc.Scene.from_text(scene.as_toml()) == scene
    disk_table = ring(**PATTERN).replace({"disk.seed": 9}).given("disk")
    assert (disk_table.deviation, disk_table.seed) == (0.01, 9)
    catch_error(lambda: ring(**pattern, disk__seed=9), "disk.seed", 9, names=r"disk\.mistuning")
