"""Drawing and writing by VTK and pyvista: points, cells and values, the camera that looks at them,
stresses, and files for ParaView (VTK XML): mode shapes and one period of the breathing crack.

Stresses at the nodes of a mesh, and at points of it, follow from the gradient of the displacement
in the cells at each node, averaged; the crack faces have nodes of their own, so nothing is averaged
across the crack. Files have all nodes, also those of quadratic elements; rank 0 writes them.
"""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.sparse import csr_matrix
from vtkmodules.vtkCommonDataModel import VTK_LINE
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import check_inner, write_together, write_whole
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.draw.figure import tenth
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate_series
from fenics_crack.scene.tables import Material
from fenics_crack.time.march import TimeHistory
from fenics_crack.version import packaged

if TYPE_CHECKING:
    from fenics_crack.runs.run import Run
    from fenics_crack.runs.stress_intensity import StressIntensity


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, d) as VTK has them: (n, 3)."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def seen_parallel(renderer: Any) -> Any:
    """The camera of a renderer, which draws on white and makes nothing smaller that is far."""
    renderer.SetBackground(1.0, 1.0, 1.0)
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    return camera


def look_from_corner(renderer: Any, points: np.ndarray) -> None:
    """Set the camera so that all of a solid is seen, y up, and what moves across it."""
    camera = seen_parallel(renderer)
    flat = points[:, [0, 2]] - points[:, [0, 2]].mean(axis=0)
    x, z = np.linalg.eigh(flat.T @ flat)[1][:, 0]  # where it is thinnest
    x, z = (x, z) if z > 0.0 else (-x, -z)
    camera.SetFocalPoint(0.0, 0.0, 0.0)
    across, up, along = -1.3, 0.55, 1.6  # along: where the solid is thinnest
    camera.SetPosition(across * z + along * x, up, along * z - across * x)
    camera.SetViewUp(0.0, 1.0, 0.0)
    renderer.ResetCamera()


def pyvista() -> Any:
    """The package, loaded without mypy, which it would load for a plugin of its own where that is
    installed: a third of the time that it takes to load."""
    modules: dict[str, Any] = sys.modules
    absent = modules.setdefault("mypy", None) is None
    try:
        import pyvista
    finally:
        if absent:
            del modules["mypy"]
    return pyvista


def off_screen_plotter(window_size: tuple[int, int] = (900, 1000)) -> Any:
    """A plotter that draws into memory, without a search for a screen where there is none."""
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        os.environ.setdefault("ALLOW_PLOTTING", "true")  # pyvista would open a window to know
    return pyvista().Plotter(off_screen=True, window_size=window_size)


def _grid_of(points: np.ndarray, cells: np.ndarray, vtk_type: int) -> Any:
    """Points (n, d) and cells of one type."""
    counted = np.insert(cells, 0, cells.shape[1], axis=1)
    types = np.full(len(cells), vtk_type)
    return pyvista().UnstructuredGrid(counted.ravel(), types, in_space(points))


def surface(points: np.ndarray, facets: np.ndarray) -> Any:
    """Some facets."""
    return pyvista().PolyData.from_regular_faces(in_space(points), facets)


def lines(points: np.ndarray, edges: np.ndarray) -> Any:
    """Some edges."""
    counted = np.insert(edges, 0, edges.shape[1], axis=1)
    return pyvista().PolyData(in_space(points), lines=counted.ravel())


def outline(mesh: NodalMesh) -> np.ndarray:
    """Edges at which the surface of a solid at rest bends: (n, 2) nodes."""
    whole = surface(mesh.points, mesh.boundary)
    whole["node"] = np.arange(len(mesh.points))
    others = dict.fromkeys(("boundary_edges", "non_manifold_edges", "manifold_edges"), False)
    edges = whole.extract_feature_edges(feature_angle=25.0, **others)
    return np.asarray(edges["node"])[edges.lines.reshape(-1, 3)[:, 1:]]


def image_of(plotter: Any, points: np.ndarray) -> np.ndarray:
    """Return the image of a plotter with a solid, without white margins; closes the plotter."""
    look_from_corner(plotter.renderer, points)
    plotter.camera_set = True
    image = plotter.screenshot(None, return_img=True)
    plotter.close()
    ink = np.argwhere((image < 250).any(axis=2))
    (top, left), (bottom, right) = ink.min(axis=0), ink.max(axis=0) + 1
    return np.asarray(image[top:bottom, left:right])


# --- stresses -------------------------------------------------------------------------------------

