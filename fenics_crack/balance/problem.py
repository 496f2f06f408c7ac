"""Problems of harmonic balance, and the search for their solutions.

A problem holds all that a solution depends on. A search tries the starts below in this order, until
Newton's method converges or the budget of iterations is spent. A start yields guesses. Newton's
method takes full steps from a guess. If these fail, shortened steps lead to a second guess:

near       a given solution
fewer      the linear solution. With many unknowns, or with a static compliance in series
           (:mod:`contact_system`), the solution with half the harmonics, found from a quarter, and
           so on. If full steps fail for a smaller number, a path leads to the solution. Above 40
           harmonics of the load, the first guess is the exact orbit next to a solution with fewer
without    with friction: the solution without friction
orbit      the exact orbit next to the solution with fewer harmonics, or without friction. With more
           than 120 modes this start comes after the path, which costs less
path       the end of a continuation from very soft contact to the law. The compliance in series
           with every pair falls along the path. At the beginning the solution is unique and close
           to the linear one; arc-length leads through folds. With friction, the path leads from a
           zero coefficient to the full one instead

The path does not return to soft contact, but several stiff pairs with little damping have thousands
of folds. All starts share one budget of iterations. With machine epsilon eps, a gap g has the
rounding error eps |g|, and the contact force eps k |g|. This force moves the gap by eps k R |g|:
no residual can be smaller.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.compliance import (
    ComplianceModel,
    load_coefficients,
    make_compliance_model,
    relative_residual_rounding,
    resized_compliance_model,
)
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    ExactIntegrals,
    integrals_with_uncoupled_pairs,
    multiply_compliance_and_force,
)
from fenics_crack.balance.contact_system import (
    ContactPoint,
    ContactSystem,
    PeriodicMotion,
    default_projection_weight,
)
from fenics_crack.balance.friction_integrals import FrictionIntegrals, integrals_with_coupled_pairs
from fenics_crack.basics.errors import (
    MAX_CONTACT_SAMPLES_PER_PERIOD,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.machine import machine_memory
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.kernel import kernel
from fenics_crack.model.contact import (
    ContactLaw,
    add_pair_for_each_contact_force,
    check_law,
    friction_of,
    is_regular,
    is_rigid,
    law_of_rows,
    merge_layers_of_pairs,
    normal_law,
    split_pairs_into_layers,
    spring_compliances,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow_or_none
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    PeriodicOrbit,
    is_orbit_search_affordable,
)
from fenics_crack.motion.search import (
    SearchOptions,
    StartStrategy,
    search_orbit,
    series_states_at_period_parts,
)
from fenics_crack.numerics.equations import COARSE_TOLERANCE, ROUNDING, Linearisation
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.numerics.newton import (
    MAX_ITERATIONS_AT_FIXED_PARAMETER,
    MAX_STALLED_STEPS,
    SystemSnes,
    can_solve_in_kernel,
    point_on_path,
    solve_at_parameter,
    solve_by_full_or_damped_steps,
)
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, EndReason, Path, PathOptions, Target

CUTOFF_TO_HIGHEST_HARMONIC = 2.0
"""Frequency above which modes are quasi-static, relative to the highest harmonic."""
MAX_UNKNOWNS_TIMES_POINTS_PER_CALL = 15_000
"""Maximum number of unknowns times points in a kernel call along a curve.

Ctrl-C waits until the call ends, a second or two.
"""
REMEDY_IF_RIGID_CONTACT_IS_SINGULAR = (
    "'penalty' with a stiffness, as rigid contact is singular here: all modes are kept (keep "
    "fewer), or a strip beside a crack is too thin (place cracks farther apart)"
)
"""Remedies, for an error message, if the residual flexibility is singular to rounding.

The contact is rigid, and static contact forces cannot move some pair independently.
"""
REMEDY_IF_FRICTION_LACKS_COMPLIANCE = (
    "a penalty law with a tangential stiffness, as sticking pairs need some compliance; or "
    "reduce the structure by reduce_structure(structure, method='massless')"
)
"""Remedies, for an error message, if pairs with friction have no compliance in series."""
N_JACOBIANS_IN_MEMORY = 4
"""Number of Jacobian-sized dense matrices in memory at once.

For coupled pairs, number of stiffness matrices per instant.
"""
MAX_SEARCH_ITERATIONS = 7500
"""Maximum number of Newton iterations in a search, over all guesses.

Steps along a path that were too long count, too. With 300 unknowns in the kernel the search takes 5
to 8 s.
"""
MIN_UNKNOWNS_WITH_GROWING_COST = 200
"""Number of unknowns below which an iteration takes constant time.

Most of this time is for the contact integrals.
"""
MAX_FRICTION_SEARCH_WORK = 8e6
"""Search budget with friction: iterations times instants times unknowns.

