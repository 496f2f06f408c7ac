"""Contact laws: force on a pair of lip nodes from its closing g (g > 0: penetration).

A law is a function of the gap alone, pair by pair; the force enters the equation of motion on the
left, M u'' + C u' + K u + B lambda(g) = f, so lambda >= 0 pushes the lips apart. To add a law,
write a class with the three members of :class:`ContactLaw`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from fenics_crack import scene as tables
from fenics_crack.errors import InputError
from fenics_crack.structure import Structure

__all__ = [
    "ContactLaw",
    "SmoothedPenalty",
    "UnilateralConstraint",
    "UnilateralPenalty",
    "contact_law",
]

Law = TypeVar("Law", bound="ContactLaw")


class ContactLaw(Protocol):
    """What every contact law has."""

    @property
    def stiffness(self) -> float | np.ndarray:
        """Largest tangent, of a firmly closed pair: one for all pairs or (n_pairs,) [N/m]."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) for gaps (..., n_pairs) [m]: the same shape [N]."""

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g for gaps (..., n_pairs) [m]: the same shape [N/m]."""

    def scaled(self: Law, factor: float) -> Law:
        """Return the same law with its stiffness multiplied by a factor."""


@dataclass(frozen=True)
class UnilateralPenalty:
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

    stiffness: float | np.ndarray

    def __post_init__(self) -> None:
        _check_positive("contact stiffness", self.stiffness)

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) [N]."""
        return self.stiffness * np.maximum(gap, 0.0)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g [N/m]."""
        return self.stiffness * (gap > 0.0)

    def scaled(self, factor: float) -> UnilateralPenalty:
        """The same law with factor * k."""
        return replace(self, stiffness=factor * self.stiffness)


@dataclass(frozen=True)
class SmoothedPenalty:
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

    stiffness: float | np.ndarray
    sharpness: float

    def __post_init__(self) -> None:
        _check_positive("contact stiffness", self.stiffness)
        _check_positive("contact sharpness", self.sharpness)

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) [N]."""
        return self.stiffness * gap * (0.5 + np.arctan(self.sharpness * gap) / np.pi)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g = k (1/2 + arctan(s g)/pi + s g / (pi (1 + (s g)^2))) [N/m]."""
        x = self.sharpness * gap
        return self.stiffness * (0.5 + (np.arctan(x) + x / (1.0 + x * x)) / np.pi)

    def scaled(self, factor: float) -> SmoothedPenalty:
        """The same law with factor * k."""
        return replace(self, stiffness=factor * self.stiffness)


@dataclass(frozen=True)
class UnilateralConstraint:
    """No penetration at all: g <= 0, lambda >= 0, lambda g = 0 (Signorini).

    The limit of the penalty law for k to infinity, balanced in frequency: with the truncated waves
    of gap and force, lambda = eps max(0, g + lambda / eps). Not a law that gives the force from
    the gap.

    Attributes
    ----------
    weight : float or None [N/m]
        eps > 0; the truncated solution depends on it a little, and less the more harmonics there
        are. None: the inverse of the static compliance that the pairs see.
    """

    weight: float | None = None

    def __post_init__(self) -> None:
        if self.weight is not None:
            _check_positive("contact weight", self.weight)


def contact_law(
    contact: tables.Contact, structure: Structure | None = None
) -> UnilateralPenalty | SmoothedPenalty | UnilateralConstraint:
    """The law that a scene's contact table describes.

    A stiffness per area [N/m^3] becomes that of each pair [N/m] by the structure's ``pair_areas``,
    so that refining the mesh does not change the physics.

    Raises
    ------
    InputError
        There is a stiffness per area, and no structure with areas.
    """
    if contact.law == "constraint":
        return UnilateralConstraint()
    stiffness: float | np.ndarray | None = contact.stiffness
    if contact.stiffness_per_area is not None:
        if structure is None or structure.pair_areas is None:
            raise InputError(
                "contact.stiffness_per_area",
                contact.stiffness_per_area,
                "used with a structure made from a mesh",
            )
        stiffness = contact.stiffness_per_area * structure.pair_areas
    assert stiffness is not None
    if contact.law == "smoothed":
        assert contact.sharpness is not None
        return SmoothedPenalty(stiffness, contact.sharpness)
    return UnilateralPenalty(stiffness)


def _check_positive(key: str, value: object) -> None:
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.asarray(np.nan)
    if numbers.ndim > 1 or not np.all(np.isfinite(numbers)) or np.any(numbers <= 0.0):
        raise InputError(key, value, "a finite number > 0, or one per pair")
