"""Contact laws: force on a pair of lip nodes from its closing g (g > 0: penetration).

A law is a function of the gap alone, pair by pair; the force enters the equation of motion on the
left, M u'' + C u' + K u + B lambda(g) = f, so lambda >= 0 pushes the lips apart. To add a law,
write a class with the four members of :class:`ContactLaw`.

What else a method needs to know of a law, :func:`is_unilateral`, :func:`is_rigid` and
:func:`is_piecewise_linear` answer: no other module looks at a law's class.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, Self, TypeGuard

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.model.matrices import numbers
from fenics_crack.model.structure import Structure

__all__ = [
    "ContactLaw",
    "SmoothedPenalty",
    "UnilateralConstraint",
    "UnilateralPenalty",
    "check_law",
    "gauss",
    "is_piecewise_linear",
    "is_rigid",
    "is_unilateral",
]


class ContactLaw(Protocol):
    """What every contact law has."""

    @property
    def stiffness(self) -> float | np.ndarray:
        """Largest tangent, of a firmly closed pair: one for all pairs or (n_pairs,) [N/m]."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) for gaps (..., n_pairs) [m]: the same shape [N]."""

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g for gaps (..., n_pairs) [m]: the same shape [N/m]."""

    def scaled(self, factor: float) -> Self:
        """Return the same law with its stiffness multiplied by a factor."""


@dataclass(frozen=True)
class _Penalty:
    """What the laws with a penalty stiffness share."""

    stiffness: float | np.ndarray

    def __post_init__(self) -> None:
        stiffness = _positive("contact stiffness", self.stiffness, each_pair=True)
        object.__setattr__(self, "stiffness", stiffness)

    def scaled(self, factor: float) -> Self:
        """The same law with factor * k."""
        return replace(self, stiffness=np.multiply(factor, self.stiffness))


@dataclass(frozen=True)
class UnilateralPenalty(_Penalty):
    """Penalty law: lambda = k g for g > 0, else 0 (paper, eq. 11).

    The tangent jumps from 0 to k where the pair closes; at g = 0 itself it is 0.

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
        """lambda(g) [N]."""
        return self.stiffness * np.maximum(gap, 0.0)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g [N/m]."""
        return self.stiffness * (gap > 0.0)


@dataclass(frozen=True)
class SmoothedPenalty(_Penalty):
    """Smoothed penalty: lambda = k g (1/2 + arctan(s g) / pi) (paper, eq. 12, sign corrected).

    It tends to the penalty law as s grows, but not faster than 1/s: an open crack keeps feeling a
    pull of k / (pi s), and at the same distance into contact k / (pi s) is missing. Choose s so
    that this is small against the contact force.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k.
    sharpness : float [1/m]
        s.

    Raises
    ------
    InputError
        The stiffness or the sharpness is not positive and finite.
    """

    sharpness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "sharpness", _positive("contact sharpness", self.sharpness))

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) [N]."""
        return self.stiffness * gap * (0.5 + np.arctan(self.sharpness * gap) / np.pi)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g = k (1/2 + arctan(s g)/pi + s g / (pi (1 + (s g)^2))) [N/m]."""
        x = self.sharpness * gap
        return self.stiffness * (0.5 + (np.arctan(x) + x / (1.0 + x * x)) / np.pi)


@dataclass(frozen=True)
class UnilateralConstraint:
    """No penetration at all: g <= 0, lambda >= 0, lambda g = 0 (Signorini).

    The limit of the penalty law for k to infinity. It gives no force from the gap alone. Where
    pairs are seen through a static compliance (:class:`fenics_crack.Problem`) the force follows
    from the slow gap; else it is balanced in frequency, with the truncated waves of gap and force,
    lambda = eps max(0, g + lambda / eps).

    Attributes
    ----------
    weight : float or None [N/m]
        eps > 0, for lips with mass; the truncated solution depends on it a little, and less the
        more harmonics there are. None: where one is needed, the inverse of the static compliance
        that the pairs see.
    """

    weight: float | None = None

    def __post_init__(self) -> None:
        if self.weight is not None:
            object.__setattr__(self, "weight", _positive("contact weight", self.weight))

    @property
    def stiffness(self) -> float:
        """Infinite."""
        return np.inf

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Refused: it does not follow from the gap."""
        raise InputError("contact", self, "a law that gives the force from the gap")

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Refused likewise."""
        return self.force(gap)

    def scaled(self, factor: float) -> UnilateralConstraint:
        """The same: nothing is stiffer."""
        return self


@lru_cache
def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's nodes between 0 and 1, and their weights: for means of forces between two gaps."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def is_rigid(contact: object) -> TypeGuard[UnilateralConstraint]:
    """Whether no force follows from the gap: :class:`UnilateralConstraint`."""
    return isinstance(contact, UnilateralConstraint)


def is_piecewise_linear(contact: object) -> TypeGuard[UnilateralPenalty]:
    """Whether lambda = k max(0, g), linear between switching instants: the penalty law."""
    return isinstance(contact, UnilateralPenalty)


def is_unilateral(contact: object) -> bool:
    """Whether a pair is open or closed and nothing between, so that exact integrals and flows know
    its law: the penalty law, or the constraint."""
    return is_piecewise_linear(contact) or is_rigid(contact)


def check_law(structure: Structure, contact: Any, *, rigid: bool = False) -> None:
    """Raise InputError unless an object is a contact law for a structure's pairs.

    :class:`UnilateralConstraint` is one only with ``rigid``.
    """
    members = ("stiffness", "force", "tangent", "scaled")
    known = not isinstance(contact, type) and all(hasattr(contact, name) for name in members)
    if not known or (is_rigid(contact) and not rigid):
        raise InputError("contact", contact, "a contact law such as UnilateralPenalty(1e9)")
    stiffness = np.asarray(contact.stiffness, dtype=np.float64)
    if stiffness.shape not in ((), (structure.n_pairs,)):
        allowed = f"one number or {structure.n_pairs}, one per pair"
        raise InputError("contact stiffness", stiffness.shape, allowed)
    if not is_rigid(contact) and not np.all(np.isfinite(stiffness)):
        raise InputError("contact stiffness", contact, "finite")


def _positive(key: str, value: object, *, each_pair: bool = False) -> float | np.ndarray:
    """A number > 0, or an array of them, one per pair; else InputError."""
    found = numbers(value)
    positive = found.size > 0 and np.all(np.isfinite(found) & (found > 0.0))
    if isinstance(value, str | bool) or found.ndim > each_pair or not positive:
        allowed = "a finite number > 0" + (", or one per pair" if each_pair else "")
        raise InputError(key, value, allowed)
    return found.copy() if found.ndim else float(found)
