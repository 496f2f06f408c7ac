"""Stress intensity factors beside handbooks, statics and other meshes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gmsh
import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error, columns_of_curve, gmsh_model
from mpi4py import MPI
from surroundings import main

import fenics_crack as fc
from fenics_crack.fem import interaction_integral
from fenics_crack.fem.cracks import CrackPath

SLOW = 30.0
"""[rad/s] The strip's first resonance is at 3200, so inertia adds 1e-4; an exact orbit takes as
long as its period has oscillations of the fastest mode."""
STRIP: dict[str, Any] = {
    "geometry": {"width": 0.1, "height": 0.4, "thickness": 0.01},
    "crack": {"edge": "left", "height": 0.2, "length": 0.03},
    "material": {"young": 2e11, "poisson": 0.3, "density": 7800.0},
    "damping": {"ratio": 0.01, "modes": 5},
    "excitation": {"omega": SLOW},
    "contact": {"law": "unilateral", "friction_error": False},
    "mesh": {
        "layout": "graded", "order": 2, "size": 0.05, "lip_elements": 8, "grading": 12.0,
        "error": False,
    },
    "reduction": {"modes": 4},
    "harmonic_balance": {"harmonics": 3, "error": False},
}  # fmt: skip
"""0.1 x 0.4 m, clamped below."""
PLAIN = {"mesh.error": False, "contact.friction_error": False}
FEW = PLAIN | {
    "reduction.modes": 8, "harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 7,
}  # fmt: skip
STRESS = 1e6
TENSION = {"loads": [{"edge": "top", "traction_mean": [0.0, STRESS], "traction_sin": [0.0, 1.0]}]}
SWING = {"loads": [{"edge": "top", "traction_sin": [0.0, STRESS]}]}


def strip(load: dict[str, Any] = TENSION, **changes: Any) -> fc.Scene:
    """The strip under a load, with some keys changed, whose dots are written as two underscores."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return fc.Scene.from_mapping(STRIP | load).replace(keys)


def of(scene: fc.Scene) -> Any:
    """Stress intensity of its vibration."""
    return fc.stress_intensity(fc.solve(scene, MPI.COMM_SELF))


def linear_of(study: fc.Study, omega: float) -> fc.Run[fc.PeriodicSolution]:
    """The vibration of a study at a frequency with lips that pass each other."""
    linear_solution = fc.solve_linear(study.structure, omega, harmonics=1)
    return fc.Run(study.scene, study.structure, study.contact, study.watched, linear_solution)


# --- handbooks: Tada, Paris, Irwin, The Stress Analysis of Cracks Handbook, 2000 ------------------


def edge_in_tension(x: float) -> float:
    """F of an edge crack, K = F sigma sqrt(pi a), x = a/W: better than 0.5 % (2.11)."""
    root = math.sqrt(2.0 / (math.pi * x) * math.tan(math.pi * x / 2.0))
    shape = 0.752 + 2.02 * x + 0.37 * (1.0 - math.sin(math.pi * x / 2.0)) ** 3
    return root * shape / math.cos(math.pi * x / 2.0)


def edge_in_bending(x: float) -> float:
    """The same in pure bending, sigma = 6 M / (t W^2): 0.2 % up to x = 0.6 (2.13, by Brown and
    Srawley)."""
    return 1.122 - 1.40 * x + 7.33 * x**2 - 13.08 * x**3 + 14.0 * x**4


def centre_in_tension(x: float) -> float:
    """The same of a crack 2 a in the middle, x = 2 a / W: better than 0.1 % (2.2)."""
    return (1.0 - 0.025 * x**2 + 0.06 * x**4) / math.sqrt(math.cos(math.pi * x / 2.0))


