"""Files for ParaView: mode shapes and one period of the breathing crack (VTK XML).

Rank 0 writes all nodes, also those of quadratic elements.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.vtk_parts import (
    COMPONENTS,
    add_values,
    in_space,
    moved_grid,
    nodal_stress,
    von_mises,
)
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.parallel import gather_rows, on_root
from fenics_crack.scene.tables import Material
from fenics_crack.stages import begin
from fenics_crack.version import packaged
from fenics_crack.whole import write_together, write_whole

__all__ = ["PeriodFields", "write_modes", "write_period"]


def write_modes(modes: Modes, path: str | Path) -> None:
    """Write mode shapes as vector fields of one .vtu file (collective).

    The fields are called ``mode 1: 2302.9 rad/s`` and so on. Their largest displacement is a tenth
    of the structure's size, ready for ParaView's Warp By Vector; the field data ``magnification of
    mode 1`` is that displacement over the shape's own.

    Parameters
    ----------
    modes : Modes
        Of a structure with a mesh.
    path : str or Path
        The .vtu file.

    Raises
    ------
    InputError
        The structure has no mesh.

    Examples
    --------
    >>> fc.write_modes(fc.solve_modes(structure, 2), "modes.vtu")
    """
    mesh = NodalMesh(modes.structure)
    shapes = mesh.field(modes.structure.expand(modes.shapes.T))

    def write() -> None:
        grid = moved_grid(mesh)
        for number, (omega, shape) in enumerate(zip(modes.omega, shapes, strict=True), 1):
            factor = _tenth(shape, mesh.size)
            moved, name = in_space(factor * shape), f"mode {number}: {omega:.1f} rad/s"
            add_values(grid.GetPointData(), name, moved)
            add_values(grid.GetFieldData(), f"magnification of mode {number}", np.array([factor]))
        write_whole(path, _vtu(grid))

    on_root(mesh.structure.comm, write)


class PeriodFields:
    """Nodal fields of a vibration at n instants of one period, on every rank (collective to make).

    Parameters are those of :func:`write_period`.

    Attributes
    ----------
    mesh : NodalMesh
        The whole mesh.
    time : (n,) [s]
        Equally spaced from 0; the period itself is left out.
    displacement, load : (n, n_nodes, d) [m], [N]
        True to scale.
    force, areas : (n, n_pairs) [N], (n_pairs,) [m^2]
        Of the contact, and of one lip.
    pair_nodes : (n_nodes, n_pairs)
        1 where a node belongs to a pair, else 0; of a patch the two nodes in its middle.
    shares : (n_nodes, n_pairs)
        Of the pairs' pressures that at a node: of patches the pressure is linear between them.
    magnification : float
        Of the displacement in pictures.
    material : Material or None
        For stresses.
    """

    def __init__(
        self,
        solution: PeriodicSolution,
        frames: int = 36,
        magnification: float | None = None,
        material: Material | None = None,
    ) -> None:
        check_count("frames", frames, 1)
        if magnification is not None:
            check_number("magnification", magnification, 0.0, above=True)
        if material is not None and not isinstance(material, Material):
            raise InputError("material", material, "that of a scene (scene.material), or None")
        structure = solution.structure.whole
        self.mesh, self.material = NodalMesh(structure), material
        assert structure.pair_areas is not None
        self.time = np.arange(frames) * solution.period / frames
        self.displacement = self.mesh.field(solution.displacement_field(self.time))
        self.magnification = float(magnification or _tenth(self.displacement, self.mesh.size))
        self.force, self.areas = solution.contact_force(self.time), structure.pair_areas
        parts = self.mesh.field(structure.force).reshape(3, -1)
        load = evaluate(parts, solution.omega, self.time)
        self.load = load.reshape(self.displacement.shape)
        if self.mesh.dimension == 3 and structure.n_pairs:
            self.pair_nodes, self.shares = _of_patches(self.mesh, structure.pair_points)
        else:
            self.pair_nodes = self.shares = _nodes_of_pairs(structure)

    @property
    def cracked(self) -> bool:
        """Whether there are lips."""
        return len(self.mesh.lips if self.mesh.dimension == 2 else self.mesh.lip_facets) > 0

    def shown(self, frame: int) -> np.ndarray:
        """The magnified displacement of a frame: (n_nodes, d) [m]."""
        return self.magnification * self.displacement[frame]

    @property
    def colour(self) -> tuple[str, str]:
        """Name and unit of the field to colour by: with a material the von Mises stress."""
        return ("von Mises stress", "Pa") if self.material else ("displacement", "m")

    @cached_property
    def colour_values(self) -> np.ndarray:
        """That field, or the length of its vectors: (n, n_nodes)."""
        if self.material is None:
            return np.linalg.norm(self.displacement, axis=2)
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
        """Stresses xx, yy, xy: (n, n_nodes, 3) [Pa]; of a solid xx, yy, zz, xy, yz, xz."""
        assert self.material is not None
        return nodal_stress(self.mesh, self.displacement, self.material)

    def grid(self, frame: int) -> vtkUnstructuredGrid:
        """The magnified mesh of a frame with the point fields of :func:`write_period`."""
        force, displacement = self.force[frame], self.displacement[frame]
        grid = moved_grid(self.mesh, self.shown(frame))
        # Between two pairs a node is closed where both are.
        closed, seen = self.shares @ (force > 0.0), self.shares.sum(axis=1)
        fields = {
            "displacement": in_space(displacement),
            "contact state": np.where(seen > 0.0, 1.0 * (closed >= seen - 1e-9), -1.0),
            "contact force": self.pair_nodes @ force,
            "contact pressure": self.shares @ (force / self.areas),
        }
        if self.material is not None:
            fields["stress"] = self.stress[frame]
            fields["von Mises stress"] = von_mises(self.stress[frame])
        for name, values in fields.items():
            # as VTK's own, in half the time and space
            array = add_values(grid.GetPointData(), name, values.astype(np.float32))
            if name == "stress":
                for component, axes in enumerate(COMPONENTS[self.mesh.dimension]):
                    array.SetComponentName(component, axes)
        add_values(grid.GetFieldData(), "magnification", np.array([self.magnification]))
        return grid


def write_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 36,
    magnification: float | None = None,
    material: Material | None = None,
) -> float:
    """Write one period of a vibration as a time series for ParaView (collective).

    A script beside it, ``paraview --script=NAME_paraview.py``, shows the plate from the front,
    coloured by stress or displacement, says the magnification and plays the period once. Each frame
    has the ``magnification`` in its field data.

    Parameters
    ----------
    solution : PeriodicSolution
        What to show.
    path : str or Path
        The .pvd file to open in ParaView; the frames (.vtu) go into a folder beside it.
    frames : int
        Instants in the period.
    magnification : float, optional
        Factor of the displacement that moves the nodes; default: the largest displacement becomes a
        tenth of the structure's size.
    material : Material, optional
        Of the scene, for stresses.

    Returns
    -------
    float
        The magnification.

    Raises
    ------
    InputError
        The structure has no mesh, or an argument cannot be used.

    Notes
    -----
    Point fields, in single precision: ``displacement`` [m], true to scale; ``contact state``: 1 on
    a closed pair of lip nodes, 0 on an open one, -1 away from the lips; ``contact force`` [N] on
    each node of a pair, and ``contact pressure`` [Pa], that force over the pair's area (of a solid,
    whose pairs are patches, the force at their middles, and the pressure linear between): smooth
    along the lips if the contact stiffness is given per area. With a material: ``stress`` (xx, yy,
    xy; of a solid xx, yy, zz, xy, yz, xz) and ``von Mises stress`` [Pa]. At the tip and under the
    point load they grow without bound as the mesh is refined.

    Examples
    --------
    >>> magnification = fc.write_period(solution, "crack.pvd", frames=4)
    """
    begin(Path(path).name)
    fields = PeriodFields(solution, frames, magnification, material)
    target = Path(path)

    def write() -> None:
        names = [f"{target.stem}/frame_{frame:04d}.vtu" for frame in range(len(fields.time))]
        entries = [
            f'    <DataSet timestep="{instant:.12g}" file={quoteattr(name)}/>'
            for instant, name in zip(fields.time, names, strict=True)
        ]
        lines = ['<VTKFile type="Collection" version="0.1">', "  <Collection>", *entries]
        series = "\n".join([*lines, "  </Collection>", "</VTKFile>", ""])
        field, unit = fields.colour
        script = target.with_name(f"{target.stem}_paraview.py")
        words = {"script": script.name, "folder": str(target.parent.resolve()), "pvd": target.name}
        colours = {"field": field, "title": f"{field} [{unit}]", "end": fields.colour_end}
        colours["mode"] = f"{fields.mesh.dimension}D"
        colours["camera"] = CAMERAS[fields.mesh.dimension]
        colours["caption"] = f"displacement x {fields.magnification:.3g}"
        state = packaged("draw/paraview_state.txt")
        about = [(target, series), (script, state.format(**words, **colours))]
        frames = ((target.parent / name, _vtu(fields.grid(n))) for n, name in enumerate(names))
        write_together(itertools.chain(about, frames))

    on_root(fields.mesh.structure.comm, write)
    return fields.magnification


CAMERAS = {2: "view.ResetActiveCameraToNegativeZ()", 3: "view.ApplyIsometricView()"}
"""How a plate and a solid are looked at."""


def _vtu(grid: vtkUnstructuredGrid) -> str:
    """The text of a .vtu file; VTK itself says nothing of a file that it cannot finish."""
    fields, writer = grid.GetPointData(), vtkXMLUnstructuredGridWriter()
    fields.SetActiveScalars(fields.GetArrayName(0))  # what is coloured by at first
    writer.SetInputData(grid)
    writer.SetDataModeToBinary()
    writer.SetCompressionLevel(1)  # three times as quick, a hundredth larger; LZ4 not all read
    writer.WriteToOutputStringOn()
    writer.Write()
    return str(writer.GetOutputString())


def _nodes_of_pairs(structure: Structure) -> np.ndarray:
    """1 where a node belongs to a pair, else 0: (n_nodes, n_pairs) on every rank (collective)."""
    assert structure.nodes is not None
    dofs = structure.nodes.dofs
    local = np.where(dofs >= 0, dofs - structure.first_dof, structure.n_local)
    rows = np.vstack([structure.gap.toarray() != 0.0, np.zeros((1, structure.n_pairs))])
    return gather_rows(structure.comm, rows[local].any(axis=1).astype(float))


def _of_patches(mesh: NodalMesh, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1 at the two nodes in the middle of each patch, and the functions psi of the pressures at all
    nodes of the lips, which are linear between these and zero at the fronts: (n_nodes, n_pairs)
    each."""
    from scipy.spatial import cKDTree  # takes a while, for some pictures

    facets, near = mesh.boundary_facets[mesh.lip_facets], 1e-6 * mesh.size
    own = np.zeros((len(mesh.points), len(places)))
    corners = np.unique(facets)
    distance, pair = cKDTree(places).query(mesh.points[corners])
    own[corners[distance <= near], pair[distance <= near]] = 1.0
    shares = own.copy()
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = np.concatenate([ends, facets[:, [0, 2]]]) if facets.shape[1] == 4 else ends
    others = np.setdiff1d(np.arange(len(mesh.points)), corners)
    distance, edge = cKDTree(mesh.points[ends].mean(axis=1)).query(mesh.points[others])
    there = distance <= near
    shares[others[there]] = own[ends[edge[there]]].mean(axis=1)
    return own, shares


def _tenth(vectors: np.ndarray, size: float) -> float:
    """Factor that makes the longest of some vectors (..., 2) a tenth of a size; 1 if all are 0."""
    largest = np.linalg.norm(vectors, axis=-1).max()
    return float(0.1 * size / largest) if largest > 0.0 else 1.0