COMPONENTS = {2: ("xx", "yy", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
"""Stresses in a plane and in space."""


def grid_at_rest(mesh: NodalMesh) -> Any:
    """The cells where they are."""
    return _grid_of(mesh.points, mesh.cells, mesh.vtk_type)


def nodal_stress(mesh: NodalMesh, displacement: np.ndarray, material: Material) -> np.ndarray:
    """Plane stresses xx, yy, xy of nodal displacements (..., n_nodes, 2) [m]: (..., n_nodes, 3)
    [Pa]; of a solid xx, yy, zz, xy, yz, xz: (..., n_nodes, 6)."""
    columns = np.moveaxis(displacement, -2, 0)
    flat = columns.reshape(len(columns), -1)
    slopes = [(part @ flat).reshape(columns.shape) for part in _slopes(mesh)]
    slope = np.moveaxis(np.stack(slopes, axis=-1), 0, -3)
    nu = material.poisson
    share = nu / (1.0 - nu) if mesh.dimension == 2 else nu / (1.0 - 2.0 * nu)
    strain = 0.5 * (slope + np.swapaxes(slope, -1, -2))
    volume = np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(mesh.dimension)
    full = material.young / (1.0 + nu) * (strain + share * volume)
    places = (map("xyz".index, name) for name in COMPONENTS[mesh.dimension])
    return np.stack([full[..., i, j] for i, j in places], axis=-1)


def _slopes(mesh: NodalMesh) -> list[csr_matrix]:
    """d/dx, d/dy (and d/dz) at the nodes of a nodal field, each the mean of the cells there, as
    matrices (n_nodes, n_nodes) [1/m].

    VTK differentiates the shape functions N at the nodes of its unit cell, and in a cell that x(X)
    maps it to, dN/dx = dN/dX (dx/dX)^-1. (In the cells themselves it looks for the nodes first,
    which fails in slim tetrahedra of ten nodes.)
    """
    of_cell = mesh.cells.shape[1]
    places = np.reshape(grid_at_rest(mesh).GetCell(0).GetParametricCoords(), (of_cell, 3))
    unit = _grid_of(places, np.arange(of_cell)[None], mesh.vtk_type)
    unit.point_data["shape"] = np.eye(of_cell)
    found = np.asarray(unit.compute_derivative("shape")["gradient"])
    shape = found.reshape(of_cell, of_cell, 3)[..., : mesh.dimension]  # node, function, axis
    mapped = np.einsum("cbx,nbX->cnxX", mesh.points[mesh.cells], shape)
    slope = np.einsum("nbX,cnXx->xcnb", shape, np.linalg.inv(mapped))
    slope /= np.bincount(mesh.cells.ravel())[mesh.cells][..., None]
    rows, functions = np.repeat(mesh.cells, of_cell), np.tile(mesh.cells, of_cell).ravel()
    size = 2 * (len(mesh.points),)
    return [csr_matrix((part.ravel(), (rows, functions)), size) for part in slope]


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress of stresses as :func:`nodal_stress` has them: (...) [Pa]."""
    if stress.shape[-1] == 3:  # none across the plane
        stress = np.insert(stress, (2, 3, 3), 0.0, axis=-1)
    xx, yy, zz, xy, yz, xz = np.moveaxis(stress, -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * normal + 3.0 * (xy**2 + yz**2 + xz**2)))


def stress_at(
    run: Run[PeriodicSolution] | Run[TimeHistory], points: Sequence[Any] | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find stresses at some points over time (collective).

    Those of the nodes, where the cells' own are averaged, but not across a crack; between the nodes
    as displacements are. At the tip of a crack and under a force at a point they grow without bound
    as the mesh is refined: there :func:`stress_intensity` is the number to ask for.

    Parameters
    ----------
    run : Run
        Result of :func:`solve` or :func:`integrate`, of a mesh.
    points : (m, d) [m]
        Where; of a line its points, ``np.linspace(start, stop, 50)``.

    Returns
    -------
    time : (n,) [s]
        128 instants of a period, or those of the record.
    stress : (n, m, 3) [Pa]
        xx, yy, xy; of a solid xx, yy, zz, xy, yz, xz: (n, m, 6).

    Raises
    ------
    InputError
        The structure has no mesh, or a point is not on it.

    Examples
    --------
    >>> time, stress = fc.stress_at(fc.solve(scene), [[0.1, 0.02], [0.1, 0.04]])
    """
    from fenics_crack.runs.run import check_motion  # loads DOLFINx

    check_motion(run)
    found, structure = run.result, run.structure
    mesh, places = NodalMesh(structure), numbers(points)
    fits = places.ndim == 2 and places.shape[1] == mesh.dimension
    if not (fits and places.size and np.all(np.isfinite(places))):
        allowed = f"one or more rows of {mesh.dimension} finite numbers [m]"
        raise InputError("points", points, allowed)
    if isinstance(found, TimeHistory):
        time = found.time
        if len(found.recorded_dofs) < structure.n_local:
            raise InputError("dofs", "some", "None, to record all displacements")
        moved = structure.expand(found.recorded)
    else:
        time = np.linspace(0.0, found.period, 128, endpoint=False)
        moved = found.displacement_field(time)
    nodal = nodal_stress(mesh, mesh.nodal_vectors(moved), run.scene.material)
    grid, columns = grid_at_rest(mesh), np.moveaxis(nodal, -2, 0)
    grid["stress"] = columns.reshape(len(columns), -1)
    seen = pyvista().PolyData(in_space(places)).sample(grid)
    off = np.flatnonzero(np.asarray(seen["vtkValidPointMask"]) == 0)
    if len(off):
        raise InputError("points", places[off[0]].tolist(), "on the mesh")
    return time, np.moveaxis(np.asarray(seen["stress"]).reshape(len(places), len(time), -1), 0, 1)


# --- files for ParaView ---------------------------------------------------------------------------


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
    shapes = mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))

    def write() -> None:
        grid = grid_at_rest(mesh)
        for number, (omega, shape) in enumerate(zip(modes.omega, shapes, strict=True), 1):
            factor = tenth(shape, mesh.size)
            moved, name = in_space(factor * shape), f"mode {number}: {omega:.1f} rad/s"
            grid.point_data[name] = moved
            grid.field_data[f"magnification of mode {number}"] = [factor]
        write_whole(path, _vtu(grid))

    on_root(mesh.structure.comm, write)