@pytest.mark.parametrize("length", [0.01, 0.03, 0.05])
def test_edge_crack_in_tension(length: float) -> None:
    """Within 1 %, and without K_II."""
    intensity = of(strip(crack__length=length))
    exact = STRESS * math.sqrt(math.pi * length) * edge_in_tension(length / 0.1)
    assert intensity.K_I.mean() == pytest.approx(exact, rel=0.01)
    assert np.abs(intensity.K_II).max() < 1e-3 * exact


def test_edge_crack_in_bending() -> None:
    """A moment of two forces at the corners, far away."""
    couple = {
        "loads": [
            {"point": [x, 0.4], "force_mean": [0.0, side * 1e4], "force_sin": [0.0, side * 1e-2]}
            for x, side in ((0.0, 1.0), (0.1, -1.0))
        ]
    }
    exact = 6.0 * 1e4 * 0.1 / (0.01 * 0.1**2) * math.sqrt(math.pi * 0.03) * edge_in_bending(0.3)
    assert of(strip(couple)).K_I.mean() == pytest.approx(exact, rel=0.01)


def test_crack_in_the_middle() -> None:
    """Both tips."""
    inner_scene = strip(crack__edge=None, crack__center=0.05, crack__length=0.04)
    intensity = of(inner_scene)
    assert intensity.tip_names == ("the right crack tip", "the left crack tip")
    assert intensity.points == pytest.approx(np.array([[0.07, 0.2], [0.03, 0.2]]))
    exact = STRESS * math.sqrt(math.pi * 0.02) * centre_in_tension(0.4)
    assert intensity.K_I.mean(axis=0) == pytest.approx([exact, exact], rel=0.01)


def test_right_edge_mirrors_the_left() -> None:
    """K_I is the same, K_II the opposite."""
    shear = {"loads": [{"edge": "top", "traction_mean": [1e4, 1e6], "traction_sin": [0.0, 1.0]}]}
    left = of(strip(shear))
    mirrored_settings = {"loads": [{**shear["loads"][0], "traction_mean": [-1e4, 1e6]}]}
    right = of(strip(mirrored_settings, crack__edge="right"))
    assert right.K_I.mean() == pytest.approx(left.K_I.mean(), rel=1e-6)
    assert right.K_II.mean() == pytest.approx(-left.K_II.mean(), rel=1e-6)
    assert left.K_II.mean() > 1e3


@pytest.fixture
def inclined(tmp_path: Path) -> fc.Scene:
    """A large plate with a small crack at 45 degrees in its middle, as a mesh file."""
    half, width, height = 0.01 / math.sqrt(2.0), 0.4, 1.2
    with gmsh_model() as model:
        geo = model.geo
        places = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
        corners = [geo.addPoint(*place, 0.0, 0.05) for place in places]
        sides = [geo.addLine(corners[n - 4], corners[n - 3]) for n in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(sides)])
        tips = [
            geo.addPoint(width / 2 + half_side, height / 2 + half_side, 0.0, 3e-4)
            for half_side in (-half, half)
        ]
        crack = geo.addLine(*tips)
        geo.synchronize()
        model.mesh.embed(1, [crack], 2, surface)
        groups = {"plate": (2, surface), "clamp": (1, sides[0]), "top": (1, sides[2])}
        for tag, (name, (dimension, part)) in enumerate((groups | {"crack": (1, crack)}).items()):
            model.addPhysicalGroup(dimension, [part], tag + 1)
            model.setPhysicalName(dimension, tag + 1, name)
        model.mesh.generate(2)
        gmsh.plugin.setNumber("Crack", "Dimension", 1)
        gmsh.plugin.setNumber("Crack", "PhysicalGroup", 4)
        gmsh.plugin.setNumber("Crack", "OpenBoundaryPhysicalGroup", 0)  # as it has it at first
        gmsh.plugin.run("Crack")
        gmsh.write(str(tmp_path / "plate.msh"))
    tables = {name: STRIP[name] for name in ("material", "damping", "excitation", "contact")}
    tables |= {"geometry": {"thickness": 0.01}, "crack": {}}
    tables["mesh"] = {"layout": "file", "file": str(tmp_path / "plate.msh"), "order": 2}
    return fc.Scene.from_mapping(tables | TENSION)


