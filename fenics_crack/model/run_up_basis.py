"""The basis of a run-up: a rotating structure reduced once for a range of speeds."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.model.damping import DampingRule
from fenics_crack.model.matrices import distributed
from fenics_crack.model.modes import mass_norms, times
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.run_up import Ritz, RunUpStructure
from fenics_crack.model.structure import Structure

__all__ = ["run_up_structure"]

SPEEDS = 3
"""Speeds of a range whose bases are put together."""
INDEPENDENT = 1e-6
"""Part of a vector that is not in the basis yet, relative to it, from which it is kept."""


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
        How many modes of each speed are in the basis.

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
    basis: np.ndarray = np.zeros((structure.n_local, 0))
    for speed in np.linspace(start, stop, SPEEDS):
        part = reduce_structure(rotation.at(float(speed)), modes=modes, method="free_interface")
        basis = np.hstack([basis, _new_part(structure, basis, part.basis)])
    here = rotation.at(rotation.speed)

    def projected(matrix: object) -> np.ndarray:
        found = structure.sum_over_ranks(basis.T @ times(matrix, basis))
        return np.asarray(0.5 * (found + found.T))

    squares, shapes = scipy.linalg.eigh(projected(here.stiffness))
    basis = basis @ (shapes / np.sqrt(squares))  # K = I at the structure's own speed
    ritz = Ritz(
        structure,
        basis,
        rotation.speed,
        projected(rotation.stiffness),
        1.0 / squares,
        structure.sum_over_ranks(rotation.at_rest.force @ basis),
        structure.sum_over_ranks(rotation.force @ basis),
        distributed(sparse.diags(1.0 / squares), MPI.COMM_SELF),
        sparse.csr_matrix(structure.apply_bt(basis.T)),
        modes,
    )
    return RunUpStructure(ritz, rotation.speed)


def _new_part(structure: Structure, basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What columns add to a basis, M-orthonormal."""
    sizes = mass_norms(structure, columns)
    for _ in range(2):  # once more against rounding
        seen = structure.sum_over_ranks(basis.T @ times(structure.mass, columns))
        columns = columns - basis @ seen
    left = mass_norms(structure, columns)
    columns = columns[:, left > INDEPENDENT * sizes] / left[left > INDEPENDENT * sizes]
    for _ in range(2):
        gram = structure.sum_over_ranks(columns.T @ times(structure.mass, columns))
        weights, vectors = np.linalg.eigh(gram)
        kept = weights > INDEPENDENT * weights.max(initial=0.0)
        columns = columns @ (vectors[:, kept] / np.sqrt(weights[kept]))
    return columns
