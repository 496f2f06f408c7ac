"""A structure that rotates: what its rotation adds to matrices and load, at any speed.

    K(W) = K + W^2 (K_1 + K_2) + W^4 K_3,     K_1 = K_g - M_y,     f_mean(W) = f_mean + K(W) u_s(W)

K_g is the geometric stiffness of the stresses that the centrifugal load f_c makes, M_y the spin
softening, K_2 and K_3 what comes with the displaced shape, (K + W^2 K_1) u_s = W^2 f_c; all of them
for W = 1 rad/s (:mod:`fenics_crack.fem.elasticity` assembles them).

One small basis serves for all speeds of a run-up:

    u = V q,        V^T K(W_0) V = I,        V^T M V diagonal

V holds, of the structure at a few speeds of the range, the lowest modes with an open crack and the
static responses to forces on every pair and to the load: the free-interface bases of these speeds
together, without what one of them adds of negligible energy. At these the small structure is as
good as the reduced one; between them its error, that of a Ritz method, is of second order in what V
lacks. At each speed its modes are those of a small dense matrix, and smooth to rounding: V is
scaled so that the stiffness is near I. A Campbell diagram has modes with a bonded crack in V, too,
and all of its frequencies from there.
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
from fenics_crack.basics.tables import RPM
from fenics_crack.model.body import Body
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import Factor, distributed, weighted_sum
from fenics_crack.model.matrices import read_only, read_only_rows
from fenics_crack.model.modes import AS_ZERO, Modes, independent_part, solve_modes, times
from fenics_crack.model.nodes import of_body
from fenics_crack.model.reduced import MasslessInterface, ReducedBody
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import DampingRule, Structure, of_original

N_SPEEDS = 3
"""Speeds of a range whose bases are put together."""


@dataclass(frozen=True)
class Rotation:
    """Stiffness and load that rotation adds to a structure.

    Attributes
    ----------
    at_rest : Structure
        The structure without it: K and its own load.
    stiffness : PETSc.Mat
        K_1 = K_g - M_y: (n, n) [kg].
    displaced : tuple of PETSc.Mat
        K_2 [kg] and K_3 [kg s^2].
    force : (n_local,) [kg m]
        f_c.
    speed : float
        W [rad/s].
    """

    at_rest: Structure
    stiffness: Any
    displaced: tuple[Any, Any]
    force: np.ndarray
    speed: float

    def at(self, speed: float) -> Structure:
        """The structure at a speed [rad/s]; at 0 the one at rest (collective).

        Raises
        ------
        InputError
            The speed is negative, or so high that the plate is unstable: K(W) is not positive
            definite.
        """
        check_number("speed", speed, 0.0)
        if speed == 0.0:
            return self.at_rest
        still, stiffness = self.stiffnesses(speed)
        with Factor(stiffness) as factor:
            if factor.negative_pivots or factor.null_pivots:
                raise InputError("rotation.speed", speed, too_fast(self.at_rest, speed))
        with Factor(still, definite=True) as factor:
            moved = factor.solve(speed**2 * self.force[None]).T
        still.destroy()
        force = self.at_rest.force.copy()
        force[0] += times(stiffness, moved)[:, 0]
        rotation = replace(self, speed=speed)
        return self.at_rest._changed(stiffness=stiffness, force=force, rotation=rotation)

    def stiffnesses(self, speed: float) -> tuple[Any, Any]:
        """K + W^2 K_1 of the displacement that rotation makes, and K(W) of what moves about it
        (collective)."""
        square, (second, third) = speed**2, self.displaced
        still = weighted_sum(self.at_rest.stiffness, square, self.stiffness)
        displaced = weighted_sum(second, square, third)
        stiffness = weighted_sum(still, square, displaced)
        displaced.destroy()
        return still, stiffness

    def changed(self, change: Callable[[Structure], Structure]) -> Rotation:
        """The same of a structure that is changed."""
        return replace(self, at_rest=change(self.at_rest))


def static_state(
    structure: Structure, force: np.ndarray, clearance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (n_local,) [m] and contact forces (n_pairs,) [N] under a constant load.

        K u + B lambda = f,        0 <= lambda,    B^T u <= g0,    lambda^T (B^T u - g0) = 0

    The forces are those of a small problem on the crack faces, through their compliance B^T K^-1 B;
    where the load opens all pairs, there are none (collective).

    Parameters
    ----------
    force : (n_local,) [N]
        f.
    clearance : (n_pairs,) [m]
        g0.

    Raises
    ------
    ConvergenceError
        No set of closed pairs was found.
    """
    pairs = np.zeros(structure.n_pairs)
    with Factor(structure.stiffness, definite=True) as factor:
        moved = factor.solve(force[None])[0]
        gap = structure.apply_bt(moved[None])[0] - clearance
        if np.any(gap > AS_ZERO * np.abs(gap).max(initial=0.0)):
            pushed = factor.solve(structure.gap.T.toarray())
            compliance = structure.apply_bt(pushed)
            pairs = solve_complementarity(0.5 * (compliance + compliance.T), gap)
            pairs = np.asarray(structure.comm.bcast(pairs))
            moved = moved - pairs @ pushed
    return moved, pairs


