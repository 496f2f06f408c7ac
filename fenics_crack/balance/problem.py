"""A problem of harmonic balance, all that a solution depends on but its start; and the motion that
solves it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fenics_crack.balance.compliance import Compliance, dynamic_compliance, load_coefficients
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    CoupledIntegrals,
    ExactIntegrals,
    contact_integrals,
)
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem, default_weight
from fenics_crack.errors import (
    MAX_SAMPLES,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.kernel import kernel
from fenics_crack.machine import machine_memory
from fenics_crack.model.contact import ContactLaw, check_law, is_regular, is_rigid
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import NEARLY_SOLVED
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_at, solve_near
from fenics_crack.numerics.path import NARROW, Path, Target

__all__ = ["Problem", "Wave", "check_memory"]

BEYOND = 2.0
"""Modes above so many times the highest harmonic answer at once."""
ON_PATH = 15_000
"""Unknowns of all points together of a path to more harmonics: 0.1 s where these are few."""
MOST_FORMED = 1000
"""Unknowns up to which J is formed for such a motion: with 1,500 each point of a path takes
seconds, and ten lead nowhere."""
SINGULAR = (
    "'penalty', with a stiffness, as some lips hardly give beside others: they lie on a strip too "
    "thin for no penetration at all, or no modes are left out; or cracks farther apart"
)
"""What is allowed where R_inf, which answers a rigid contact at once, is singular to rounding."""
STIFF = 100.0
"""k R_inf from which a penalty on lips with mass is seen through R_inf."""
MATRICES = 4
"""Dense matrices of the size of the Jacobian that are held at a time, or stiffnesses of coupled
pairs at all instants."""


@dataclass(frozen=True, repr=False)
class Wave:
    """u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t), w = omega / subharmonic.

    Its attributes are those of :class:`fenics_crack.PeriodicSolution`.
    """

    structure: Structure
    omega: float
    contact: ContactLaw | None
    displacement_coefficients: np.ndarray
    gap_coefficients: np.ndarray
    force_coefficients: np.ndarray
    subharmonic: int = 1
    static_above: float | None = None

    @property
    def harmonics(self) -> int:
        """H, the highest harmonic kept."""
        return (len(self.gap_coefficients) - 1) // 2

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def period(self) -> float:
        """Period of the response [s]."""
        return float(2.0 * np.pi / self.base_omega)

    @cached_property
    def residual(self) -> np.ndarray | None:
        """R_inf, the compliance of what answers contact forces at once: (n_pairs, n_pairs) [m/N];
        None where nothing does."""
        if self.static_above is None:
            return None
        return all_modes(self.structure).static_part(self.static_above)

    @cached_property
    def _forces(self) -> CoupledIntegrals:
        """lambda(s) where something answers at once."""
        assert self.contact is not None
        return CoupledIntegrals(self.contact, self.harmonics, residual=self.residual)

    @property
    def slow_gap_coefficients(self) -> np.ndarray:
        """Of s = g + R_inf lambda, the gap without what answers at once: (2H+1, n_pairs) [m]."""
        if self.residual is None:
            return self.gap_coefficients
        return self.gap_coefficients + self.force_coefficients @ self.residual

    def gap(self, time: np.ndarray) -> np.ndarray:
        """g at times [s]: (len(time), n_pairs) [m]. Where some of it answers contact forces at
        once, s(t) - R_inf lambda(s(t)), with its kinks."""
        slow = evaluate(self.slow_gap_coefficients, self.base_omega, time)
        if self.residual is None:
            return slow
        return slow - self.contact_force(time) @ self.residual

    def contact_force(self, time: np.ndarray) -> np.ndarray:
        """Contact force at times [s]: (len(time), n_pairs) [N], lambda(g(t)) or lambda(s(t)); of a
        constraint of pairs that nothing couples, eps max(0, g + lambda / eps) of the waves."""
        gap = evaluate(self.slow_gap_coefficients, self.base_omega, time)
        if self.contact is None:
            return np.zeros_like(gap)
        if self.residual is not None:
            return self._forces.forces(gap)
        if not is_rigid(self.contact):
            return self.contact.force(gap)
        assert self.contact.weight is not None
        force = evaluate(self.force_coefficients, self.base_omega, time)
        return np.asarray(np.maximum(0.0, self.contact.weight * gap + force))

    def coordinates(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the structure's own dofs on this rank: (len(time), n_local) [m]."""
        found = evaluate(self.displacement_coefficients, self.base_omega, time)
        if self.static_above is not None:
            # What answers at once follows the forces as they are, with their kinks.
            waves = evaluate(self.force_coefficients, self.base_omega, time)
            moved = all_modes(self.structure).moved_at_once(self.static_above)
            found -= (self.contact_force(time) - waves) @ moved.T
        return found