def test_inclined_crack_in_a_large_plate(inclined: fc.Scene) -> None:
    """K_I = sigma sqrt(pi a) sin^2 b, K_II = sigma sqrt(pi a) sin b cos b, b = 45 degrees to the
    load; and the angle at which it would turn is Erdogan and Sih's for K_I = K_II, 53 degrees."""
    intensity = of(inclined)
    exact = 0.5 * STRESS * math.sqrt(math.pi * 0.01)
    assert intensity.K_I.mean(axis=0) == pytest.approx([exact, exact], rel=0.01)
    assert np.abs(intensity.K_II.mean(axis=0)) == pytest.approx([exact, exact], rel=0.01)
    assert np.degrees(np.abs(intensity.crack_kink_angles)) == pytest.approx([53.13, 53.13], abs=0.5)
    angles = np.degrees(
        np.arctan2(*intensity.growth_directions.T[::-1]) + intensity.crack_kink_angles
    )
    # Both turn to grow across the load, which pulls along y.
    normal_factor = np.abs(np.sin(np.radians(angles)))
    assert np.all(normal_factor < 0.2)


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_order_of_convergence(order: int) -> None:
    """Three meshes: one, as of every number that a sharp tip changes; extrapolated to 0.5 %."""
    intensities = [
        of(strip(mesh__order=order, mesh__lip_elements=n, mesh__size=0.16 / n, mesh__grading=4.0))
        .K_I.mean() for n in (4, 8, 16)
    ]  # fmt: skip
    rate = math.log2((intensities[1] - intensities[0]) / (intensities[2] - intensities[1]))
    assert rate == pytest.approx(1.0, abs=0.25)
    exact = STRESS * math.sqrt(math.pi * 0.03) * edge_in_tension(0.3)
    assert 2.0 * intensities[2] - intensities[1] == pytest.approx(exact, rel=0.005)


# --- statics, dynamics and contact ----------------------------------------------------------------


@pytest.mark.drawn(3)
@pytest.mark.parametrize("swing", [0.5, 1.5, 2.2, 10.0, 1e3])
def test_load_that_hardly_vibrates(swing: float) -> None:
    """A millionth of the mean and more, of a crack that stays open: equations are solved to parts
    of the whole motion, which may leave 2e-5 of what moves; its orbit is its own, and stable."""
    swinging_load = {"edge": "top", "traction_mean": [0.0, STRESS], "traction_sin": [0.0, swing]}
    keys = {"harmonic_balance__harmonics": None, "harmonic_balance__error": True}
    scene = strip({"loads": [swinging_load]}, **keys)
    solution = fc.solve(scene, MPI.COMM_SELF).result
    assert solution.stability.verdict == "stable" and solution.report.total < 1e-4


@pytest.mark.parametrize(
    "law",
    [
        {},
        pytest.param(
            {"contact.law": "penalty", "contact.stiffness": 1e9}, marks=pytest.mark.nightly
        ),
    ],
)
def test_slow_loading_is_statics(law: dict[str, Any]) -> None:
    """A preloaded strip that opens and closes, at all instants: within 0.5 % of the largest."""
    force = {"excitation": {"omega": SLOW, "point": [0.1, 0.4], "force_sin": [1e4, 0.0]}}
    scene = fc.Scene.from_mapping(STRIP | force).replace(
        {"excitation.force_mean": [3e3, 0.0], "mesh.lip_elements": 4, "contact.law": "unilateral"}
    )
    run = fc.solve(scene.replace({"harmonic_balance.harmonics": 40}), MPI.COMM_SELF)
    stress_intensity = fc.stress_intensity(run)
    study = fc.prepare(scene, MPI.COMM_SELF)
    instants = np.arange(0, len(stress_intensity.time), 101)
    exact = []
    for phase in SLOW * stress_intensity.time[instants]:
        weights = np.zeros((3, 3))
        weights[0] = 1.0, np.cos(phase), np.sin(phase)
        held_structure = study.structure.varied(load=weights)
        still_solution = fc.solve_harmonic_balance(held_structure, SLOW, study.contact, harmonics=1)
        static_intensity = fc.stress_intensity(
            replace(run, structure=held_structure, result=still_solution)
        )
        exact.append((static_intensity.K_I[0, 0], static_intensity.K_II[0, 0]))
    error = np.abs(
        np.column_stack([stress_intensity.K_I, stress_intensity.K_II])[instants] - exact
    ).max(axis=0)
    max_intensity = np.abs(exact).max(axis=0)
    assert np.all(error < 0.005 * max_intensity)
    assert (
        stress_intensity.min_K_I_by_tip[0]
        < 0.01 * max_intensity[0]
        < 0.5 * stress_intensity.max_K_I_by_tip[0]
    )


