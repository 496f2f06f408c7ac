"""Run-ups: curves over a rotor's speed, which the load's frequency follows."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error
from mpi4py import MPI
from rotating import cracked

import fenics_crack as fc
from fenics_crack import Run, Scene
from fenics_crack.basics.observables import IN_SPECIAL_POINTS_TABLE
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM
from fenics_crack.cli.account import select_printed_quantities
from fenics_crack.cli.curves import tabulate_curve_points, tabulate_special_points
from fenics_crack.curves.balance_equations import BalanceAlongSpeed

ORDER = 12
CURVE = {"parameter": "speed", "start": 560.0, "stop": 640.0}


def blade(changes: dict[str, Any] | None = None) -> Scene:
    """A blade whose breathing mode is met by order 12 near 600 rad/s."""
    scene = cracked(600.0, -250.0).replace({"excitation.order": ORDER, "reduction.modes": 6})
    return scene.replace({f"curve.{key}": value for key, value in (changes or {}).items()})


@pytest.fixture(scope="module")
def run_up() -> Run[fc.ResponseCurve]:
    """Followed through the resonance."""
    return fc.curve(blade(CURVE), MPI.COMM_SELF)


def test_basis_of_all_speeds() -> None:
    """Natural frequencies and compliances of structures that are assembled at speeds where the
    basis has none of its own."""
    full_structure = fc.build_structure(blade(), MPI.COMM_SELF)
    rotor = fc.run_up_structure(full_structure, 500.0, 700.0, 6)
    law = fc.UnilateralConstraint()
    for speed in (540.0, 660.0):
        at_speed = rotor.at_speed(speed)
        structure_at_speed = full_structure.rotation.structure_rotating_at_speed(speed)
        assert at_speed.omega == pytest.approx(
            fc.solve_modes(structure_at_speed, 6).omega, rel=1e-8
        )
        massless_structure = fc.reduce_structure(structure_at_speed, modes=6, method="massless")
        rotor_compliance, massless_compliance = (
            fc.Problem(structure, 0.9 * ORDER * speed, law).compliance_model()
            for structure in (at_speed, massless_structure)
        )
        for name in ("matrices", "linear_gap"):
            rotor_array, massless_array = (
                getattr(rotor_compliance, name),
                getattr(massless_compliance, name),
            )
            assert np.abs(rotor_array - massless_array).max() < 1e-7 * np.abs(massless_array).max()


@pytest.mark.nightly
def test_stated_errors_of_a_run_up(run_up: Run[fc.ResponseCurve]) -> None:
    """Of the largest response those of the scene at its speed; the speed at which the resonance is
    met is off as on a mesh twice as fine, between a fifth of what is stated and 1.5 times it."""
    errors = run_up.errors
    assert errors is not None and errors.causes == ("modes", "harmonics", "mesh", "friction")
    peak, curve = run_up.peak(), run_up.result
    assert [peak.error, peak.omega_error] == [
        errors.stated(name)[0] for name in ("amplitude", "speed")
    ]
    assert errors.values["amplitude"] == pytest.approx(curve.amplitude().max(), rel=1e-3)
    name = "omega_bilinear_1"
    rate = 1.0 - curve.solution(peak.index).structure.stiffening_exponent(peak.omega)
    assert rate < 0.99 and errors.stated("speed")[0] * rate == pytest.approx(errors.stated(name)[0])
    mesh = run_up.scene.mesh
    changes = {"mesh.lip_elements": 2 * mesh.given("lip_elements"), "mesh.size": mesh.size / 2.0}
    changes |= {"mesh.error": False, "curve.stability": False}
    changes |= {"curve.start": 0.99 * peak.value, "curve.stop": 1.01 * peak.value}
    true_shift = (
        fc.curve(run_up.scene.replace(changes), MPI.COMM_SELF).peak().value / peak.value - 1.0
    )
    assert 0.2 < abs(true_shift) / errors.stated("speed")[0] < 1.5
    # A resonance that is higher is met at a higher speed; the coarse mesh's, where a finer one's is
    # met at a lower speed.
    for parts in errors.parts.values():
        shifts = (
            np.array(parts[quantity].values) / errors.values[quantity] - 1.0
            for quantity in (name, "speed")
        )
        resonance_shift, speed_shift = shifts
        assert speed_shift * rate == pytest.approx(resonance_shift, abs=1e-12)
    assert true_shift * (errors.parts["mesh"]["speed"].values[1] - errors.values["speed"]) < 0.0


def test_factor_of_the_damping() -> None:
    """A varied structure's run-up is damped as it is, at each speed."""
    full_structure = fc.build_structure(blade(), MPI.COMM_SELF)
    rotor, doubled_rotor = (
        fc.run_up_structure(full_structure.varied(damping=factor), 560.0, 640.0, 3)
        for factor in (1.0, 2.0)
    )
    assert doubled_rotor.modal_damping == pytest.approx(2.0 * rotor.modal_damping, rel=1e-9)
    assert str(doubled_rotor.at_speed(600.0).damping) == "modal damping 1 %"
    assert str(doubled_rotor.varied(damping=3.0).at_speed(600.0).damping) == "modal damping 3 %"


