"""One period of a vibration on its mesh: displacements, stresses, contact and load at each instant.

Stresses follow from the gradient of the displacement, taken in the cells at each node and averaged;
the lips have nodes of their own, so nothing is averaged across the crack.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.tables import Material

__all__ = ["PeriodFields", "magnifying", "nodal_stress", "von_mises"]

LONGEST = 0.1
"""Of the displacements of files and animations, relative to the size of the structure."""


@dataclass(frozen=True)
class PeriodFields:
    """Nodal fields of a vibration at n instants of one period, on every rank."""

    mesh: NodalMesh
    time: np.ndarray  # (n,) [s], equally spaced from 0; the period itself is left out
    displacement: np.ndarray  # (n, n_nodes, 2) [m], true to scale
    force: np.ndarray  # (n, n_pairs) [N], of the contact
    areas: np.ndarray  # (n_pairs,) [m^2], of one lip
    load: np.ndarray  # (n, n_nodes, 2) [N]
    pair_nodes: np.ndarray  # (n_nodes, n_pairs), 1 where a node belongs to a pair, else 0
    magnification: float  # of the displacement in pictures
    material: Material | None  # for stresses

    @classmethod
    def of(
        cls,
        solution: PeriodicSolution,
        frames: int = 60,
        magnification: float | None = None,
        material: Material | None = None,
    ) -> PeriodFields:
        """The fields of a solution, arguments as of :func:`fenics_crack.write_period`
        (collective)."""
        check_count("frames", frames, 1)
        if magnification is not None:
            check_number("magnification", magnification, 0.0, above=True)
        if material is not None and not isinstance(material, Material):
            raise InputError("material", material, "that of a scene (scene.material), or None")
        structure = solution.structure.whole
        mesh = NodalMesh(structure)
        time = np.arange(frames) * solution.period / frames
        displacement = mesh.field(solution.displacement_field(time))
        magnification = float(magnification or magnifying(displacement, mesh.size))
        force, areas = solution.contact_force(time), structure.pair_areas
        load = evaluate(mesh.field(structure.force).reshape(3, -1), solution.omega, time)
        load = load.reshape(displacement.shape)
        assert areas is not None
        nodes = _nodes_of_pairs(structure)
        return cls(mesh, time, displacement, force, areas, load, nodes, magnification, material)

    @cached_property
    def places(self) -> np.ndarray:
        """The nodes, moved by the magnified displacement: (n, n_nodes, 2) [m]."""
        return np.asarray(self.mesh.points + self.magnification * self.displacement)

    @property
    def colour(self) -> tuple[str, str]:
        """Name and unit of the field to colour by: with a material the von Mises stress."""
        return ("von Mises stress", "Pa") if self.material else ("displacement", "m")

    @cached_property
    def colour_values(self) -> np.ndarray:
        """That field, or the length of its vectors: (n, n_nodes)."""
        if self.material is None:
            return np.asarray(np.linalg.norm(self.displacement, axis=2))
        return von_mises(self.stress)

    @property
    def colour_end(self) -> float:
        """End of the colour scale of the whole period, which begins at 0.

        The stresses of one node in 50 lie beyond: at the tip and under the load they are unbounded.
        """
        largest = self.colour_values.max(axis=0)
        end = largest.max() if self.material is None else np.quantile(largest, 0.98)
        return float(end) if end > 0.0 else 1.0

    @cached_property
    def stress(self) -> np.ndarray:
        """Stresses xx, yy, xy: (n, n_nodes, 3) [Pa]."""
        assert self.material is not None
        return nodal_stress(self.mesh, self.displacement, self.material)


def magnifying(vectors: np.ndarray, size: float) -> float:
    """Factor that makes the longest of some vectors (..., 2) a tenth of a size; 1 if all are 0."""
    largest = np.linalg.norm(vectors, axis=-1).max()
    return float(LONGEST * size / largest) if largest > 0.0 else 1.0


def nodal_stress(mesh: NodalMesh, displacement: np.ndarray, material: Material) -> np.ndarray:
    """Plane stresses xx, yy, xy of nodal displacements (..., n_nodes, 2) [m]: (..., n_nodes, 3)
    [Pa]."""
    cells, columns = mesh.cells, np.moveaxis(displacement, -2, 0)
    count, inside = len(columns), _reference_gradients(cells.shape[1])
    jacobian = np.einsum("dnk,ckx->cndx", inside, mesh.points[cells])
    own = np.einsum("cnxd,dnk->xcnk", np.linalg.inv(jacobian), inside)
    share = own / np.bincount(cells.ravel(), minlength=count)[cells][:, :, None]
    of_nodes, by_nodes = np.broadcast_arrays(cells[:, :, None], cells[:, None, :])
    places = of_nodes.ravel(), by_nodes.ravel()
    along_x, along_y = (
        np.moveaxis(
            (coo_matrix((part.ravel(), places), (count, count)) @ columns.reshape(count, -1))
            .reshape(columns.shape), 0, -2,
        )
        for part in share
    )  # fmt: skip
    strain = np.stack(
        [along_x[..., 0], along_y[..., 1], along_x[..., 1] + along_y[..., 0]], axis=-1
    )
    nu = material.poisson
    plane = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]])
    return np.asarray(strain @ (material.young / (1.0 - nu**2) * plane))


def _reference_gradients(count: int) -> np.ndarray:
    """Derivatives of the shape functions of a reference cell with ``count`` nodes, in VTK's order,
    at these: (2, nodes, functions)."""
    triangle, order = count in (3, 6), 1 if count in (3, 4) else 2
    corners = np.array([(0, 0), (1, 0), (0, 1)] if triangle else [(0, 0), (1, 0), (1, 1), (0, 1)])
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    x, y = np.vstack([corners, middles, [[0.5, 0.5]]])[:count].T[..., None]
    steps = range(order + 1)
    i, j = np.array([(i, j) for i in steps for j in steps if not triangle or i + j <= order]).T
    slopes = i * x ** np.maximum(i - 1, 0) * y**j, j * x**i * y ** np.maximum(j - 1, 0)
    return np.asarray(np.stack(slopes) @ np.linalg.inv(x**i * y**j))


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress of plane stresses xx, yy, xy (..., 3): (...) [Pa]."""
    xx, yy, xy = np.moveaxis(stress, -1, 0)
    return np.asarray(np.sqrt(xx**2 - xx * yy + yy**2 + 3.0 * xy**2))


def _nodes_of_pairs(structure: Structure) -> np.ndarray:
    """1 where a node belongs to a pair, else 0: (n_nodes, n_pairs) on every rank (collective)."""
    assert structure.nodes is not None
    dofs = structure.nodes.dofs
    local = np.where(dofs >= 0, dofs - structure.first_dof, structure.n_local)
    rows = np.vstack([structure.gap.toarray() != 0.0, np.zeros((1, structure.n_pairs))])
    return gather_rows(structure.comm, rows[local].any(axis=1).astype(float))
