"""Reduction of structures to few coordinates with the same pairs, load and damping.

The displacement is sought in the span of a basis T, u = T q, by one of two methods:

- ``massless``: the lowest modes Phi with free crack faces, and their truncated part without mass
  (:class:`fenics_crack.model.reduced.MasslessStructure`). Crack faces with mass bounce on stiff
  contact, at frequencies of the mesh; massless faces do not. The compliance at the pairs is exact
  at w = 0. A truncated mode makes it wrong by (w/w_j)^2 / (1 - (w/w_j)^2) times the static
  compliance of the mode.
- ``free_interface`` (MacNeal, Rubin): the lowest modes Phi with free crack faces, and for every
  pair and load the *residual attachment vector*, the truncated static response

      Psi = (K^-1 - Phi Lambda^-1 Phi^T) [B, f].

  The compliance at the pairs is then exact at w = 0, together with its derivative by w^2.

With mass, T is made M-orthonormal and K-diagonal: the reduced structure is diagonal.

Estimate of the reduction error
-------------------------------
A reduced structure has a *reference*, a larger reduction. With mass, the reference also has the
static response K^-1 M Psi to the inertia of Psi, the next term of the expansion in w^2. A massless
reference has twice the modes. The error estimate is the difference between both results, divided by
the share of the truncation error that the reference removes.

To the order of w^2, truncated modes with flexibility G change the compliance of the pairs by w^2
B^T G M G B. A massless reference removes a known share of the trace. At most a half is assumed,
because contact also excites modes at their own frequencies.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_choice
from fenics_crack.basics.progress import begin_stage
from fenics_crack.model.factor import Factor, factored_sum
from fenics_crack.model.modal import MAX_DENSE_SIZE
from fenics_crack.model.modes import (
    ZERO_TOLERANCE,
    count_damped_modes,
    modes_with_modal_damping,
    multiply_columns,
    orthonormalise_against_basis,
    project_damping_on_modes,
    solve_modes,
    solve_modes_with_factor,
)
from fenics_crack.model.receptance import ResidualFlexibility, find_loaded_row_mask, receptance
from fenics_crack.model.reduced import MasslessStructure, ReducedStructure, check_faces_have_mass
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure

REDUCTION_METHODS = ("massless", "free_interface")
"""Methods of :func:`reduce_structure`: crack faces without mass, or with mass."""
MIN_ERROR_SHARE_REMOVED_BY_REFERENCE = 0.1
"""Minimum share of the truncation error that a reference is taken to remove.