More than 350 unknowns count as 350. The search takes 1 to 3 s.
"""


@keep_old_attribute_names(
    structure_with_row_pairs="structure_with_pair_per_row",
    with_weight="with_projection_weight",
    compliance="compliance_model",
    cutoff="quasi_static_above",
)
@dataclass(frozen=True)
class Problem:
    """Structure under its load, with the contact law and the harmonics to solve for.

    Attributes
    ----------
    structure : Structure
        Structure that vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law for all pairs; :class:`UnilateralConstraint` too.
    harmonics : int
        H, the highest multiple of ``omega / subharmonic`` kept; default: 5.
    samples : int, optional
        Instants per period of the response at which the contact force is evaluated. Default for a
        piecewise linear law: exact integrals, without instants. Default with friction: 32 H, at
        least 128. Default for other laws: 1024, or the next power of two from 32 H on; for
        uncoupled pairs, as many in each load period.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float, optional
        Frequency [rad/s] above which modes respond quasi-statically to the contact force's
        harmonics above H. Only used if the problem has a :attr:`residual_compliance`. Default: 2 H
        times the response's frequency.

    Raises
    ------
    InputError
        A value cannot be used.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    harmonics: int = SearchOptions.guess_harmonic_counts[0]
    samples: int | None = None
    subharmonic: int = 1
    static_above: float | None = None

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_count("subharmonic", self.subharmonic, 1)
        check_count("harmonics", self.harmonics, self.least_harmonics)
        check_law(self.structure, self.contact, allows_rigid=True)
        if self.structure.n_pairs == 0:
            requirement = "a structure with contact pairs; without pairs, use solve_linear"
            raise InputError("structure", "0 pairs", requirement)
        if self.samples is not None:
            if is_rigid(self.contact):
                raise InputError("samples", self.samples, "left out with UnilateralConstraint")
            check_count("samples", self.samples, 2 * self.harmonics + 1)
            if self.samples > MAX_CONTACT_SAMPLES_PER_PERIOD:
                raise InputError(
                    "samples", self.samples, f"at most {MAX_CONTACT_SAMPLES_PER_PERIOD}"
                )
        if self.static_above is not None:
            check_number("static_above", min(self.static_above, 1e300), 0.0)  # inf: none

    @property
    def least_harmonics(self) -> int:
        """Load's highest harmonic, as a multiple of the response's frequency."""
        return least_harmonics(self.structure, self.subharmonic)

    def response_harmonics(self, load_harmonics: int) -> int:
        """Return the number of response harmonics up to a load harmonic.

        The load has ``subharmonic`` times the response's frequency. So the result is
        ``subharmonic`` times ``load_harmonics``, but at least the load's highest harmonic.
        """
        return max(load_harmonics * self.subharmonic, self.least_harmonics)

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def load(self) -> np.ndarray:
        """Fourier coefficients of the load in the response's period: (2H+1, n_local) [N]."""
        return load_coefficients(self.structure, self.harmonics, self.subharmonic)

    @property
    def quasi_static_above(self) -> float:
        """Frequency above which modes are quasi-static [rad/s].

        The value is ``static_above``, or 2 H times the response's frequency. Without a
        :attr:`residual_compliance` no mode is quasi-static.
        """
        default_cutoff = CUTOFF_TO_HIGHEST_HARMONIC * self.harmonics * self.base_omega
        return default_cutoff if self.static_above is None else self.static_above

    @property
    def static_cutoff(self) -> float | None:
        """Frequency above which modes are quasi-static [rad/s], or None.

        Used as ``static_above`` of a solution. None: without a residual flexibility, no mode is
        quasi-static.
        """
        return None if self.residual_compliance is None else self.quasi_static_above

    @cached_property
    def structure_with_pair_per_row(self) -> Structure:
        """Structure with a contact pair for each scalar contact force.

        With friction, each tangential gap is an additional pair. Under the layered law every pair
        comes twice, in both directions. Under other laws the result is the structure itself.
        """
        return add_pair_for_each_contact_force(self.contact, self.structure)

    @cached_property
    def row_law(self) -> ContactLaw:
        """Law for the pairs of :attr:`structure_with_pair_per_row`.

        Under the layered law every pair comes twice. The result is then a penalty law with a
        stiffness for each copy. Otherwise the problem's own law.
        """
        return law_of_rows(self.contact, self.structure.n_pairs)

    @property
    def has_friction(self) -> bool:
        """True if the law has friction: tangential forces are then balanced, too."""
        return friction_of(self.contact) is not None

    @cached_property
    def residual_compliance(self) -> np.ndarray | None:
        """Residual flexibility in series with contact: (n_rows, n_rows) [m/N], or None.

        The flexibility R is the quasi-static response of gaps to contact forces. Only small
        structures have R, and only in these cases:

        - The law has friction.
        - The crack faces have no mass.
        - The faces have mass, the law is rigid without ``weight``, and R is regular.
        - The faces have mass under a penalty law, ``static_above`` is given, and R is not zero.
        - The faces have mass under a penalty law of stiffness k, and k R > 100 for a diagonal entry
          of R.

        InputError: R is singular under a rigid law of crack faces without mass.
        """
        structure, contact_law = self.structure, self.contact
        if self.has_friction:
            return self._residual_compliance_with_friction
        has_massless_faces, has_rigid_law = (
            structure.has_massless_crack_faces,
            is_rigid(contact_law),
        )
        may_project_constraint = (
            is_rigid(contact_law) and contact_law.weight is not None and not has_massless_faces
        )
        if may_project_constraint or not is_small(structure):
            return None
        residual_compliance = all_modes(self.structure_with_pair_per_row).static_pair_compliance(
            self.quasi_static_above
        )
        if not has_massless_faces and not has_rigid_law:
            is_static_part_requested = self.static_above is not None and np.any(residual_compliance)
            # A penalty k is stiff from k R_inf = 100 on.
            if (
                not is_static_part_requested
                and not float(np.max(self.row_law.stiffness * np.diag(residual_compliance))) > 100.0
            ):
                return None
        if has_rigid_law and not is_regular(residual_compliance):
            if has_massless_faces:
                raise InputError("contact law", "unilateral", REMEDY_IF_RIGID_CONTACT_IS_SINGULAR)
            return None
        return residual_compliance

    @property
    def _residual_compliance_with_friction(self) -> np.ndarray | None:
        """Residual flexibility of normal, then tangential gaps: (2 n_pairs, 2 n_pairs) [m/N].

        None for large structures. Raises InputError if gaps have no compliance in series.
        """
        has_few_dofs = is_small(self.structure)
        pair_spring_compliances = spring_compliances(self.contact, self.structure.n_pairs)
        residual_compliance = (
            all_modes(self.structure_with_pair_per_row).static_pair_compliance(
                self.quasi_static_above
            )
            if has_few_dofs
            else None
        )
        series_compliance = (
            np.diag(pair_spring_compliances)
            if residual_compliance is None
            else residual_compliance + np.diag(pair_spring_compliances)
        )
        if not np.all(pair_spring_compliances) and not is_regular(series_compliance):
            raise InputError("contact", self.contact, REMEDY_IF_FRICTION_LACKS_COMPLIANCE)
        return residual_compliance

    def with_common_cutoff(self, cutoff: float) -> Problem:
        """Return the problem for a curve on which all points have the same quasi-static modes.

        Modes above ``cutoff`` [rad/s] are quasi-static at all points. The problem at this cutoff
        also decides for all points whether pairs have a residual flexibility.
        """
        base_omega_with_this_cutoff = cutoff / (CUTOFF_TO_HIGHEST_HARMONIC * self.harmonics)
        residual_compliance = replace(
            self, static_above=None, omega=base_omega_with_this_cutoff * self.subharmonic
        ).residual_compliance
        return replace(self, static_above=np.inf if residual_compliance is None else cutoff)

    @property
    def has_projected_constraint(self) -> bool:
        """True if a rigid law is solved pair by pair: without residual flexibility and friction.

        The contact force is then eps max(0, g + lambda / eps), with truncated series of gap g and
        force lambda, and a weight eps (``default_projection_weight``).
        """
        return is_rigid(self.contact) and self.residual_compliance is None and not self.has_friction

    def with_projection_weight(self, compliance_model: ComplianceModel) -> Problem:
        """Return the problem with a default weight if its rigid law is solved pair by pair.

        The weight [N/m] stands for a contact stiffness. It follows from the static compliance in
        ``compliance_model`` (``default_projection_weight``). Other problems, and problems with
        a given weight, are returned unchanged.
        """
        contact_law = self.contact
        if not (
            is_rigid(contact_law) and self.has_projected_constraint and contact_law.weight is None
        ):
            return self
        return replace(
            self, contact=replace(contact_law, weight=default_projection_weight(compliance_model))
        )

    def system(self, compliance_model: ComplianceModel) -> ContactSystem:
        """Return the harmonic-balance equations with gaps as unknowns.

        ``compliance_model`` is the problem's dynamic compliance of the gaps.
        """
        return ContactSystem(
            compliance_model, self.with_projection_weight(compliance_model).integrals()
        )

    def wave(self, point: ContactPoint) -> PeriodicMotion:
        """Return the motion at a solution of the equations (collective)."""
        displacement = point.system.compliance_model.displacement(point.force)
        return self.wave_of(displacement, point.gap, point.force)

    def wave_of(
        self, displacement: np.ndarray, gap: np.ndarray, force: np.ndarray
    ) -> PeriodicMotion:
        """Return the motion with given Fourier coefficients.

        Parameters
        ----------
        displacement : (2H+1, n_local) [m]
            Displacement coefficients for this rank's dofs.
        gap, force : (2H+1, n_columns) [m], [N]
            Gap and contact force coefficients, a column for each pair. With friction, tangential
            columns follow the normal ones. Under the layered law, with two springs for each pair,
            a column for each spring is also possible: first springs, then second springs.
        """
        n_pairs = self.structure.n_pairs
        gap, force = merge_layers_of_pairs(self.contact, n_pairs, gap, force)
        tangential_gap_force_coefficients = (
            (gap[:, n_pairs:], force[:, n_pairs:]) if self.has_friction else (None, None)
        )
        return PeriodicMotion(
            self.structure, self.omega, self.contact, displacement, gap[:, :n_pairs],
            force[:, :n_pairs], self.subharmonic, self.static_cutoff,
            *tangential_gap_force_coefficients,
        )  # fmt: skip

    def integrals(self) -> ContactIntegrals:
        """Return the object that computes contact forces and derivatives from gaps.

        If a rigid law is solved pair by pair, the law's weight is the contact stiffness.
        """
        contact_law, harmonics = self.row_law, self.harmonics
        if self.residual_compliance is not None:
            return integrals_with_coupled_pairs(
                contact_law, harmonics, self.residual_compliance, self.samples
            )
        if self.has_friction:
            all_zero_residual_compliance = np.zeros((self.structure_with_pair_per_row.n_pairs,) * 2)
            return integrals_with_coupled_pairs(
                contact_law, harmonics, all_zero_residual_compliance, self.samples
            )
        if is_rigid(contact_law):
            assert contact_law.weight is not None
            inverse_projection_weight = np.eye(self.structure.n_pairs) / contact_law.weight
            return ExactIntegrals(
                contact_law, harmonics, residual_compliance=inverse_projection_weight
            )
        return integrals_with_uncoupled_pairs(
            contact_law, harmonics, self.samples, self.subharmonic
        )

    def compliance_model(self) -> ComplianceModel:
        """Return the gaps' dynamic compliance at harmonics 0 to H (collective).

        The caller frees it with ``destroy``.
        """
        return make_compliance_model(
            self.structure_with_pair_per_row, self.base_omega, self.harmonics, self.subharmonic
        )

    def with_harmonics(self, harmonics: int) -> Problem:
        """Return the problem with another number of harmonics."""
        return self if harmonics == self.harmonics else replace(self, harmonics=harmonics)


