"""A structure that rotates: changes of its matrices and load with the speed W.

    K(W) = K + W^2 (K_1 + K_2) + W^4 K_3,     K_1 = K_g - M_y,     f_mean(W) = f_mean + K(W) u_s(W)

K_g is the geometric stiffness of the centrifugal stresses, M_y the spin softening. K_2 and K_3 come
with the displaced shape, (K + W^2 K_1) u_s = W^2 f_c, under the centrifugal load f_c. All of them
hold for W = 1 rad/s (:mod:`fenics_crack.fem.elasticity` assembles them).

Run-ups
-------
One small basis serves for all speeds of a run-up:

    u = V q,        V^T K(W_0) V = I,        V^T M V diagonal

V is made at a few speeds of the range. It holds the lowest modes with an open crack, and the static
responses to forces on every pair and to the load. These free-interface bases are put together, and
directions of negligible energy are left out. At these speeds the small structure is as accurate as
the reduced one. Between them the error, of a Ritz method, is of second order in what V lacks. The
modes at each speed come from a small dense matrix and are smooth to rounding: V is scaled so that
the stiffness is near I. For a Campbell diagram V also holds modes with a bonded crack, and gives
all frequencies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_number
from fenics_crack.basics.ranks import collect_garbage, gather_rows
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM
from fenics_crack.model.body import Body
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import (
    Factor,
    make_matrix_from_local_rows,
    matrix_plus_weighted_matrix,
)
from fenics_crack.model.matrices import read_only_array, read_only_csr_matrix
from fenics_crack.model.modes import (
    ZERO_TOLERANCE,
    Modes,
    multiply_columns,
    orthonormalise_against_basis,
    solve_modes,
)
from fenics_crack.model.nodes import body_property
from fenics_crack.model.reduced import QuasiStaticReduction, ReducedBody
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import DampingRule, Structure, shared_property

N_BASIS_SPEEDS = 3
"""Number of speeds in a range whose bases are put together."""


@dataclass(frozen=True)
class Rotation:
    """Stiffness and load that rotation adds to a structure.

    At the speed W, the stiffness K at rest becomes K + W^2 (K_1 + K_2) + W^4 K_3.

    Attributes
    ----------
    structure_at_rest : Structure
        The structure without rotation: K and its own load.
    rotation_stiffness : PETSc.Mat
        K_1 = K_g - M_y at 1 rad/s: (n, n) [kg]. K_g is stress stiffening, M_y spin softening.
    displaced_shape_stiffness_terms : tuple of PETSc.Mat
        K_2 [kg] and K_3 [kg s^2], at 1 rad/s: stiffness because rotation displaces the structure.
    force : (n_local,) [kg m]
        Centrifugal load f_c at 1 rad/s.
    speed : float
        W [rad/s].
    """

    structure_at_rest: Structure
    rotation_stiffness: Any
    displaced_shape_stiffness_terms: tuple[Any, Any]
    force: np.ndarray
    speed: float

    def structure_rotating_at_speed(self, speed: float) -> Structure:
        """Return the structure at a speed [rad/s]; at 0 the one at rest (collective).

        Raises
        ------
        InputError
            The speed is negative, or so high that the plate is unstable: K(W) is not positive
            definite.
        """
        check_number("speed", speed, 0.0)
        if speed == 0.0:
            return self.structure_at_rest
        stiffness_for_static_displacement, stiffness = self.static_and_motion_stiffness(speed)
        with Factor(stiffness) as factored_stiffness:
            if factored_stiffness.n_negative_pivots or factored_stiffness.n_null_pivots:
                raise InputError(
                    "rotation.speed", speed, describe_unstable_speed(self.structure_at_rest, speed)
                )
        with Factor(stiffness_for_static_displacement, definite=True) as factored_stiffness:
            rotation_displacement = factored_stiffness.solve(speed**2 * self.force[None]).T
        stiffness_for_static_displacement.destroy()
        load_coefficients = self.structure_at_rest.force.copy()
        load_coefficients[0] += multiply_columns(stiffness, rotation_displacement)[:, 0]
        rotation = replace(self, speed=speed)
        return self.structure_at_rest._plain_structure_with_changes(
            stiffness=stiffness, force=load_coefficients, rotation=rotation
        )

    def static_and_motion_stiffness(self, speed: float) -> tuple[Any, Any]:
        """Return the stiffness for the static displacement and for vibration (collective).

        W is ``speed`` [rad/s], K the stiffness at rest, and K_1 the ``rotation_stiffness``.

        Returns
        -------
        PETSc.Mat
            K + W^2 K_1, for the displacement u_s due to rotation.
        PETSc.Mat
            K(W), for vibration about the displaced shape.
        """
        speed_squared, (K_2_per_squared_speed, K_3_per_fourth_power_of_speed) = (
            speed**2,
            self.displaced_shape_stiffness_terms,
        )
        stiffness_for_static_displacement = matrix_plus_weighted_matrix(
            self.structure_at_rest.stiffness, speed_squared, self.rotation_stiffness
        )
        displaced_shape_stiffness = matrix_plus_weighted_matrix(
            K_2_per_squared_speed, speed_squared, K_3_per_fourth_power_of_speed
        )
        motion_stiffness = matrix_plus_weighted_matrix(
            stiffness_for_static_displacement, speed_squared, displaced_shape_stiffness
        )
        displaced_shape_stiffness.destroy()
        return stiffness_for_static_displacement, motion_stiffness

    def with_changed_rest_structure(self, change: Callable[[Structure], Structure]) -> Rotation:
        """Return the same terms of rotation, with ``change`` applied to the structure at rest."""
        return replace(self, structure_at_rest=change(self.structure_at_rest))


def static_displacement_and_forces(
    structure: Structure, constant_load: np.ndarray, clearance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find displacement and contact forces under a constant load (collective).

        K u + B lambda = f,        0 <= lambda,    B^T u <= g0,    lambda^T (B^T u - g0) = 0

    Contact is rigid. u is the displacement, K the stiffness, B the gap matrix and g0 the clearance.
    The contact forces lambda solve a small problem on the crack faces, with the compliance B^T K^-1
    B. If the load f opens all pairs, lambda is zero.

    Parameters
    ----------
    constant_load : (n_local,) [N]
        f.
    clearance : (n_pairs,) [m]
        g0.

    Returns
    -------
    (n_local,) [m]
        u.
    (n_pairs,) [N]
        lambda.

    Raises
    ------
    ConvergenceError
        No set of closed pairs was found.
    """
    contact_forces = np.zeros(structure.n_pairs)
    with Factor(structure.stiffness, definite=True) as factored_stiffness:
        displacement = factored_stiffness.solve(constant_load[None])[0]
        gap_without_contact = structure.apply_bt(displacement[None])[0] - clearance
        if np.any(
            gap_without_contact > ZERO_TOLERANCE * np.abs(gap_without_contact).max(initial=0.0)
        ):
            pair_responses = factored_stiffness.solve(structure.gap.T.toarray())
            compliance = structure.apply_bt(pair_responses)
            contact_forces = solve_complementarity(
                0.5 * (compliance + compliance.T), gap_without_contact
            )
            contact_forces = np.asarray(structure.comm.bcast(contact_forces))
            displacement = displacement - contact_forces @ pair_responses
    return displacement, contact_forces