def test_derivative_by_the_speed() -> None:
    """dF/dW of the equations, against wider differences of them, near resonance and in contact."""
    full_structure = fc.build_structure(blade(), MPI.COMM_SELF)
    rotor = fc.run_up_structure(full_structure, 560.0, 640.0, 6).at_speed(600.0)
    problem = fc.Problem(rotor, ORDER * 600.0, fc.UnilateralConstraint(), 3)
    solution = fc.solve_harmonic_balance(rotor, problem.omega, problem.contact, harmonics=3)
    assert solution.indicators(0).closed_share > 0.05
    family, unknown = (
        BalanceAlongSpeed(problem, 560.0, 640.0),
        solution.gap_series_without_static_part,
    )
    rate = family._residual_derivative_by_value(600.0, family.system(600.0).linearise(unknown))
    lower_residual, upper_residual = (
        family._make_system(600.0 + d).linearise(unknown).residual for d in (-0.01, 0.01)
    )
    assert rate == pytest.approx(
        (upper_residual - lower_residual) / 0.02, rel=1e-3, abs=1e-5 * np.abs(rate).max()
    )


@pytest.mark.nightly
def test_a_crack_that_rotation_holds_open() -> None:
    """By far more than it vibrates, and further at each speed: what holds it open does not make
    steps short, nor long; the peak is that of a linear structure, proportional to the load."""
    peaks = []
    for force in (0.02, 0.2):
        load_changes = {"excitation.force_mean": [0.0, 0.0], "excitation.force_sin": [force, 0.0]}
        curve = fc.curve(
            blade(CURVE | {"stability": False}).replace(load_changes), MPI.COMM_SELF
        ).result
        assert curve.complete and len(curve) < 200
        assert curve.indicators().closed_share.max() == 0.0
        peaks.append(curve.peak())
    assert peaks[1].amplitude == pytest.approx(10.0 * peaks[0].amplitude, rel=1e-3)
    assert peaks[1].damping == pytest.approx(peaks[0].damping, rel=1e-2)
    full_structure, (speed, omega) = (
        fc.build_structure(blade(), MPI.COMM_SELF),
        (peaks[1].value, peaks[1].omega),
    )
    rotor = fc.run_up_structure(full_structure, 560.0, 640.0, 6).at_speed(speed)
    nearby_omegas = [rotor.at_speed(speed * (1.0 + h)).omega for h in (-1e-4, 1e-4)]
    mode = int(np.abs(rotor.omega - omega).argmin())
    stiffening = float(np.log(nearby_omegas[1] / nearby_omegas[0])[mode]) / 2e-4
    assert rotor.stiffening_exponent(omega) == pytest.approx(stiffening, rel=1e-4)
    assert 0.02 < stiffening and peaks[1].damping == pytest.approx(0.005, rel=3e-3)


