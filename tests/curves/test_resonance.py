"""Phase resonance: closed forms of one mass, modes beside each other, and a blade's curves."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error, titanium_blade
from rotating import CRACKED, cracked

import fenics_crack as fc
from fenics_crack import Problem, follow_resonance, resonance_at
from fenics_crack.curves.phase import ResonanceSystem
from fenics_crack.curves.resonance import first_phase_resonance


def mass(
    ratio: float, *, force: float = 1.0, mean: float = 0.0, clearance: float = 0.0
) -> fc.Structure:
    """m = k = 1, damped, with a stop."""
    return fc.Structure.from_matrices(
        np.eye(1), np.eye(1), gap=np.ones((1, 1)), force_sin=np.array([force]),
        force_mean=np.array([mean]), clearance=clearance, damping=np.array([[2.0 * ratio]]),
    )  # fmt: skip


def free_frequency(reach: float, stiffness: float, clearance: float) -> float:
    """Of x'' + x + k max(x - g0, 0) = 0, whose motion turns back at x = -farthest: arcs of cosine,
    outside the stop about 0, within it about k g0 / (1 + k)."""
    omega_in_contact = math.sqrt(1.0 + stiffness)
    if abs(clearance) >= reach:
        return 1.0 if clearance > 0.0 else omega_in_contact
    speed = math.sqrt(reach**2 - clearance**2)
    open_phase = math.acos(-clearance / reach)
    half = (
        open_phase
        + math.atan2(speed / omega_in_contact, clearance / omega_in_contact**2) / omega_in_contact
    )
    return math.pi / half


@pytest.mark.parametrize("stiffness", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("ratio", [1e-2, 1e-3, 1e-4])
def test_bilinear_mass(stiffness: float, ratio: float) -> None:
    """Without clearance 2 w1 w2 / (w1 + w2) at any load, but for the square of the damping; the
    width is that of the damping, and the amplitude grows with the load."""
    law, closed_omega = fc.UnilateralPenalty(stiffness), math.sqrt(1.0 + stiffness)
    small_load_resonance, large_load_resonance = (
        resonance_at(Problem(mass(ratio, force=force), 1.0, law, 30)) for force in (1.0, 100.0)
    )
    bilinear = 2.0 * closed_omega / (1.0 + closed_omega)
    assert small_load_resonance.omega == pytest.approx(bilinear, rel=1e-7 + 0.05 * ratio**2)
    assert large_load_resonance.omega == pytest.approx(small_load_resonance.omega, rel=1e-12)
    assert large_load_resonance.solution.amplitude() == pytest.approx(
        100.0 * small_load_resonance.solution.amplitude()
    )
    assert small_load_resonance.width == pytest.approx(2.0 * ratio, rel=1e-4)
    assert not small_load_resonance.several and small_load_resonance.solution.converged


def test_newton_step_against_differences() -> None:
    """A step by the linearised equations changes the residual by their right-hand side."""
    problem = Problem(mass(0.05, clearance=0.3), 1.0, fc.UnilateralPenalty(1.0), 6)
    point = first_phase_resonance(problem, 1.0)
    system = ResonanceSystem(point.problem, point.exciting_harmonic, point.linearised_balance)
    rng, width = np.random.default_rng(4), 1e-6
    unknown = point.unknown * (1.0 + 0.05 * rng.normal(size=system.shape))  # not a solution
    residual = rng.normal(size=system.shape)
    step = width * system.linearise(unknown, 0.0).solve(residual)
    ends = (system.linearise(unknown + side * step, 0.0).residual for side in (1.0, -1.0))
    change = np.subtract(*ends) / (2.0 * width)
    assert change == pytest.approx(residual, abs=1e-5 * np.abs(residual).max())


@pytest.mark.parametrize("clearance", [1.0, -1.0], ids=["clearance", "preload"])
@pytest.mark.parametrize("ratio", [1e-3, 1e-4])
@pytest.mark.parametrize("force", [0.5, 2.0, 4.0, 40.0])
def test_mass_with_a_stop(clearance: float, ratio: float, force: float) -> None:
    """The frequency is that of the free motion as large, whose load is what the damping takes."""
    stiffness = 1.0
    structure = mass(ratio, force=2.0 * ratio * force, clearance=clearance)
    problem = Problem(structure, 1.0, fc.UnilateralPenalty(stiffness), 60)
    resonance = resonance_at(problem, near=1.0 if clearance > 0.0 else math.sqrt(2.0))
    displacement = resonance.solution.displacement(resonance.solution.instants())[:, 0]
    exact = free_frequency(-float(displacement.min()), stiffness, clearance)
    assert resonance.omega == pytest.approx(exact, rel=1e-6)
    assert not resonance.several


@pytest.mark.parametrize("force", [0.5, 4.0])
def test_curve_over_the_load(force: float) -> None:
    """Linear until the mass meets the stop, then the resonance by itself at each load; and from the
    largest load back."""
    ratio, law = 1e-3, fc.UnilateralPenalty(1.0)
    problem = Problem(mass(ratio, force=2.0 * ratio, clearance=1.0), 1.0, law, 20)
    curve = follow_resonance(problem, 0.1, 2.0 * force)
    assert curve.complete and curve.parameter == "resonance"
    assert curve.values[[0, -1]] == pytest.approx([0.1, 2.0 * force])
    assert np.ptp(curve.omega[curve.values < 0.99]) < 1e-12
    resonance = resonance_at(
        Problem(mass(ratio, force=2.0 * ratio * 2.0 * force, clearance=1.0), 1.0, law, 20)
    )
    assert curve.omega[-1] == pytest.approx(resonance.omega, rel=1e-9)
    assert curve.amplitude()[-1] == pytest.approx(resonance.solution.amplitude(), rel=1e-6)
    last_solution = curve.solution(len(curve) - 1)
    assert last_solution.amplitude() == pytest.approx(curve.amplitude()[-1], rel=1e-6)
    returning_curve = follow_resonance(problem, 2.0 * force, 0.1)
    assert returning_curve.omega[-1] == pytest.approx(curve.omega[0], rel=1e-9)


def test_stop_at_rest_is_where_contact_begins() -> None:
    """The mean load that presses the mass onto the stop moves it as a clearance below 0 does."""
    ratio, law = 1e-3, fc.UnilateralPenalty(1.0)
    pressed_resonance, shifted_resonance = (
        resonance_at(Problem(structure, math.sqrt(2.0), law, 20))
        for structure in (
            mass(ratio, force=6e-3, mean=1.0), mass(ratio, force=6e-3, clearance=-1.0)
        )
    )  # fmt: skip
    assert pressed_resonance.omega == pytest.approx(shifted_resonance.omega, rel=1e-9)
    assert 1.2 < pressed_resonance.omega < 1.41


# --- several modes --------------------------------------------------------------------------------


@pytest.mark.drawn(1)
@pytest.mark.parametrize(("second", "several"), [(1.15, True), (2.5, False)])
def test_several_modes(second: float, several: bool) -> None:
    """Two masses under one load: the point knows how far the top of the curve is, and says where
    that is more than a tenth of the width."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, second**2]), gap=[1.0, 0.0], force_sin=np.ones(2),
        damping=0.06 * np.eye(2),
    ).watching(0)  # fmt: skip
    law = fc.UnilateralPenalty(0.1)
    resonance = resonance_at(Problem(structure, 1.0, law, 20))
    assert resonance.several == several and ("several = yes" in repr(resonance)) == several

    lower_omega, upper_omega = (
        resonance.omega - 2.0 * resonance.width,
        resonance.omega + 2.0 * resonance.width,
    )
    curve = fc.continue_frequency(
        structure, lower_omega, upper_omega, law, harmonics=20, longest_step=0.02
    )
    motion_size = np.hypot(*sum(curve.coefficients_at(dof)[:, 1:3] for dof in (0, 1)).T)
    top = np.argmax(motion_size)
    fit = np.polyfit(
        curve.omega[top - 3 : top + 4] - resonance.omega, motion_size[top - 3 : top + 4], 2
    )
    peak_distance = -0.5 * fit[1] / fit[0] / resonance.width
    assert resonance.apart == pytest.approx(peak_distance, rel=0.7 if several else 0.1)