def describe_unstable_speed(structure: Structure, speed: float) -> str:
    """Return the error text for a speed [rad/s] at which the structure is unstable (collective).

    The stiffness is then not positive definite. A solid may still be stable by the Coriolis force,
    which is left out. The text reports the size of the mesh in m: positions in mm by mistake make a
    structure unstable.
    """
    subject, problem = "the plate", f"is unstable at {speed / RAD_PER_S_PER_RPM:.6g} rpm"
    if structure.nodes is not None:
        mesh_extents = np.ptp(gather_rows(structure.comm, structure.nodes.points), axis=0)
        extents_text = " x ".join(f"{mesh_extent:.3g}" for mesh_extent in mesh_extents)
        problem += f"; the mesh measures {extents_text} m: check that its lengths are in m"
        if len(mesh_extents) == 3:
            subject = "without the Coriolis force, which is left out, the solid"
    return f"lower: {subject} {problem}"


def relative_coriolis_shifts(modes: Modes, rotation_vector: np.ndarray) -> np.ndarray:
    """Return relative shifts of natural frequencies due to the Coriolis force (collective).

    Other functions omit the Coriolis force. In the space of the given modes,

        q'' + G q' + Lambda q = 0,      G = 2 Phi^T M (W x Phi)

    Phi are the mode shapes, q their amplitudes, and Lambda the squares of their frequencies. W x
    Phi is the cross product for each node's displacement. With x = (Lambda^1/2 q, q') the matrix of
    x' = A x is skew. A plate has no shifts: it cannot move in the direction of the force.

    Parameters
    ----------
    modes : Modes
        Modes of a whole structure that turns.
    rotation_vector : (3,) [rad/s]
        W.

    Returns
    -------
    (m,)
        Shift of each frequency, relative to the frequency.
    """
    structure, n_modes = modes.structure, len(modes.omega)
    nodes = structure.nodes
    if nodes is None or nodes.points.shape[1] != 3:
        return np.zeros(n_modes)
    node_dofs = nodes.dofs[nodes.dofs[:, 0] >= 0] - structure.first_dof
    shape_cross_products = np.zeros_like(modes.shapes)
    shape_cross_products[node_dofs] = np.cross(
        rotation_vector, modes.shapes[node_dofs], axisb=1, axisc=1
    )
    gyroscopic = 2.0 * structure.sum_over_ranks(
        modes.shapes.T @ multiply_columns(structure.mass, shape_cross_products)
    )
    omega_matrix, zero_matrix = np.diag(modes.omega), np.zeros((n_modes, n_modes))
    gyroscopic_eigenproblem_matrix = np.block(
        [[zero_matrix, omega_matrix], [-omega_matrix, -gyroscopic]]
    )
    return np.asarray(
        np.linalg.eigvalsh(1j * gyroscopic_eigenproblem_matrix)[n_modes:] / modes.omega - 1.0
    )