def too_fast(structure: Structure, speed: float) -> str:
    """Describe the allowed values instead of a speed [rad/s] at which a plate is unstable; or a
    solid, which the Coriolis force may keep from that. A mesh in mm is: so its size is reported
    (collective)."""
    what, at = "the plate", f"is unstable at {speed / RPM:.6g} rpm"
    if structure.nodes is not None:
        sides = np.ptp(gather_rows(structure.comm, structure.nodes.points), axis=0)
        at += f"; it measures {' x '.join(f'{side:.3g}' for side in sides)} m"
        if len(sides) == 3:
            what = "without the Coriolis force, which is left out, the solid"
    return f"lower: {what} {at}"


def coriolis_shifts(modes: Modes, turning: np.ndarray) -> np.ndarray:
    """By how much the Coriolis force, which is left out, would change natural frequencies of a
    solid, relative to them: (m,); of a plate, to which it is normal, nothing (collective).

        q'' + G q' + Lambda q = 0,      G = 2 Phi^T M (W x Phi)

    in the space of these modes. The mass matrix is the same in each direction, so it multiplies
    what W turns of each node. With x = (Lambda^1/2 q, q') the matrix of x' = A x is skew.

    Parameters
    ----------
    modes : Modes
        Of a whole structure that turns.
    turning : (3,) [rad/s]
        W.
    """
    structure, count = modes.structure, len(modes.omega)
    nodes = structure.nodes
    if nodes is None or nodes.points.shape[1] != 3:
        return np.zeros(count)
    rows = nodes.dofs[nodes.dofs[:, 0] >= 0] - structure.first_dof
    turned = np.zeros_like(modes.shapes)
    turned[rows] = np.cross(turning, modes.shapes[rows], axisb=1, axisc=1)
    coupling = 2.0 * structure.sum_over_ranks(modes.shapes.T @ times(structure.mass, turned))
    root, zero = np.diag(modes.omega), np.zeros((count, count))
    matrix = np.block([[zero, root], [-root, -coupling]])
    return np.asarray(np.linalg.eigvalsh(1j * matrix)[count:] / modes.omega - 1.0)