def test_other_mode_is_found_by_its_frequency() -> None:
    """That nearest to the frequency that is given."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 9.0]), gap=[1.0, 1.0], force_sin=np.ones(2),
        damping=0.01 * np.eye(2),
    )  # fmt: skip
    problem = Problem(structure, 1.0, fc.UnilateralPenalty(0.1), 10)
    first_omega, second_omega = (resonance_at(problem, near=near).omega for near in (1.2, 2.7))
    assert 1.0 < first_omega < 1.05 and 3.0 < second_omega < 3.05


@pytest.mark.parametrize(("near", "harmonic"), [(1.0, 1), (0.35, 3), (0.45, 3)])
def test_harmonic_that_takes_most_power(near: float, harmonic: int) -> None:
    """Of a load with two harmonics, the third much larger: next to a frequency one of them excites
    the mode."""
    structure = mass(0.01, force=0.1).with_added_load_harmonics({3: (np.zeros(1), np.ones(1))})
    resonance = resonance_at(Problem(structure, near, fc.UnilateralPenalty(1.0), 20))
    bilinear = 2.0 * math.sqrt(2.0) / (1.0 + math.sqrt(2.0))
    assert resonance.harmonic == harmonic
    assert resonance.omega == pytest.approx(bilinear / harmonic, rel=0.02)
    assert resonance.width == pytest.approx(0.02 / harmonic, rel=0.05)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.0, 1.3, 2.0])
def test_found_from_either_side(factor: float) -> None:
    """The phase says on which side of a frequency the resonance lies, of a hardening one too."""
    ratio, law = 1e-3, fc.UnilateralPenalty(1.0)
    problem = Problem(mass(ratio, force=8e-3, clearance=1.0), 1.0, law, 20)
    resonance = resonance_at(problem, 1.17)
    assert resonance_at(problem, factor).omega == pytest.approx(resonance.omega, rel=1e-7)


# --- plates ---------------------------------------------------------------------------------------


def test_plate_pressed_by_a_mean_load() -> None:
    """The top of its curve of exact orbits, between bonded and breathing crack."""
    study = fc.prepare(cracked(0.0, -300.0))
    law, omega = study.contact, study.scene.excitation.omega
    resonance = fc.resonance_at(Problem(study.structure, omega, law), tolerance=0.01)
    frequencies = fc.bilinear_frequencies(study.structure)
    assert (
        frequencies.omega_bilinear[0] < resonance.omega < (1.0 + 1e-9) * frequencies.omega_tied[0]
    )
    ends = (
        frequencies.omega_tied[0] + 3.0 * resonance.width,
        resonance.omega - 3.0 * resonance.width,
    )
    top = fc.continue_frequency(study.structure, *ends, law, tolerance=1e-3).top()
    assert abs(top.value - resonance.omega) < 0.1 * resonance.width
    assert resonance.solution.amplitude() == pytest.approx(top.amplitude, rel=0.02)


def test_rotor_at_the_speed_of_its_resonance() -> None:
    """The order meets the resonance of the structure at that speed."""
    scene = cracked(300.0)
    full_structure = fc.build_structure(scene.replace({"excitation.omega": 12.0 * 300.0}))
    rotor = fc.run_up_structure(full_structure, 280.0, 350.0, 4)
    law = fc.prepare(scene).contact
    resonance = resonance_at(Problem(rotor, 12.0 * rotor.speed, law), parameter="speed")
    assert resonance.omega == pytest.approx(12.0 * resonance.value, rel=1e-12)
    resonance_at_speed = resonance_at(
        Problem(rotor.at_speed(resonance.value), resonance.omega, law)
    )
    assert resonance_at_speed.omega == pytest.approx(resonance.omega, rel=1e-8)
    assert resonance_at_speed.solution.amplitude() == pytest.approx(
        resonance.solution.amplitude(), rel=1e-6
    )
    assert (
        resonance.width / resonance.value > resonance_at_speed.width / resonance_at_speed.value
    )  # it takes longer to pass


def test_scene_over_its_load(tmp_path: Path) -> None:
    """curve.at = "resonance", with a mean load that stays; a file is read as it was written."""
    scene = cracked(200.0, 100.0, curve={
        "parameter": "load", "at": "resonance", "start": 0.1, "stop": 2.0, "stability": False,
    })  # fmt: skip
    run = fc.curve(scene)
    curve = run.result
    assert curve.complete and np.ptp(curve.omega) > 0.0
    run.save(tmp_path / "curve.h5")
    loaded_curve = fc.load_run(tmp_path / "curve.h5").result
    assert np.array_equal(loaded_curve.omega, curve.omega)
    assert loaded_curve.amplitude() == pytest.approx(curve.amplitude(), rel=1e-9)
    place = len(curve) // 2
    point = curve.solution(place)
    solution = fc.solve_harmonic_balance(
        point.structure, point.omega, point.contact, harmonics=point.harmonics, initial=point
    )
    assert solution.amplitude() == pytest.approx(curve.amplitude()[place], rel=1e-5)


@pytest.mark.nightly
@pytest.mark.parametrize("force", [0.2, 0.4, 1.0])
def test_solid_blade_on_a_rotor(force: float) -> None:
    """Its resonance is that of its curve over rpm, which the load moves by 20 rpm: the centrifugal
    load opens the crack, and the bilinear frequency meets the order at 5,847 rpm."""
    scene = titanium_blade(force)
    rotor = fc.run_up_structure(fc.build_structure(scene), 605.0, 615.0, 10)
    problem = Problem(rotor, 4.0 * rotor.speed, fc.UnilateralConstraint())
    resonance = resonance_at(problem, parameter="speed", tolerance=0.01)
    peak = fc.curve(scene).peak()
    assert resonance.omega == pytest.approx(peak.omega, rel=2e-4)
    assert resonance.solution.amplitude() == pytest.approx(peak.amplitude, rel=0.02)
    assert not resonance.several


def test_large_structures_are_reduced() -> None:
    """As for curves, to crack faces without mass."""
    scene = cracked(0.0)
    full_structure, law = fc.build_structure(scene), fc.prepare(scene).contact
    solution = resonance_at(Problem(full_structure, scene.excitation.omega, law)).solution
    assert full_structure.n_dofs > 600 > solution.structure.n_dofs
    assert solution.structure.whole is full_structure and solution.converged


def test_the_short_form() -> None:
    """Structure, law and frequency in place of a problem, with 5 harmonics or those of the load;
    the frequency is that of a mass on each of two springs for half of its own periods."""
    law, structure = fc.UnilateralPenalty(1.0), mass(0.01)
    resonance = fc.resonance_at(structure, law, 1.2)
    bilinear = 2.0 / (1.0 + math.sqrt(0.5))
    assert (
        resonance.omega == pytest.approx(bilinear, rel=2e-3) and resonance.solution.harmonics == 5
    )
    assert resonance.omega == fc.resonance_at(Problem(structure, 1.2, law)).omega
    harmonic_load_structure = structure.with_added_load_harmonics({7: (None, np.array([1e-6]))})
    assert fc.resonance_at(harmonic_load_structure, law, 1.2).solution.harmonics == 7


# --- refused --------------------------------------------------------------------------------------


def test_what_has_no_phase_resonance() -> None:
    """Friction and smooth laws, no damping, no load, a load of 0; a key beside another
    parameter."""
    law, structure = fc.UnilateralPenalty(1.0), mass(0.01)
    problem = Problem(structure, 1.0, law, 5)
    smooth_law = fc.SmoothedPenalty(1.0, 1e3)
    for refused_problem, key, value in (
        (Problem(structure, 1.0, smooth_law, 5), "contact", smooth_law),
        (Problem(mass(0.0), 0.9, law, 5), "damping", 0.0),
        (Problem(mass(0.01, force=0.0), 1.0, law, 5), "load", 0.0),
    ):
        catch_error(partial(resonance_at, refused_problem), key, value)
    catch_error(lambda: follow_resonance(problem, 0.0, 1.0), "start", 0.0)
    catch_error(lambda: resonance_at(problem, near=0.0), "near", 0.0)
    catch_error(lambda: follow_resonance(problem, 0.5, 1.0, tolerance=-0.01), "tolerance", -0.01)
    catch_error(
        lambda: fc.continue_parameter(structure, 1.0, law, "resonance", 0.5, 1.0),
        "parameter",
        "resonance",
        names="follow_resonance",
    )
    span = {"parameter": "clearance", "at": "resonance", "start": 0.1, "stop": 1.0}
    catch_error(lambda: fc.Scene.from_mapping(CRACKED | {"curve": span}), "curve.at", "resonance")


def test_a_structure_needs_a_frequency() -> None:
    """Named as such."""
    catch_error(lambda: resonance_at(mass(0.01), fc.UnilateralPenalty(1.0)), "omega", None)