@dataclass(frozen=True)
class RitzProjection:
    """A rotating structure projected on a basis V for all speeds (Ritz method).

    Every rank has all arrays. At the speed of ``structure``, the projected stiffness is I.

    Attributes
    ----------
    structure : Structure
        Structure that was projected, at its own speed.
    basis : (structure.n_local, n)
        V, of modes and static responses at several speeds.
    rest_stiffness, stiffness_terms_K_1_K_2_K_3 : (n, n), (3, n, n)
        V^T K V at rest, and V^T K_i V of the terms K_1, K_2, K_3 of :class:`Rotation`.
    mass_diagonal : (n,)
        Diagonal of the mass matrix V^T M V.
    force : (2K+1, n)
        Load V^T f at rest.
    centrifugal_load : (n,)
        Centrifugal load V^T f_c at 1 rad/s.
    mass, gap, tangential
        The mass as a PETSc matrix, and the gap matrices V^T B (normal) and V^T B_t (tangential, or
        None).
    n_modes_with_mass : int
        Number of modes with mass in a :class:`RunUpStructure`.
    """

    structure: Structure
    basis: np.ndarray
    rest_stiffness: np.ndarray
    stiffness_terms_K_1_K_2_K_3: np.ndarray
    mass_diagonal: np.ndarray
    force: np.ndarray
    centrifugal_load: np.ndarray
    mass: Any
    gap: sparse.csr_matrix
    tangential: np.ndarray | None
    n_modes_with_mass: int

    @classmethod
    def of_range(
        cls, structure: Structure, start: float, stop: float, modes: int, n_bonded: int = 0
    ) -> RitzProjection:
        """Project a structure on a basis for a range of speeds (collective).

        Parameters
        ----------
        structure : Structure
            Rotating structure; the projected stiffness is I at its own speed.
        start, stop : float [rad/s]
            Ends of the range.
        modes : int
            Number of modes with an open crack at each of three speeds: both ends and the middle.
        n_bonded : int
            Number of modes with a bonded crack at each of these speeds.

        Raises
        ------
        InputError
            The structure is unstable at a speed.
        """
        rotation = structure.rotation
        basis: np.ndarray = np.zeros((structure.n_local, 0))
        for speed in np.unique(np.linspace(start, stop, N_BASIS_SPEEDS)):
            is_speed_of_given_structure = np.isclose(speed, rotation.speed, rtol=1e-12, atol=0.0)
            structure_at_speed = (
                structure
                if is_speed_of_given_structure
                else rotation.structure_rotating_at_speed(float(speed))
            )
            reduced_structure_at_speed = reduce_structure(
                structure_at_speed, modes=modes, method="free_interface", reference=False
            )
            new_shapes, new_omegas = (
                reduced_structure_at_speed.basis,
                reduced_structure_at_speed.omega,
            )
            if n_bonded:
                bonded_modes = solve_modes(structure_at_speed, n_bonded, lips="tied")
                new_shapes = np.hstack([new_shapes, bonded_modes.shapes])
                new_omegas = np.append(new_omegas, bonded_modes.omega)
                del bonded_modes
            if not np.all(new_omegas > 0.0):  # pivots need not show what rounding hides
                raise InputError(
                    "rotation.speed", float(speed), describe_unstable_speed(structure, float(speed))
                )
            new_columns = orthonormalise_against_basis(
                structure, structure.stiffness, basis, new_shapes
            )
            basis = np.hstack([basis, new_columns])
            del structure_at_speed, reduced_structure_at_speed, new_shapes, new_columns
            collect_garbage(structure.comm)

        def project_matrix(petsc_matrix: object) -> np.ndarray:
            """Return the symmetric projection V^T A V of a matrix A on the basis V: (n, n)."""
            projection = structure.sum_over_ranks(basis.T @ multiply_columns(petsc_matrix, basis))
            return np.asarray(0.5 * (projection + projection.T))

        mass_diagonal, projected_mass_eigenvectors = np.linalg.eigh(project_matrix(structure.mass))
        basis = basis @ projected_mass_eigenvectors
        own_speed_squared = rotation.speed**2
        petsc_stiffness_terms = (
            rotation.rotation_stiffness,
            *rotation.displaced_shape_stiffness_terms,
        )
        projected_stiffness_terms = np.array(
            [project_matrix(petsc_matrix) for petsc_matrix in petsc_stiffness_terms]
        )
        rest_stiffness = np.eye(len(mass_diagonal)) - own_speed_squared * (
            projected_stiffness_terms[0]
            + projected_stiffness_terms[1]
            + own_speed_squared * projected_stiffness_terms[2]
        )
        try:
            np.linalg.cholesky(rest_stiffness)
        except np.linalg.LinAlgError:  # K is only rounding of the terms of rotation
            requirement = describe_unstable_speed(structure, rotation.speed)
            raise InputError("rotation.speed", rotation.speed, requirement) from None
        return cls(
            structure,
            read_only_array(basis),  # shared by all speeds
            rest_stiffness,
            projected_stiffness_terms,
            mass_diagonal,
            structure.sum_over_ranks(rotation.structure_at_rest.force @ basis),
            structure.sum_over_ranks(rotation.force @ basis),
            make_matrix_from_local_rows(sparse.diags(mass_diagonal), MPI.COMM_SELF),
            read_only_csr_matrix(structure.apply_bt(basis.T)),
            structure.apply_tangential(basis.T),
            modes,
        )

    def stiffness_and_load(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Return stiffness and load at a speed W [rad/s], projected on the basis V.

        Returns
        -------
        (n, n)
            Stiffness V^T K(W) V.
        (2K+1, n)
            Load V^T f, with the mean load due to rotation.
        """
        K_1_times_squared_speed, K_2_times_squared_speed, K_3_times_squared_speed = (
            speed**2 * self.stiffness_terms_K_1_K_2_K_3
        )
        stiffness = (
            self.rest_stiffness
            + K_1_times_squared_speed
            + K_2_times_squared_speed
            + speed**2 * K_3_times_squared_speed
        )
        rotation_displacement = np.linalg.solve(
            self.rest_stiffness + K_1_times_squared_speed, speed**2 * self.centrifugal_load
        )
        load_coefficients = self.force.copy()
        load_coefficients[0] += stiffness @ rotation_displacement
        return stiffness, load_coefficients

    def structure_at_speed(self, speed: float) -> Structure:
        """Return the small structure at a speed [rad/s], without damping."""
        stiffness, load_coefficients = self.stiffness_and_load(speed)
        petsc_stiffness = make_matrix_from_local_rows(stiffness, MPI.COMM_SELF)
        return Structure(
            Body(self.mass, petsc_stiffness, self.gap, load_coefficients, self.structure.clearance)
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedBodyAtOneSpeed(ReducedBody):
    """Constant data of a :class:`RunUpStructure`.

    ``speed``, ``shapes`` and ``truncated_flexibility_root`` are explained in that class. ``ritz``
    is the projection for all speeds. ``dense_stiffness`` (n, n) is the stiffness V^T K(W) V at the
    speed W, with the basis V.
    """

    speed: float
    shapes: np.ndarray
    truncated_flexibility_root: np.ndarray
    ritz: RitzProjection
    dense_stiffness: np.ndarray


@keep_old_attribute_names(stiffening="stiffening_exponent")
class RunUpStructure(QuasiStaticReduction):
    """A rotating structure at one speed, in coordinates that hold for a range of speeds.

    The coordinates are amplitudes of a basis (:class:`RitzProjection`). The lowest modes have mass.
    All other modes respond statically, without mass.

    Attributes
    ----------
    speed : float
        Rotor speed W [rad/s].
    shapes : (n_dofs, n_modes)
        Mode shapes Phi in the coordinates, mass-normalised.
    truncated_flexibility_root : (n_dofs, n_dofs - n_modes)
        Root L of the other modes' flexibility, K^-1 - Phi Lambda^-1 Phi^T = L L^T. K is the
        stiffness, and Lambda holds the squares of the modes' frequencies.
    """

    body: ReducedBodyAtOneSpeed
    speed: float = body_property("speed")
    shapes: np.ndarray = body_property("shapes")
    truncated_flexibility_root: np.ndarray = body_property("truncated_flexibility_root")

    def __init__(self, ritz: RitzProjection, speed: float) -> None:
        projected_stiffness_at_speed, load_coefficients = ritz.stiffness_and_load(speed)
        try:
            inverse_cholesky_factor = np.linalg.inv(
                np.linalg.cholesky(projected_stiffness_at_speed)
            )
        except np.linalg.LinAlgError:
            raise InputError(
                "speed", speed, describe_unstable_speed(ritz.structure, speed)
            ) from None
        # Rounding hardly changes the largest eigenvalues, 1 / omega^2.
        inverse_squares, eigenvectors = np.linalg.eigh(
            (inverse_cholesky_factor * ritz.mass_diagonal) @ inverse_cholesky_factor.T
        )
        inverse_squares = inverse_squares[: -ritz.n_modes_with_mass - 1 : -1]
        scaled_eigenvectors = inverse_cholesky_factor.T @ eigenvectors[:, ::-1]
        damping = ritz.structure.damping
        omega = 1.0 / np.sqrt(inverse_squares)
        reduced_body = ReducedBodyAtOneSpeed(
            ritz.mass, None, ritz.gap, load_coefficients, ritz.structure.clearance,
            damping=damping and damping.rule_for_n_modes(len(load_coefficients[0])),
            tangential=ritz.tangential, nodes=ritz.structure.nodes, pairs=ritz.structure.pairs,
            basis=ritz.basis, omega=omega, source=ritz.structure, speed=speed, ritz=ritz,
            shapes=scaled_eigenvectors[:, : ritz.n_modes_with_mass] * omega,
            truncated_flexibility_root=scaled_eigenvectors[:, ritz.n_modes_with_mass :],
            dense_stiffness=projected_stiffness_at_speed,
        )  # fmt: skip
        Structure.__init__(self, reduced_body)

    @shared_property
    def stiffness(self) -> Any:
        """Stiffness in the coordinates at this speed, as a PETSc matrix (n_dofs, n_dofs).

        The matrix is made on request: curves over the speed make many structures and need none.
        """
        return make_matrix_from_local_rows(self.body.dense_stiffness, MPI.COMM_SELF)

    @property
    def _size_description(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole.n_dofs} dofs at {self.speed:g} rad/s"

    def at_speed(self, speed: float) -> RunUpStructure:
        """Return the same structure at another speed [rad/s].

        Raises
        ------
        InputError
            The speed is not positive, or so high that the plate is unstable.
        """
        check_number("speed", speed, 0.0, excludes_bound=True)
        return RunUpStructure(self.body.ritz, float(speed))._in_setting(
            self.load_damping_clearance_changes
        )

    def stiffening_exponent(self, omega: float) -> float:
        """Return a natural frequency's relative growth per relative growth of rotor speed.

        With an open crack and the stiffness K, the frequency w of the mode phi at the speed W has

            d ln w / d ln W = phi^T dK/d(ln W) phi / (2 w^2)

        Parameters
        ----------
        omega : float [rad/s]
            Frequency; the nearest natural frequency w is taken.
        """
        K_1_times_squared_speed, K_2_times_squared_speed, K_3_times_squared_speed = (
            self.speed**2 * self.body.ritz.stiffness_terms_K_1_K_2_K_3
        )
        nearest_mode_index = int(np.abs(self.omega - omega).argmin())
        nearest_mode_shape = self.shapes[:, nearest_mode_index]
        log_speed_stiffness_slope = 2.0 * (
            K_1_times_squared_speed
            + K_2_times_squared_speed
            + 2.0 * self.speed**2 * K_3_times_squared_speed
        )
        return float(
            nearest_mode_shape
            @ log_speed_stiffness_slope
            @ nearest_mode_shape
            / (2.0 * self.omega[nearest_mode_index] ** 2)
        )

    def damped(self, damping: DampingRule | None) -> RunUpStructure:
        """Raise InputError: a run-up has the damping of the structure from which it was made."""
        raise InputError("damping", damping, "left out; damp the structure before run_up_structure")


def run_up_structure(structure: Structure, start: float, stop: float, modes: int) -> RunUpStructure:
    """Make a rotating structure for all speeds in a range (collective).

    The result has the speed of ``structure``. Modal damping holds for the modes at each speed. With
    several ratios, modes without a ratio of their own get the last one.

    Parameters
    ----------
    structure : Structure
        Rotating structure with all dofs, not reduced.
    start, stop : float
        Ends of the range [rad/s].
    modes : int
        Number of modes to keep at each speed.

    Returns
    -------
    RunUpStructure
        Structure whose speed :func:`continue_parameter` can vary.

    Raises
    ------
    InputError
        The structure does not rotate, its damping is a matrix, or it is unstable at a speed of the
        range. Or the range or the number of modes is not allowed.

    Examples
    --------
    >>> rotor = fc.run_up_structure(fc.build_structure(blade), 100.0, 200.0, 4)
    """
    rotation = structure.rotation
    if rotation is None:
        raise InputError(
            "structure", repr(structure), "a rotating structure, from a scene with [rotation]"
        )
    if not isinstance(structure.damping, DampingRule | None):
        raise InputError("damping", "a matrix", "modal or Rayleigh damping for a run-up")
    return RunUpStructure(RitzProjection.of_range(structure, start, stop, modes), rotation.speed)