def least_harmonics(structure: Structure, subharmonic: int) -> int:
    """Return the load's highest harmonic, in multiples of the response's frequency."""
    return subharmonic * (len(structure.force) // 2)


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError if the equations with H = ``harmonics`` do not fit into memory.

    The equations may take 80 % of the machine's memory. Uncoupled pairs need dense Jacobians. Crack
    faces without mass need the pairs' stiffness matrix at all instants, and vectors for GMRES.
    """
    n_pairs = structure.n_pairs
    n_unknowns, memory_exponent = (2 * harmonics + 1) * n_pairs, 2
    n_numbers = N_JACOBIANS_IN_MEMORY * n_unknowns**2
    if structure.has_massless_crack_faces:  # an error estimate has twice the harmonics
        n_krylov_vectors = (
            2 * kernel.MAX_KRYLOV_VECTORS + 2
        )  # vectors kept, and those for a solution
        n_numbers = 2 * (2 * N_JACOBIANS_IN_MEMORY * n_pairs + n_krylov_vectors) * n_unknowns
        memory_exponent = 1
    machine_bytes = machine_memory()
    if 8 * n_numbers > 0.8 * machine_bytes:
        max_allowed_harmonics = int(
            harmonics * (0.1 * machine_bytes / n_numbers) ** (1.0 / memory_exponent)
        )
        needed_gib_text, machine_gib_text = (
            f"{n_bytes / 2**30:.0f}" for n_bytes in (8 * n_numbers, machine_bytes)
        )
        needed_and_machine_memory_text = (
            f"{n_unknowns} unknowns need {needed_gib_text} GiB of memory, "
            f"and this machine has {machine_gib_text} GiB"
        )
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {max_allowed_harmonics} with {n_pairs} pairs: "
            f"{needed_and_machine_memory_text}",
        )


# --- the search -----------------------------------------------------------------------------------


@dataclass
class Search:
    """Search for a solution of harmonic-balance equations, with a record of its attempts.

    Newton's method starts from several guesses in turn, until it converges or the iterations are
    spent.
    """

    system: ContactSystem
    problem: Problem
    """Problem whose equations ``system`` has."""
    tolerance: float
    """Maximum relative residual |F(x)| / |x| of a solution x; raised to the rounding error."""
    budget_fraction: float
    """Fraction of the search's iterations that may be used, 0 to 1."""
    remedy: str = (
        "other harmonics, a softer contact, more damping, or a neighbouring solution as initial"
    )
    """Changes that may lead to a solution, for the message after a failure."""
    has_converged: bool = False
    """True if the last attempt met the tolerance."""
    iterations: int = 0
    """Newton iterations, all attempts together."""
    orbit: PeriodicOrbit | None = None
    """Exact orbit whose coefficients were the last guess; None for another guess."""
    snes_residual_norms: list[float] = field(default_factory=list)
    """Residual norm |F| in every iteration of PETSc's SNES.

    If the equations are in the kernel, SNES makes only a last attempt after all others have failed.
    """
    attempt_texts: list[str] = field(default_factory=list)
    """Name, outcome and number of iterations of each attempt, in words."""
    _residual_rounding: float = ROUNDING
    """Rounding error of the relative residual |F(x)| / |x|."""
    _max_iterations: float = 0.0
    """Maximum iterations of all attempts; cheap attempts, which do not count, raise it."""
    _simpler_point: ContactPoint | None = None
    """Last solution with fewer harmonics, or the point under the forces without friction."""

    @property
    def status(self) -> str:
        """Return all attempts in words, with a remedy if none succeeded."""
        attempts_text = "; then ".join(self.attempt_texts)
        if self.has_converged:
            return attempts_text
        return f"{attempts_text}; no solution in {self.iterations} iterations: try {self.remedy}"

    def solve(self, *neighbour_slow_gaps: np.ndarray) -> Linearisation:
        """Search, and return the equations linearised at the solution or the last point reached.

        Parameters
        ----------
        *neighbour_slow_gaps : (2H+1, n_rows) [m]
            Slow gaps of neighbouring solutions, tried first: gap plus residual flexibility times
            contact force. n_rows is the number of pairs, with friction twice as many.

        Raises
        ------
        InputError
            The contact is so stiff that rounding hides the contact force.
        """
        system = self.system
        if system.residual_compliance is None:
            self._residual_rounding = relative_residual_rounding(
                system.compliance_model, system.integrals.law
            )
            if self._residual_rounding > ROUNDING:
                self.tolerance = max(self.tolerance, self._residual_rounding)
        self._max_iterations = self.budget_fraction * _allowed_search_iterations(system)
        point: Linearisation | None = None
        with ExitStack() as exit_stack:
            snes = None
            if not can_solve_in_kernel(system):
                snes = exit_stack.enter_context(SystemSnes(system, self.snes_residual_norms))
            for start_strategy in self._yield_start_strategies(neighbour_slow_gaps):
                begin_stage(start_strategy.name)
                iterations_before = self.iterations
                for slow_gap_guess in start_strategy.generate_candidates():
                    point = self._point_after_newton_steps_or_at_guess(snes, slow_gap_guess)
                    if self.has_converged or self._is_budget_spent:
                        break
                self.append_attempt_text(start_strategy.name, iterations_before)
                if self.has_converged:
                    break
        point = point or system.linearise(np.zeros(system.shape), 1.0)
        if (
            not self.has_converged and snes is None and self.budget_fraction == 1.0
        ):  # for the history
            iterations_before = self.iterations
            with SystemSnes(system, self.snes_residual_norms) as snes:
                point = self._point_after_newton_steps_or_at_guess(snes, point.unknown)
            if self.has_converged:
                self.append_attempt_text("full steps of SNES", iterations_before)
            else:
                self.iterations = iterations_before
        return point

    def append_attempt_text(self, start_name: str, iterations_before: int) -> None:
        """Record in words whether an attempt converged, and in how many iterations.

        ``start_name`` is the attempt's name in the text. ``iterations_before`` is the search's
        number of iterations when the attempt began.
        """
        outcome_text = "converged" if self.has_converged else "failed"
        self.attempt_texts.append(
            f"{start_name}: {outcome_text} ({self.iterations - iterations_before} iterations)"
        )

    def _point_after_newton_steps_or_at_guess(
        self, snes: SystemSnes | None, guess: np.ndarray
    ) -> Linearisation:
        """Take full Newton steps from a guess; return the equations at the last point.

        The attribute ``has_converged`` is set.

        Parameters
        ----------
        snes : SystemSnes or None
            Solver by PETSc for the steps. None: the C kernel takes them.
        guess : (2H+1, n_rows) [m]
            Slow gap coefficients at which the steps begin.

        Returns
        -------
        Linearisation
            Equations at the last point. If the kernel's steps fail, equations at the guess.
        """
        if snes is not None:
            point, self.has_converged, n_iterations = snes.solve_and_linearise(
                guess, 1.0, self.tolerance, self._max_iterations_per_guess
            )
            self.iterations += n_iterations
            return point
        solution_from_kernel_or_none = self._point_after_full_steps_or_none(self.system, guess)
        self.has_converged = solution_from_kernel_or_none is not None
        return (
            self.system.linearise(guess, 1.0)
            if solution_from_kernel_or_none is None
            else solution_from_kernel_or_none
        )

    def _point_after_full_steps_or_none(
        self,
        system: ContactSystem,
        guess: np.ndarray,
        tolerance: float = 0.0,
        parameter: float = 1.0,
    ) -> Linearisation | None:
        """Take full Newton steps in the C kernel; return the solution or None.

        The equations are F(x) = 0, with slow gap coefficients x.

        Parameters
        ----------
        system : ContactSystem
            Equations, perhaps with fewer harmonics or along a path parameter.
        guess : (2H+1, n_rows) [m]
            Slow gap coefficients at which the steps begin.
        tolerance : float
            Maximum relative residual |F| / |x|. A smaller value than the search's tolerance is
            replaced by the latter.
        parameter : float
            Path parameter of the system: 1 is the law itself, 0 very soft contact.
        """
        max_iterations_per_guess = self._max_iterations_per_guess
        raised_tolerance = max(self.tolerance, tolerance)
        path_point = solve_at_parameter(
            system,
            guess,
            parameter,
            tolerance=raised_tolerance,
            max_iterations=max_iterations_per_guess,
        )
        self.iterations += max_iterations_per_guess if path_point is None else path_point.iterations
        return None if path_point is None else path_point.linearisation

    @property
    def _max_iterations_per_guess(self) -> int:
        """Maximum number of iterations per guess: 20; fewer with many harmonics and friction."""
        return min(
            MAX_ITERATIONS_AT_FIXED_PARAMETER,
            math.ceil(self.budget_fraction * _allowed_search_iterations(self.system)),
        )

    @property
    def _is_budget_spent(self) -> bool:
        """True if the search has taken all iterations that it may use."""
        return self.iterations >= self._max_iterations

    # --- the ladder of starts ---------------------------------------------------------------------

    def _yield_start_strategies(
        self, neighbour_slow_gaps: Sequence[np.ndarray]
    ) -> Iterator[StartStrategy]:
        """Yield the starts that suit the problem, in the order of this module's description.

        ``neighbour_slow_gaps`` (2H+1, n_rows) [m] are slow gap coefficients of neighbouring
        solutions, tried first.
        """
        system, problem = self.system, self.problem
        for neighbour_slow_gap in neighbour_slow_gaps:
            yield StartStrategy(
                "full Newton steps",
                partial(self._yield_guess_and_damped_newton_point, system, neighbour_slow_gap),
            )
        if problem.has_friction:
            yield StartStrategy(
                "from contact without friction", self._yield_guesses_without_friction
            )
        else:
            is_system_large = (
                system.residual_compliance is not None or system.size > kernel.MANY_UNKNOWNS
            )
            coarsest_harmonics = problem.least_harmonics if is_system_large else problem.harmonics
            harmonic_counts = halved_harmonic_counts(problem.harmonics, coarsest_harmonics)
            strategy_name = "from fewer harmonics" if is_system_large else "full Newton steps"
            yield StartStrategy(
                strategy_name, partial(self._yield_guesses_from_fewer_harmonics, harmonic_counts)
            )
        continued_quantity_name = (
            "coefficient of friction" if problem.has_friction else "contact compliance"
        )
        path_guess_function = partial(self._yield_guesses_by_continuation, system)
        later_strategies = (
            []
            if self._is_budget_spent
            else [
                StartStrategy(f"continuation in the {continued_quantity_name}", path_guess_function)
            ]
        )
        if (
            self.budget_fraction == 1.0
            and system.integrals.has_coupled_pairs
            and problem.harmonics <= self._n_harmonics_above_which_orbit_first
        ):
            flow = exact_flow_or_none(problem.structure, problem.contact)
            is_orbit_last = flow is not None and flow.n_modes > MAX_MODES_FOR_MONODROMY
            orbit_strategy = StartStrategy("from an exact orbit", self._yield_guesses_from_orbit)
            later_strategies.insert(len(later_strategies) * is_orbit_last, orbit_strategy)
        yield from later_strategies

    @property
    def _n_harmonics_above_which_orbit_first(self) -> int:
        """Number of harmonics above which an exact orbit is the first guess.

        The number is 40 harmonics of the load frequency.
        """
        return self.problem.response_harmonics(SearchOptions.guess_harmonic_counts[-1])

    def _yield_guess_and_damped_newton_point(
        self, system: ContactSystem, guess: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield a guess, then the end of shortened Newton steps from it.

        The end is left out if the iterations are spent, or the steps fail. Both are slow gap
        coefficients (2H+1, n_rows) [m].
        """
        yield guess
        if self._is_budget_spent:
            return
        shortened_step_point = solve_by_full_or_damped_steps(
            system, guess, 1.0, tolerance=self.tolerance, try_full_steps=False
        )
        self.iterations += (
            MAX_STALLED_STEPS if shortened_step_point is None else shortened_step_point.iterations
        )
        if shortened_step_point is not None:
            yield shortened_step_point.unknown

    def _yield_guesses_from_fewer_harmonics(
        self, harmonic_counts: list[int]
    ) -> Iterator[np.ndarray]:
        """Yield guesses from solutions with fewer harmonics.

        ``harmonic_counts`` are ascending numbers of harmonics; the last is the problem's. Newton's
        method starts from the linear solution with the first number, then from each solution with
        the next number. A number without a solution is skipped. Before the first number above 40
        harmonics of the load frequency, an exact orbit is searched. If found, its gaps are yielded.
        Guesses are slow gap coefficients (2H+1, n_rows) [m] with the problem's harmonics.
        """
        n_harmonics_above_which_orbit_first = self._n_harmonics_above_which_orbit_first
        for n_harmonics in harmonic_counts:
            if (
                n_harmonics_above_which_orbit_first
                < n_harmonics
                <= 2 * n_harmonics_above_which_orbit_first
            ):
                yield from self._yield_guesses_from_orbit()
            system = self.system
            iterations_before = self.iterations
            simpler_point = self._simpler_point
            if n_harmonics != harmonic_counts[-1]:
                coarser_compliance_model = resized_compliance_model(
                    system.compliance_model, n_harmonics
                )
                system = self.problem.with_harmonics(n_harmonics).system(coarser_compliance_model)
            guess = (
                system.linear_gap
                if simpler_point is None
                else system.gap_without_static_part(simpler_point.gap, simpler_point.force)
            )
            if system is self.system:
                yield from self._yield_guess_and_damped_newton_point(system, guess)
                continue
            coarse_point = self._first_coarse_solution_or_none(
                system, self._yield_guess_and_damped_newton_point(system, guess)
            )
            # Iterations with fewer harmonics cost little: they do not count.
            self._max_iterations += self.iterations - iterations_before
            if coarse_point is None and not system.is_matrix_free:
                coarse_point = self._first_coarse_solution_or_none(
                    system, self._yield_guesses_by_continuation(system, 0.5)
                )
            self._simpler_point = coarse_point or simpler_point

    def _first_coarse_solution_or_none(
        self, system: ContactSystem, guesses: Iterator[np.ndarray]
    ) -> ContactPoint | None:
        """Return the first solution by full Newton steps from guesses, or None.

        The tolerance for residual over unknowns, |F| / |x|, is coarse: 6e-6. Guesses are slow gap
        coefficients (2H+1, n_rows) [m].
        """
        points_or_none = (
            self._point_after_full_steps_or_none(system, guess, COARSE_TOLERANCE)
            for guess in guesses
        )
        return next(
            (
                system.linearise(point_or_none.unknown)
                for point_or_none in points_or_none
                if point_or_none is not None
            ),
            None,
        )

    def _yield_guesses_without_friction(self) -> Iterator[np.ndarray]:
        """Search the solution without friction, and yield the gaps under its contact forces.

        Above 40 harmonics of the load frequency, an exact orbit with friction is first searched
        from this solution. If found, the orbit's gaps are yielded first. Nothing is yielded if the
        solution is not found. Guesses are slow gap coefficients (2H+1, n_rows) [m].
        """
        problem_with_friction, system_with_friction = self.problem, self.system
        frictionless_problem = replace(
            problem_with_friction, contact=normal_law(problem_with_friction.contact)
        )
        compliance_model = frictionless_problem.compliance_model()
        try:
            frictionless_search = Search(
                frictionless_problem.system(compliance_model),
                frictionless_problem,
                self.tolerance,
                0.5 * self.budget_fraction,
            )
            frictionless_point = frictionless_search.solve()
        finally:
            compliance_model.destroy()
        self.iterations += frictionless_search.iterations
        self._max_iterations += frictionless_search.iterations  # they cost little and do not count
        if not frictionless_search.has_converged:
            return
        frictionless_force = np.zeros(system_with_friction.shape)
        frictionless_force[:, : frictionless_point.unknown.shape[1]] = (
            frictionless_search.system.integrals.force(frictionless_point.unknown)
        )
        self._simpler_point = system_with_friction.linearise(
            system_with_friction.linear_gap
            - multiply_compliance_and_force(
                system_with_friction.dynamic_less_static_compliance, frictionless_force
            )
        )
        if problem_with_friction.harmonics > self._n_harmonics_above_which_orbit_first:
            yield from self._yield_guesses_from_orbit()
        yield self._simpler_point.unknown

    def _yield_guesses_from_orbit(self) -> Iterator[np.ndarray]:
        """Yield guesses from an exact orbit: slow gap coefficients (2H+1, n_rows) [m].

        The search for the orbit begins at the solution with fewer harmonics or without friction, if
        known, and otherwise at rest. Nothing is yielded if no exact flow is known, if the search
        would take long, or if no orbit is found.
        """
        problem = self.problem
        simpler_point = self._simpler_point
        state_guesses = list[np.ndarray]()
        flow = exact_flow_or_none(problem.structure, problem.contact)
        load_omega, n_load_periods = problem.omega, problem.subharmonic
        if flow is None or not is_orbit_search_affordable(flow, load_omega, n_load_periods):
            return
        if simpler_point is not None:
            displacement_at_simpler_point = self.system.compliance_model.displacement(
                resize_harmonics(simpler_point.force, problem.harmonics)
            )
            state_guesses.append(
                series_states_at_period_parts(
                    flow, displacement_at_simpler_point, problem.base_omega
                )
            )
        self.orbit = search_orbit(
            flow, load_omega, state_guesses, n_load_periods, prefer_stable=False
        ).orbit
        if self.orbit is not None:
            gap_and_force_coefficients = self.orbit.coefficients(problem.harmonics)
            self._max_iterations += self._max_iterations_per_guess
            self.remedy = "a tolerance: the solution is then the exact orbit that was found"
            yield from self._yield_guess_and_damped_newton_point(
                self.system,
                self.system.gap_without_static_part(
                    *split_pairs_into_layers(
                        problem.contact,
                        problem.structure.n_pairs,
                        gap_and_force_coefficients.gap,
                        gap_and_force_coefficients.force,
                    )
                ),
            )
        self.orbit = None

    def _yield_guesses_by_continuation(
        self, system: ContactSystem, budget_fraction: float = 1.0
    ) -> Iterator[np.ndarray]:
        """Yield the end of a path from very soft contact to the law.

        With friction the path leads from zero to the full friction coefficient instead. The path
        may take ``budget_fraction`` of the remaining iterations. Nothing is yielded if the path
        does not arrive. The guess has slow gap coefficients (2H+1, n_rows) [m].
        """
        start_point: Linearisation | None = self._simpler_point
        if self.problem.has_friction:
            system = system.system_along_friction_factor()
        else:
            system = system.system_along_softness()
            start_point = self._point_after_full_steps_or_none(
                system, system.linear_gap, parameter=0.0
            )
        if start_point is None:
            return
        max_steps = 1 + max(0, int(budget_fraction * (self._max_iterations - self.iterations)))
        max_total_iterations = self.iterations + max_steps
        max_path_points_per_call = min(
            PathOptions.max_path_points_per_call, 1 + max_steps // MAX_STALLED_STEPS
        )
        path_options = replace(
            HOMOTOPY_OPTIONS,
            rounding=self._residual_rounding,
            max_steps=max_steps,
            max_path_points_per_call=max_path_points_per_call,
        )
        continuation_path = Path(
            system, point_on_path(system, start_point.unknown, 0.0), path_options, [Target(1.0)]
        )
        for path_point in continuation_path.points():
            self.iterations += path_point.iterations
            if self.iterations >= max_total_iterations:
                return
        if continuation_path.end_reason is EndReason.TERMINAL_EVENT_REACHED:
            yield continuation_path.last_point.unknown


def halved_harmonic_counts(harmonics: int, min_harmonics: int) -> list[int]:
    """Return ascending numbers of harmonics, each about half of the next.

    The first is ``min_harmonics``, the last is ``harmonics``.
    """
    harmonic_counts = [harmonics]
    while harmonic_counts[0] > min_harmonics:
        harmonic_counts.insert(0, max((harmonic_counts[0] + 1) // 2, min_harmonics))
    return harmonic_counts


def _allowed_search_iterations(system: ContactSystem) -> float:
    """Return the maximum number of Newton iterations in a search.

    In the kernel the maximum is 7500 (300 / n)^2, with the number of unknowns n, at least 200. In
    Python it is at most 1500. With friction it is ``MAX_FRICTION_SEARCH_WORK`` divided by the
    product of instants and unknowns.
    """
    integrals = system.integrals
    if isinstance(integrals, FrictionIntegrals):
        return MAX_FRICTION_SEARCH_WORK / (integrals.n_instants * system.n_cost_unknowns)
    max_iterations_in_kernel = (
        MAX_SEARCH_ITERATIONS * (300.0 / max(MIN_UNKNOWNS_WITH_GROWING_COST, system.size)) ** 2
    )
    if getattr(system, "compiled_equations", None) is not None:
        return max_iterations_in_kernel
    max_iterations_in_python = MAX_SEARCH_ITERATIONS / 5  # Python takes five times as long
    return (
        max_iterations_in_python
        if system.is_matrix_free
        else min(max_iterations_in_python, max_iterations_in_kernel)
    )
