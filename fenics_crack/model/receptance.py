"""Receptance of a structure: its response to pair forces and load, at pairs and load.

The columns of X = [B, B_t, f] are the forces of the normal pairs, of the tangential pairs, and the
load's parts. The response to forces X c of angular frequency w is

    X^T u = sum_j X^T phi_j phi_j^T X c / (w_j^2 - w^2) + S c

The sum has the N lowest modes; S = X^T G X is the static compliance of all other modes, with their
flexibility G. With fewer modes in the sum, the static compliance of the modes between is added to
S. So a receptance with N modes contains all receptances with fewer modes, as sums of small arrays.
It is extended if more modes are requested.

All structures with the same matrices share a receptance. A receptance read from a file works
without mass and stiffness matrices. Displacements are then known only for dofs in the file.

References
----------
MacNeal, Computers & Structures 1, 1971, 581.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse

from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.factor import MAX_BLOCK_COLUMNS, Factor
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.modes import multiply_columns, solve_modes, solve_modes_with_factor
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING


@dataclass(frozen=True, eq=False)
class Receptance:
    """Lowest modes of a structure, and the static flexibility G of all other modes.

    Both are given at the contact pairs and along the load. The columns of X are unit forces on the
    pairs, then the nonzero parts of the load (:func:`pair_and_load_force_matrix`). Every rank has
    the same arrays, except ``force``.

    Attributes
    ----------
    squares : (n_modes,) [rad^2/s^2]
        Squares of the lowest natural frequencies, ascending.
    modal : (n_sources, n_modes)
        X^T Phi with the mass-normalised mode shapes Phi.
    compliance : (n_sources, n_sources)
        S = X^T G X: displacement along each column of X by the forces of each column.
    rows : dict of int to ((n_modes,), (n_sources,))
        Displacements of single dofs by the dof's number: a row of Phi, and a row of G X. Further
        dofs are added on request.
    force : (2K+1, n_local) [N]
        The structure's load f.
    inertia : (n_pairs,) [m s^2/N]
        Diagonal of B^T G M G B, with the gap matrix B and the mass M. At the angular frequency w, a
        pair's compliance by these modes exceeds the static one by about w^2 times this number.
    n_base : int or None
        G omits the lowest ``n_base`` modes: 0 if the structure is well supported. None: all modes.
        Modes that are added later leave G as it is.
    mode_counts : tuple of int
        Numbers of modes that were computed one after another. Computed in other steps, modes differ
        in their last digits.
    """

    squares: np.ndarray
    modal: np.ndarray
    compliance: np.ndarray
    rows: dict[int, tuple[np.ndarray, np.ndarray]]
    force: np.ndarray
    inertia: np.ndarray
    n_base: int | None = None
    mode_counts: tuple[int, ...] = ()

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.squares)

    def _sign_and_modes(self, n_kept_modes: int) -> tuple[float, slice]:
        """Return +1 and the modes n_kept to n_base, or -1 and the modes n_base to n_kept."""
        n_base = self.n_modes if self.n_base is None else self.n_base
        lower_count, upper_count = sorted((n_kept_modes, n_base))
        return (1.0 if n_kept_modes < n_base else -1.0), slice(lower_count, upper_count)

    def residual_response(
        self, n_kept_modes: int, residual_part: np.ndarray, modal_displacements: np.ndarray
    ) -> np.ndarray:
        """Return static responses that omit only the first ``n_kept_modes`` modes.

        The responses are Y^T G X: displacements along the columns of a matrix Y (m columns) by the
        unit forces X on pairs and load. G is the static flexibility of all modes except the first
        ``n_kept_modes``. Modes that only one of both flexibilities omits are added to, or taken
        from, ``residual_part``.

        Parameters
        ----------
        n_kept_modes : int
            Number of lowest modes that G omits, at most ``n_modes``.
        residual_part : (m, n_sources)
            Y^T G X with the static flexibility that omits ``n_base`` modes.
        modal_displacements : (m, n_modes)
            Y^T Phi with the mode shapes Phi.

        Returns
        -------
        (m, n_sources)
            Y^T G X.
        """
        sign, modes = self._sign_and_modes(n_kept_modes)
        modal_flexibility = modal_displacements[:, modes] / (sign * self.squares[modes])
        return np.asarray(residual_part + modal_flexibility @ self.modal[:, modes].T)

    def compliance_beyond(self, n_kept_modes: int) -> np.ndarray:
        """Return the static compliance of all modes except the first ``n_kept_modes``.

        The compliance is S = X^T G X, (n_sources, n_sources). X are the unit forces on pairs and
        load. G is the static flexibility of all modes except the first ``n_kept_modes``.
        """
        return self.residual_response(n_kept_modes, self.compliance, self.modal)

    def inertia_beyond(self, n_kept_modes: int) -> np.ndarray:
        """Return how the truncated modes' pair compliances grow with w^2: (n_pairs,) [m s^2/N].

        All modes except the first ``n_kept_modes`` are truncated. At a low angular frequency w, the
        truncated modes' compliance at pair i is S_ii + w^2 J_i. S is the static compliance, and J
        is the result: the diagonal of B^T G M G B. B is the gap matrix, M the mass, and G the
        truncated modes' static flexibility. The sum of J measures the error of a quasi-static
        response.
        """
        sign, modes = self._sign_and_modes(n_kept_modes)
        modal_flexibility = self.modal[: len(self.inertia), modes] / self.squares[modes]
        return np.asarray(self.inertia + sign * np.sum(modal_flexibility**2, axis=1))


def receptance(
    structure: Structure, n_modes: int, stiffness_factor: Factor | None = None
) -> Receptance:
    """Return the receptance of a structure with at least ``n_modes`` modes (collective).

    Load, clearance and damping are those before the structure was varied. The receptance is kept
    for later requests. ``stiffness_factor`` is the factor of the stiffness, if known.

    Raises
    ------
    InputError
        The structure comes from a file without matrices, and the file has fewer modes or another
        load.
    """
    structure = structure.unvaried_structure
    known_receptances = structure.compute_once(make_receptance_cache)
    shared_receptances = structure.compute_once(make_shared_receptance_cache, from_matrices=True)
    if not known_receptances and shared_receptances:
        known_receptances += filter(
            None, [_convert_receptance_to_load(structure, shared_receptances[0])]
        )
    if not known_receptances or known_receptances[0].n_modes < n_modes:
        check_has_matrices(structure, f"{n_modes} modes")
        known_receptances[:] = shared_receptances[:] = [
            _extend_receptance(
                structure,
                known_receptances[0] if known_receptances else None,
                n_modes,
                stiffness_factor,
            )
        ]
    return known_receptances[0]


def make_receptance_cache(structure: Structure) -> list[Receptance]:
    """Return an empty list, in which a structure caches a receptance.

    The list holds the receptance with the most modes so far. The list does not refer to
    ``structure``, which would keep the structure in memory.
    """
    return []


def make_shared_receptance_cache(structure: Structure) -> list[Receptance]:
    """Return an empty list, in which structures share a cached receptance.

    Structures with the same matrices share the list, whatever the load. The list holds the
    receptance computed last. The list does not refer to ``structure``.
    """
    return []


def _convert_receptance_to_load(
    structure: Structure, known_receptance: Receptance
) -> Receptance | None:
    """Convert a receptance of the same structure under another load (collective).

    ``known_receptance`` has the other load; the result has the load of ``structure``. Returns None
    unless every part of the load is a linear combination of the other load's parts, to 1e-12.
    Returns None, too, if either the structure or the receptance has tangential pairs, but not both.
    """
    load_of_known_receptance = known_receptance.force
    new_load_rows = structure.force[find_loaded_row_mask(structure)]
    known_and_new_load_rows = np.vstack(
        [
            load_of_known_receptance[find_loaded_row_mask(structure, load_of_known_receptance)],
            new_load_rows,
        ]
    )
    n_known_load_rows = len(known_and_new_load_rows) - len(new_load_rows)
    if len(known_receptance.modal) - n_known_load_rows != pair_and_load_force_matrix(
        structure
    ).shape[1] - len(new_load_rows):
        return None  # only one of the two has tangents
    gram_matrix = structure.sum_over_ranks(known_and_new_load_rows @ known_and_new_load_rows.T)
    load_weights = (
        np.linalg.pinv(gram_matrix[:n_known_load_rows, :n_known_load_rows], hermitian=True)
        @ gram_matrix[:n_known_load_rows, n_known_load_rows:]
    )
    residual_norms_squared = structure.sum_over_ranks(
        ((new_load_rows - load_weights.T @ known_and_new_load_rows[:n_known_load_rows]) ** 2).sum(
            axis=1
        )
    )
    if np.any(
        residual_norms_squared > (ROUNDING * ROUNDING) * np.diag(gram_matrix)[n_known_load_rows:]
    ):
        return None
    source_transformation = scipy.linalg.block_diag(
        np.eye(len(known_receptance.modal) - n_known_load_rows), load_weights
    )
    rows_by_dof = {
        known_dof: (shape_row, residual_row @ source_transformation)
        for known_dof, (shape_row, residual_row) in known_receptance.rows.items()
    }
    compliance = source_transformation.T @ known_receptance.compliance @ source_transformation
    return replace(
        known_receptance,
        modal=source_transformation.T @ known_receptance.modal,
        compliance=compliance,
        rows=rows_by_dof,
        force=structure.force,
    )


def check_has_matrices(structure: Structure, result_name: str) -> None:
    """Raise InputError if a structure from a file lacks its matrices.

    ``result_name`` stands in the message: the result that needs the matrices.
    """
    if not structure.has_matrices:
        raise AbsentMatrix.input_error(result_name)


def pair_and_load_force_matrix(structure: Structure) -> sparse.csr_matrix:
    """Return unit forces on pairs and load as columns X = [B, B_t, f] (collective).

    B is the matrix of normal gaps, B_t the matrix of tangential gaps (if any). f are the nonzero
    parts of the load: mean, cosine and sine parts. The shape is (n_local, n_sources).
    """
    nonzero_load_rows = structure.force[find_loaded_row_mask(structure)]
    pair_forces = [structure.gap] + ([] if structure.tangential is None else [structure.tangential])
    return sparse.hstack([*pair_forces, nonzero_load_rows.T]).tocsr()


def find_loaded_row_mask(
    structure: Structure, load_coefficients: np.ndarray | None = None
) -> np.ndarray:
    """Return True for each nonzero row of a load (collective).

    Parameters
    ----------
    structure : Structure
        Structure whose ranks share the load.
    load_coefficients : (2K+1, n_local) [N], optional
        Load: mean, then cosine and sine part of each harmonic. Default: the structure's load.

    Returns
    -------
    (2K+1,) bool
        In the order of the load's rows.
    """
    load_coefficients = structure.force if load_coefficients is None else load_coefficients
    return np.asarray(structure.sum_over_ranks((load_coefficients**2).sum(axis=1)) > 0.0)


def _extend_receptance(
    structure: Structure,
    known_receptance: Receptance | None,
    n_modes: int,
    stiffness_factor: Factor | None,
) -> Receptance:
    """Compute a receptance with ``n_modes`` modes (collective).

    If ``known_receptance`` with fewer modes is given, its static responses stay as they are. They
    are computed if it is None or all of its modes are rigid, and are 0 if no mode is left out.
    ``stiffness_factor`` is the factor of the stiffness, if known.
    """
    begin_stage("factorisation of the stiffness")
    with (
        Factor(structure.stiffness, definite=True)
        if stiffness_factor is None
        else nullcontext(stiffness_factor)
    ) as factored_stiffness:
        mode_counts = (*(known_receptance.mode_counts if known_receptance else ()), n_modes)
        for n_modes_of_step in mode_counts:  # of a file in the steps of its command
            modes = solve_modes_with_factor(factored_stiffness, structure, n_modes_of_step)
        squares, sources = modes.omega**2, pair_and_load_force_matrix(structure)
        modal_forces = structure.sum_over_ranks(sources.T @ modes.shapes)
        has_all_modes = n_modes == structure.n_dofs
        # Without an elastic mode there may be further rigid-body motions.
        if known_receptance is None or known_receptance.squares[-1] == 0.0 or has_all_modes:
            begin_stage("static responses")
            # With a hinge that hardly resists, only rounding of the modal part would remain.
            is_well_supported = np.all(squares > np.sqrt(MACHINE_EPSILON) * squares[-1])
            n_base = 0 if is_well_supported and not has_all_modes else n_modes
            sources_shape = (len(modal_forces),)
            compliance, inertia = np.zeros(2 * sources_shape), np.zeros(sources_shape)
            if not has_all_modes:
                compliance, inertia = ResidualFlexibility(
                    structure, modes.shapes[:, :n_base], squares[:n_base], sources
                ).compliance_and_inertia(factored_stiffness)
            receptance_from_scratch = Receptance(
                squares, modal_forces, compliance, {}, structure.force,
                inertia[: structure.n_pairs], n_base, mode_counts,
            )  # fmt: skip
            _store_dof_rows(
                receptance_from_scratch,
                structure,
                _loaded_dofs(structure),
                modes.shapes,
                factored_stiffness,
            )
            return receptance_from_scratch
    known_dofs = [*known_receptance.rows]
    shape_rows = structure.values_at(modes.shapes.T, known_dofs).T
    rows_by_dof = {
        dof: (shape_row, known_receptance.rows[dof][1])
        for dof, shape_row in zip(known_dofs, shape_rows, strict=True)
    }
    return replace(
        known_receptance,
        squares=squares,
        modal=modal_forces,
        rows=rows_by_dof,
        mode_counts=mode_counts,
    )


def modal_and_static_displacement_rows(
    structure: Structure, n_modes: int, dofs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements of dofs by modes, and static ones by all other modes (collective).

    The displacements are kept in the structure's receptance for later calls.

    Parameters
    ----------
    n_modes : int
        Number of lowest modes.
    dofs : (m,) int
        Numbers of the dofs.

    Returns
    -------
    (m, n_modes)
        Displacements of the dofs in the mass-normalised modes.
    (m, n_sources)
        Static displacements of the dofs by unit forces on pairs and load. The static flexibility
        omits the ``n_modes`` modes.
    """
    known_receptance, structure = receptance(structure, n_modes), structure.unvaried_structure
    requested_dofs = [int(dof) for dof in dofs]
    missing_dofs = [
        dof for dof in dict.fromkeys(requested_dofs) if dof not in known_receptance.rows
    ]
    if missing_dofs:
        shapes = solve_modes(structure, known_receptance.n_modes).shapes
        _store_dof_rows(known_receptance, structure, np.array(missing_dofs), shapes)
    shape_rows, static_displacement_rows = (
        np.array(rows_of_dofs)
        for rows_of_dofs in zip(
            *(known_receptance.rows[dof] for dof in requested_dofs), strict=True
        )
    )
    return shape_rows[:, :n_modes], known_receptance.residual_response(
        n_modes, static_displacement_rows, shape_rows
    )


