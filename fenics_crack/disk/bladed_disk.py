"""Compute blade vibrations, nodal diameters and amplification by mistuning.

In a tuned wheel with N sectors, an engine order E excites the modes with one nodal diameter,

    n = min(E mod N, N - E mod N).

In a mistuned wheel the order excites all modes, and a blade may vibrate more than in the tuned
wheel. If blades differ in frequency only, Whitehead's bound for the amplification is (1 + sqrt(N))
/ 2 (Journal of Mechanical Engineering Science 8, 1966, 15).

Without contact, the response u [m] to the load f at frequency w [rad/s] is a sum over the mistuned
wheel's modes m, with frequency w_m, shape phi_m and damping ratio xi_m,

    u(w) = sum_m phi_m (phi_m . f) / (w_m^2 - w^2 + 2 i xi_m w_m w).

The peak is sought next to 2 N natural frequencies, the excited family and neighbouring modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
import scipy.linalg
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import MAX_VALUES_OF_AXIS, InputError, check_count, check_number
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    Conclusion,
    Report,
    Table,
    Tabular,
    format_count,
    format_quantity,
    hertz_property,
)
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.disk.cyclic import excited_diameter
from fenics_crack.disk.wheel import Wheel, WheelInFewCoordinates, count_basis_families
from fenics_crack.fem.build import assemble_structure
from fenics_crack.files.store import SavableResult
from fenics_crack.model.structure import DampingRule, Structure
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import remarks_on_scene

SEARCH_FREQUENCIES_PER_BANDWIDTH = 8
"""Number of frequencies per half-power bandwidth 2 xi w in the first search for a peak.

For a single mode, the first search finds the peak amplitude to 8e-3. A second search, in 40 steps
between the neighbouring frequencies, finds it to 2e-5.
"""
SEARCH_BANDWIDTHS_PER_SIDE = 1.5
"""Half-width of the search interval around a natural frequency, in half-power bandwidths."""


def wheel_of(structure: Structure) -> Wheel:
    """Return a structure's bladed disk, not reduced.

    ``structure`` is a wheel or a wheel's reduced structure.

    Raises
    ------
    InputError
        The structure does not belong to a scene with [disk].
    """
    if not isinstance(structure, Structure) or not isinstance(structure.whole, Wheel):
        raise InputError(
            "structure",
            repr(structure),
            "the structure of a scene with [disk], as fc.build_structure(scene) returns",
        )
    return structure.whole


@keep_old_attribute_names(fundamental="first_harmonic", second="second_harmonic_ratio")
@dataclass(frozen=True, repr=False)
class Blades(Tabular):
    """Result of :func:`blades`: vibration at the same dof in each blade.

    Attributes
    ----------
    amplitude : (N,) [m]
        Half the peak-to-peak displacement. For a curve, at the point with the blade's largest
        response.
    first_harmonic : (N,) complex [m]
        First harmonic, the coefficient of e^(i w t): a - i b for a cos(w t) + b sin(w t).
    second_harmonic_ratio : (N,)
        Second harmonic's amplitude over the first harmonic's amplitude.
    omega : (N,) [rad/s]
        Load frequency. For a curve, at the point with the blade's largest response.
    mistuning : (N,)
        Relative deviation of each sector's stiffness.
    cracked : tuple of int
        Cracked blades' numbers, from 1.
    """

    amplitude: np.ndarray
    first_harmonic: np.ndarray
    second_harmonic_ratio: np.ndarray
    omega: np.ndarray
    mistuning: np.ndarray
    cracked: tuple[int, ...]

    KIND: ClassVar[str] = "blades"
    frequency = hertz_property()

    @property
    def phase(self) -> np.ndarray:
        """Phase lead (N,) [rad] of each blade's first harmonic over cos(w t)."""
        return np.angle(self.first_harmonic)

    def to_dict(self) -> dict[str, Any]:
        """Return the result's columns by name, with a row for each blade."""
        blade_numbers = range(1, len(self.amplitude) + 1)
        return {
            "blade": list(blade_numbers),
            "amplitude": self.amplitude.tolist(),
            "phase": np.degrees(self.phase).tolist(),
            "ratio_2_1": self.second_harmonic_ratio.tolist(),
            "frequency": (self.omega / (2.0 * np.pi)).tolist(),
            "mistuning": self.mistuning.tolist(),
            "crack": [
                "yes" if blade_number in self.cracked else "no" for blade_number in blade_numbers
            ],
        }

    def _unit_by_name(self) -> dict[str, str]:
        return {"amplitude": "m", "phase": "degrees", "frequency": "Hz"}

    def _repr_text(self) -> str:
        blade_index = int(np.argmax(self.amplitude))
        amplitude_text = f"{self.amplitude[blade_index]:.4g} m of blade {blade_index + 1}"
        return (
            f"{format_count(len(self.amplitude), 'blade')}, the largest amplitude {amplitude_text}"
        )