@dataclass(frozen=True)
class Ritz:
    """A structure and what rotation adds to it, in a basis; the same on every rank.

    Attributes
    ----------
    whole : Structure
        Structure that was reduced, at its own speed.
    basis : (whole.n_local, n)
        V.
    at_rest, stiffness : (n, n), (3, n, n)
        V^T K V, and V^T K_i V of K_1, K_2, K_3.
    squares_inverse : (n,)
        V^T M V, which is diagonal.
    force : (2K+1, n)
        V^T f at rest.
    centrifugal : (n,)
        V^T f_c.
    mass, gap, tangential
        The mass as a matrix of PETSc's, V^T B, and V^T B_t or None.
    modes : int
        Number of modes with mass.
    """

    whole: Structure
    basis: np.ndarray
    at_rest: np.ndarray
    stiffness: np.ndarray
    squares_inverse: np.ndarray
    force: np.ndarray
    centrifugal: np.ndarray
    mass: Any
    gap: sparse.csr_matrix
    tangential: np.ndarray | None
    modes: int

    @classmethod
    def of_range(
        cls, structure: Structure, start: float, stop: float, modes: int, tied: int = 0
    ) -> Ritz:
        """Return the basis for speeds between two [rad/s], from some of the lowest modes of a few
        of them, open crack and bonded; scaled at the structure's own speed (collective)."""
        rotation = structure.rotation
        basis: np.ndarray = np.zeros((structure.n_local, 0))
        for speed in np.linspace(start, stop, N_SPEEDS):
            own = np.isclose(speed, rotation.speed, rtol=1e-12, atol=0.0)
            there = structure if own else rotation.at(float(speed))
            part = reduce_structure(there, modes=modes, method="free_interface", reference=False)
            shapes, omega = part.basis, part.omega
            if tied:
                found = solve_modes(there, tied, lips="tied")
                shapes, omega = np.hstack([shapes, found.shapes]), np.append(omega, found.omega)
                del found
            if not np.all(omega > 0.0):  # to rounding, which pivots need not see
                raise InputError("rotation.speed", float(speed), too_fast(structure, float(speed)))
            new = independent_part(structure, structure.stiffness, basis, shapes)
            basis = np.hstack([basis, new])
            del there, part, shapes, new
            collect_garbage(structure.comm)

        def projected(matrix: object) -> np.ndarray:
            found = structure.sum_over_ranks(basis.T @ times(matrix, basis))
            return np.asarray(0.5 * (found + found.T))

        inverse, turned = np.linalg.eigh(projected(structure.mass))
        basis = basis @ turned
        square = rotation.speed**2
        added = np.array([projected(part) for part in (rotation.stiffness, *rotation.displaced)])
        at_rest = np.eye(len(inverse)) - square * (added[0] + added[1] + square * added[2])
        try:
            np.linalg.cholesky(at_rest)
        except np.linalg.LinAlgError:  # beside what rotation adds it is rounding
            words = too_fast(structure, rotation.speed)
            raise InputError("rotation.speed", rotation.speed, words) from None
        return cls(
            structure,
            read_only(basis),  # shared by all speeds
            at_rest,
            added,
            inverse,
            structure.sum_over_ranks(rotation.at_rest.force @ basis),
            structure.sum_over_ranks(rotation.force @ basis),
            distributed(sparse.diags(inverse), MPI.COMM_SELF),
            read_only_rows(structure.apply_bt(basis.T)),
            structure.apply_tangential(basis.T),
            modes,
        )

    def matrices(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """The stiffness (n, n) and the load (2K+1, n) at a speed [rad/s]."""
        first, second, third = speed**2 * self.stiffness
        stiffness = self.at_rest + first + second + speed**2 * third
        moved = np.linalg.solve(self.at_rest + first, speed**2 * self.centrifugal)
        force = self.force.copy()
        force[0] += stiffness @ moved
        return stiffness, force

    def at(self, speed: float) -> Structure:
        """The small structure at a speed [rad/s], without damping."""
        stiffness, force = self.matrices(speed)
        matrix = distributed(stiffness, MPI.COMM_SELF)
        return Structure(Body(self.mass, matrix, self.gap, force, self.whole.clearance))


@dataclass(frozen=True, eq=False, kw_only=True)
class RunUpBody(ReducedBody):
    """That of a rotating structure at one speed; ``dense`` is V^T K(W) V."""

    speed: float
    shapes: np.ndarray
    static_root: np.ndarray
    ritz: Ritz
    dense: np.ndarray


class RunUpStructure(MasslessInterface):
    """A rotating structure at one speed, in coordinates that do not depend on it.

    Its lowest modes have mass; what they leave out is quasi-static, as in
    :class:`fenics_crack.MasslessStructure`.

    Attributes
    ----------
    speed : float
        W [rad/s].
    shapes, static_root : (n_dofs, n_modes), (n_dofs, n_dofs - n_modes)
        Phi, mass-normalised, and a root L of K^-1 - Phi Lambda^-1 Phi^T = L L^T.
    """

    body: RunUpBody
    speed: float = of_body("speed")
    shapes: np.ndarray = of_body("shapes")
    static_root: np.ndarray = of_body("static_root")

    def __init__(self, ritz: Ritz, speed: float) -> None:
        stiffness, force = ritz.matrices(speed)
        try:
            factor = np.linalg.inv(np.linalg.cholesky(stiffness))
        except np.linalg.LinAlgError:
            raise InputError("speed", speed, too_fast(ritz.whole, speed)) from None
        # The largest eigenvalues, 1 / omega^2, are those that rounding leaves alone.
        inverse, turned = np.linalg.eigh((factor * ritz.squares_inverse) @ factor.T)
        inverse, static = inverse[: -ritz.modes - 1 : -1], factor.T @ turned[:, ::-1]
        damping = ritz.whole.damping
        omega = 1.0 / np.sqrt(inverse)
        body = RunUpBody(
            ritz.mass, None, ritz.gap, force, ritz.whole.clearance,
            damping=None if damping is None else damping.of_kept(len(force[0])),
            tangential=ritz.tangential, nodes=ritz.whole.nodes, pairs=ritz.whole.pairs,
            basis=ritz.basis, omega=omega, whole=ritz.whole, speed=speed, ritz=ritz,
            shapes=static[:, : ritz.modes] * omega, static_root=static[:, ritz.modes :],
            dense=stiffness,
        )  # fmt: skip
        Structure.__init__(self, body)

    @of_original
    def stiffness(self) -> Any:
        """V^T K(W) V. Paths make a structure for each of their many speeds, and do not ask for its
        matrix."""
        return distributed(self.body.dense, MPI.COMM_SELF)

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} coordinates of {self.whole.n_dofs} dofs at {self.speed:g} rad/s"

    def at_speed(self, speed: float) -> RunUpStructure:
        """The same structure at another speed [rad/s].

        Raises
        ------
        InputError
            The speed is not positive, or so high that the plate is unstable.
        """
        check_number("speed", speed, 0.0, above=True)
        return RunUpStructure(self.body.ritz, float(speed))._in(self.setting)

    def stiffening(self, omega: float) -> float:
        """d ln w / d ln W of the natural frequency w, crack open, that is nearest to one [rad/s]:
        phi^T dK/d(ln W) phi / (2 w^2), phi being its mode."""
        first, second, third = self.speed**2 * self.body.ritz.stiffness
        mode = int(np.abs(self.omega - omega).argmin())
        shape = self.shapes[:, mode]
        change = 2.0 * (first + second + 2.0 * self.speed**2 * third)
        return float(shape @ change @ shape / (2.0 * self.omega[mode] ** 2))

    def damped(self, damping: DampingRule | None) -> RunUpStructure:
        """Return this structure with a modal or Rayleigh damping, or none."""
        raise InputError("damping", damping, "that of the structure from which this one was made")


def run_up_structure(structure: Structure, start: float, stop: float, modes: int) -> RunUpStructure:
    """A rotating structure for all speeds between two, at its own speed (collective).

    One ratio, or one for each of the lowest modes, damps the modes at each speed, those beyond with
    the last one.

    Parameters
    ----------
    structure : Structure
        The whole one, with its rotation.
    start, stop : float
        Ends of the range [rad/s].
    modes : int
        Number of modes of each speed in the basis.

    Returns
    -------
    RunUpStructure
        For :func:`continue_parameter` over "speed".

    Raises
    ------
    InputError
        The structure does not rotate, its damping is a matrix, or a speed cannot be used.

    Examples
    --------
    >>> rotor = fc.run_up_structure(fc.build_structure(blade), 100.0, 200.0, 4)
    """
    rotation = structure.rotation
    if rotation is None:
        raise InputError("structure", repr(structure), "one that rotates, of a scene's [rotation]")
    if not isinstance(structure.damping, DampingRule | None):
        raise InputError("damping", "a matrix", "modal or Rayleigh damping in a run-up")
    return RunUpStructure(Ritz.of_range(structure, start, stop, modes), rotation.speed)
