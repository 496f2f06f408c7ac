"""A bladed disk in numbers: its blades side by side, its frequencies over the nodal diameter, and
how much mistuning amplifies the response of one blade.

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

PER_WIDTH = 8
"""Frequencies in the half-power bandwidth of a mode at which a response is computed: the largest is
then within 2e-3 of the peak of one mode, and a parabola through three within 1e-5."""
WIDTHS = 1.5
"""Half-power bandwidths to either side of a natural frequency in which a peak is looked for."""


def wheel_of(structure: Structure) -> Wheel:
    """The whole wheel of a structure, reduced or not.

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
    """How each blade of a bladed disk vibrates, at the dof that is watched of the first one.

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
        """A row for every blade."""
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
        largest = int(np.argmax(self.amplitude))
        size = f"{self.amplitude[largest]:.4g} m of blade {largest + 1}"
        return f"{counted(len(self.amplitude), 'blade')}, the largest amplitude {size}"


def blades(found: Any, dof: int | None = None) -> Blades:
    """The vibration of every blade of a bladed disk (collective).

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
    on_one = isinstance(result, PeriodicSolution)
    if not on_one and not isinstance(result, ResponseCurve):
        raise InputError("found", type(found).__name__, "a solution or a response curve")
    structure = result.structure
    wheel = wheel_of(structure)
    dofs = wheel.dofs_of_blades(int(wheel.check_dofs([dof])[0]))
    solution_at = cache(lambda place: result if on_one else result.solution(place))
    values: list[tuple[float, complex, float, float]] = []
    for seen, one in zip(result.measure(dofs), dofs, strict=True):
        solution = solution_at(int(np.argmax(seen.amplitude)))
        rows = to_complex(structure.values_at(solution.displacement_coefficients, [one]))[:, 0]
        higher = abs(rows[2]) if len(rows) > 2 else 0.0
        second = higher / abs(rows[1]) if rows[1] else 0.0
        values.append((solution.amplitude(one), rows[1], second, solution.omega))
    amplitude, fundamental, ratio, omega = map(np.array, zip(*values, strict=True))
    cracked = tuple(place + 1 for place in wheel.cracked)
    return Blades(amplitude, fundamental, ratio, omega, wheel.mistuning, cracked)


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
        """A row for every nodal diameter; frequencies of the families."""
        found: dict[str, Any] = {"nodal_diameter": list(range(len(self.omega)))}
        for family, omega in enumerate(self.omega.T, 1):
            found[f"frequency_{family}"] = (omega / (2.0 * np.pi)).tolist()
        return found | {"engine_orders": [self._orders(n) for n in range(len(self.omega))]}

    def _orders(self, diameter: int) -> str:
        """The lowest engine orders that excite a nodal diameter."""
        first = sorted({diameter, self.sectors - diameter, self.sectors + diameter} - {0})
        return " ".join(map(str, first))

    def _units(self) -> dict[str, str]:
        return {f"frequency_{family + 1}": "Hz" for family in range(self.omega.shape[1])}

    def said(self) -> Said:
        """What the last sentence on the frequencies says."""
        hertz = ", ".join(f"{omega / TURN:.6g}" for omega in self.omega[self.excited])
        excited = f"engine order {self.order} excites nodal diameter {self.excited}: {hertz} Hz"
        others = ["without the Coriolis force"] if self.scene.speed > 0.0 else []
        return Said(f"{counted(len(self.omega), 'nodal diameter')} found", excited, others=others)

    def _title(self) -> str:
        return f"{counted(len(self.omega), 'nodal diameter')} of {self.sectors} sectors"