def expand_residual_response(
    structure: Structure, shapes: np.ndarray, squares: np.ndarray, amplitudes: np.ndarray
) -> np.ndarray:
    """Return static displacements G X c without given modes (collective).

    G is the static flexibility of all modes except those given. X are unit forces on pairs and
    load, and c their amplitudes.

    Parameters
    ----------
    shapes : (n_local, n_modes)
        Mass-normalised modes that G omits.
    squares : (n_modes,) [rad^2/s^2]
        Squares of their frequencies.
    amplitudes : (m, n_sources)
        Amplitudes c, one load case in each row (X: :func:`pair_and_load_force_matrix`).

    Returns
    -------
    (m, n_local) [m]
        Displacements, a row for each load case.
    """
    has_nonzero_amplitudes = np.any(amplitudes != 0.0, axis=1)
    displacements = np.zeros((len(amplitudes), structure.n_local))
    if np.any(has_nonzero_amplitudes):
        unit_force_matrix = pair_and_load_force_matrix(structure.unvaried_structure)
        flexibility = ResidualFlexibility(structure, shapes, squares, unit_force_matrix)
        with Factor(structure.stiffness, definite=True) as factored_stiffness:
            displacements[has_nonzero_amplitudes] = flexibility.solve(
                factored_stiffness, (unit_force_matrix @ amplitudes[has_nonzero_amplitudes].T).T
            )
    return displacements