@dataclass(frozen=True)
class Problem:
    """A structure under its load, the law of its pairs, and how its motion is balanced.

    Attributes
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs; :class:`UnilateralConstraint` too.
    harmonics : int
        H, the highest multiple of ``omega / subharmonic`` kept.
    samples : int, optional
        Instants per period of the response at which the contact force is evaluated. Default: none,
        but exact integrals, where the law is piecewise linear; else 1024 for each period of the
        load, or 32 H where that is more.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float, optional
        Modes of higher frequencies [rad/s] answer the harmonics of the contact force above H at
        once, as all that a massless reduction leaves out does. Default: 2 H times the base
        frequency, where all pairs are seen through a static compliance then; else none.

    Raises
    ------
    InputError
        A value cannot be used.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    harmonics: int = 5
    samples: int | None = None
    subharmonic: int = 1
    static_above: float | None = None

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_count("subharmonic", self.subharmonic, 1)
        check_count("harmonics", self.harmonics, self.subharmonic)
        check_law(self.structure, self.contact, rigid=True)
        if self.structure.n_pairs == 0:
            raise InputError(
                "structure", "0 pairs", "one with contact pairs; else use solve_linear"
            )
        if self.samples is not None:
            if is_rigid(self.contact):
                raise InputError("samples", self.samples, "left out with UnilateralConstraint")
            check_count("samples", self.samples, 2 * self.harmonics + 1)
            if self.samples > MAX_SAMPLES:
                raise InputError("samples", self.samples, f"at most {MAX_SAMPLES}")
        if self.static_above is not None:
            check_number("static_above", min(self.static_above, 1e300), 0.0)  # inf: none

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def load(self) -> np.ndarray:
        """c: coefficients of the load, (2H+1, n_local) [N]."""
        return load_coefficients(self.structure, self.harmonics, self.subharmonic)

    @property
    def cutoff(self) -> float:
        """Frequency above which modes answer at once, where there is a :attr:`residual` [rad/s]."""
        default = BEYOND * self.harmonics * self.base_omega
        return default if self.static_above is None else self.static_above

    @property
    def static_cutoff(self) -> float | None:
        """The same, None where pairs are not seen through a static compliance: what solutions keep
        of it."""
        return None if self.residual is None else self.cutoff

    @cached_property
    def residual(self) -> np.ndarray | None:
        """R_inf, the static compliance through which contact is seen; None where there is none.

        Lips with mass are seen through one if the law is rigid, or so stiff against it that they
        bounce at frequencies which H harmonics do not resolve."""
        structure, contact = self.structure, self.contact
        light, rigid = structure.light_lips, is_rigid(contact)
        projected = is_rigid(contact) and contact.weight is not None and not light
        if projected or not is_small(structure):
            return None
        found = all_modes(structure).static_part(self.cutoff)
        if not light and not rigid:
            asked = self.static_above is not None and np.any(found)
            if not asked and not float(np.max(contact.stiffness * np.diag(found))) > STIFF:
                return None
        if rigid and not is_regular(found):
            if light:
                raise InputError("contact law", "unilateral", SINGULAR)
            return None
        return found

    def seen_alike(self, cutoff: float) -> Problem:
        """The same for a family of problems: whether pairs are seen through a static compliance,
        and that of which modes, is settled for all of them by a frequency [rad/s]."""
        highest = cutoff / (BEYOND * self.harmonics)
        known = replace(self, static_above=None, omega=highest * self.subharmonic).residual
        return replace(self, static_above=np.inf if known is None else cutoff)

    @property
    def projected(self) -> bool:
        """Whether the constraint is balanced in frequency: that of pairs that nothing couples."""
        return is_rigid(self.contact) and self.residual is None

    def weighted(self, compliance: Compliance) -> Problem:
        """The same with the weight of a projection."""
        contact = self.contact
        if not (is_rigid(contact) and self.projected and contact.weight is None):
            return self
        return replace(self, contact=replace(contact, weight=default_weight(compliance)))

    def system(self, compliance: Compliance) -> ContactSystem:
        """The equations."""
        return ContactSystem(compliance, self.weighted(compliance).integrals())

    def wave(self, at: ContactPoint) -> Wave:
        """The motion that belongs to a point of the equations (collective)."""
        displacement = at.system.compliance.displacement(at.force)
        return Wave(
            self.structure, self.omega, self.contact, displacement, at.gap, at.force,
            self.subharmonic, self.static_cutoff,
        )  # fmt: skip

    def next_to(self, wave: Wave) -> Wave | None:
        """The motion that Newton's method leads to from a wave, in the kernel, or else a path from
        it; None where these lead to none, or the kernel has no such equations."""
        try:
            system = self.system(self.compliance())
            if not system.integrals.exact:
                return None
            start = system.slow(
                wave.gap_coefficients, wave.force_coefficients, self.subharmonic // wave.subharmonic
            )
            found = _nearly_solved(system, start) or _end_of_path(system, start)
            return None if found is None else self.wave(system.linearise(found.unknown))
        except (ConvergenceError, np.linalg.LinAlgError):
            return None

    def left(self, wave: Wave, gap: np.ndarray, force: np.ndarray) -> float:
        """What Newton's method from a motion of some coefficients leaves of the way to a wave;
        infinite where it does not arrive."""
        try:
            system = self.system(self.compliance())
            start = system.slow(gap, force)
            found = _nearly_solved(system, start)
        except (ConvergenceError, np.linalg.LinAlgError):
            return np.inf
        end = system.slow(wave.gap_coefficients, wave.force_coefficients)
        if found is None:
            return np.inf
        return float(np.linalg.norm(found.unknown - end) / np.linalg.norm(start - end))

    def integrals(self) -> ContactIntegrals:
        """How the contact force is integrated; that of a projection by its weight."""
        contact, harmonics = self.contact, self.harmonics
        if self.residual is not None:
            return CoupledIntegrals(
                contact, harmonics, residual=self.residual, samples=self.samples
            )
        if is_rigid(contact):
            assert contact.weight is not None
            each = np.eye(self.structure.n_pairs) / contact.weight
            return ExactIntegrals(contact, harmonics, residual=each)
        return contact_integrals(contact, harmonics, self.samples, self.subharmonic)

    def compliance(self) -> Compliance:
        """Compliance at the multiples of the base frequency, to be destroyed (collective)."""
        return dynamic_compliance(self.structure, self.base_omega, self.harmonics, self.subharmonic)

    def with_harmonics(self, harmonics: int) -> Problem:
        """The same with other harmonics."""
        return self if harmonics == self.harmonics else replace(self, harmonics=harmonics)


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the equations would not fit, or of coupled pairs
    what they are at all instants, and the vectors of solutions."""
    pairs = structure.n_pairs
    unknowns, order = (2 * harmonics + 1) * pairs, 2
    numbers = MATRICES * unknowns**2
    if structure.light_lips:  # of an estimate too, with twice the harmonics
        vectors = 2 * kernel.KRYLOV_MOST + 2  # those kept, and those of a solution
        numbers, order = 2 * (2 * MATRICES * pairs + vectors) * unknowns, 1
    memory = machine_memory()
    if 8 * numbers > 0.8 * memory:
        fits = int(harmonics * (0.1 * memory / numbers) ** (1.0 / order))
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {unknowns} unknowns need "
            f"{numbers * 8 / 2**30:.0f} GiB of this machine's {memory / 2**30:.0f}",
        )


def _nearly_solved(system: ContactSystem, start: np.ndarray) -> PathPoint | None:
    """By Newton's method; where J is not formed by full steps alone, as those that lead nowhere
    take long. None where J would be formed of too many unknowns."""
    if system.global_size > MOST_FORMED and not system.matrix_free:
        return None
    steps = solve_at if system.matrix_free else solve_near
    return steps(system, start, 1.0, tolerance=NEARLY_SOLVED)


def _end_of_path(system: ContactSystem, start: np.ndarray) -> PathPoint | None:
    """Where the path F(s) = (1 - p) F(s_0) from a start has its end; None where it has none, or
    that takes long."""
    if system.global_size > MOST_FORMED:
        return None
    most = ON_PATH // system.global_size
    missed = system.linearise(start).residual
    along = system.compile(system.linear + missed, system.moving, linear_rate=-missed)
    options = replace(NARROW, max_steps=most, at_once=most, rtol=NEARLY_SOLVED)
    return Path(along, point_on_path(along, start, 0.0), options, [Target(1.0)]).run()