def write_fronts(found: StressIntensity, path: str | Path) -> None:
    """Write stress intensities along the fronts of a solid's cracks as lines of one .vtu file
    (collective).

    Parameters
    ----------
    found : StressIntensity
        Of a solid.
    path : str or Path
        The .vtu file.

    Raises
    ------
    InputError
        It is of a plate.

    Notes
    -----
    Fields of the stations: :attr:`StressIntensity.numbers` and ``K_I while closed`` [Pa m^0.5], and
    ``ahead``, the direction in which the crack would grow straight on.

    Examples
    --------
    >>> along = fc.stress_intensity(fc.solve(solid))  # doctest: +SKIP
    >>> fc.write_fronts(along, "fronts.vtu")  # doctest: +SKIP
    """
    if found.three is None:
        raise InputError("found", "of a plate", "of a solid, whose cracks have fronts")

    def write() -> None:
        lines = [pair for its in found.fronts.values() for pair in itertools.pairwise(its)]
        grid = _grid_of(found.points, np.array(lines, dtype=int).reshape(-1, 2), VTK_LINE)
        for name, values in {**found.numbers, "K_I while closed": found.closed}.items():
            grid.point_data[name] = values
        grid.point_data["ahead"] = found.ahead
        write_whole(path, _vtu(grid))

    on_root(found.comm, write)


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
        Of the contact, and of one face.
    pair_nodes : (n_nodes, n_pairs)
        What a pair's unit force is at a node, 1 at the two nodes of a pair; of a solid's patch 1 at
        the two nodes in its middle.
    shares : (n_nodes, n_pairs)
        Of the pairs' pressures that at a node.
    magnification : float
        Of the displacement in pictures.
    material : Material or None
        For stresses.
    has_one_load : bool
        True if there is a load of which one arrow says something: not one on each blade.
    colour : (str, str)
        Name and unit of the field to colour by: with a material the von Mises stress.
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
        self.displacement = self.mesh.nodal_vectors(solution.displacement_field(self.time))
        self.magnification = float(magnification or tenth(self.displacement, self.mesh.size))
        self.force, self.areas = solution.contact_force(self.time), structure.pair_areas
        parts = self.mesh.nodal_vectors(structure.force).reshape(len(structure.force), -1)
        self.load = evaluate_series(parts, solution.omega, self.time).reshape(
            self.displacement.shape
        )
        one_frame = structure.nodes is None or structure.nodes.frames is None
        self.has_one_load = bool(np.any(self.load)) and one_frame
        self.colour = ("von Mises stress", "Pa") if material else ("displacement", "m")
        if self.mesh.dimension == 3 and structure.n_pairs:
            self.pair_nodes, self.shares = self.mesh.pair_centre_and_pressure_functions
        else:
            self.pair_nodes = _nodes_of_pairs(structure)
            self.shares = self.pair_nodes * self.areas
            of_node = self.shares.sum(axis=1, keepdims=True)
            of_node[of_node <= 1e-9 * of_node.max(initial=0.0)] = np.inf  # rounding at tips
            self.shares /= of_node

    @property
    def cracked(self) -> bool:
        """True if there are crack faces."""
        return len(self.mesh.crack_face_sides) > 0

    @cached_property
    def moved(self) -> np.ndarray:
        """Places of the nodes by the magnified displacement: (n, n_nodes, d) [m]."""
        return self.mesh.points + self.magnification * self.displacement

    @cached_property
    def colour_values(self) -> np.ndarray:
        """Values of that field, or the length of its vectors: (n, n_nodes)."""
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

    def grid(self, frame: int) -> Any:
        """Return the mesh at rest with the point fields of :func:`write_period` in a frame."""
        force, displacement = self.force[frame], self.displacement[frame]
        grid = grid_at_rest(self.mesh)
        # Half-way between two pairs a node is closed where both are.
        closed, seen = self.shares @ (force > 0.0), self.shares.sum(axis=1)
        fields = {
            "displacement": in_space(displacement),
            "contact state": np.where(seen > 0.0, 1.0 * (closed > 0.501 * seen), -1.0),
            "contact force": self.pair_nodes @ force,
            "contact pressure": self.shares @ (force / self.areas),
        }
        if self.material is not None:
            fields["stress"] = self.stress[frame]
            fields["von Mises stress"] = von_mises(self.stress[frame])
        for name, values in fields.items():
            grid.point_data[name] = values.astype(np.float32)  # in half the time and space
        stress = grid.GetPointData().GetArray("stress")
        for component, axes in enumerate(COMPONENTS[self.mesh.dimension] if self.material else ()):
            stress.SetComponentName(component, axes)
        grid.field_data["magnification"] = [self.magnification]
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

    The points of all frames are those at rest: ParaView's Warp By Vector moves them by
    ``displacement``. A script beside it, ``paraview --script=NAME_paraview.py``, does so with the
    magnification, shows the plate from the front, coloured by stress or displacement, and plays the
    period once. Each frame has the ``magnification`` in its field data.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to show.
    path : str or Path
        The .pvd file to open in ParaView; the frames (.vtu) go into a folder beside it.
    frames : int
        Instants in the period.
    magnification : float, optional
        Scale factor of Warp By Vector in the script; default: the largest displacement becomes a
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
        The structure has no mesh, an argument cannot be used, or the frames' folder is a link.

    Notes
    -----
    Point fields, in single precision: ``displacement`` [m], true to scale; ``contact state``: 1 on
    a closed pair of face nodes, 0 on an open one, -1 away from the crack faces; ``contact force``
    [N] on each node of a pair (of a solid's patch on the two in its middle), and ``contact
    pressure`` [Pa], that force over the pair's area, and between the pairs that are patches: smooth
    along the crack faces if the contact stiffness is given per area. With a material: ``stress``
    (xx, yy, xy; of a solid xx, yy, zz, xy, yz, xz) and ``von Mises stress`` [Pa]. At the tip and
    under the point load they grow without bound as the mesh is refined.

    Examples
    --------
    >>> magnification = fc.write_period(solution, "crack.pvd", frames=4)
    """
    begin(Path(path).name)
    fields = PeriodFields(solution, frames, magnification, material)
    target = Path(path)

    def write() -> None:
        check_inner(target.with_name(target.stem))
        names = [f"{target.stem}/frame_{frame:04d}.vtu" for frame in range(len(fields.time))]
        lines = ['<VTKFile type="Collection" version="0.1">', "  <Collection>"]
        for instant, name in zip(fields.time, names, strict=True):
            lines.append(f'    <DataSet timestep="{instant:.12g}" file={quoteattr(name)}/>')
        series = "\n".join([*lines, "  </Collection>", "</VTKFile>", ""])
        field, unit = fields.colour
        script = target.with_name(f"{target.stem}_paraview.py")
        words = {"script": script.name, "folder": str(target.parent.resolve()), "pvd": target.name}
        colours = {"field": field, "title": f"{field} [{unit}]", "end": fields.colour_end}
        colours["mode"] = f"{fields.mesh.dimension}D"
        colours["camera"] = CAMERAS[fields.mesh.dimension]
        colours["caption"] = f"displacement x {fields.magnification:.3g}"
        colours["factor"] = fields.magnification
        state = packaged("draw/paraview_state.txt")
        about = [(target, series), (script, state.format(**words, **colours))]
        frames = ((target.parent / name, _vtu(fields.grid(n))) for n, name in enumerate(names))
        write_together(itertools.chain(about, frames))

    on_root(fields.mesh.structure.comm, write)
    return fields.magnification


CAMERAS = {2: "view.ResetActiveCameraToNegativeZ()", 3: "view.ApplyIsometricView()"}
"""ParaView's view of a plate and of a solid."""


def _vtu(grid: Any) -> str:
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
    """Forces of nodes by unit forces on pairs: (n_nodes, n_pairs) on every rank (collective)."""
    assert structure.nodes is not None
    dofs, gap = structure.nodes.dofs, structure.gap
    moving = np.nonzero(dofs >= 0)
    entries = np.ones(len(moving[0])), (moving[0], dofs[moving] - structure.first_dof)
    sums = csr_matrix(entries, (len(dofs), structure.n_local))
    return gather_rows(structure.comm, np.sqrt((sums @ gap.multiply(gap)).toarray()))