@pytest.mark.parametrize("patches", [None, 3])
def test_closed_crack_has_none(patches: int | None) -> None:
    """Under pressure K_I vanishes, where it would be negative if the lips passed each other."""
    pressed_settings = {"loads": [{"edge": "top", "pressure_mean": 1e6, "pressure_sin": 1.0}]}
    full_intensity = STRESS * math.sqrt(math.pi * 0.03) * edge_in_tension(0.3)
    for order in (1, 2):
        elements = {"mesh__lip_elements": 4 if patches is None else 12, "mesh__patches": patches}
        intensity = of(strip(pressed_settings, mesh__order=order, **elements))
        assert np.abs(intensity.K_I).max() < 2e-3 * full_intensity
        assert intensity.effective[0] < 2e-3 * full_intensity


def test_full_reversal_opens_for_one_half() -> None:
    """Slow and without preload the effective range is half of that of lips that pass each other;
    with a preload it is its closed form, mean and amplitude together."""
    exact = {"mesh__lip_elements": 4, "harmonic_balance__harmonics": 40}
    run = fc.solve(strip(SWING, **exact), MPI.COMM_SELF)
    open_range = np.ptp(fc.stress_intensity(linear_of(run, SLOW)).K_I[:, 0])
    assert fc.stress_intensity(run).effective[0] == pytest.approx(0.5 * open_range, rel=0.01)
    for mean in (-0.4, 0.3, 1.2):
        load = {"edge": "top", "traction_sin": [0.0, STRESS], "traction_mean": [0.0, mean * STRESS]}
        closed_form = 0.5 * open_range * (min(mean + 1.0, 2.0))
        intensity = of(strip({"loads": [load]}, **exact))
        assert intensity.effective[0] == pytest.approx(closed_form, rel=0.01)


@pytest.mark.parametrize("omega", [2000.0, 9000.0])
def test_few_modes_are_enough(omega: float) -> None:
    """Below and above the first resonance, beside the whole structure: their statics are whole."""
    force = {"excitation": {"omega": omega, "point": [0.1, 0.4], "force_sin": [1e4, 0.0]}}
    scene = fc.Scene.from_mapping(STRIP | force).replace({"mesh.lip_elements": 4})
    unreduced_study = fc.prepare(scene, MPI.COMM_SELF, whole=True)
    intensities = {}
    for modes in (5, 15, None):
        study = unreduced_study
        if modes is not None:
            study = fc.prepare(scene.replace({"reduction.modes": modes}), MPI.COMM_SELF)
        stress_intensity = fc.stress_intensity(linear_of(study, omega))
        intensities[modes] = np.column_stack(
            [stress_intensity.K_I[:, 0], stress_intensity.K_II[:, 0]]
        )
    size = np.abs(intensities[None]).max()
    assert np.abs(intensities[5] - intensities[None]).max() < 0.01 * size
    assert np.abs(intensities[15] - intensities[None]).max() < 1e-3 * size


