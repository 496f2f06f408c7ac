"""Blades of a bladed disk, frequencies over the nodal diameter, amplification by mistuning.

An engine order E excites, of the modes of a tuned wheel of N sectors, those of one nodal diameter:

    n = min(E mod N, N - E mod N).

In a mistuned wheel it excites all of them, and one blade may vibrate by more than any does in the
tuned one. Whitehead's bound of that amplification, for blades alike but for their frequencies, is
(1 + sqrt(N)) / 2 (Journal of Mechanical Engineering Science 8, 1966, 15).

The response of a pattern without contact is a sum over the wheel's modes,

    u(w) = sum_m phi_m (phi_m . f) / (w_m^2 - w^2 + 2 i xi_m w_m w),

looked for next to the natural frequencies of the family that is excited.
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
from fenics_crack.basics.errors import MAX_CASES, InputError, check_count, check_number
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import TURN, Said, Table, Tabular, counted, hertz_of, quantity
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.disk.cyclic import excited_diameter
from fenics_crack.disk.wheel import Wheel, WheelStructure, count_basis_families
from fenics_crack.fem.build import assemble
from fenics_crack.files.saved import Saved
from fenics_crack.model.structure import DampingRule, Structure
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import remarks_on_scene

FREQUENCIES_PER_WIDTH = 8
"""Frequencies per half-power bandwidth at which a response is computed. The largest amplitude is
within 2e-3 of the peak of one mode, and a parabola through three within 1e-5."""
SEARCH_WIDTHS = 1.5
"""Half-power bandwidths to either side of a natural frequency in which a peak is looked for."""


def wheel_of(structure: Structure) -> Wheel:
    """Return the whole wheel of a structure, reduced or not.

    Raises
    ------
    InputError
        It is none of a scene with [disk].
    """
    if not isinstance(structure, Structure) or not isinstance(structure.whole, Wheel):
        raise InputError("structure", repr(structure), "that of a scene with [disk]")
    return structure.whole


@dataclass(frozen=True, repr=False)
class Blades(Tabular):
    """Vibration of each blade of a disk, at the same dof of all.

    Attributes
    ----------
    amplitude : (N,) [m]
        Half of the peak-to-peak displacement; of a curve at the blade's largest response.
    fundamental : (N,) complex [m]
        Coefficients of e^(i w t): a - i b of a cos(w t) + b sin(w t).
    second : (N,)
        Amplitude of the second harmonic over that of the first.
    omega : (N,) [rad/s]
        The load's frequency.
    mistuning : (N,)
        Relative deviation of the sector's stiffness.
    cracked : tuple of int
        Numbers of the blades with a crack, from 1.
    """

    amplitude: np.ndarray
    fundamental: np.ndarray
    second: np.ndarray
    omega: np.ndarray
    mistuning: np.ndarray
    cracked: tuple[int, ...]

    KIND: ClassVar[str] = "blades"
    frequency = hertz_of()

    @property
    def phase(self) -> np.ndarray:
        """Angle by which the first harmonic leads the load on the first blade: (N,) [rad]."""
        return np.angle(self.fundamental)

    def to_dict(self) -> dict[str, Any]:
        """Return columns with a row for every blade."""
        numbers = range(1, len(self.amplitude) + 1)
        return {
            "blade": list(numbers),
            "amplitude": self.amplitude.tolist(),
            "phase": np.degrees(self.phase).tolist(),
            "ratio_2_1": self.second.tolist(),
            "frequency": (self.omega / (2.0 * np.pi)).tolist(),
            "mistuning": self.mistuning.tolist(),
            "crack": ["yes" if number in self.cracked else "no" for number in numbers],
        }

    def _units(self) -> dict[str, str]:
        return {"amplitude": "m", "phase": "degrees", "frequency": "Hz"}

    def _title(self) -> str:
        blade_index = int(np.argmax(self.amplitude))
        size = f"{self.amplitude[blade_index]:.4g} m of blade {blade_index + 1}"
        return f"{counted(len(self.amplitude), 'blade')}, the largest amplitude {size}"


def blades(found: Any, dof: int | None = None) -> Blades:
    """Find the vibration of every blade of a bladed disk (collective).

    Parameters
    ----------
    found : PeriodicSolution, ResponseCurve, or a Run of one
        Solution; of a curve each blade is taken where it moves most.
    dof : int, optional
        Of one blade; default: the one that is watched.

    Returns
    -------
    Blades
        A row for every blade.

    Raises
    ------
    InputError
        It is no result of a scene with [disk].

    Examples
    --------
    >>> fc.blades(fc.solve(disk)).amplitude.max()
    """
    result = getattr(found, "result", found)
    is_solution = isinstance(result, PeriodicSolution)
    if not is_solution and not isinstance(result, ResponseCurve):
        raise InputError("found", type(found).__name__, "a solution or a response curve")
    structure = result.structure
    wheel = wheel_of(structure)
    dofs = wheel.dofs_of_blades(int(wheel.check_dofs([dof])[0]))
    solution_at = cache(lambda place: result if is_solution else result.solution(place))
    values: list[tuple[float, complex, float, float]] = []
    for indicators, blade_dof in zip(result.measure(dofs), dofs, strict=True):
        solution = solution_at(int(np.argmax(indicators.amplitude)))
        coefficients = structure.values_at(solution.displacement_coefficients, [blade_dof])
        rows = to_complex(coefficients)[:, 0]
        second_amplitude = abs(rows[2]) if len(rows) > 2 else 0.0
        ratio = second_amplitude / abs(rows[1]) if rows[1] else 0.0
        values.append((solution.amplitude(blade_dof), rows[1], ratio, solution.omega))
    amplitude, fundamental, ratios, omega = map(np.array, zip(*values, strict=True))
    cracked_numbers = tuple(place + 1 for place in wheel.cracked)
    return Blades(amplitude, fundamental, ratios, omega, wheel.mistuning, cracked_numbers)


# --- nodal diameters ------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class NodalDiameters(Saved):
    """Natural frequencies of a tuned bladed disk without a crack, over the nodal diameter.

    Attributes
    ----------
    scene : Scene
        That of the disk.
    omega : (n_diameters, families) [rad/s]
        Of n = 0 .. N/2; those of n = 0, and of N/2, are of one mode each, others of two.
    """

    scene: Scene
    omega: np.ndarray

    KIND: ClassVar[str] = "nodal diameters"
    frequency = hertz_of()

    @property
    def excited(self) -> int:
        """The nodal diameter that the engine order excites."""
        return excited_diameter(self.order, self.sectors)

    @property
    def order(self) -> int:
        """Engine order of the load."""
        return self.scene.excitation.order or 0

    @property
    def sectors(self) -> int:
        """N."""
        return self.scene.given("disk").sectors

    def to_dict(self) -> dict[str, Any]:
        """Return columns of frequencies and engine orders over the nodal diameter."""
        columns: dict[str, Any] = {"nodal_diameter": list(range(len(self.omega)))}
        for family, omega in enumerate(self.omega.T, 1):
            columns[f"frequency_{family}"] = (omega / (2.0 * np.pi)).tolist()
        return columns | {"engine_orders": [self._orders(n) for n in range(len(self.omega))]}

    def _orders(self, diameter: int) -> str:
        """Return the lowest engine orders that excite a nodal diameter."""
        lowest_orders = sorted({diameter, self.sectors - diameter, self.sectors + diameter} - {0})
        return " ".join(map(str, lowest_orders))

    def _units(self) -> dict[str, str]:
        return {f"frequency_{family + 1}": "Hz" for family in range(self.omega.shape[1])}

    def said(self) -> Said:
        """Return the parts of the last sentence on the frequencies."""
        hertz = ", ".join(f"{omega / TURN:.6g}" for omega in self.omega[self.excited])
        answer = f"engine order {self.order} excites nodal diameter {self.excited}: {hertz} Hz"
        remarks = ["without the Coriolis force"] if self.scene.speed > 0.0 else []
        return Said(f"{counted(len(self.omega), 'nodal diameter')} found", answer, others=remarks)

    def _title(self) -> str:
        return f"{counted(len(self.omega), 'nodal diameter')} of {self.sectors} sectors"


def nodal_diameters(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> NodalDiameters:
    """Find natural frequencies of a bladed disk over the nodal diameter (collective).

    The disk has no mistuning, and its cracks are bonded. Ranks share the nodal diameters.

    Parameters
    ----------
    scene : Scene
        With [disk], whose families are found.
    comm : MPI.Comm
        Ranks that share the work.

    Returns
    -------
    NodalDiameters
        A row for every nodal diameter.

    Raises
    ------
    InputError
        The scene has no [disk], or a value that cannot be used.

    Examples
    --------
    >>> fc.nodal_diameters(disk).omega[2, 0]
    """
    scene.given("disk")
    wheel = wheel_of(assemble(scene, comm))
    return NodalDiameters(scene, np.array(wheel.cyclic_modes().omega))


def report_of_diameters(diameters: NodalDiameters) -> Report:
    """Report the frequencies, and those that the load excites."""
    return Report(diameters.table(), diameters.said(), remarks=remarks_on_scene(diameters.scene))


# --- patterns of mistuning ------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Amplification(Saved):
    """Amplification factors of random patterns of mistuning, without contact.

    Attributes
    ----------
    scene : Scene
        That of the disk.
    factor : (n,)
        Largest amplitude of any blade over the frequency, relative to that of the tuned wheel
        without a crack.
    omega : (n,) [rad/s]
        Where it is.
    blade : (n,) int
        Of which blade, from 1.
    tuned, tuned_omega : float [m], [rad/s]
        Largest amplitude of the tuned wheel, and where.
    deviation, seed : float, int
        Of the patterns: each has a seed of its own, one after the other.
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
    frequency = hertz_of()
    tuned_frequency = hertz_of("tuned_omega")

    @property
    def bound(self) -> float:
        """Whitehead's bound of the factor: (1 + sqrt(N)) / 2."""
        return 0.5 * (1.0 + math.sqrt(self.scene.given("disk").sectors))

    def percentile(self, percent: float) -> float:
        """Return the factor that a percentage of the patterns does not exceed."""
        check_number("percent", percent, 0.0)
        return float(np.percentile(self.factor, min(percent, 100.0)))

    def to_dict(self) -> dict[str, Any]:
        """Return columns with a row for every pattern."""
        seeds = range(self.seed, self.seed + len(self.factor))
        return {
            "seed": list(seeds),
            "factor": self.factor.tolist(),
            "frequency": (self.omega / (2.0 * np.pi)).tolist(),
            "blade": self.blade.tolist(),
        }

    def _units(self) -> dict[str, str]:
        return {"frequency": "Hz"}

    def said(self) -> Said:
        """Return the parts of the last sentence on the patterns."""
        answer = f"95 % of the amplification factors are at most {self.percentile(95.0):.4g}"
        answer += f", the largest {self.factor.max():.4g}; Whitehead's bound {self.bound:.4g}"
        return Said(f"{counted(len(self.factor), 'pattern')} solved", answer)

    def _title(self) -> str:
        size = f"up to {self.factor.max():.4g} (bound {self.bound:.4g})"
        patterns = f"{counted(len(self.factor), 'pattern')} of {100.0 * self.deviation:.3g} %"
        return f"{patterns}, amplification {size}"