def nodal_diameters(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> NodalDiameters:
    """Natural frequencies of a scene's bladed disk over the nodal diameter, without mistuning and
    with bonded cracks; ranks share the nodal diameters (collective).

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


def report_of_diameters(found: NodalDiameters) -> Report:
    """The frequencies, and those that the load excites."""
    return Report(found.table(), found.said(), remarks=remarks_on_scene(found.scene))


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
        """Whitehead's: (1 + sqrt(N)) / 2."""
        return 0.5 * (1.0 + math.sqrt(self.scene.given("disk").sectors))

    def percentile(self, percent: float) -> float:
        """The factor that so many of the patterns do not exceed [%]."""
        check_number("percent", percent, 0.0)
        return float(np.percentile(self.factor, min(percent, 100.0)))

    def to_dict(self) -> dict[str, Any]:
        """A row for every pattern."""
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
        """What the last sentence on the patterns says."""
        known = f"95 % of the amplification factors are at most {self.percentile(95.0):.4g}"
        known += f", the largest {self.factor.max():.4g}; Whitehead's bound {self.bound:.4g}"
        return Said(f"{counted(len(self.factor), 'pattern')} solved", known)

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
    """Amplification factors of random patterns of mistuning of a bladed disk without a crack.

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
    of_pattern = {"disk.mistuning": None, "disk.deviation": float(deviation), "disk.seed": seed}
    bonded = scene.replace({"disk.cracked": [], **of_pattern})
    wheel = wheel_of(assemble(bonded, comm))
    largest = _largest_response(wheel, scene.excitation.omega)
    tuned, tuned_omega, _ = largest(np.zeros(wheel.sector.count))
    found = []
    for number in range(comm.rank, patterns, comm.size):
        own = bonded.replace({"disk.seed": seed + number})
        found.append((number, *largest(own.given("disk").deviations)))
    every = sorted(one for part in comm.allgather(found) for one in part)
    _, sizes, omegas, numbers = map(np.array, zip(*every, strict=True))
    largest_ones = sizes / tuned, omegas, numbers, tuned, tuned_omega
    return Amplification(scene, *largest_ones, float(deviation), seed)


def report_of_amplification(found: Amplification) -> Report:
    """Amplification factors by shares of the patterns."""
    shares = (5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0)
    rows = [[share, found.percentile(share)] for share in shares]
    tuned = f"{quantity(found.tuned, 'm')} at {found.tuned_omega / TURN:.6g} Hz"
    shown = Table(["share of patterns [%]", "amplification factor"], rows)
    notes = [f"the tuned wheel without a crack: {tuned}"]
    return Report(found.table(), found.said(), shown=shown, notes=notes)


Largest = Callable[[np.ndarray], tuple[float, float, int]]
"""Largest amplitude [m] of any blade without contact, its frequency [rad/s] and the number of the
blade, of the relative deviations of all sectors' stiffness."""


def _largest_response(wheel: Wheel, near: float) -> Largest:
    """Return the largest response of a wheel, in the family of modes that its engine order excites
    next to a frequency."""
    few, count = WheelStructure(wheel, count_basis_families(wheel.families)), wheel.sector.count
    (mass, tuned), damping = few.basis.tuned_matrices, wheel.damping
    force = few.force[1] - 1j * few.force[2]
    if not np.any(force):
        raise InputError("load", "steady", "one that changes in time: nothing vibrates")
    if not isinstance(damping, DampingRule):
        raise InputError("damping", None, "modal or Rayleigh damping, which bounds a peak")
    families = np.array(wheel.cyclic_modes().omega)
    excited = families[excited_diameter(wheel.order, count)]
    slower = families < excited[np.argmin(np.abs(excited - near))] * (1.0 - 1e-9)
    below = round(count * float(wheel.sector.shares @ slower.sum(axis=1)))
    # Of the excited family all N modes are looked at, and as many around it.
    around = slice(max(below - count, 0), max(below - count, 0) + 2 * count)
    rows = few.values_at(np.eye(few.n_dofs), wheel.dofs_of_blades(wheel.watched_dof)).T
    steps = np.arange(-WIDTHS, WIDTHS + 0.5 / PER_WIDTH, 1.0 / PER_WIDTH)

    def largest(deviations: np.ndarray) -> tuple[float, float, int]:
        stiffness = tuned + np.tensordot(deviations, few.basis.sector_stiffnesses, 1)
        squares, shapes = scipy.linalg.eigh(stiffness, mass)
        natural, rate = np.sqrt(squares), damping.rate(squares)
        pull, seen = shapes.T @ force, rows @ shapes
        omega = np.sort((natural[around, None] + rate[around, None] * steps).ravel())

        def amplitudes(at: np.ndarray) -> np.ndarray:
            change = squares - at[:, None] ** 2 + 1j * rate * at[:, None]
            return np.abs((pull / change) @ seen.T)

        sizes = amplitudes(omega)
        place, blade = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        step = np.interp(omega[place], natural[around], rate[around]) / PER_WIDTH
        finer = omega[place] + step * np.linspace(-1.0, 1.0, 41)
        best = amplitudes(finer)[:, blade]
        top = int(np.argmax(best))
        return float(best[top]), float(finer[top]), int(blade) + 1

    return largest