def test_natural_frequencies_are_those_of_each_speed(run_up: Run[fc.ResponseCurve]) -> None:
    """Columns of a run-up, and of its special points, against structures at their own speeds."""
    rotation = run_up.structure.whole.rotation
    points, special = tabulate_curve_points(run_up), tabulate_special_points(run_up)
    for table, rows in ((points, points.rows[:: len(points.rows) // 5]), (special, special.rows)):
        for row in rows:
            record = dict(zip(table.columns, row, strict=True))
            omega = record["omega [rad/s]"]
            frequencies = fc.bilinear_frequencies(
                rotation.structure_rotating_at_speed(omega / ORDER)
            ).nearest(omega)
            for name in ("over_open", "over_tied", "over_bilinear"):
                assert record[name] == pytest.approx(float(frequencies[name]), rel=2e-5)
    [first_omega, last_omega] = (
        row[points.columns.index("omega_open [rad/s]")] for row in (points.rows[0], points.rows[-1])
    )
    assert last_omega > 1.001 * first_omega


def test_verdicts_are_those_of_single_solutions(run_up: Run[fc.ResponseCurve]) -> None:
    """At three speeds, each of a scene that is meshed, reduced and solved by itself."""
    curve = run_up.result
    peak = int(curve.amplitude(run_up.watched_dof).argmax())
    for index in (0, peak, len(curve) - 1):
        speed = float(curve.values[index])
        solution_run = fc.solve(blade().replace({"rotation.speed": speed}), MPI.COMM_SELF)
        amplitude = solution_run.result.amplitude(solution_run.watched_dof)
        assert curve.amplitude(run_up.watched_dof)[index] == pytest.approx(amplitude, rel=1e-3)
        assert curve.verdicts[index] == solution_run.result.stability.verdict == "stable"
        max_multiplier = abs(solution_run.result.stability.multipliers[0])
        # Interpolated between orbits; at the peak a pair becomes real, which is a square root.
        rtol = 3e-3 if index == peak else 1e-5
        assert abs(curve.multipliers[index]) == pytest.approx(max_multiplier, rel=rtol)


def test_run_up_in_a_file(run_up: Run[fc.ResponseCurve], tmp_path: Path) -> None:
    """It is saved, and read with its scene, as it was; tip timing takes it."""
    fc.save(run_up.result, tmp_path / "curve.h5", run_up.scene)
    loaded_run = fc.load_run(tmp_path / "curve.h5", MPI.COMM_SELF)
    dof = run_up.watched_dof
    assert (
        isinstance(loaded_run.result, fc.ResponseCurve) and loaded_run.result.parameter == "speed"
    )
    assert loaded_run.result.amplitude(dof) == pytest.approx(run_up.result.amplitude(dof), rel=1e-6)
    arrivals = fc.tip_timing(
        run_up.result, dof, probes=[0.1, 1.0, 2.5], tip_radius=0.42, order=ORDER, revolutions=50
    )
    assert 2.0 * np.pi / np.diff(arrivals.marks)[[0, -1]] == pytest.approx([560, 640], rel=0.02)


@pytest.mark.drawn(1)
@pytest.mark.parametrize("in_rpm", [True, False])
def test_run_up_in_the_scenes_unit(
    run_up: Run[fc.ResponseCurve], in_rpm: bool, tmp_path: Path
) -> None:
    """Pictures, tables and words have rpm and Hz where the scene gives rpm, else rad/s; files have
    both; the picture names the frequency of the engine order."""
    speeds = (
        {"parameter": "rpm", "start": 560.0 / RAD_PER_S_PER_RPM, "stop": 640.0 / RAD_PER_S_PER_RPM}
        if in_rpm
        else CURVE
    )
    run, unit = replace(run_up, scene=blade(speeds)), "rpm" if in_rpm else "rad/s"
    factor, per_speed = (1.0 / RAD_PER_S_PER_RPM, 12.0 / 60.0) if in_rpm else (1.0, 12.0)
    figure = fc.draw_curve(run.result, run.watched_dof, in_hertz=run.scene.is_frequency_in_hertz)
    [panel] = figure.axes
    assert panel.get_xlabel() == f"rotor speed [{unit}]"
    assert panel.lines[0].get_xdata()[0] == pytest.approx(560.0 * factor)
    [top_axes] = panel.child_axes
    order = f"load frequency, engine order 12 [{'Hz' if in_rpm else 'rad/s'}]"
    assert top_axes.get_xlabel() == order
    figure.draw_without_rendering()
    assert top_axes.get_xlim() == pytest.approx(per_speed * np.array(panel.get_xlim()))

    table = tabulate_special_points(run)
    record = dict(zip(table.columns, table.rows[0], strict=True))
    first_speeds = record["speed [rad/s]"], record["rpm"]
    assert first_speeds == pytest.approx((560.0, 560.0 / RAD_PER_S_PER_RPM))
    assert record["omega [rad/s]"] == pytest.approx(12.0 * 560.0)
    assert record["frequency [Hz]"] == pytest.approx(12.0 * 560.0 / (2.0 * np.pi))
    printed_columns = select_printed_quantities(table, run.scene, IN_SPECIAL_POINTS_TABLE).columns[
        :3
    ]
    assert printed_columns == (["point", "rpm", "frequency [Hz]"] if in_rpm else
                     ["point", "speed [rad/s]", "omega [rad/s]"])  # fmt: skip
    assert tabulate_curve_points(run).columns[:4] == table.columns[1:5]


def test_bad_input() -> None:
    """A run-up needs an order, a structure that rotates, and one that knows all speeds."""
    catch_error(lambda: cracked(600.0, curve=CURVE), "curve.parameter", "speed")
    for method in ("off", "free_interface"):  # none of which it would take
        catch_error(
            partial(fc.curve, blade(CURVE).replace({"reduction.method": method}), MPI.COMM_SELF),
            "reduction.method",
            method,
            names="'massless'",
        )
    plate = fc.prepare(cracked(600.0), MPI.COMM_SELF)
    catch_error(
        lambda: fc.continue_parameter(plate.structure, 7e3, plate.contact, "speed", 560.0, 640.0),
        "structure",
        names="run_up_structure",
    )
    catch_error(
        lambda: fc.run_up_structure(
            fc.build_structure(cracked(0.0), MPI.COMM_SELF), 560.0, 640.0, 6
        ),
        "structure",
        names=r"\[rotation\]",
    )
