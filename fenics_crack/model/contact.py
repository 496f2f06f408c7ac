"""Contact laws, and the contact forces of all pairs at one instant.

A law gives the force lambda of a pair from its gap g alone (g > 0: penetration). In the equation of
motion, M u'' + C u' + K u + B lambda(g) = f, a force lambda >= 0 pushes the crack faces apart. A
new law is a class with the four members of :class:`ContactLaw`. Solution methods that need more of
a law ask :func:`is_unilateral`, :func:`is_rigid` or :func:`is_piecewise_linear`, not for its class.

Coupled pairs
-------------
A residual flexibility R_inf couples the pairs: the truncated part of a structure responds to
contact forces quasi-statically, without mass. Let s be the gap from the modes and the load alone:

    g = s - R_inf lambda

R_inf is symmetric and positive semidefinite. The forces follow from s at each instant:

    0 <= lambda,     (R_inf + I/k) lambda - s >= 0,     complementary,         k infinite: rigid

The matrix D = R_inf + I/k of this linear complementarity problem is positive definite. There is one
solution, piecewise linear in s. With the set A of closed pairs,

    lambda_A = (D_AA)^-1 s_A,       opening of all other pairs = (D lambda - s) >= 0

The primal-dual active set method, a semismooth Newton method, finds the sets. If it cycles, Murty's
method changes one pair at a time (``kernel/sets.c``). If rounding spoils that, or D is singular, a
least-squares problem with bounds gives the minimum of lambda^T D lambda / 2 - lambda^T s for lambda
>= 0. Lawson and Hanson's method solves it in a finite number of steps. A law that is not piecewise
linear is solved by Newton's method at all instants together.

A convex piecewise-linear law is a sum of penalties with clearances of their own. Each penalty is a
row: the layered law has the gap rows B twice, with the clearances g0 and g0 + p and the stiffnesses
a k and (1 - a) k. With friction, tangential gaps are rows. Under the layered law each pair then has
two sliders in parallel, with tangential stiffnesses a k_t and (1 - a) k_t. The friction force is
the sum of both sliders' forces. :func:`add_pair_for_each_contact_force` makes the rows, and
:func:`merge_layers_of_pairs` returns from rows to pairs.

A step of time integration solves the same problem. D is then the compliance of the step, and s the
gap that the step would reach without contact forces.

References
----------
Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865 (active sets).
Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.
MacNeal, Computers & Structures 1 (1971) 581 (statics of truncated modes).
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810 (massless boundaries).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, Self, TypeGuard

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.machine import machine_memory
from fenics_crack.kernel import attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import CENTRAL_DIFFERENCE_STEP, MACHINE_EPSILON, ROUNDING


class ContactLaw(Protocol):
    """Interface of every contact law, from the gap of a pair to its contact force."""

    @property
    def stiffness(self) -> float | np.ndarray:
        """Largest slope of the contact force over the gap: a number or (n_pairs,) [N/m].

        This is the slope for a firmly closed pair.
        """

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces lambda(g) [N] for gaps g [m]: the same shape.

        Gaps are (..., n_pairs). A gap g > 0 is penetration; lambda > 0 is pressure.
        """

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return the slopes d lambda / d g [N/m] of the contact forces lambda: the shape of g.

        Gaps g are (..., n_pairs) [m]; a gap > 0 is penetration.
        """

    def scaled(self, factor: float) -> Self:
        """Return this law with its stiffness multiplied by a factor."""


@dataclass(frozen=True)
class _PenaltyBase:
    """Base of the laws with a penalty stiffness k [N/m].

    k is the largest slope of the contact force over the gap.
    """

    stiffness: float | np.ndarray

    def __post_init__(self) -> None:
        stiffness = _checked_positive_number("contact stiffness", self.stiffness, allows_array=True)
        object.__setattr__(self, "stiffness", stiffness)

    def scaled(self, factor: float) -> Self:
        """Return this law with its stiffness k multiplied by a factor."""
        return replace(self, stiffness=np.multiply(factor, self.stiffness))


@dataclass(frozen=True)
class UnilateralPenalty(_PenaltyBase):
    """Penalty law: contact force lambda = k g at penetration g > 0, else 0.

    Equation 11 of Kharyton's paper (README). The tangent d lambda / d g jumps from 0 to k as a pair
    closes; at g = 0 it is 0.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k, for all pairs or pair by pair.

    Raises
    ------
    InputError
        The stiffness is not positive and finite.
    """

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces k max(0, g) [N] for gaps g (..., n_pairs) [m]: the same shape.

        k is the stiffness of the law. A gap g > 0 is penetration.
        """
        return self.stiffness * np.maximum(gap, 0.0)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return the slopes d lambda / d g [N/m] of the contact forces lambda: the shape of g.

        Gaps g are (..., n_pairs) [m]. The slope is the stiffness k at penetration, g > 0, else 0.
        """
        return self.stiffness * (gap > 0.0)


@dataclass(frozen=True)
class LayeredPenalty(_PenaltyBase):
    """Bilinear penalty: a soft layer on the crack faces, and a stiffer contact below it.

        lambda = a k max(0, g) + (1 - a) k max(0, g - p)

    lambda is the contact force and g the gap of a pair; g > 0 is penetration. The slope of lambda
    is a k in the layer, 0 < g < p, and k at g > p.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k, for all pairs or pair by pair.
    layer_depth : float [m]
        p, the penetration at which the layer is compressed.
    layer_share : float
        a, the layer's share of the stiffness, between 0 and 1.

    Raises
    ------
    InputError
        The stiffness or the depth is not positive and finite, or the share not between 0 and 1.
    """

    layer_depth: float
    layer_share: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("layer_depth", "layer_share"):
            number = _checked_positive_number(f"contact {name}", getattr(self, name))
            object.__setattr__(self, name, number)
        if self.layer_share >= 1.0:
            raise InputError("contact layer_share", self.layer_share, "a number between 0 and 1")

    @property
    def row_stiffnesses(self) -> tuple[float | np.ndarray, ...]:
        """Stiffnesses [N/m] of a pair's two parallel springs, as (a k, (1 - a) k).

        The first spring acts from gap 0 on, the second spring from the layer's depth on. k is the
        law's stiffness and a the layer's share. Each stiffness is a number or (n_pairs,).
        """
        return self.layer_share * self.stiffness, (1.0 - self.layer_share) * self.stiffness

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces [N] for gaps g (..., n_pairs) [m]: the same shape.

        A gap g > 0 is penetration. The equation stands in :class:`LayeredPenalty`.
        """
        soft_layer_stiffness, deep_stiffness = self.row_stiffnesses
        soft_layer_force = soft_layer_stiffness * np.maximum(gap, 0.0)
        return soft_layer_force + deep_stiffness * np.maximum(gap - self.layer_depth, 0.0)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return the slopes d lambda / d g [N/m] of the contact forces lambda: the shape of g.

        Gaps g are (..., n_pairs) [m]. The slope is 0 in an open pair, a k in the layer, and k below
        the layer. k is the law's stiffness and a the layer's share.
        """
        soft_layer_stiffness, deep_stiffness = self.row_stiffnesses
        return soft_layer_stiffness * (gap > 0.0) + deep_stiffness * (gap > self.layer_depth)


@dataclass(frozen=True)
class SmoothedPenalty(_PenaltyBase):
    """Smoothed penalty: contact force lambda = k g (1/2 + arctan(s g) / pi) of a gap g.

    Equation 12 of Kharyton's paper (README), with the sign corrected. The law tends to the penalty
    law as the sharpness s grows, but not faster than 1/s. The force is smaller than the penalty
    law's by up to k / (pi s); an open crack feels this as a pull. Choose s so that k / (pi s) is
    small against the contact force.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k, the slope at large penetration.
    sharpness : float [1/m]
        s, the inverse of the gap over which the law bends.

    Raises
    ------
    InputError
        The stiffness or the sharpness is not positive and finite.
    """

    sharpness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(
            self, "sharpness", _checked_positive_number("contact sharpness", self.sharpness)
        )

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces [N] for gaps g (..., n_pairs) [m]: the same shape.

        With the stiffness k and the sharpness s, the forces are k g (1/2 + arctan(s g) / pi). A gap
        g > 0 is penetration.
        """
        return self.stiffness * gap * (0.5 + np.arctan(self.sharpness * gap) / np.pi)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return the slopes d lambda / d g [N/m] of the contact forces lambda: the shape of g.

        With the stiffness k, the sharpness s and the gaps g (..., n_pairs) [m],

            d lambda / d g = k (1/2 + arctan(s g) / pi + s g / (pi (1 + (s g)^2)))
        """
        x = self.sharpness * gap
        return self.stiffness * (0.5 + (np.arctan(x) + x / (1.0 + x * x)) / np.pi)


@dataclass(frozen=True)
class UnilateralConstraint:
    """Rigid contact, no penetration: g <= 0, lambda >= 0, lambda g = 0 (Signorini).

    g is the gap and lambda the contact force of a pair; g < 0 is an opening. The law is the penalty
    law with infinite stiffness, so the gap alone gives no force. If crack faces have no mass, the
    force follows from the slow gap s = g + R_inf lambda. R_inf is the static flexibility of the
    crack faces beyond the structure's modes. If crack faces have mass, truncated Fourier series of
    gap and force fulfil, with a weight eps,

        lambda = eps max(0, g + lambda / eps)

    Attributes
    ----------
    weight : float or None [N/m]
        eps > 0, for crack faces with mass. The truncated solution depends on it a little, and less
        with more harmonics. None: the weight, if needed, is the inverse of the static compliance at
        the pairs.
    """

    weight: float | None = None

    def __post_init__(self) -> None:
        if self.weight is not None:
            object.__setattr__(
                self, "weight", _checked_positive_number("contact weight", self.weight)
            )

    @property
    def stiffness(self) -> float:
        """Stiffness of rigid contact: infinite."""
        return np.inf

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Raise InputError: the force does not follow from the gap."""
        raise InputError(
            "contact",
            self,
            "a law whose force follows from the gap, such as UnilateralPenalty(1e9)",
        )

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Raise InputError: a rigid law has no slope d lambda / d g."""
        return self.force(gap)

    def scaled(self, factor: float) -> UnilateralConstraint:
        """Return this law: it has no finite stiffness to scale."""
        return self


@dataclass(frozen=True)
class CoulombFriction:
    """Coulomb friction with a law of normal contact, along a line for each pair.

        abs(lambda_t) <= mu lambda_n; h' = 0 if abs(lambda_t) < mu lambda_n, else lambda_t h' >= 0

    Both the normal force lambda_n and the tangential force lambda_t stand on the left of the
    equation of motion. The slider position h = g_t - lambda_t / k_t [m] is the tangential gap g_t
    less the elastic deformation. A closed pair sticks (h' = 0) or slips. One coefficient holds at
    rest and in motion.

    Attributes
    ----------
    law : UnilateralPenalty, LayeredPenalty or UnilateralConstraint
        Law of normal contact. Under the layered law, the layer and the contact below it have a
        slider each, with the layer's share of k_t and the rest.
    coefficient : float or (n_pairs,)
        mu.
    tangential_stiffness : float or (n_pairs,) [N/m]
        k_t; infinite: no elastic deformation before slip. Under the layered law it is finite.
    direction : (n_pairs,) [rad] or None
        In a solid, whose tangential gaps have two directions: the angle of each pair's sliding
        line, from the first to the second direction (:func:`fenics_crack.slide_along_lines`).
    turning : float or None
        Ratio of sliding across these lines to sliding along them, in the motion that gave the
        lines. None: the lines do not come from a motion.

    Raises
    ------
    InputError
        ``law`` is of another class, or the coefficient or the tangential stiffness is not positive.
        Or the tangential stiffness is infinite under the layered law.
    """

    law: Any
    coefficient: float | np.ndarray
    tangential_stiffness: float | np.ndarray = np.inf
    direction: np.ndarray | None = None
    turning: float | None = None

    def __post_init__(self) -> None:
        if not is_unilateral(self.law):
            requirement = "UnilateralPenalty, LayeredPenalty or UnilateralConstraint"
            raise InputError("law", self.law, requirement)
        mu = _checked_positive_number("friction coefficient", self.coefficient, allows_array=True)
        object.__setattr__(self, "coefficient", mu)
        if is_layered(self.law) or not np.array_equal(self.tangential_stiffness, np.inf):
            tangential_stiffness = _checked_positive_number(
                "tangential stiffness", self.tangential_stiffness, allows_array=True
            )
            object.__setattr__(self, "tangential_stiffness", tangential_stiffness)

    @property
    def stiffness(self) -> float | np.ndarray:
        """Stiffness of the normal contact law [N/m]."""
        return self.law.stiffness

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the normal forces [N] for normal gaps (..., n_pairs) [m]: the same shape.

        InputError: normal contact is rigid, so the forces do not follow from the gaps.
        """
        return np.asarray(self.law.force(gap))

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return the normal forces' slopes [N/m] for normal gaps (..., n_pairs) [m]: same shape.

        InputError: normal contact is rigid, so the slopes are infinite.
        """
        return np.asarray(self.law.tangent(gap))

    def scaled(self, factor: float) -> CoulombFriction:
        """Return this law with normal and tangential stiffness multiplied by a factor.

        The friction coefficient stays.
        """
        scaled_tangential_stiffness = np.multiply(factor, self.tangential_stiffness)
        return replace(
            self, law=self.law.scaled(factor), tangential_stiffness=scaled_tangential_stiffness
        )


def friction_of(contact: object) -> CoulombFriction | None:
    """Return the law itself if it has Coulomb friction, else None."""
    return contact if isinstance(contact, CoulombFriction) else None


def friction_coefficient_of(contact: object) -> float | np.ndarray | None:
    """Return a law's friction coefficient mu; None without friction."""
    return getattr(friction_of(contact), "coefficient", None)


def normal_law(contact: ContactLaw) -> ContactLaw:
    """Return a law without its friction: the law of normal contact."""
    return contact.law if isinstance(contact, CoulombFriction) else contact


def with_penalty_as_normal_law(contact: ContactLaw, stiffness: float) -> ContactLaw:
    """Replace a law's normal contact by the penalty law with a stiffness [N/m].

    Friction, if any, stays.
    """
    penalty = UnilateralPenalty(stiffness)
    return replace(contact, law=penalty) if isinstance(contact, CoulombFriction) else penalty


def add_pair_for_each_contact_force(contact: object, structure: Structure) -> Structure:
    """Return a structure with one contact pair for each scalar contact force of a law.

    Under the layered law, every gap is added a second time. The second copy of the normal gaps has
    the layer's depth as additional clearance. With friction, the tangential gaps are added as
    further pairs, after all normal gaps. Under any other law, the structure itself is returned.
    """
    friction, layered_law = friction_of(contact), layered_law_of(contact)
    line_angles = None if friction is None else friction.direction
    if layered_law is not None:
        structure = structure.with_parallel_copy_of_pairs(layered_law.layer_depth)
        line_angles = None if line_angles is None else np.tile(line_angles, 2)
    return structure if friction is None else structure.with_tangential_pairs(line_angles)


def law_of_rows(contact: ContactLaw, n_pairs: int) -> ContactLaw:
    """Return the law for a structure with one pair for each scalar contact force.

    The structure is made by :func:`add_pair_for_each_contact_force`. Under the layered law, every
    pair occurs twice in that structure. The penalty law with one stiffness for each copy, (2
    n_pairs,), is then returned; with friction, both copies have the same coefficient. Any other law
    is returned unchanged.

    Parameters
    ----------
    contact : ContactLaw
        Law of the original structure.
    n_pairs : int
        Number of pairs in the original structure.
    """
    if not is_layered(contact):
        return contact
    spring_stiffnesses = 1.0 / spring_compliances(contact, n_pairs)
    penalty = UnilateralPenalty(spring_stiffnesses[: 2 * n_pairs])
    friction = friction_of(contact)
    if friction is None:
        return penalty
    coefficient_of_each_pair = np.broadcast_to(friction.coefficient, n_pairs)
    return CoulombFriction(
        penalty, np.tile(coefficient_of_each_pair, 2), spring_stiffnesses[2 * n_pairs :]
    )


def spring_compliances(contact: ContactLaw, n_pairs: int) -> np.ndarray:
    """Return the compliances 1/k of all contact springs.

    Parameters
    ----------
    contact : ContactLaw
        Law with the spring stiffnesses k.
    n_pairs : int
        Number of contact pairs.

    Returns
    -------
    (n_rows,) [m/N]
        Compliance of each pair's normal spring. With friction, the compliances of all tangential
        springs follow. Under the layered law, in either direction the springs of the layer come
        first, then the springs below the layer.
    """
    friction, layered_law = friction_of(contact), layered_law_of(contact)
    pair_stiffnesses = [contact.stiffness]
    if friction is not None:
        pair_stiffnesses.append(friction.tangential_stiffness)
    stiffness_shares = [1.0]
    if layered_law is not None:
        stiffness_shares = [layered_law.layer_share, 1.0 - layered_law.layer_share]
    ones_per_pair = np.ones(n_pairs)
    return np.concatenate(
        [
            ones_per_pair / np.multiply(share, stiffness)
            for stiffness in pair_stiffnesses
            for share in stiffness_shares
        ]
    )


def count_rows_per_pair(contact: object) -> int:
    """Return the number of scalar contact forces of each pair.

    Each of friction and a layer doubles the number.
    """
    n_directions = 1 if friction_of(contact) is None else 2
    return n_directions * count_normal_rows_per_pair(contact)


def count_normal_rows_per_pair(contact: object) -> int:
    """Return the number of normal contact forces of each pair, and with friction of sliders.

    The number is 2 under the layered law, otherwise 1.
    """
    return 2 if is_layered(contact) else 1


def merge_layers_of_pairs(
    contact: object, n_pairs: int, gaps: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Merge the two springs of each pair under the layered law.

    The results are the pair's gap, and the sum of both spring forces; with friction in either
    direction. Under any other law, and if the springs are merged already, gaps and forces are
    returned unchanged.

    Parameters
    ----------
    contact : ContactLaw
        Contact law.
    n_pairs : int
        Number of contact pairs.
    gaps, forces : (n, n_rows) [m], [N]
        Values at n instants, or n Fourier coefficients, for the n_rows scalar contact forces
        (:func:`add_pair_for_each_contact_force`).

    Returns
    -------
    gaps, forces : (n, n_pairs) [m], [N]
        Values for each pair. With friction, (n, 2 n_pairs): all normal columns, then all tangential
        columns.
    """
    if not is_layered(contact):
        return gaps, forces
    n_directions = 1 if friction_of(contact) is None else 2
    row_gaps = gaps.reshape(len(gaps), n_directions, -1, n_pairs)
    row_forces = forces.reshape(len(forces), n_directions, -1, n_pairs)
    return (
        row_gaps[:, :, 0].reshape(len(gaps), -1),
        row_forces.sum(axis=2).reshape(len(forces), -1),
    )


def split_pairs_into_layers(
    contact: object, n_pairs: int, gaps: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Split each pair's gap and force into two springs, under the layered law.

    The first spring gets the gap of the pair. The second spring's mean gap is smaller by the
    layer's depth. The first spring gets the whole force, since both springs act on the structure
    alike. Under any other law, gaps and forces are returned unchanged.

    Parameters
    ----------
    gaps, forces : (2H+1, n_pairs) [m], [N]
        Fourier coefficients up to harmonic H of the pairs' gaps and total forces. With friction
        normal columns, then tangential ones: (2H+1, 2 n_pairs).

    Returns
    -------
    gaps, forces : (2H+1, n_rows) [m], [N]
        Coefficients of all first springs, then of all second springs; with friction the same for
        the tangential columns.
    """
    layered_law = layered_law_of(contact)
    if layered_law is None:
        return gaps, forces
    gaps_by_direction = gaps.reshape(len(gaps), -1, n_pairs)
    row_gaps = np.stack([gaps_by_direction, gaps_by_direction], axis=2)
    row_gaps[0, 0, 1] -= layered_law.layer_depth
    row_forces = np.zeros_like(row_gaps)
    row_forces[:, :, 0] = forces.reshape(len(forces), -1, n_pairs)
    return row_gaps.reshape(len(gaps), -1), row_forces.reshape(len(forces), -1)


@lru_cache
def gauss_rule(n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights of Gauss's rule on 0 to 1: (n_nodes,) each.

    The weights add up to 1: the rule averages contact forces along a line between two gaps.
    """
    nodes, weights = np.polynomial.legendre.leggauss(n_nodes)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def contact_energy(contact: ContactLaw, gap: np.ndarray) -> np.ndarray:
    """Return the contact energy of gaps g (..., n_pairs) [m]: the same shape [J].

    The energy is the integral of the law's contact force from gap 0 to g.
    """
    gauss_nodes, gauss_weights = gauss_rule(32)
    forces_at_nodes = contact.force(np.multiply.outer(gauss_nodes, gap))
    return np.asarray(gap * np.tensordot(gauss_weights, forces_at_nodes, 1))


def is_rigid(contact: object) -> TypeGuard[UnilateralConstraint]:
    """Return True for rigid normal contact (:class:`UnilateralConstraint`), also with friction.

    No force follows from the gap then.
    """
    return isinstance(getattr(contact, "law", contact), UnilateralConstraint)


def layered_law_of(contact: object) -> LayeredPenalty | None:
    """Return the layered law of normal contact, also with friction; None under any other law."""
    normal_contact = getattr(contact, "law", contact)
    return normal_contact if isinstance(normal_contact, LayeredPenalty) else None


def is_layered(contact: object) -> bool:
    """Return True for the layered law, in which each pair has two springs; also with friction."""
    return layered_law_of(contact) is not None


def is_piecewise_linear(contact: object) -> TypeGuard[UnilateralPenalty | LayeredPenalty]:
    """Return True if normal contact follows the penalty law, or the layered one."""
    return isinstance(getattr(contact, "law", contact), UnilateralPenalty | LayeredPenalty)


def is_unilateral(contact: object) -> bool:
    """Return True for the penalty law, the layered law and rigid contact, also with friction.

    Under these laws every spring is either open or closed. Exact integration between two contact
    events requires this.
    """
    return is_piecewise_linear(contact) or is_rigid(contact)


def check_law(structure: Structure, contact: Any, *, allows_rigid: bool = False) -> None:
    """Raise InputError unless an object is a contact law for a structure's pairs.

    :class:`UnilateralConstraint` passes only with ``allows_rigid``.
    """
    member_names = ("stiffness", "force", "tangent", "scaled")
    is_class = isinstance(contact, type)
    absent_members = [
        member_name for member_name in member_names if is_class or not hasattr(contact, member_name)
    ]
    if absent_members or (is_rigid(contact) and not allows_rigid):
        absent_text = f"; missing attributes: {', '.join(absent_members)}" if absent_members else ""
        raise InputError(
            "contact", contact, f"a contact law object such as UnilateralPenalty(1e9){absent_text}"
        )
    stiffness = np.asarray(contact.stiffness, dtype=np.float64)
    if stiffness.shape not in ((), (structure.n_pairs,)):
        requirement = f"one number, or an array ({structure.n_pairs},) with one per pair"
        raise InputError("contact stiffness", stiffness.shape, requirement)
    if not is_rigid(contact) and not np.all(np.isfinite(stiffness)):
        raise InputError("contact stiffness", contact, "finite; or use UnilateralConstraint()")
    if not is_unilateral(contact):
        _check_law_outputs(contact, structure.n_pairs)


def _check_law_outputs(law: ContactLaw, n_pairs: int) -> None:
    """Raise InputError unless a user's contact law returns valid values.

    For gaps (n, n_pairs), ``force`` and ``tangent`` must return finite arrays of the same shape.
    The tangents must be >= 0. ``scaled(0.5)`` must return a law of the same class with half the
    stiffness.
    """
    gap = np.outer([-MACHINE_EPSILON, 0.0, MACHINE_EPSILON], np.ones(n_pairs))
    law_name = type(law).__name__
    for method_name in ("force", "tangent"):
        try:
            output_values = floats_or_single_nan(getattr(law, method_name)(gap))
        except (ArithmeticError, TypeError, ValueError, IndexError):
            output_values = np.asarray(np.nan)
        if output_values.shape != gap.shape or not np.all(np.isfinite(output_values)):
            requirement = (
                f"a law whose {method_name}(gap) returns a finite number for each gap (n, n_pairs)"
            )
            raise InputError("contact", law_name, requirement)
    if np.any(output_values < -MACHINE_EPSILON * np.abs(output_values).max(initial=0.0)):
        raise InputError("contact", law_name, "a law whose tangent(gap) is a stiffness >= 0 [N/m]")
    try:
        law_with_half_stiffness = law.scaled(0.5)
        is_stiffness_halved = isinstance(law_with_half_stiffness, type(law)) and np.allclose(
            floats_or_single_nan(law_with_half_stiffness.stiffness),
            0.5 * floats_or_single_nan(law.stiffness),
            atol=0.0,
        )
    except (ArithmeticError, TypeError, ValueError):
        is_stiffness_halved = False
    if not is_stiffness_halved:
        requirement = (
            "a law whose scaled(factor) returns a law of the same class, factor times as stiff"
        )
        raise InputError("contact", law_name, requirement)


def check_slope(law: ContactLaw, gap: np.ndarray) -> None:
    """Raise InputError unless a law's tangent is the slope of its force.

    The tangent is compared with differences of the force at gaps (n, n_pairs) [m]. At a kink, any
    slope between both sides passes. The tolerance is 0.25 % of the slope, plus rounding.
    """
    gap_step = CENTRAL_DIFFERENCE_STEP * float(np.abs(gap).max(initial=0.0))
    forces = [
        np.asarray(law.force(gap + step_multiple * gap_step))
        for step_multiple in (-2.0, -1.0, 0.0, 1.0, 2.0)
    ]
    force_increments, expected_force_increment = (
        np.diff(forces, axis=0),
        gap_step * law.tangent(gap),
    )
    force_increment_size = np.maximum(
        np.abs(force_increments).max(axis=0), np.abs(expected_force_increment)
    )
    force_increment_mismatch = np.maximum(
        force_increments[1:3].min(axis=0) - expected_force_increment,
        expected_force_increment - force_increments[1:3].max(axis=0),
    )
    # The outer increments differ from the inner ones by rounding, or if the slope bends within a
    # step. Differences leave some digits; half of these may be wrong.
    force_increment_uncertainty = float(
        np.abs(force_increments[[0, 3]] - force_increments[[1, 2]]).max(initial=0.0)
    )
    if np.any(
        force_increment_mismatch
        > np.sqrt(CENTRAL_DIFFERENCE_STEP) * force_increment_size + force_increment_uncertainty
    ):
        requirement = "a law whose tangent(gap) is the derivative of force(gap)"
        raise InputError("contact", type(law).__name__, requirement)


def _checked_positive_number(
    key: str, number: object, *, allows_array: bool = False
) -> float | np.ndarray:
    """Return a finite number > 0, or an array of them; else raise InputError.

    ``key`` names the number in the error. Only ``allows_array`` lets an array (n,) pass.
    """
    number_array = floats_or_single_nan(number)
    is_all_positive = number_array.size > 0 and np.all(
        np.isfinite(number_array) & (number_array > 0.0)
    )
    if isinstance(number, str | bool) or number_array.ndim > allows_array or not is_all_positive:
        requirement = "a finite number > 0" + (
            ", or an array with one per pair" if allows_array else ""
        )
        raise InputError(key, number, requirement)
    return number_array.copy() if number_array.ndim else float(number_array)


class FrictionContactSolver:
    """Solver of contact with friction at successive instants.

    Each pair is open, sticks or slips. The matrices for a combination of these states are kept for
    later instants.

    Parameters
    ----------
    compliance_matrix : (2 n_pairs, 2 n_pairs) [m/N]
        D = R_inf + diag(1/k, 1/k_t): residual flexibility plus normal and tangential contact
        springs; normal gaps come first.
    coefficient : float or (n_pairs,)
        Friction coefficient mu.

    Attributes
    ----------
    compliance_matrix
        The parameter ``compliance_matrix``.
    """

    def __init__(self, compliance_matrix: np.ndarray, coefficient: float | np.ndarray) -> None:
        n_gaps = len(compliance_matrix)
        self.compliance_matrix = compliance_matrix = require_shape(
            compliance_matrix, n_gaps, n_gaps
        )
        friction_coefficients = np.ascontiguousarray(
            np.broadcast_to(coefficient, n_gaps // 2), dtype=float
        )
        # The kernel does not copy all of these.
        self._kernel_arrays = np.zeros((n_gaps, 1)), compliance_matrix, friction_coefficients
        max_numbers_in_memory = int(SETS_MEMORY_FRACTION * machine_memory()) // 8
        raw_handle = kernel.new_closed_sets(
            1, n_gaps // 2, *map(pointer, self._kernel_arrays), max_numbers_in_memory
        )
        self.handle = attach_destructor(raw_handle, kernel.free_closed_sets)
        """Solver object in the C kernel, freed together with this one."""

    def solve(
        self, gap: np.ndarray, slider_positions: np.ndarray, max_periods: int = 1
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Find contact forces instant by instant until the slider positions repeat.

        A slider position is the tangential gap at which a pair's tangential spring is relaxed. The
        positions repeat if they are the same as one period before, to 1e-12 of the largest gap.

        Parameters
        ----------
        gap : (n, 2 n_pairs) [m]
            Slow gaps s = g + R_inf lambda at n instants of a period. g are the gaps, lambda the
            contact forces, and R_inf the residual flexibility. Normal gaps come first.
        slider_positions : (n_pairs,) [m]
            Slider positions before the first instant.
        max_periods : int
            Number of periods after which the forces are returned, even if the positions do not
            repeat.

        Returns
        -------
        forces : (n, 2 n_pairs) [N]
            Forces in the last period, normal ones first.
        pair_states : (n, n_pairs) int
            0: open, 1: sticks, 2 and 3: slips with growing and with falling tangential gap.
        positions : (n, n_pairs) [m]
            Slider positions after each instant.
        last_unstuck_instants : (n_pairs,) int
            Index in the period of the last instant at which each pair did not stick; 0 if the pair
            always stuck.

        Raises
        ------
        ConvergenceError
            The contact forces at an instant do not exist, or are not unique.
        """
        n_instants, n_gaps = gap.shape
        gap = require_shape(gap, n_instants, n_gaps)
        start_slider_positions = np.array(slider_positions, dtype=float)
        forces, sampled_slider_positions = np.empty_like(gap), np.empty((n_instants, n_gaps // 2))
        pair_states = np.empty(sampled_slider_positions.shape, dtype=np.int8)
        last_unstuck_instant_by_pair = np.empty(n_gaps // 2, dtype=np.intc)
        array_pointers = map(
            pointer,
            (
                gap,
                start_slider_positions,
                forces,
                pair_states,
                sampled_slider_positions,
                last_unstuck_instant_by_pair,
            ),
        )
        if kernel.march_friction(self.handle, n_instants, max_periods, *array_pointers):
            raise ConvergenceError(
                "contact: the forces at an instant have no unique solution; lower contact.friction"
            )
        return forces, pair_states, sampled_slider_positions, last_unstuck_instant_by_pair


SETS_MEMORY_FRACTION = 1 / 32
"""Fraction of the machine's memory in which a solver or flow stores matrices of closed pairs.

Several processes, each with this much, must fit into the memory. To compute a matrix again takes
the time of five intervals of the exact flow, with a Taylor series each.
"""
MAX_SMOOTH_LAW_ITERATIONS = 200
"""Maximum number of iterations for contact forces of a smooth law, or by least squares."""
REGULAR_EIGENVALUE_RATIO: float = kernel.REGULAR_EIGENVALUE_RATIO
"""Smallest over largest eigenvalue, 1e-6, above which a compliance counts as regular.

Rigid contact can only be solved if the residual flexibility is regular. A penalty law that replaces
rigid contact has springs of this compliance, relative to the pairs' mean residual flexibility.
"""


def is_regular(matrix: np.ndarray) -> bool:
    """Return True if a symmetric matrix is positive definite beyond rounding.

    The smallest eigenvalue must exceed 1e-6 times the largest. A matrix without rows is regular.
    """
    eigenvalues = np.linalg.eigvalsh(matrix)
    return not len(eigenvalues) or bool(
        eigenvalues[0] > REGULAR_EIGENVALUE_RATIO * eigenvalues[-1] > 0.0
    )


class ActiveSetSolver:
    """Solver of contact without friction, by sets of closed pairs.

    The solver guesses which pairs are closed, solves for the forces, and corrects the guess. The
    inverse of the compliance D on each set is kept for later instants.

    Attributes
    ----------
    compliance_matrix : (n_pairs, n_pairs) [m/N]
        D = R_inf + diag(1/k): residual flexibility plus contact springs.
    """

    def __init__(self, compliance_matrix: np.ndarray) -> None:
        self.compliance_matrix = compliance_matrix = require_shape(
            compliance_matrix, len(compliance_matrix), len(compliance_matrix)
        )
        max_inverses = int(SETS_MEMORY_FRACTION * machine_memory()) // max(
            compliance_matrix.nbytes, 8
        )
        n_pairs = len(compliance_matrix)
        self.handle = attach_destructor(
            kernel.new_sets(n_pairs, pointer(compliance_matrix), max_inverses), kernel.free_sets
        )
        """Solver object in the C kernel, freed together with this one."""

    def invert_compliance_on_sets(self, sets: np.ndarray) -> np.ndarray:
        """Invert the compliance D on sets A of closed pairs, with zeros outside A.

        Parameters
        ----------
        sets : (m, n_pairs) bool
            True for the closed pairs of each set.

        Returns
        -------
        (m, n_pairs, n_pairs) [N/m]
            Inverse of D on each set: contact forces of the closed pairs by unit gaps.

        Raises
        ------
        ConvergenceError
            D is singular on a set.
        """
        is_closed = require_shape(sets, len(sets), len(self.compliance_matrix), kind=bool)
        inverse_matrices = np.empty((*is_closed.shape, is_closed.shape[1]))
        if kernel.invert_sets(
            self.handle, len(is_closed), pointer(is_closed), pointer(inverse_matrices)
        ):
            raise ConvergenceError(
                "contact: the compliance of the closed pairs is singular; "
                "use contact.law = 'penalty'"
            )
        return inverse_matrices

    def solve(
        self, gap: np.ndarray, is_closed: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find contact forces and closed pairs at each instant.

        Parameters
        ----------
        gap : (n, n_pairs) [m]
            Slow gaps s = g + R_inf lambda at n instants. g are the gaps, lambda the contact forces,
            and R_inf the residual flexibility.
        is_closed : (n, n_pairs) bool, optional
            First guess of the closed pairs. Default: pairs with s > 0.

        Returns
        -------
        (n, n_pairs) [N]
            Contact forces lambda.
        (n, n_pairs) bool
            True for closed pairs.

        Raises
        ------
        ConvergenceError
            The forces at an instant do not exist, or were not found: neither by correcting the set
            of closed pairs, nor by least squares.
        """
        gap = require_shape(gap, len(gap), len(self.compliance_matrix))
        closed_guess = gap > 0.0 if is_closed is None else np.array(is_closed)
        is_closed = require_shape(closed_guess, *gap.shape, kind=bool)
        forces, is_failed_instant = np.zeros_like(gap), np.empty(len(gap), dtype=bool)
        kernel.solve_instants(
            self.handle,
            len(gap),
            pointer(gap),
            pointer(is_closed),
            pointer(forces),
            pointer(is_failed_instant),
        )
        for failed_instant in np.flatnonzero(is_failed_instant):
            forces[failed_instant] = solve_complementarity_by_least_squares(
                self.compliance_matrix, gap[failed_instant]
            )
            is_closed[failed_instant] = forces[failed_instant] > 0.0
        return forces, is_closed


def solve_complementarity(
    matrix: np.ndarray, penetration: np.ndarray, is_closed: np.ndarray | None = None
) -> np.ndarray:
    """Find contact forces lambda without penetration, from a compliance D and gaps g.

        0 <= lambda,      D lambda - g >= 0,      lambda^T (D lambda - g) = 0

    A set of positions with lambda > 0 is guessed, and corrected step by step.

    Parameters
    ----------
    matrix : (n, n)
        D, positive definite, and nearly symmetric.
    penetration : (n,)
        g, the gaps without contact forces; g > 0 is penetration.
    is_closed : (n,) bool, optional
        First guess of the positions with lambda > 0.

    Returns
    -------
    (n,)
        lambda.

    Raises
    ------
    ConvergenceError
        There is no solution, or none was found.
    """
    closed_guess = None if is_closed is None else np.array(is_closed)[None]
    return np.asarray(
        ActiveSetSolver(matrix).solve(require_shape(penetration, len(matrix))[None], closed_guess)[
            0
        ][0]
    )


def solve_complementarity_by_least_squares(
    compliance_matrix: np.ndarray, penetration: np.ndarray
) -> np.ndarray:
    """Find contact forces lambda without penetration, from a compliance D and gaps g.

        0 <= lambda,      D lambda - g >= 0,      lambda^T (D lambda - g) = 0

    A slower method, for cases in which :class:`ActiveSetSolver` fails. The problem with the
    symmetric part of D is solved by non-negative least squares. An iteration of at most 200 steps
    adds the unsymmetric part.

    Parameters
    ----------
    compliance_matrix : (n, n)
        D, positive definite, and nearly symmetric.
    penetration : (n,)
        g, the gaps without contact forces; g > 0 is penetration.

    Returns
    -------
    (n,)
        lambda.

    Raises
    ------
    ConvergenceError
        There is no solution, or none was found.
    """
    import scipy.optimize  # takes a while, and is rarely needed

    symmetric_part = 0.5 * (compliance_matrix + compliance_matrix.T)
    unit_diagonal_scale = 1.0 / np.sqrt(np.maximum(np.diag(symmetric_part), np.finfo(float).tiny))
    eigenvalues, eigenvectors = np.linalg.eigh(
        unit_diagonal_scale[:, None] * symmetric_part * unit_diagonal_scale
    )
    sqrt_eigenvalues = np.sqrt(np.maximum(eigenvalues, 1e-15 * eigenvalues.max(initial=0.0)))
    tolerance = 1e-10 * float(np.abs(penetration).max(initial=0.0))
    forces = np.zeros(len(penetration))
    for _ in range(MAX_SMOOTH_LAW_ITERATIONS):
        least_squares_target = (
            eigenvectors.T
            @ (unit_diagonal_scale * (penetration - (compliance_matrix - symmetric_part) @ forces))
        ) / sqrt_eigenvalues
        try:
            forces = (
                unit_diagonal_scale
                * scipy.optimize.nnls((eigenvectors * sqrt_eigenvalues).T, least_squares_target)[0]
            )
        except RuntimeError:
            break
        openings = compliance_matrix @ forces - penetration
        if (
            openings.min() >= -tolerance
            and np.abs(openings[forces > 0.0]).max(initial=0.0) <= tolerance
        ):
            return forces
    raise ConvergenceError(
        "contact: no contact forces were found for a step; use contact.law = 'penalty'"
    )


def forces_and_slopes_of_smooth_law(
    law: ContactLaw, compliance: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find contact forces under a smooth law, and their derivatives by the gaps.

    The forces lambda satisfy lambda = h(s - D lambda). h is the law's force as a function of the
    gap. Newton's method starts from the solution with the penalty law of the same stiffness.

    Parameters
    ----------
    law : ContactLaw
        h; its force may not fall while the gap grows.
    compliance : (n_pairs, n_pairs) [m/N]
        D, the gap change by unit forces.
    gap : (n, n_pairs) [m]
        s, the gaps as they would be without contact forces, at n instants.

    Returns
    -------
    (n, n_pairs) [N]
        lambda.
    (n, n_pairs, n_pairs) [N/m]
        Derivative of lambda by s.

    Raises
    ------
    ConvergenceError
        Newton's method does not converge in 200 iterations, or meets a singular matrix.
    """
    spring_compliance = np.broadcast_to(1.0 / np.asarray(law.stiffness, dtype=float), gap.shape[1:])
    force_guess = ActiveSetSolver(compliance + np.diag(spring_compliance)).solve(gap)[0]
    forces = solve_contact_forces_by_newton(
        lambda g: (law.force(g), law.tangent(g)), compliance, gap, force_guess
    )
    law_slope = law.tangent(gap - forces @ compliance)
    identity_plus_compliance_slope = np.eye(gap.shape[1]) + compliance * law_slope[:, None, :]
    return forces, law_slope[:, :, None] * np.linalg.inv(identity_plus_compliance_slope)


def solve_contact_forces_by_newton(
    law_force_and_slope_function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    compliance: np.ndarray,
    gap: np.ndarray,
    guess: np.ndarray,
) -> np.ndarray:
    """Solve lambda = h(s - D lambda) for contact forces by Newton's method.

    All n instants are solved together. The law h gives each contact force lambda from the gap s - D
    lambda. The forces minimise a convex function. A Newton step beyond the minimum, where the
    function rises, is shortened.

    Parameters
    ----------
    law_force_and_slope_function : callable
        Gives the law's force h(g) and its derivative for gaps g (n, n_pairs), pair by pair; h may
        not fall while g grows.
    compliance : (n_pairs, n_pairs) [m/N]
        D, symmetric, the gap change by unit forces.
    gap : (n, n_pairs) [m]
        s, the gaps as they would be without contact forces.
    guess : (n, n_pairs) [N]
        First guess of lambda.

    Returns
    -------
    (n, n_pairs) [N]
        lambda.

    Raises
    ------
    ConvergenceError
        Newton's method does not converge in 200 iterations, or meets a singular matrix.
    """

    def gap_law_force_and_slope(force: np.ndarray, slow_gap: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the gaps under contact forces, and the law's forces and slopes at these gaps.

        The gaps are s - D lambda, with ``slow_gap`` s, compliance D and ``force`` lambda. All
        arrays are (n, n_pairs).
        """
        total_gap = slow_gap - force @ compliance
        return (total_gap, *law_force_and_slope_function(total_gap))

    forces_at_all_instants, unfinished_instants = np.array(guess), np.arange(len(gap))
    identity, (reached_gap, law_force, law_slope) = (
        np.eye(gap.shape[1]),
        gap_law_force_and_slope(forces_at_all_instants, gap),
    )
    for _ in range(MAX_SMOOTH_LAW_ITERATIONS):
        force, gap_at_unfinished_instants = (
            forces_at_all_instants[unfinished_instants],
            gap[unfinished_instants],
        )
        force_excess = force - law_force
        if not np.any(force_excess):
            return forces_at_all_instants
        try:
            newton_change = -np.linalg.solve(
                identity + law_slope[:, :, None] * compliance, force_excess[:, :, None]
            )
        except np.linalg.LinAlgError:
            break
        gap_change = newton_change[:, :, 0] @ compliance
        trial_forces = force + newton_change[:, :, 0]
        if not np.all(np.isfinite(trial_forces)):
            break
        forces_at_all_instants[unfinished_instants] = trial_forces
        gap_size = (
            np.abs(gap_at_unfinished_instants) + np.abs(gap_at_unfinished_instants - reached_gap)
        ).max(axis=1)
        is_instant_unfinished = np.abs(gap_change).max(axis=1) > ROUNDING * gap_size
        if not np.any(is_instant_unfinished):
            return forces_at_all_instants
        unfinished_instants = unfinished_instants[is_instant_unfinished]
        force, gap_at_unfinished_instants = (
            force[is_instant_unfinished],
            gap_at_unfinished_instants[is_instant_unfinished],
        )
        gap_change = gap_change[is_instant_unfinished]
        slope_tolerance = -0.1 * np.sum(gap_change * force_excess[is_instant_unfinished], axis=1)
        reached_gap, law_force, law_slope = gap_law_force_and_slope(
            forces_at_all_instants[unfinished_instants], gap_at_unfinished_instants
        )
        step_slopes = np.sum(
            gap_change * (forces_at_all_instants[unfinished_instants] - law_force), axis=1
        )
        is_step_too_long_at_instant = (slope_tolerance > 0.0) & (step_slopes > slope_tolerance)
        if np.any(is_step_too_long_at_instant):
            long_step_instant_indices, force_before_step = (
                unfinished_instants[is_step_too_long_at_instant],
                force[is_step_too_long_at_instant],
            )
            force_step = forces_at_all_instants[long_step_instant_indices] - force_before_step
            step_fractions = _minimising_step_fraction_by_instant(
                gap_law_force_and_slope,
                force_before_step,
                force_step,
                gap_at_unfinished_instants[is_step_too_long_at_instant],
                slope_tolerance[is_step_too_long_at_instant],
            )
            forces_at_all_instants[long_step_instant_indices] = (
                force_before_step + step_fractions[:, None] * force_step
            )
            reached_gap, law_force, law_slope = gap_law_force_and_slope(
                forces_at_all_instants[unfinished_instants], gap_at_unfinished_instants
            )
    raise ConvergenceError(
        "contact: Newton's method for a step's forces did not converge; lower contact.stiffness"
    )


def _minimising_step_fraction_by_instant(
    gap_and_law_force_function: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]],
    force_before_step: np.ndarray,
    force_step: np.ndarray,
    gap: np.ndarray,
    slope_tolerance: np.ndarray,
) -> np.ndarray:
    """Find the best fraction of a Newton step for contact forces, for each instant.

    The fraction minimises the convex function of :func:`solve_contact_forces_by_newton`. Bisection
    finds the zero of the slope along the step. The slow gap s is the gap without contact forces.
    Contact forces lambda reduce s to the gap s - D lambda, with the compliance D.

    Parameters
    ----------
    gap_and_law_force_function : callable
        Takes contact forces lambda and slow gaps s. The first two results are the gaps s - D lambda
        [m], and the law's contact forces [N] at these gaps, (n, n_pairs) each.
    force_before_step, force_step : (n, n_pairs) [N]
        Contact forces at the start of each step, and their change by a full step.
    gap : (n, n_pairs) [m]
        Slow gaps s at n instants.
    slope_tolerance : (n,) [J]
        Bisection ends if the magnitude of the slope along the step is at most this tolerance.

    Returns
    -------
    (n,)
        Fractions from 0 to 1.
    """
    gap_change = (
        gap_and_law_force_function(force_before_step, gap)[0]
        - gap_and_law_force_function(force_before_step + force_step, gap)[0]
    )  # D times the step
    step_fractions, half_width = np.full(len(force_before_step), 0.5), 0.5
    while half_width > MACHINE_EPSILON:
        trial_forces = force_before_step + step_fractions[:, None] * force_step
        slopes = np.sum(
            gap_change * (trial_forces - gap_and_law_force_function(trial_forces, gap)[1]), axis=1
        )
        is_slope_above_tolerance = np.abs(slopes) > slope_tolerance
        if not np.any(is_slope_above_tolerance):
            break
        half_width *= 0.5
        step_fractions -= np.where(is_slope_above_tolerance, np.copysign(half_width, slopes), 0.0)
    return step_fractions
