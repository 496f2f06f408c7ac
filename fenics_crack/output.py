"""Files for ParaView: mode shapes and one period of the breathing crack (VTK XML).

Everything is gathered on rank 0 and written there, with all nodes of quadratic elements.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pyvista

from fenics_crack.errors import InputError
from fenics_crack.modes import Modes
from fenics_crack.parallel import gather_rows, on_root
from fenics_crack.solution import PeriodicSolution
from fenics_crack.store import make_folder
from fenics_crack.structure import Structure

__all__ = ["NodalMesh", "write_modes", "write_period"]


class NodalMesh:
    """The whole mesh of a structure on every rank (collective to make).

    Attributes
    ----------
    points : (n_nodes, 2) [m]
        Node positions.
    cells : (n_cells, k) int
        Their nodes in VTK's order.
    size : float [m]
        Largest extent.
    """

    def __init__(self, structure: Structure) -> None:
        if structure.nodes is None:
            raise InputError("structure", "made from matrices", "made from a mesh, to be drawn")
        whole = structure.whole
        nodes, comm = structure.nodes, whole.comm
        self.structure = whole
        self.points = gather_rows(comm, nodes.points)
        self.size = float(np.ptp(self.points, axis=0).max())
        self._dofs = gather_rows(comm, nodes.dofs)
        self.cells = np.concatenate([c for c in comm.allgather(nodes.cells) if len(c)])
        self._vtk_type = nodes.vtk_type

    def field(self, rows: np.ndarray) -> np.ndarray:
        """Nodal vectors (m, n_nodes, 2) of dof values (m, n_local); zero where clamped."""
        comm = self.structure.comm
        whole = np.concatenate(comm.allgather(rows), axis=1)
        return np.where(self._dofs >= 0, whole[:, np.maximum(self._dofs, 0)], 0.0)

    def grid(self, displacement: np.ndarray) -> pyvista.UnstructuredGrid:
        """The mesh displaced by nodal vectors (n_nodes, 2) [m]."""
        points = np.zeros((len(self.points), 3))
        points[:, :2] = self.points + displacement
        count, nodes = self.cells.shape
        cells = np.column_stack([np.full(count, nodes), self.cells]).ravel()
        return pyvista.UnstructuredGrid(cells, np.full(count, self._vtk_type), points)


def write_modes(structure: Structure, modes: Modes, path: str | Path) -> None:
    """Write mode shapes as vector fields of one .vtu file (collective).

    The fields are called ``mode 1: 2302.9 rad/s`` and so on and scaled to a largest displacement of
    a tenth of the structure's size, ready for ParaView's Warp By Vector.
    """
    mesh = NodalMesh(structure)
    shapes = mesh.field(structure.expand(modes.shapes.T))

    def write() -> None:
        grid = mesh.grid(np.zeros_like(mesh.points))
        for number, (omega, shape) in enumerate(zip(modes.omega, shapes, strict=True), 1):
            grid[f"mode {number}: {omega:.1f} rad/s"] = _scaled(shape, 0.1 * mesh.size)
        make_folder(path)
        grid.save(str(path))

    on_root(structure.comm, write)


def write_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 60,
    magnification: float | None = None,
) -> float:
    """Write one period of a vibration as a time series for ParaView (collective).

    Parameters
    ----------
    solution : PeriodicSolution
        What to show.
    path : str or Path
        The .pvd file to open in ParaView; the frames (.vtu) go into a folder beside it.
    frames : int
        Instants in the period.
    magnification : float, optional
        The nodes are moved by the displacement times this; default: so that the largest
        displacement is a tenth of the structure's size.

    Returns
    -------
    float
        The magnification.

    Notes
    -----
    Point fields: ``displacement`` [m], true to scale; ``contact state``: 1 on a closed pair of lip
    nodes, 0 on an open one, -1 away from the lips; ``contact force`` [N] on each node of a pair.
    """
    structure = solution.structure.whole
    mesh = NodalMesh(structure)
    time = np.arange(frames) * solution.period / frames
    displacement = mesh.field(solution.displacement_field(time))
    force = solution.contact_force(time)
    on_pair = _node_of_pairs(structure)
    nodal_force = force @ on_pair.T
    closed = (force > 0.0).astype(float) @ on_pair.T
    state = np.where(on_pair.any(axis=1), np.minimum(closed, 1.0), -1.0)
    if magnification is None:
        largest = np.linalg.norm(displacement, axis=2).max()
        magnification = 0.1 * mesh.size / largest if largest > 0.0 else 1.0
    target = Path(path)

    def write() -> None:
        folder = target.with_suffix("")
        folder.mkdir(parents=True, exist_ok=True)
        entries = []
        for frame, instant in enumerate(time):
            grid = mesh.grid(magnification * displacement[frame])
            grid["displacement"] = np.pad(displacement[frame], ((0, 0), (0, 1)))
            grid["contact state"] = state[frame]
            grid["contact force"] = nodal_force[frame]
            grid.field_data["magnification"] = [magnification]
            name = f"{folder.name}/frame_{frame:04d}.vtu"
            grid.save(str(target.parent / name))
            entries.append(f'    <DataSet timestep="{instant:.12g}" file={quoteattr(name)}/>')
        lines = ['<VTKFile type="Collection" version="0.1">', "  <Collection>", *entries]
        target.write_text("\n".join([*lines, "  </Collection>", "</VTKFile>", ""]))

    on_root(structure.comm, write)
    return magnification


def _node_of_pairs(structure: Structure) -> np.ndarray:
    """1 where a node belongs to a pair, else 0: (n_nodes, n_pairs) on every rank (collective)."""
    assert structure.nodes is not None
    touched = structure.gap.copy()
    touched.data = np.abs(touched.data)
    dofs = structure.nodes.dofs
    local = np.where(dofs >= 0, dofs - structure.first_dof, structure.n_local)
    rows = np.vstack([touched.toarray(), np.zeros((1, structure.n_pairs))])
    return gather_rows(structure.comm, (rows[local].sum(axis=1) > 0.0).astype(float))


def _scaled(vectors: np.ndarray, largest: float) -> np.ndarray:
    """Three-dimensional vectors (n, 3) scaled to a largest length."""
    length = np.linalg.norm(vectors, axis=1).max()
    return np.pad(vectors * (largest / length if length > 0.0 else 0.0), ((0, 0), (0, 1)))
