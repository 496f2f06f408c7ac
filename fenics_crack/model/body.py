"""What of a structure never varies, and what does.

A structure is a body in a setting. Copies of it in other settings share the body: its matrices, and
all that has been computed from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.model.matrices import ReadOnlyArrays, read_only_rows
from fenics_crack.model.nodes import Clamp, Nodes, Pairs


@dataclass(frozen=True, eq=False)
class Body(ReadOnlyArrays):
    """The attributes of a structure as it was made; arrays are made read-only.

    The load and the clearance are those that weights and additions of a setting refer to. A mean
    load that rotation makes is part of this load, and no weight applies to it.
    """

    mass: Any
    stiffness: Any
    gap: Any
    force: np.ndarray
    clearance: np.ndarray
    damping: Any = None
    tangential: Any = None
    nodes: Nodes | None = None
    pairs: Pairs = field(default_factory=Pairs)
    watched: np.ndarray | None = None
    clamp: Clamp | None = None
    rotation: Any = None
    comm: MPI.Comm = None
    cached_results: dict[Callable[..., Any], Any] = field(default_factory=dict)
    """Results of :meth:`Structure.cached_result`."""
    matrix_results: dict[Callable[..., Any], Any] = field(default_factory=dict)
    """Those that follow from mass, stiffness and pairs: bodies that share these share it."""

    def __post_init__(self) -> None:
        if self.comm is None:
            object.__setattr__(self, "comm", self.mass.comm.tompi4py())
        for name in ("gap", "tangential"):
            if (rows := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_only_rows(rows))
        super().__post_init__()


MATRIX_INDEPENDENT_NAMES = {
    "force",
    "clearance",
    "damping",
    "clamp",
    "rotation",
    "watched",
    "tangential",
}
"""Attributes of a body on which none of :attr:`Body.matrix_results` depends."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What varies of a structure.

    Attributes
    ----------
    weights : float or (2K+1, 2K+1)
        Factor of the load, or the matrix that maps its rows to others.
    damping_factor : float
        Factor of the damping.
    clearance : float or (n_pairs,) [m]
        Added to that of each pair.
    watched_dof : int or None
        Dof of the whole structure for results to be requested of; None: the body's.
    """

    weights: float | np.ndarray = 1.0
    damping_factor: float = 1.0
    clearance: float | np.ndarray = 0.0
    watched_dof: int | None = None

    def combine_with(self, other: Setting) -> Setting:
        """This setting, varied by another."""
        watched = self.watched_dof if other.watched_dof is None else other.watched_dof
        weights, factor = np.dot(other.weights, self.weights), other.damping_factor
        clearance = other.clearance + self.clearance
        return Setting(weights, factor * self.damping_factor, clearance, watched)


DEFAULT_SETTING = Setting()
"""The setting in which a structure is made."""