def blades(found: Any, dof: int | None = None) -> Blades:
    """Find every blade's vibration in a bladed disk (collective).

    Parameters
    ----------
    found : PeriodicSolution, ResponseCurve, or a Run
        Solution, curve, or a run with either. On a curve each blade has the point with the blade's
        largest response.
    dof : int, optional
        Dof on any blade, to take at the same place on each blade; default: the watched dof.

    Returns
    -------
    Blades
        A row for every blade.

    Raises
    ------
    InputError
        The result does not belong to a scene with [disk].

    Examples
    --------
    >>> fc.blades(fc.solve(disk)).amplitude.max()
    """
    solution_or_curve = getattr(found, "result", found)
    is_solution = isinstance(solution_or_curve, PeriodicSolution)
    if not is_solution and not isinstance(solution_or_curve, ResponseCurve):
        raise InputError(
            "found",
            type(found).__name__,
            "a PeriodicSolution, a ResponseCurve, or a Run, as fc.solve or fc.curve returns",
        )
    structure = solution_or_curve.structure
    wheel = wheel_of(structure)
    blade_dofs = wheel.dofs_of_blades(int(wheel.as_dof_numbers([dof])[0]))
    get_solution_at_curve_point = cache(
        lambda point_index: (
            solution_or_curve if is_solution else solution_or_curve.solution(point_index)
        )
    )
    blade_result_rows: list[tuple[float, complex, float, float]] = []
    for blade_indicators, blade_dof in zip(
        solution_or_curve.indicators_of_dofs(blade_dofs), blade_dofs, strict=True
    ):
        solution = get_solution_at_curve_point(int(np.argmax(blade_indicators.amplitude)))
        displacement_coefficients = structure.values_at(
            solution.displacement_coefficients, [blade_dof]
        )
        complex_harmonics = to_complex(displacement_coefficients)[:, 0]
        second_harmonic_amplitude = abs(complex_harmonics[2]) if len(complex_harmonics) > 2 else 0.0
        second_harmonic_ratio = (
            second_harmonic_amplitude / abs(complex_harmonics[1]) if complex_harmonics[1] else 0.0
        )
        blade_result_rows.append(
            (
                solution.amplitude(blade_dof),
                complex_harmonics[1],
                second_harmonic_ratio,
                solution.omega,
            )
        )
    amplitudes, first_harmonics, second_ratios, omegas = map(
        np.array, zip(*blade_result_rows, strict=True)
    )
    return Blades(
        amplitudes,
        first_harmonics,
        second_ratios,
        omegas,
        wheel.mistuning,
        cracked=tuple(sector_index + 1 for sector_index in wheel.cracked),
    )


# --- nodal diameters ------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class NodalDiameters(SavableResult):
    """Result of :func:`nodal_diameters`: natural frequencies over the nodal diameter.

    The disk is tuned, with bonded cracks.

    Attributes
    ----------
    scene : Scene
        The disk's scene.
    omega : (n_diameters, families) [rad/s]
        Natural frequencies for the nodal diameters n = 0 .. N/2, ascending in each row. Each
        belongs to a pair of modes, at n = 0 and N/2 to a single mode.
    """

    scene: Scene
    omega: np.ndarray

    KIND: ClassVar[str] = "nodal diameters"
    frequency = hertz_property()

    @property
    def excited(self) -> int:
        """Nodal diameter excited by the engine order."""
        return excited_diameter(self.order, self.sectors)

    @property
    def order(self) -> int:
        """Engine order of the scene's load; 0 without an engine order."""
        return self.scene.excitation.order or 0

    @property
    def sectors(self) -> int:
        """N, the number of sectors."""
        return self.scene.given("disk").sectors

    def to_dict(self) -> dict[str, Any]:
        """Return the result's columns by name, with a row for each nodal diameter.

        "engine_orders" has the lowest engine orders with this nodal diameter.
        """
        nodal_diameters = list(range(len(self.omega)))
        frequencies_by_column = {
            f"frequency_{family_number}": (family_omega / (2.0 * np.pi)).tolist()
            for family_number, family_omega in enumerate(self.omega.T, 1)
        }
        return {
            "nodal_diameter": nodal_diameters,
            **frequencies_by_column,
            "engine_orders": [self._describe_lowest_orders(n) for n in nodal_diameters],
        }

    def _describe_lowest_orders(self, diameter: int) -> str:
        """List the lowest engine orders with a nodal diameter: "3 5 11"."""
        lowest_orders = sorted({diameter, self.sectors - diameter, self.sectors + diameter} - {0})
        return " ".join(map(str, lowest_orders))

    def _unit_by_name(self) -> dict[str, str]:
        return {
            f"frequency_{family_index + 1}": "Hz" for family_index in range(self.omega.shape[1])
        }

    def build_conclusion(self) -> Conclusion:
        """Return the printed summary: frequencies at the excited nodal diameter."""
        frequencies_text = ", ".join(
            f"{omega / RAD_PER_TURN:.6g}" for omega in self.omega[self.excited]
        )
        answer = (
            f"engine order {self.order} excites nodal diameter {self.excited}, whose natural "
            f"frequencies are {frequencies_text} Hz"
        )
        remarks = ["the Coriolis force is neglected"] if self.scene.speed > 0.0 else []
        return Conclusion(
            f"{format_count(len(self.omega), 'nodal diameter')} found",
            answer,
            further_clauses=remarks,
        )

    def _repr_text(self) -> str:
        return f"{format_count(len(self.omega), 'nodal diameter')} of {self.sectors} sectors"