def _store_dof_rows(
    known_receptance: Receptance,
    structure: Structure,
    dofs: np.ndarray,
    shapes: np.ndarray,
    stiffness_factor_or_none: Factor | None = None,
) -> None:
    """Add displacements of dofs to the attribute ``rows`` of a receptance (collective).

    For each dof, ``rows`` gets the displacements in the receptance's modes, and static
    displacements by unit forces. The static displacements omit the first ``n_base`` modes.

    Parameters
    ----------
    known_receptance : Receptance
        Receptance to extend.
    structure : Structure
        Structure with the stiffness, to which the dofs belong.
    dofs : (m,) int
        Numbers of the dofs.
    shapes : (n_local, n_modes)
        Shapes of the receptance's modes.
    stiffness_factor_or_none : Factor, optional
        Factor of the stiffness. Default: it is computed.
    """
    dofs_from_first_owned = dofs - structure.first_dof
    indices_of_owned_dofs = np.flatnonzero(
        (dofs_from_first_owned >= 0) & (dofs_from_first_owned < structure.n_local)
    )
    unit_forces_shape = structure.n_local, len(dofs)
    unit_forces = sparse.csr_matrix(
        (
            np.ones(len(indices_of_owned_dofs)),
            (dofs_from_first_owned[indices_of_owned_dofs], indices_of_owned_dofs),
        ),
        unit_forces_shape,
    )
    static_displacement_rows = np.zeros((len(dofs), len(known_receptance.modal)))
    if known_receptance.n_modes < structure.n_dofs:
        n_base = known_receptance.n_base
        flexibility = ResidualFlexibility(
            structure,
            shapes[:, :n_base],
            known_receptance.squares[:n_base],
            pair_and_load_force_matrix(structure),
        )
        stiffness_factor = stiffness_factor_or_none or Factor(structure.stiffness, definite=True)
        with (
            nullcontext(stiffness_factor)
            if stiffness_factor_or_none
            else stiffness_factor as usable_factor
        ):
            static_displacement_rows = flexibility.projected_compliance_and_inertia(
                usable_factor, unit_forces
            )[0]
    shape_rows = structure.values_at(shapes.T, dofs).T
    known_receptance.rows.update(
        zip(map(int, dofs), zip(shape_rows, static_displacement_rows, strict=True), strict=True)
    )