The error estimate is divided by the share. A reference with a smaller share tells nothing about the
truncated modes.
"""
DEFAULT_MODES_OF_LARGE_STRUCTURE = 50
"""Default number of modes for a large structure whose modes are all damped."""


def reduce_structure(
    structure: Structure,
    *,
    modes: int | None = None,
    method: str = "free_interface",
    reference: bool | int = True,
) -> ReducedStructure:
    """Reduce a structure to a few coordinates (collective).

    The displacement is sought as u = T q with few coordinates q. The columns of T are the lowest
    modes with an open crack, then static responses to each pair's force and to the load. With the
    method "free_interface", these responses have mass. With "massless", they have none and move
    quasi-statically, so crack faces have no mass (:class:`MasslessStructure`). This is best for
    contact on many pairs.

    If one ratio damps all modes of the structure, it damps all modes of the reduced one. Rayleigh
    damping keeps its coefficients. Any other damping is projected on T. With "massless" and several
    ratios, kept modes without a ratio of their own get the last ratio.

    Parameters
    ----------
    structure : Structure
        Structure to reduce.
    modes : int, optional
        Number of the lowest modes to keep. Default: the number of damped modes. If every mode is
        damped and there are more than 600 dofs: 50. Without damping, or with a damping matrix: 20.
    method : "massless" or "free_interface"
        Kind of the static responses in T, as above.
    reference : bool or int
        True: also keep a larger reduction, the reference, to estimate the reduction error. With
        "massless" the reference has twice the modes, otherwise further static responses. A number,
        with "massless" only: number of modes in the reference.

    Returns
    -------
    ReducedStructure
        Reduced structure, the same on every rank. With "massless" a :class:`MasslessStructure`.

    Raises
    ------
    InputError
        The method is unknown, the structure has fewer modes than requested, or each of more than
        600 dofs has its own damping ratio.

    Examples
    --------
    >>> reduced = fc.reduce_structure(structure, modes=10)
    """
    check_choice("method", method, REDUCTION_METHODS)
    check_faces_have_mass(structure, "reduce structure.whole")
    uniform_rule = _uniform_damping_rule_or_none(structure)
    is_modally_damped = uniform_rule is None and isinstance(structure.damping, ModalDamping)
    n_damped = count_damped_modes(structure) if is_modally_damped else None
    if modes is None:
        modes = min(20, structure.n_dofs) if n_damped is None else n_damped
        if uniform_rule is not None:
            modes = (
                DEFAULT_MODES_OF_LARGE_STRUCTURE
                if structure.n_dofs > MAX_DENSE_SIZE
                else structure.n_dofs
            )
    is_integer = isinstance(modes, int | np.integer) and not isinstance(modes, bool)
    if not (is_integer and 1 <= modes <= structure.n_dofs):
        raise InputError("modes", modes, f"a whole number from 1 to n_dofs = {structure.n_dofs}")

    if method == "massless":
        return _reduce_massless(structure, int(modes), reference)

    if is_modally_damped:  # more modes, which are cached
        modes_with_modal_damping(structure)
    begin_stage("reduction")
    with Factor(structure.stiffness, definite=True) as stiffness_factor:
        computed_modes = solve_modes_with_factor(stiffness_factor, structure, int(modes))
        mode_shapes, squares = computed_modes.shapes[:, :modes], computed_modes.omega[:modes] ** 2
        with _regular_stiffness_factor(
            stiffness_factor, structure, is_held=bool(squares[0] > 0.0)
        ) as factor:
            # Static responses to pair forces and load, without the part of the modes.
            nonzero_load_rows = structure.force[find_loaded_row_mask(structure)]
            unit_pair_and_load_forces = np.vstack([structure.gap.T.toarray(), nonzero_load_rows])
            flexibility = ResidualFlexibility(
                structure, mode_shapes, squares, unit_pair_and_load_forces.T
            )
            static_shapes = flexibility.solve(factor, unit_pair_and_load_forces).T
            own_compliances = structure.sum_over_ranks(
                (unit_pair_and_load_forces.T * static_shapes).sum(axis=0)
            )
            is_rounding = _is_residual_flexibility_rounding(
                own_compliances, flexibility.modal_forces_of_sources.T, squares
            )
            static_shapes = static_shapes[:, ~is_rounding]
            static_shapes = orthonormalise_against_basis(
                structure, structure.mass, mode_shapes, static_shapes
            )
            if not reference:
                return _reduce_to_vectors(structure, mode_shapes, squares, static_shapes, None)
            vector_blocks_of_larger_reduction = [
                static_shapes,
                factor.solve(multiply_columns(structure.mass, static_shapes).T).T,
            ]
            if uniform_rule is None and structure.damping_matrix is not None:
                damping_forces = multiply_columns(
                    structure.damping_matrix, np.hstack([mode_shapes, static_shapes])
                )
                vector_blocks_of_larger_reduction.append(factor.solve(damping_forces.T).T)
    larger_reduced_structure = _reduce_to_vectors(
        structure, mode_shapes, squares, np.hstack(vector_blocks_of_larger_reduction), None
    )
    return _reduce_to_vectors(
        structure, mode_shapes, squares, static_shapes, larger_reduced_structure
    )


def _reduce_massless(
    structure: Structure, n_kept: int, reference_choice: bool | int
) -> MasslessStructure:
    """Reduce a structure to ``n_kept`` modes and crack faces without mass.

    A second reduction with more modes, the reference, serves to estimate the truncation error. The
    default number of modes in the reference is 2 ``n_kept``, and at least ``n_kept`` + 10. It is
    limited to n_dofs - n_pairs, to leave each pair a static part. The reference has all modes
    instead

    - if ``n_kept`` reaches this limit;
    - if the limit applies, and a pair keeps more than half of the residual flexibility.

    The reference removes the fraction 1 - J_r / J of the truncation error, as an estimate. J is the
    sum of :meth:`Receptance.inertia_beyond` for ``n_kept`` modes, and J_r the sum for the
    reference's modes. The fraction is at least 0.1, and at most 0.5 unless the reference has all
    modes. The result stores the fraction as ``error_share_removed_by_reference``.

    Parameters
    ----------
    structure : Structure
        Structure to reduce.
    n_kept : int
        Number of the lowest modes to keep.
    reference_choice : bool or int
        True: the default reference. False: no reference. A number above ``n_kept``: number of modes
        in the reference.

    Raises
    ------
    InputError
        A rigid-body motion is not among the ``n_kept`` modes.
    """
    original = structure.unvaried_structure
    n_wanted_reference_modes, max_reference_modes = (
        n_kept + max(n_kept, 10),
        original.n_dofs - original.n_pairs,
    )
    n_reference_modes = (
        min(n_wanted_reference_modes, max_reference_modes)
        if max_reference_modes > n_kept
        else original.n_dofs
    )
    if has_given_reference_mode_count := reference_choice is not True and reference_choice > n_kept:
        n_reference_modes = int(reference_choice)
    reference_and_kept_mode_counts = (n_reference_modes, n_kept) if reference_choice else (n_kept,)
    receptance_with_most_modes = receptance(original, max(reference_and_kept_mode_counts))
    if n_missing_rigid_modes := np.count_nonzero(
        receptance_with_most_modes.squares[n_kept:] == 0.0
    ):
        requirement = f"at least {n_kept + n_missing_rigid_modes}, to keep all rigid-body motions"
        raise InputError("modes", n_kept, requirement)
    if (
        reference_choice
        and not has_given_reference_mode_count
        and n_reference_modes < n_wanted_reference_modes
        and n_reference_modes == max_reference_modes
    ):
        pair_range = slice(original.n_pairs)
        compliance_beyond_reference_modes, compliance = (
            np.diag(receptance_with_most_modes.compliance_beyond(n_modes))[pair_range]
            for n_modes in reference_and_kept_mode_counts
        )
        if np.any(
            compliance_beyond_reference_modes > compliance - compliance_beyond_reference_modes
        ):
            reference_and_kept_mode_counts = (original.n_dofs, n_kept)
            receptance_with_most_modes = receptance(original, original.n_dofs)
    is_nonzero_load_part, modal_sources = (
        find_loaded_row_mask(original),
        receptance_with_most_modes.modal.T,
    )
    n_load_fourier_parts = len(is_nonzero_load_part)
    n_gaps = len(receptance_with_most_modes.modal) - np.count_nonzero(is_nonzero_load_part)
    # The amplitudes of the load's parts are unknowns, and S maps them to their forces.
    nonzero_load_part_selection = np.hstack(
        [
            np.zeros((n_load_fourier_parts, n_gaps)),
            np.eye(n_load_fourier_parts)[:, is_nonzero_load_part],
        ]
    )
    inertia_sums = [
        float(receptance_with_most_modes.inertia_beyond(n_modes).sum())
        for n_modes in reference_and_kept_mode_counts
    ]
    error_share_removed_by_reference = max(
        1.0 - inertia_sums[0] / max(inertia_sums[-1], 1e-300), MIN_ERROR_SHARE_REMOVED_BY_REFERENCE
    )
    error_share_removed_by_reference = min(
        error_share_removed_by_reference,
        1.0 if reference_and_kept_mode_counts[0] == original.n_dofs else 0.5,
    )
    damping_rule, massless_reduced_structure = original.damping, None
    damping: Any = damping_rule
    for n_modes in reference_and_kept_mode_counts:
        compliance = receptance_with_most_modes.compliance_beyond(n_modes)
        squares = receptance_with_most_modes.squares[:n_modes]
        is_rounding = _is_residual_flexibility_rounding(
            np.diag(compliance), modal_sources[:n_modes], squares
        )
        # forces that the kept modes carry alone
        compliance[is_rounding] = compliance[:, is_rounding] = 0.0
        if not isinstance(damping_rule, DampingRule | None):
            damping = _reduce_damping(original, solve_modes(original, n_modes).shapes, squares)
        massless_reduced_structure = MasslessStructure(
            original,
            squares,
            damping,
            modal_sources[:n_modes, :n_gaps],
            nonzero_load_part_selection
            @ np.hstack([receptance_with_most_modes.modal[:, :n_modes], compliance]),
            compliance,
            reference=massless_reduced_structure,
            error_share_removed_by_reference=error_share_removed_by_reference
            if n_modes == reference_and_kept_mode_counts[-1]
            else 0.5,
        )
    assert massless_reduced_structure is not None
    return massless_reduced_structure._in_setting(structure.load_damping_clearance_changes)


def _is_residual_flexibility_rounding(
    compliance_diagonal: np.ndarray, modal_sources: np.ndarray, squared_omegas: np.ndarray
) -> np.ndarray:
    """Return True for forces whose residual flexibility is only rounding: (n_sources,) bool.

    The residual flexibility is then at most 1e-14 of the compliance by the kept modes.

    Parameters
    ----------
    compliance_diagonal : (n_sources,) [m/N]
        Residual flexibility of each force.
    modal_sources : (n_modes, n_sources)
        Modal forces Phi^T X by the unit forces X.
    squared_omegas : (n_modes,) [rad^2/s^2]
        Squares of the modes' frequencies.
    """
    is_elastic_mode = squared_omegas > 0.0
    modal_compliance = np.sum(
        modal_sources[is_elastic_mode] ** 2 / squared_omegas[is_elastic_mode, None], axis=0
    )
    return np.asarray(compliance_diagonal <= ZERO_TOLERANCE * modal_compliance)


def _uniform_damping_rule_or_none(structure: Structure) -> DampingRule | None:
    """Return the damping rule if one rule holds for all modes, else None.

    The rule is one ratio, or Rayleigh's coefficients. It also holds for the modes of the reduced
    structure. InputError: more than 600 dofs have a ratio for each mode.
    """
    damping = structure.damping
    if isinstance(damping, RayleighDamping):
        return damping
    if not isinstance(damping, ModalDamping) or damping.modes not in (None, structure.n_dofs):
        return None
    if isinstance(damping.ratio, float):
        return replace(damping, modes=None)
    if structure.n_dofs <= MAX_DENSE_SIZE:
        return None
    problem_text = f"{len(damping.ratio)} ratios for all {structure.n_dofs} modes"
    requirement = (
        "one ratio, or ratios of the lowest modes (damping.modes), as the structure has more than "
        f"{MAX_DENSE_SIZE} dofs"
    )
    raise InputError("damping ratio", problem_text, requirement)


@contextmanager
def _regular_stiffness_factor(
    stiffness_factor: Factor, structure: Structure, *, is_held: bool
) -> Iterator[Factor]:
    """Yield a factor of the stiffness K, or of a shifted stiffness if K is singular.

    The shifted stiffness is K + s M, with the mass M and the shift s = omega^2 of the tenth mode.

    Parameters
    ----------
    stiffness_factor : Factor
        Factor of K, yielded itself if K is regular.
    structure : Structure
        Structure with K and M.
    is_held : bool
        True if K is regular: the structure cannot move as a rigid body.
    """
    if is_held:
        yield stiffness_factor
        return
    squared_omega_shift = (
        solve_modes_with_factor(stiffness_factor, structure, min(structure.n_dofs, 10)).omega[-1]
        ** 2
        or 1.0
    )
    with factored_sum(
        structure.stiffness, squared_omega_shift, structure.mass, definite=True
    ) as regular_factor:
        yield regular_factor


def _reduce_to_vectors(
    structure: Structure,
    mode_shapes: np.ndarray,
    squared_omegas: np.ndarray,
    displacement_vectors: np.ndarray,
    reference: ReducedStructure | None,
) -> ReducedStructure:
    """Reduce a structure to the span of modes and other displacement vectors.

    The basis T has T^T M T = I and a diagonal T^T K T, with the mass M and the stiffness K.

    Parameters
    ----------
    structure : Structure
        Structure to reduce.
    mode_shapes : (n_local, n_modes)
        Mass-normalised modes.
    squared_omegas : (n_modes,) [rad^2/s^2]
        Squares of the modes' frequencies.
    displacement_vectors : (n_local, m)
        Other displacements; directions in the span of the modes are dropped.
    reference : ReducedStructure or None
        Larger reduction, to estimate the reduction error.
    """
    displacement_vectors = orthonormalise_against_basis(
        structure, structure.mass, mode_shapes, displacement_vectors
    )
    projected_stiffness = structure.sum_over_ranks(
        displacement_vectors.T @ multiply_columns(structure.stiffness, displacement_vectors)
    )
    vector_squared_omegas, eigenvectors = np.linalg.eigh(projected_stiffness)
    displacement_vectors = displacement_vectors @ eigenvectors
    basis = np.hstack([mode_shapes, displacement_vectors])
    squared_omegas = np.concatenate([squared_omegas, vector_squared_omegas])
    damping = _reduce_damping(structure, basis, squared_omegas)
    return ReducedStructure(structure, basis, squared_omegas, damping, reference)


def _reduce_damping(
    structure: Structure, basis: np.ndarray, squared_omegas: np.ndarray
) -> DampingRule | np.ndarray | None:
    """Return the reduced damping T^T C T as a rule or matrix; None without damping.

    T is the basis, with T^T M T = I and T^T K T = diag(squared_omegas). Rayleigh's coefficients and
    one ratio for all modes stay. Any other damping is projected. If the projection is diagonal, it
    becomes a ratio for each coordinate, unless it damps a rigid-body motion.
    """
    if structure.damping is None:
        return None
    if (uniform_rule := _uniform_damping_rule_or_none(structure)) is not None:
        return uniform_rule
    modal_damping = project_damping_on_modes(structure, basis, squared_omegas)
    omega = np.sqrt(np.maximum(squared_omegas, 0.0))
    if modal_damping.ndim == 2:
        return modal_damping
    if np.any(modal_damping[omega == 0.0] > 0.0):  # no ratio damps a motion as a rigid body
        return np.diag(modal_damping)
    damping_ratios = np.divide(
        modal_damping, 2.0 * omega, out=np.zeros_like(modal_damping), where=omega > 0.0
    )
    return ModalDamping(tuple(np.maximum(damping_ratios, 0.0)))
