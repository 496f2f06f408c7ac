"""The two parts of a structure: the constant body and the variable setting.

The body holds the matrices, the load and all results from them. The setting holds factors of load
and damping and an added clearance. Copies of a structure in other settings share the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.model.matrices import ReadOnlyArrays, read_only_csr_matrix
from fenics_crack.model.nodes import ClampReactionData, Nodes, Pairs


@dataclass(frozen=True, eq=False)
class Body(ReadOnlyArrays):
    """Constant data of a structure: matrices, load, gaps; arrays are read-only.

    Fields have the names and meanings of attributes in :class:`Structure`. The values are those
    before variation: a :class:`LoadDampingClearanceSetting` holds the factors and the added
    clearance. The load includes the mean load due to rotation.
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
    clamp: ClampReactionData | None = None
    rotation: Any = None
    comm: MPI.Comm = None
    result_cache: dict[Callable[..., Any], Any] = field(default_factory=dict)
    """Results of :meth:`Structure.compute_once`; the key is the function that computes them."""
    cache_of_matrix_results: dict[Callable[..., Any], Any] = field(default_factory=dict)
    """Results that depend on mass, stiffness and pairs alone; the key is their function.

    Bodies with the same matrices and pairs share this dictionary.
    """

    def __post_init__(self) -> None:
        if self.comm is None:
            object.__setattr__(self, "comm", self.mass.comm.tompi4py())
        for field_name in ("gap", "tangential"):
            if (gap_matrix_or_none := getattr(self, field_name)) is not None:
                object.__setattr__(self, field_name, read_only_csr_matrix(gap_matrix_or_none))
        super().__post_init__()


FIELD_NAMES_THAT_KEEP_MATRIX_CACHE = {
    "force",
    "clearance",
    "damping",
    "clamp",
    "rotation",
    "watched",
    "tangential",
}
"""Attributes of a body that :attr:`Body.cache_of_matrix_results` does not depend on."""


@dataclass(frozen=True, eq=False)
class LoadDampingClearanceSetting:
    """Changes by which a copy of a structure differs: load, damping, clearance, watched dof.

    Attributes
    ----------
    load_factor_or_harmonic_matrix : float or (2K+1, 2K+1)
        Factor of the load, or matrix that multiplies the load's rows: mean, then cosine and sine
        part of each harmonic 1 to K.
    damping_multiplier : float
        Factor of the damping.
    added_clearance : float or (n_pairs,) [m]
        Clearance added to each pair.
    watched_dof : int or None
        Dof for results without a named dof, numbered in the whole structure. None:
        :attr:`DofsAndContactPairs.watched_dof` selects the dof.
    """

    load_factor_or_harmonic_matrix: float | np.ndarray = 1.0
    damping_multiplier: float = 1.0
    added_clearance: float | np.ndarray = 0.0
    watched_dof: int | None = None

    def combine_with(
        self, later_setting: LoadDampingClearanceSetting
    ) -> LoadDampingClearanceSetting:
        """Return the setting that has the effect of this one and then a later one.

        Factors of load and damping are multiplied, and added clearances are summed. The watched dof
        is the later setting's, or this setting's if the later has none.
        """
        watched_dof = (
            self.watched_dof if later_setting.watched_dof is None else later_setting.watched_dof
        )
        load_weights = np.dot(
            later_setting.load_factor_or_harmonic_matrix, self.load_factor_or_harmonic_matrix
        )
        damping_factor = later_setting.damping_multiplier * self.damping_multiplier
        added_clearance = later_setting.added_clearance + self.added_clearance
        return LoadDampingClearanceSetting(
            load_weights, damping_factor, added_clearance, watched_dof
        )


SETTING_WITHOUT_CHANGES = LoadDampingClearanceSetting()
"""Setting of a new structure: factors of 1, no added clearance, and no chosen watched dof."""