def amplification(
    scene: Scene,
    patterns: int = 1000,
    deviation: float = 0.01,
    seed: int = 0,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Amplification:
    """Find amplification factors of random mistuning patterns of a disk without cracks.

    The family of modes is the one whose frequency at the nodal diameter of the engine order is
    nearest to the scene's load; what is watched is the scene's dof on every blade. Ranks share the
    patterns (collective).

    Parameters
    ----------
    scene : Scene
        With [disk], whose own mistuning and cracks are left out.
    patterns : int
        Number of patterns.
    deviation : float
        Standard deviation of the relative deviations of the sectors' stiffness.
    seed : int
        Of the first pattern, as of ``disk.seed``.
    comm : MPI.Comm
        Ranks that share the work.

    Returns
    -------
    Amplification
        A factor for every pattern.

    Raises
    ------
    InputError
        The scene has no [disk], no load that vibrates or no modal or Rayleigh damping.

    Examples
    --------
    >>> found = fc.amplification(disk, patterns=100, deviation=0.01)
    >>> found.percentile(95.0) < found.bound
    """
    check_count("patterns", patterns, 1, MAX_CASES)
    check_count("seed", seed, 0)
    check_number("deviation", deviation, 0.0)
    scene.given("disk")
    pattern_keys = {"disk.mistuning": None, "disk.deviation": float(deviation), "disk.seed": seed}
    bonded_scene = scene.replace({"disk.cracked": [], **pattern_keys})
    wheel = wheel_of(assemble(bonded_scene, comm))
    find_peak = _make_peak_finder(wheel, scene.excitation.omega)
    tuned_amplitude, tuned_omega, _ = find_peak(np.zeros(wheel.sector.n_sectors))
    rank_rows = []
    for number in range(comm.rank, patterns, comm.size):
        pattern_scene = bonded_scene.replace({"disk.seed": seed + number})
        rank_rows.append((number, *find_peak(pattern_scene.given("disk").deviations)))
    rows = sorted(row for part in comm.allgather(rank_rows) for row in part)
    _, sizes, omegas, numbers = map(np.array, zip(*rows, strict=True))
    columns = sizes / tuned_amplitude, omegas, numbers, tuned_amplitude, tuned_omega
    return Amplification(scene, *columns, float(deviation), seed)


def report_of_amplification(factors: Amplification) -> Report:
    """Report amplification factors by shares of the patterns."""
    shares = (5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0)
    rows = [[share, factors.percentile(share)] for share in shares]
    tuned_peak = f"{quantity(factors.tuned, 'm')} at {factors.tuned_omega / TURN:.6g} Hz"
    share_table = Table(["share of patterns [%]", "amplification factor"], rows)
    notes = [f"the tuned wheel without a crack: {tuned_peak}"]
    return Report(factors.table(), factors.said(), shown=share_table, notes=notes)


PeakFinder = Callable[[np.ndarray], tuple[float, float, int]]
"""Function of the sectors' relative deviations of stiffness (N,). Without contact, it returns the
largest amplitude of any blade [m], its frequency [rad/s] and the number of the blade."""


def _make_peak_finder(wheel: Wheel, load_omega: float) -> PeakFinder:
    """Return the function that finds the largest response of a mistuned wheel.

    It looks in the family of modes that the engine order excites next to the load's frequency.
    """
    structure = WheelStructure(wheel, count_basis_families(wheel.families))
    count = wheel.sector.n_sectors
    (mass, tuned_stiffness), damping = structure.basis.tuned_mass_and_stiffness, wheel.damping
    force = structure.force[1] - 1j * structure.force[2]
    if not np.any(force):
        raise InputError("load", "steady", "one that changes in time: nothing vibrates")
    if not isinstance(damping, DampingRule):
        raise InputError("damping", None, "modal or Rayleigh damping, which bounds a peak")
    families = np.array(wheel.cyclic_modes().omega)
    excited_omega = families[excited_diameter(wheel.order, count)]
    family_omega = excited_omega[np.argmin(np.abs(excited_omega - load_omega))]
    is_slower = families < family_omega * (1.0 - 1e-9)
    n_slower = round(count * float(wheel.sector.diameter_shares @ is_slower.sum(axis=1)))
    # Of the excited family all N modes are looked at, and as many around it.
    mode_range = slice(max(n_slower - count, 0), max(n_slower - count, 0) + 2 * count)
    rows = structure.values_at(np.eye(structure.n_dofs), wheel.dofs_of_blades(wheel.watched_dof)).T
    steps = np.arange(
        -SEARCH_WIDTHS, SEARCH_WIDTHS + 0.5 / FREQUENCIES_PER_WIDTH, 1.0 / FREQUENCIES_PER_WIDTH
    )

    def find_peak(deviations: np.ndarray) -> tuple[float, float, int]:
        stiffness = tuned_stiffness + np.tensordot(
            deviations, structure.basis.sector_stiffnesses, 1
        )
        squares, shapes = scipy.linalg.eigh(stiffness, mass)
        natural_omega, rate = np.sqrt(squares), damping.rate(squares)
        modal_force, blade_shapes = shapes.T @ force, rows @ shapes
        omega = np.sort((natural_omega[mode_range, None] + rate[mode_range, None] * steps).ravel())

        def amplitudes(frequencies: np.ndarray) -> np.ndarray:
            change = squares - frequencies[:, None] ** 2 + 1j * rate * frequencies[:, None]
            return np.abs((modal_force / change) @ blade_shapes.T)

        sizes = amplitudes(omega)
        place, blade = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        width = np.interp(omega[place], natural_omega[mode_range], rate[mode_range])
        step = width / FREQUENCIES_PER_WIDTH
        fine_omega = omega[place] + step * np.linspace(-1.0, 1.0, 41)
        fine_sizes = amplitudes(fine_omega)[:, blade]
        top = int(np.argmax(fine_sizes))
        return float(fine_sizes[top]), float(fine_omega[top]), int(blade) + 1

    return find_peak