def test_opening_of_the_lips(omega: float = 6000.0) -> None:
    """Another way to the same number, above the first resonance: the opening of free lips at a
    distance r from the tip is 8 K_I / E (r / 2 pi)^1/2 (1 + c r + ...), without the elements at
    the tip; 2 %."""
    force = {"excitation": {"omega": omega, "point": [0.1, 0.4], "force_sin": [1e4, 0.0]}}
    scene = fc.Scene.from_mapping(STRIP | force).replace({"mesh.lip_elements": 24})
    study = fc.prepare(scene.replace({"reduction.modes": 30}), MPI.COMM_SELF)
    run = linear_of(study, omega)
    stress_intensity = fc.stress_intensity(run)
    top = int(np.argmax(stress_intensity.K_I[:, 0]))
    distance = 0.03 - study.structure.whole.pairs.positions
    is_near = (distance > 0.0015) & (distance < 0.006)
    opening = -run.result.gap(stress_intensity.time[top : top + 1])[0, is_near]
    intensity_by_opening = 2e11 / 8.0 * np.sqrt(2.0 * np.pi / distance[is_near]) * opening
    assert np.polyfit(distance[is_near], intensity_by_opening, 1)[-1] == pytest.approx(
        stress_intensity.K_I[top, 0], rel=0.02
    )


def test_stress_along_a_line() -> None:
    """In the ligament of a strip in tension it grows towards the tip as K_I / (2 pi r)^1/2, and it
    carries the load; far away it is the load's."""
    run = fc.solve(strip(mesh__lip_elements=16), MPI.COMM_SELF)
    x = np.linspace(0.0302, 0.1, 400)
    time, stress = fc.stress_at(run, np.column_stack([x, np.full_like(x, 0.2)]))
    assert stress.shape == (len(time), 400, 3)
    normal_stress = stress.mean(axis=0)[:, 1]
    expected_stress = fc.stress_intensity(run).K_I.mean() / np.sqrt(2.0 * np.pi * (x - 0.03))
    is_near = (x > 0.031) & (x < 0.033)
    assert normal_stress[is_near] == pytest.approx(expected_stress[is_near], rel=0.1)
    step = x[1] - x[0]
    assert normal_stress.sum() * step == pytest.approx(
        0.1 * STRESS, rel=0.1
    )  # the rest is at the tip
    far_stress = fc.stress_at(run, [[0.05, 0.35]])[1].mean(axis=0)[0]
    assert far_stress == pytest.approx([0.0, STRESS, 0.0], abs=0.01 * STRESS)
    catch_error(lambda: fc.stress_at(run, np.empty((0, 2))), "points", np.empty((0, 2)))
    catch_error(lambda: fc.stress_at(run, [[0.2, 0.2]]), "points", [0.2, 0.2])
    catch_error(
        lambda: fc.stress_at(run.result, [[0.05, 0.35]]),
        "run",
        "PeriodicSolution",
        names=r"fc\.solve",
    )