def _loaded_dofs(structure: Structure) -> np.ndarray:
    """Return the dofs on which the load acts (collective).

    A receptance stores the displacements of these dofs from the start. If there are more than 16
    (MAX_BLOCK_COLUMNS), the result is the watched dof alone.
    """
    owned_dofs = np.flatnonzero(np.any(structure.force != 0.0, axis=0)) + structure.first_dof
    dofs = gather_rows(structure.comm, owned_dofs)
    return dofs if len(dofs) <= MAX_BLOCK_COLUMNS else np.array([structure.watched_dof])


class ResidualFlexibility:
    """Static flexibility G = K^-1 - Phi Lambda^-1 Phi^T without some modes Phi.

    G maps forces to displacements, with the stiffness K and the squares Lambda of the modes'
    frequencies. A force f first loses its part on the modes, r = f - M Phi Phi^T f, with the mass
    M. The displacement x = K^-1 r then loses its part, too: x - Phi Phi^T M x. So no digits cancel.
    Compliances of a well supported structure are computed faster: the part of the modes is
    subtracted from the compliance with K^-1. If the structure can move as a rigid body, these
    motions are among the modes.

    Attributes
    ----------
    structure : Structure
        Structure that is not reduced.
    shapes : (n_local, n_modes)
        Phi, mass-normalised.
    squares : (n_modes,) [rad^2/s^2]
        Squares of the modes' frequencies.
    sources : (n_local, n_sources)
        X: the forces of unit amplitude, as a sparse matrix.
    modal_forces_of_sources : (n_sources, n_modes)
        X^T Phi.
    """

    def __init__(
        self, structure: Structure, shapes: np.ndarray, squares: np.ndarray, sources: Any
    ) -> None:
        self.structure, self.shapes, self.squares = structure, shapes, squares
        self.sources = sparse.csr_matrix(sources)
        self.modal_forces_of_sources = structure.sum_over_ranks(self.sources.T @ shapes)
        # With a hinge that hardly resists, only rounding of the modal part would remain.
        self._is_well_supported = bool(np.all(squares > np.sqrt(MACHINE_EPSILON) * squares[-1:]))

    def solve(self, stiffness_factor: Factor, forces: np.ndarray) -> np.ndarray:
        """Return displacements G f by ``forces`` f, both (m, n_local) (collective).

        G is the static flexibility of all modes except ``shapes``. ``stiffness_factor`` is the
        factor of the stiffness.
        """
        structure, mode_shapes = self.structure, self.shapes
        modal_forces = structure.sum_over_ranks(forces @ mode_shapes)
        displacements = stiffness_factor.solve(
            forces - multiply_columns(structure.mass, mode_shapes @ modal_forces.T).T
        )
        inertia_forces = multiply_columns(structure.mass, displacements.T).T
        return (
            displacements - structure.sum_over_ranks(inertia_forces @ mode_shapes) @ mode_shapes.T
        )

    def projected_compliance_and_inertia(
        self, stiffness_factor: Factor, force_columns: sparse.spmatrix
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the static compliance and its w^2 term between two sets of forces (collective).

        G is the static flexibility of all modes except ``shapes``, X are the ``sources``, and M is
        the mass. At the angular frequency w, the dynamic compliance along Y is about Y^T G Y + w^2
        Y^T G M G Y.

        Parameters
        ----------
        stiffness_factor : Factor
            Factor of the stiffness.
        force_columns : (n_local, m)
            Y, sparse forces.

        Returns
        -------
        (m, n_sources)
            Y^T G X, displacements along Y by the forces X.
        (m,)
            Diagonal of Y^T G M G Y.
        """
        projected_compliance_parts, compliance_slope_parts = (
            [np.zeros((0, self.sources.shape[1]))],
            [np.zeros(0)],
        )
        for start in range(0, force_columns.shape[1], MAX_BLOCK_COLUMNS):
            rows_of_force_block = force_columns[:, start : start + MAX_BLOCK_COLUMNS].T.toarray()
            # If K^-1 is small enough, its modal part is subtracted once, below.
            responses = (
                stiffness_factor.solve(rows_of_force_block)
                if self._is_well_supported
                else self.solve(stiffness_factor, rows_of_force_block)
            )
            projected_compliance_parts.append((self.sources.T @ responses.T).T)
            compliance_slope_parts.append(
                np.sum(responses.T * multiply_columns(self.structure.mass, responses.T), axis=0)
            )
        projected_compliance: np.ndarray = self.structure.sum_over_ranks(
            np.concatenate(projected_compliance_parts)
        )
        squared_omega_slope_of_compliance: np.ndarray = self.structure.sum_over_ranks(
            np.concatenate(compliance_slope_parts)
        )
        if self._is_well_supported:
            modal_flexibility = (
                self.structure.sum_over_ranks(force_columns.T @ self.shapes) / self.squares
            )
            projected_compliance -= modal_flexibility @ self.modal_forces_of_sources.T
            squared_omega_slope_of_compliance -= np.sum(modal_flexibility**2, axis=1)
        return projected_compliance, squared_omega_slope_of_compliance

    def compliance_and_inertia(self, stiffness_factor: Factor) -> tuple[np.ndarray, np.ndarray]:
        """Return the static compliance of ``sources`` X and its w^2 term (collective).

        G is the static flexibility of all modes except ``shapes``, M is the mass, and w an angular
        frequency. ``stiffness_factor`` is the factor of the stiffness.

        Returns
        -------
        (n_sources, n_sources)
            S = X^T G X, symmetric.
        (n_sources,)
            Diagonal of X^T G M G X, the derivative of the dynamic compliance's diagonal by w^2.
        """
        unsymmetric_compliance, squared_omega_slope_of_compliance = (
            self.projected_compliance_and_inertia(stiffness_factor, self.sources)
        )
        return 0.5 * (
            unsymmetric_compliance + unsymmetric_compliance.T
        ), squared_omega_slope_of_compliance
