"""A structure that rotates: what its rotation adds to matrices and load, at any speed.

    K(W) = K + W^2 K_1,        K_1 = K_g - M_y,        f_mean(W) = f_mean + W^2 f_c

K_g is the geometric stiffness of the stresses that the centrifugal load f_c makes, M_y the spin
softening, both for W = 1 rad/s (:mod:`fenics_crack.fem.rotation` assembles them).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.errors import InputError, check_number
from fenics_crack.model.coupled import solve_complementarity
from fenics_crack.model.damping import DampingRule
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modes import ROUNDING
from fenics_crack.model.structure import Structure
from fenics_crack.table import RPM

__all__ = ["Rotation", "static_state", "too_fast"]


@dataclass(frozen=True)
class Rotation:
    """Stiffness and load that rotation adds to a structure.

    Attributes
    ----------
    at_rest : Structure
        The structure without it: K and its own load.
    stiffness : PETSc.Mat
        K_1 = K_g - M_y: (n, n) [kg].
    force : (n_local,) [kg m]
        f_c.
    speed : float
        W [rad/s].
    """

    at_rest: Structure
    stiffness: Any
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
        stiffness = weighted_sum(self.at_rest.stiffness, speed**2, self.stiffness)
        with Factor(stiffness) as factor:
            if factor.negative_pivots or factor.null_pivots:
                raise InputError("rotation.speed", speed, too_fast(speed))
        force = self.at_rest.force.copy()
        force[0] += speed**2 * self.force
        found = self.at_rest._changed(stiffness=stiffness, force=force)
        found._hold(rotation=replace(self, speed=speed))
        return found

    def damped(self, damping: DampingRule | None) -> Rotation:
        """The same of a structure with another damping."""
        return replace(self, at_rest=self.at_rest.damped(damping))


def static_state(
    structure: Structure, force: np.ndarray, clearance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (n_local,) [m] and contact forces (n_pairs,) [N] under a constant load.

        K u + B lambda = f,        0 <= lambda,    B^T u <= g0,    lambda^T (B^T u - g0) = 0

    The forces are those of a small problem on the lips, through their compliance B^T K^-1 B; where
    the load opens all pairs, there are none (collective).

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
        if np.any(gap > ROUNDING * np.abs(gap).max(initial=0.0)):
            pushed = factor.solve(structure.gap.T.toarray())
            compliance = structure.apply_bt(pushed)
            pairs = solve_complementarity(0.5 * (compliance + compliance.T), gap)
            pairs = np.asarray(structure.comm.bcast(pairs))
            moved = moved - pairs @ pushed
    return moved, pairs


def too_fast(speed: float) -> str:
    """Say what is allowed instead of a speed [rad/s] at which the plate is unstable."""
    return f"lower: the plate is unstable at {speed / RPM:.6g} rpm"