def nodal_diameters(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> NodalDiameters:
    """Find a bladed disk's natural frequencies over the nodal diameter (collective).

    The disk has no mistuning, and bonded cracks. Ranks share the nodal diameters.

    Parameters
    ----------
    scene : Scene
        Scene with [disk], which has ``disk.families`` frequencies for each nodal diameter.
    comm : MPI.Comm
        Communicator, whose ranks share the work.

    Returns
    -------
    NodalDiameters
        A row for each nodal diameter.

    Raises
    ------
    InputError
        The scene has no [disk], or an unusable value.

    Examples
    --------
    >>> fc.nodal_diameters(disk).omega[2, 0]
    """
    scene.given("disk")
    wheel = wheel_of(assemble_structure(scene, comm))
    return NodalDiameters(scene, np.array(wheel.cyclic_modes().omega))


def report_of_diameters(disk_modes: NodalDiameters) -> Report:
    """Return the command's printed and written output: table of frequencies, and summary."""
    return Report(
        disk_modes.table(),
        disk_modes.build_conclusion(),
        remarks=remarks_on_scene(disk_modes.scene),
    )


# --- patterns of mistuning ------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Amplification(SavableResult):
    """Result of :func:`amplification`: factors for n random mistuning patterns, without contact.

    Attributes
    ----------
    scene : Scene
        The disk's scene.
    factor : (n,)
        Largest amplitude over blades and frequencies, relative to the tuned wheel. The wheels have
        no crack.
    omega : (n,) [rad/s]
        Load frequency at the largest amplitude.
    blade : (n,) int
        Blade, from 1, with the largest amplitude in each pattern.
    tuned, tuned_omega : float [m], [rad/s]
        The tuned wheel's largest amplitude, and the load frequency for this amplitude.
    deviation, seed : float, int
        Standard deviation for the sectors' relative stiffness deviations, and the first pattern's
        seed; the following patterns have consecutive seeds.
    """

    scene: Scene
    factor: np.ndarray
    omega: np.ndarray
    blade: np.ndarray
    tuned: float
    tuned_omega: float
    deviation: float
    seed: int

    KIND: ClassVar[str] = "amplification"
    frequency = hertz_property()
    tuned_frequency = hertz_property("tuned_omega")

    @property
    def bound(self) -> float:
        """Whitehead's bound for the factor: (1 + sqrt(N)) / 2."""
        return 0.5 * (1.0 + math.sqrt(self.scene.given("disk").sectors))

    def percentile(self, percent: float) -> float:
        """Return the percentile of the factors at ``percent`` from 0 to 100."""
        check_number("percent", percent, 0.0)
        return float(np.percentile(self.factor, min(percent, 100.0)))

    def to_dict(self) -> dict[str, Any]:
        """Return the result's columns by name, with a row for each pattern."""
        return {
            "seed": list(range(self.seed, self.seed + len(self.factor))),
            "factor": self.factor.tolist(),
            "frequency": (self.omega / (2.0 * np.pi)).tolist(),
            "blade": self.blade.tolist(),
        }

    def build_conclusion(self) -> Conclusion:
        """Return the printed summary: 95th percentile, largest factor, bound."""
        answer = (
            f"95 % of the amplification factors are at most {self.percentile(95.0):.4g}, "
            f"the largest is {self.factor.max():.4g}; Whitehead's bound is {self.bound:.4g}"
        )
        return Conclusion(f"{format_count(len(self.factor), 'pattern')} solved", answer)

    def _repr_text(self) -> str:
        factor_text = f"up to {self.factor.max():.4g} (bound {self.bound:.4g})"
        patterns_text = (
            f"{format_count(len(self.factor), 'pattern')} of {100.0 * self.deviation:.3g} %"
        )
        return f"{patterns_text}, amplification {factor_text}"


def amplification(
    scene: Scene,
    patterns: int = 1000,
    deviation: float = 0.01,
    seed: int = 0,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Amplification:
    """Find a disk's amplification factors for random mistuning patterns (collective).

    The disk has N blades and no cracks. A family has N modes: the modes with the same mode number
    at all nodal diameters. The chosen family has the natural frequency nearest to the scene's load
    frequency, at the nodal diameter excited by the load. For each pattern the largest response is
    sought near 2 N natural frequencies: N in this family, and the N next to the family. The
    amplitude is taken at the watched dof, and at the same place on every blade. Ranks share the
    patterns.

    Parameters
    ----------
    scene : Scene
        Scene with [disk]; mistuning and cracks in the scene are ignored.
    patterns : int
        Number of patterns.
    deviation : float
        Standard deviation for the sectors' relative stiffness deviations.
    seed : int
        Seed of the first pattern, as ``disk.seed``.
    comm : MPI.Comm
        Communicator, whose ranks share the work.

    Returns
    -------
    Amplification
        A factor for each pattern.

    Raises
    ------
    InputError
        The scene has no [disk], no load that vibrates or no modal or Rayleigh damping.

    Examples
    --------
    >>> factors = fc.amplification(disk, patterns=100, deviation=0.01)
    >>> factors.percentile(95.0) < factors.bound
    """
    check_count("patterns", patterns, 1, MAX_VALUES_OF_AXIS)
    check_count("seed", seed, 0)
    check_number("deviation", deviation, 0.0)
    scene.given("disk")
    uncracked_scene = scene.replace(
        {
            "disk.cracked": [],
            "disk.mistuning": None,
            "disk.deviation": float(deviation),
            "disk.seed": seed,
        }
    )
    wheel = wheel_of(assemble_structure(uncracked_scene, comm))
    find_peak = _make_peak_finder(wheel, scene.excitation.omega)
    tuned_amplitude, tuned_omega, _ = find_peak(np.zeros(wheel.sector.n_sectors))
    own_result_rows = []
    for pattern_index in range(comm.rank, patterns, comm.size):
        pattern_scene = uncracked_scene.replace({"disk.seed": seed + pattern_index})
        own_result_rows.append((pattern_index, *find_peak(pattern_scene.given("disk").deviations)))
    pattern_result_rows = sorted(
        result_row
        for rows_of_rank in comm.allgather(own_result_rows)
        for result_row in rows_of_rank
    )
    _, peak_amplitudes, peak_omegas, blade_numbers = map(
        np.array, zip(*pattern_result_rows, strict=True)
    )
    return Amplification(
        scene,
        peak_amplitudes / tuned_amplitude,
        peak_omegas,
        blade_numbers,
        tuned_amplitude,
        tuned_omega,
        float(deviation),
        seed,
    )


def report_of_amplification(amplification_result: Amplification) -> Report:
    """Return the command's printed and written output: percentiles of the factors, and summary.

    The full table with a row for each pattern is written, but not printed.
    """
    percentile_levels = (5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0)
    percentile_table = Table(
        ["share of patterns [%]", "amplification factor"],
        [
            [percentile_level, amplification_result.percentile(percentile_level)]
            for percentile_level in percentile_levels
        ],
    )
    tuned_peak_text = (
        f"{format_quantity(amplification_result.tuned, 'm')} at "
        f"{amplification_result.tuned_omega / RAD_PER_TURN:.6g} Hz"
    )
    return Report(
        amplification_result.table(),
        amplification_result.build_conclusion(),
        printed_table=percentile_table,
        notes=[f"largest amplitude of the tuned bladed disk without cracks: {tuned_peak_text}"],
    )


PeakFinder = Callable[[np.ndarray], tuple[float, float, int]]
"""Function for a mistuned wheel's largest response without contact.

The argument has the sectors' relative stiffness deviations (N,). Returned are amplitude [m], load
frequency [rad/s] and the blade's number from 1.
"""


def _make_peak_finder(wheel: Wheel, load_omega: float) -> PeakFinder:
    """Return a function for a mistuned wheel's largest response without contact.

    Used to compare random mistuning patterns. The returned function (``PeakFinder``) takes the
    sectors' relative stiffness deviations (N,). The results are the largest amplitude [m], the load
    frequency [rad/s] at this amplitude, and the blade number, from 1.

    The function searches near 2 N natural frequencies: N in a chosen family, and the N next to the
    family. A family has the same mode number at all nodal diameters. The chosen family has the
    natural frequency nearest to ``load_omega`` [rad/s], at the nodal diameter excited by the load.

    Raises
    ------
    InputError
        The load does not vibrate, or damping is neither modal nor Rayleigh.
    """
    wheel_structure = WheelInFewCoordinates(wheel, count_basis_families(wheel.families))
    n_sectors = wheel.sector.n_sectors
    mass, tuned_stiffness = wheel_structure.basis.tuned_mass_and_stiffness
    damping_rule = wheel.damping
    complex_load = wheel_structure.force[1] - 1j * wheel_structure.force[2]
    if not np.any(complex_load):
        raise InputError("load", "steady", "one that changes in time, such as excitation.force_sin")
    if not isinstance(damping_rule, DampingRule):
        raise InputError("damping", None, "modal or Rayleigh damping, which limits the amplitude")
    omegas_of_diameters = np.array(wheel.cyclic_modes().omega)
    excited_omegas = omegas_of_diameters[excited_diameter(wheel.order, n_sectors)]
    natural_omega_nearest_to_load = excited_omegas[np.argmin(np.abs(excited_omegas - load_omega))]
    is_below_family = omegas_of_diameters < natural_omega_nearest_to_load * (1.0 - 1e-9)
    n_modes_below_family = round(
        n_sectors * float(wheel.sector.shares_of_single_sector_load @ is_below_family.sum(axis=1))
    )
    # The range has all N modes of the excited family, and N neighbouring modes.
    mode_range = slice(
        max(n_modes_below_family - n_sectors, 0),
        max(n_modes_below_family - n_sectors, 0) + 2 * n_sectors,
    )
    blade_motion_matrix = wheel_structure.values_at(
        np.eye(wheel_structure.n_dofs), wheel.dofs_of_blades(wheel.watched_dof)
    ).T
    band_offsets = np.arange(
        -SEARCH_BANDWIDTHS_PER_SIDE,
        SEARCH_BANDWIDTHS_PER_SIDE + 0.5 / SEARCH_FREQUENCIES_PER_BANDWIDTH,
        1.0 / SEARCH_FREQUENCIES_PER_BANDWIDTH,
    )

    def find_peak(deviations: np.ndarray) -> tuple[float, float, int]:
        mistuned_stiffness = tuned_stiffness + np.tensordot(
            deviations, wheel_structure.basis.sector_stiffnesses, 1
        )
        squared_omegas, mode_shapes = scipy.linalg.eigh(mistuned_stiffness, mass)
        natural_omegas, damping_rates = np.sqrt(squared_omegas), damping_rule.rate(squared_omegas)
        modal_forces, blade_shapes = mode_shapes.T @ complex_load, blade_motion_matrix @ mode_shapes
        search_omegas = np.sort(
            (
                natural_omegas[mode_range, None] + damping_rates[mode_range, None] * band_offsets
            ).ravel()
        )

        def compute_amplitudes(load_omegas: np.ndarray) -> np.ndarray:
            dynamic_stiffness = (
                squared_omegas
                - load_omegas[:, None] ** 2
                + 1j * damping_rates * load_omegas[:, None]
            )
            return np.abs((modal_forces / dynamic_stiffness) @ blade_shapes.T)

        search_amplitudes = compute_amplitudes(search_omegas)
        peak_index, blade_index = np.unravel_index(
            int(np.argmax(search_amplitudes)), search_amplitudes.shape
        )
        half_power_bandwidth = np.interp(
            search_omegas[peak_index], natural_omegas[mode_range], damping_rates[mode_range]
        )
        frequency_step = half_power_bandwidth / SEARCH_FREQUENCIES_PER_BANDWIDTH
        fine_omegas = search_omegas[peak_index] + frequency_step * np.linspace(-1.0, 1.0, 41)
        fine_amplitudes = compute_amplitudes(fine_omegas)[:, blade_index]
        fine_peak_index = int(np.argmax(fine_amplitudes))
        return (
            float(fine_amplitudes[fine_peak_index]),
            float(fine_omegas[fine_peak_index]),
            int(blade_index) + 1,
        )

    return find_peak