def test_march_and_solution_agree() -> None:
    """The record of a settled motion in time has the same extremes as the solution."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        {
            "damping.ratio": 0.03,
            "integration.periods": 300,
            "harmonic_balance.tolerance": 1e-3,
            **PLAIN,
        }
    )
    march = fc.stress_intensity(fc.integrate(scene, MPI.COMM_SELF))
    intensity = of(scene)
    assert march.effective == pytest.approx(intensity.effective, rel=3e-3)
    assert march.max_K_I_by_tip == pytest.approx(intensity.max_K_I_by_tip, rel=3e-3)


def leading(run: fc.Run[fc.PeriodicSolution], name: str) -> float:
    """A number of the leading tip."""
    stress_intensity = fc.stress_intensity(run)
    return float(stress_intensity.numbers[name][stress_intensity.leading_tip_index])


def test_along_a_curve(tmp_path: Path) -> None:
    """Columns of a curve are those of its solutions, to the tolerance."""
    names = ("amplitude", "K_max", "delta_K_effective")
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        {"curve.start": 780.0, "curve.stop": 800.0, "curve.stability": False,
         "output.quantities": names, **FEW}
    )  # fmt: skip
    columns = columns_of_curve(scene, tmp_path)
    omega = float(columns["omega"][len(columns["omega"]) // 2])
    single_run = fc.solve(scene.replace({"excitation.omega": omega}), MPI.COMM_SELF)
    for name in names[1:]:
        middle_value = columns[name][len(columns[name]) // 2]
        assert middle_value == pytest.approx(leading(single_run, name), rel=1e-2)


# --- refusals, ranks ------------------------------------------------------------------------------


def test_refused_by_name() -> None:
    """Solids, matrices, curves and plates without a crack, whether they have a contact law or
    not, where a remark says that it is left out; a preload by faces that overlap."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml")
    for bare in (scene.replace({"crack": None, "contact": None}), scene.replace({"crack": None})):
        catch_error(partial(of, bare), "run")
        assert bare.replace({"output.quantities": ["K_max"]}).quantities is None
    catch_error(lambda: fc.stress_intensity(3.0), "run", 3.0, names=r"fc\.solve")  # type: ignore[arg-type]
    catch_error(
        lambda: scene.replace({"output.quantities": ["K_III_max"]}),
        "output.quantities",
        "K_III_max",
        names=r"geometry\.kind = 'solid'",
    )
    catch_error(
        lambda: scene.replace({"output.quantities": ["K_max"], "crack.clearance": -1e-9}),
        "output.quantities",
        "K_max",
        names=r"crack\.clearance < 0",
    )


@pytest.mark.parametrize("command", ["check", "solve", "curve", "integrate"])
def test_refused_and_nothing_is_left(command: str, tmp_path: Path) -> None:
    """A tip whose elements are too long for what is asked of it."""
    options = ["--set", 'output.quantities=["K_max"]', "--quiet"]
    options += ["--output", str(tmp_path)] * (command != "check")
    assert main([command, str(DEMOS / "paper_plate.toml"), *options]) == 2
    assert not [*tmp_path.iterdir()]


@pytest.mark.usefixtures("not_drawn")
def test_a_tip_next_to_an_edge(tmp_path: Path) -> None:
    """Whose domain is smaller than an element has no stress intensity; its pictures are drawn."""
    run = fc.solve(strip(crack__length=0.0985, mesh__lip_elements=4))
    error = catch_error(lambda: fc.stress_intensity(run), "crack", names=r"0\.0015 m")
    assert "0.0015 m" in str(error)
    fc.save(run.result, tmp_path / "solution.h5", run.scene)
    assert main(["plot", str(tmp_path / "solution.h5")]) == 0
    picture_names = {path.name for path in tmp_path.iterdir()}
    assert "solution_waves.png" in picture_names and "solution_tips.png" not in picture_names


def test_domains_at_the_tips_of_a_bent_crack(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are .8 of the straight piece at the tip wide, and point along it."""
    corners = np.array([[0.0, 0.0], [0.03, 0.0], [0.04, 0.0], [0.07, 0.04], [0.1, 0.08]])
    monkeypatch.setattr(
        interaction_integral, "_outer_boundary_points", lambda _: np.full((1, 2), 1.0)
    )
    plate = SimpleNamespace(crack_paths_or_surfaces=[CrackPath(corners, has_mouth=False)])
    dofs: Any = SimpleNamespace(part_mesh=plate, comm=MPI.COMM_SELF)
    right, left = interaction_integral.find_tips(dofs)
    assert (right.domain_radius, left.domain_radius) == pytest.approx((0.8 * 0.1, 0.8 * 0.04))
    assert right.growth_direction == pytest.approx(
        [0.6, 0.8]
    ) and left.growth_direction == pytest.approx([-1.0, 0.0])
    assert (right.arc_length, left.arc_length) == pytest.approx((0.14, 0.0))
