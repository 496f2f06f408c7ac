"""Draw meshes by VTK, compute stresses, and write files for ParaView (VTK XML).

The files hold mode shapes, stress intensities along crack fronts, or one period of the breathing
crack. They have all nodes, also the middle nodes of quadratic elements, and rank 0 writes them.

The stress at a node follows from the displacement gradient averaged over the cells at the node. No
average crosses the crack, since both crack faces have their own nodes.
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
from fenics_crack.basics.atomic_files import (
    check_is_no_link_or_file,
    write_file_whole,
    write_files_together,
)
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.draw.figure import magnification_to_tenth
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate_series
from fenics_crack.scene.tables import Material
from fenics_crack.time.march import TimeHistory
from fenics_crack.version import read_packaged_text

if TYPE_CHECKING:
    from fenics_crack.runs.run import Run
    from fenics_crack.runs.stress_intensity import StressIntensity


def pad_to_space(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2) with z = 0 added: (n, 3); vectors (n, 3) stay unchanged."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def set_parallel_camera(renderer: Any) -> Any:
    """Set a white background and a parallel projection for a VTK renderer.

    Returns the renderer's camera.
    """
    renderer.SetBackground(1.0, 1.0, 1.0)
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    return camera


def look_from_corner(renderer: Any, points: np.ndarray) -> None:
    """Set a VTK renderer's camera to show a solid from a corner.

    y is upwards, and the whole solid is visible. The camera looks from above and from the side,
    mostly along the horizontal axis in which the solid is thinnest.

    Parameters
    ----------
    renderer : vtkRenderer
        Renderer that shows the solid.
    points : (n, 3) [m]
        Nodes of the solid.
    """
    camera = set_parallel_camera(renderer)
    node_offsets = points[:, [0, 2]] - points[:, [0, 2]].mean(axis=0)
    thinnest_axis_x, thinnest_axis_z = np.linalg.eigh(node_offsets.T @ node_offsets)[1][
        :, 0
    ]  # thinnest axis
    thinnest_axis_x, thinnest_axis_z = (
        (thinnest_axis_x, thinnest_axis_z)
        if thinnest_axis_z > 0.0
        else (-thinnest_axis_x, -thinnest_axis_z)
    )
    camera.SetFocalPoint(0.0, 0.0, 0.0)
    wide_offset, upward_offset, thin_offset = -1.3, 0.55, 1.6  # along the camera's three axes
    camera.SetPosition(
        wide_offset * thinnest_axis_z + thin_offset * thinnest_axis_x,
        upward_offset,
        thin_offset * thinnest_axis_z - wide_offset * thinnest_axis_x,
    )
    camera.SetViewUp(0.0, 1.0, 0.0)
    renderer.ResetCamera()


def import_pyvista() -> Any:
    """Import pyvista without its mypy plugin, and return the package.

    Where mypy is installed, the plugin would take a third of the loading time.
    """
    loaded_module_by_name: dict[str, Any] = sys.modules
    is_mypy_import_blocked = loaded_module_by_name.setdefault("mypy", None) is None
    try:
        import pyvista
    finally:
        if is_mypy_import_blocked:
            del loaded_module_by_name["mypy"]
    return pyvista


def off_screen_plotter(window_size: tuple[int, int] = (900, 1000)) -> Any:
    """Return a pyvista plotter that draws into memory and needs no screen.

    ``window_size`` is the image's width and height [pixels].
    """
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        os.environ.setdefault("ALLOW_PLOTTING", "true")  # pyvista would try a window
    return import_pyvista().Plotter(off_screen=True, window_size=window_size)


def _make_grid(points: np.ndarray, cells: np.ndarray, vtk_type: int) -> Any:
    """Return pyvista's unstructured grid from points and cells.

    Parameters
    ----------
    points : (n, d) [m]
        Positions of the nodes.
    cells : (m, k) int
        For each cell, the indices of k nodes in ``points``.
    vtk_type : int
        VTK's number of the cell type, the same for all cells.
    """
    cells_with_size = np.insert(cells, 0, cells.shape[1], axis=1)
    cell_types = np.full(len(cells), vtk_type)
    return import_pyvista().UnstructuredGrid(
        cells_with_size.ravel(), cell_types, pad_to_space(points)
    )


def make_surface(points: np.ndarray, facets: np.ndarray) -> Any:
    """Return a surface as pyvista's PolyData.

    Parameters
    ----------
    points : (n, d) [m]
        Positions of the nodes.
    facets : (m, k) int
        For each facet, the indices of k nodes in ``points``.
    """
    return import_pyvista().PolyData.from_regular_faces(pad_to_space(points), facets)


def make_lines(points: np.ndarray, edges: np.ndarray) -> Any:
    """Return lines as pyvista's PolyData.

    Parameters
    ----------
    points : (n, d) [m]
        Positions of the nodes.
    edges : (m, k) int
        For each line, the indices of k nodes in ``points``.
    """
    edges_with_size = np.insert(edges, 0, edges.shape[1], axis=1)
    return import_pyvista().PolyData(pad_to_space(points), lines=edges_with_size.ravel())


def find_node_pairs_of_sharp_edges(mesh: NodalMesh) -> np.ndarray:
    """Return the sharp edges of a solid's surface: (n, 2) node indices.

    At a sharp edge the surface bends by more than 25 degrees.
    """
    boundary_surface = make_surface(mesh.points, mesh.boundary_sides)
    boundary_surface["node"] = np.arange(len(mesh.points))
    sharp_edges = boundary_surface.extract_feature_edges(
        feature_angle=25.0, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    return np.asarray(sharp_edges["node"])[sharp_edges.lines.reshape(-1, 3)[:, 1:]]


def render_cropped_image(plotter: Any, points: np.ndarray) -> np.ndarray:
    """Render a solid from a corner, without white margins, and close the plotter.

    Parameters
    ----------
    plotter : pyvista.Plotter
        Plotter with everything that is to be drawn.
    points : (n, 3) [m]
        Nodes of the solid.

    Returns
    -------
    (height, width, 3) uint8
        Red, green and blue of each pixel.
    """
    look_from_corner(plotter.renderer, points)
    plotter.camera_set = True
    image = plotter.screenshot(None, return_img=True)
    plotter.close()
    coloured_pixels = np.argwhere((image < 250).any(axis=2))
    (top_row, left_column), (bottom_row, right_column) = (
        coloured_pixels.min(axis=0),
        coloured_pixels.max(axis=0) + 1,
    )
    return np.asarray(image[top_row:bottom_row, left_column:right_column])


# --- stresses -------------------------------------------------------------------------------------

STRESS_COMPONENTS_BY_DIMENSION = {2: ("xx", "yy", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
"""Names of the stress components in a plane and in space, in the order of arrays."""


def make_grid_at_rest(mesh: NodalMesh) -> Any:
    """Return a mesh at rest as pyvista's unstructured grid, without fields."""
    return _make_grid(mesh.points, mesh.cells, mesh.vtk_type)


def nodal_stress(mesh: NodalMesh, displacement: np.ndarray, material: Material) -> np.ndarray:
    """Compute the stress at the nodes, in a plate as plane stress.

    The displacement gradient at a node is the mean over the cells at the node.

    Parameters
    ----------
    displacement : (..., n_nodes, d) [m]
        Nodal displacements.
    material : Material
        Young's modulus and Poisson's ratio.

    Returns
    -------
    (..., n_nodes, 3) or (..., n_nodes, 6) [Pa]
        Components xx, yy, xy in a plate; xx, yy, zz, xy, yz, xz in a solid.
    """
    displacement_by_node = np.moveaxis(displacement, -2, 0)
    flat_displacement = displacement_by_node.reshape(len(displacement_by_node), -1)
    derivative_fields = [
        (derivative_matrix @ flat_displacement).reshape(displacement_by_node.shape)
        for derivative_matrix in _make_derivative_matrices(mesh)
    ]
    displacement_gradient = np.moveaxis(np.stack(derivative_fields, axis=-1), 0, -3)
    nu = material.poisson
    volume_strain_coefficient = nu / (1.0 - nu) if mesh.dimension == 2 else nu / (1.0 - 2.0 * nu)
    strain = 0.5 * (displacement_gradient + np.swapaxes(displacement_gradient, -1, -2))
    volume_strain = np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(mesh.dimension)
    stress = material.young / (1.0 + nu) * (strain + volume_strain_coefficient * volume_strain)
    component_names = STRESS_COMPONENTS_BY_DIMENSION[mesh.dimension]
    component_indices = (map("xyz".index, name) for name in component_names)
    return np.stack([stress[..., i, j] for i, j in component_indices], axis=-1)


def _make_derivative_matrices(mesh: NodalMesh) -> list[csr_matrix]:
    """Return matrices that differentiate a nodal field at the nodes.

    A derivative at a node is the mean over the cells at the node. VTK gives the derivatives dN/dX
    of the shape functions N at the nodes of a unit cell, with coordinates X. The map x(X) leads
    from the unit cell to a cell of the mesh: dN/dx = dN/dX (dx/dX)^-1. VTK does not differentiate
    in the cells of the mesh: it would search for the nodes, and fail in slim tetrahedra.

    Returns
    -------
    list of (n_nodes, n_nodes) [1/m]
        Matrices for d/dx, d/dy and, in a solid, d/dz.
    """
    n_cell_nodes = mesh.cells.shape[1]
    unit_cell_node_coordinates = np.reshape(
        make_grid_at_rest(mesh).GetCell(0).GetParametricCoords(), (n_cell_nodes, 3)
    )
    unit_cell = _make_grid(unit_cell_node_coordinates, np.arange(n_cell_nodes)[None], mesh.vtk_type)
    unit_cell.point_data["shape"] = np.eye(n_cell_nodes)
    flat_shape_gradients = np.asarray(unit_cell.compute_derivative("shape")["gradient"])
    # Node, shape function, axis.
    shape_gradients = flat_shape_gradients.reshape(n_cell_nodes, n_cell_nodes, 3)[
        ..., : mesh.dimension
    ]
    jacobians = np.einsum("cbx,nbX->cnxX", mesh.points[mesh.cells], shape_gradients)
    node_averaged_cell_derivatives = np.einsum(
        "nbX,cnXx->xcnb", shape_gradients, np.linalg.inv(jacobians)
    )
    node_averaged_cell_derivatives /= np.bincount(mesh.cells.ravel())[mesh.cells][..., None]
    matrix_rows = np.repeat(mesh.cells, n_cell_nodes)
    matrix_columns = np.tile(mesh.cells, n_cell_nodes).ravel()
    matrix_shape = 2 * (len(mesh.points),)
    return [
        csr_matrix((axis_derivatives.ravel(), (matrix_rows, matrix_columns)), matrix_shape)
        for axis_derivatives in node_averaged_cell_derivatives
    ]


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Return the von Mises stress (...) [Pa] for stress components (..., 3) or (..., 6) [Pa].

    Three components are xx, yy, xy in plane stress; six are xx, yy, zz, xy, yz, xz.
    """
    if stress.shape[-1] == 3:  # plane stress
        stress = np.insert(stress, (2, 3, 3), 0.0, axis=-1)
    xx, yy, zz, xy, yz, xz = np.moveaxis(stress, -1, 0)
    normal_differences = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * normal_differences + 3.0 * (xy**2 + yz**2 + xz**2)))


def stress_at(
    run: Run[PeriodicSolution] | Run[TimeHistory], points: Sequence[Any] | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find stresses at given points over time (collective).

    The stress at a node is the mean over the cells at the node, on one side of a crack only.
    Between nodes the stress is interpolated by the shape functions of displacements. At a crack tip
    and under a point force, stresses grow without bound as the mesh is refined; use
    :func:`stress_intensity` at a tip.

    Parameters
    ----------
    run : Run
        Result of :func:`solve` or :func:`integrate`, with a mesh.
    points : (m, d) [m]
        Points in the mesh; for a line ``np.linspace(start, stop, 50)``.

    Returns
    -------
    time : (n,) [s]
        For :func:`solve` 128 instants in a period, for :func:`integrate` the recorded instants.
    stress : (n, m, 3) or (n, m, 6) [Pa]
        xx, yy, xy in a plate; xx, yy, zz, xy, yz, xz in a solid.

    Raises
    ------
    InputError
        The structure has no mesh, a displacement was not recorded, or a point is off the mesh.

    Examples
    --------
    >>> time, stress = fc.stress_at(fc.solve(scene), [[0.1, 0.02], [0.1, 0.04]])
    """
    from fenics_crack.runs.run import check_run_has_motion  # loads DOLFINx

    check_run_has_motion(run)
    solution_or_history, structure = run.result, run.structure
    mesh, stress_points = NodalMesh(structure), floats_or_single_nan(points)
    has_valid_points_shape = stress_points.ndim == 2 and stress_points.shape[1] == mesh.dimension
    if not (has_valid_points_shape and stress_points.size and np.all(np.isfinite(stress_points))):
        raise InputError(
            "points", points, f"one or more rows of {mesh.dimension} finite numbers [m]"
        )
    if isinstance(solution_or_history, TimeHistory):
        time = solution_or_history.time
        if len(solution_or_history.recorded_dofs) < structure.n_local:
            raise InputError(
                "dofs",
                solution_or_history.recorded_dofs.tolist(),
                "None, to record all displacements",
            )
        displacement = structure.expand(solution_or_history.recorded)
    else:
        time = np.linspace(0.0, solution_or_history.period, 128, endpoint=False)
        displacement = solution_or_history.displacement_field(time)
    nodal_stresses = nodal_stress(mesh, mesh.nodal_vectors(displacement), run.scene.material)
    grid, stress_by_node = make_grid_at_rest(mesh), np.moveaxis(nodal_stresses, -2, 0)
    grid["stress"] = stress_by_node.reshape(len(stress_by_node), -1)
    points_with_sampled_stress = import_pyvista().PolyData(pad_to_space(stress_points)).sample(grid)
    outside_indices = np.flatnonzero(
        np.asarray(points_with_sampled_stress["vtkValidPointMask"]) == 0
    )
    if len(outside_indices):
        raise InputError("points", stress_points[outside_indices[0]].tolist(), "on the mesh")
    point_stresses = np.reshape(
        points_with_sampled_stress["stress"], (len(stress_points), len(time), -1)
    )
    return time, np.moveaxis(point_stresses, 0, 1)


# --- files for ParaView ---------------------------------------------------------------------------


def write_modes(modes: Modes, path: str | Path) -> None:
    """Write mode shapes as vector fields of one .vtu file (collective).

    The fields have names such as ``mode 1: 2302.9 rad/s``. Each shape is scaled so that the largest
    displacement is a tenth of the structure's size, for ParaView's Warp By Vector. The field data
    ``magnification of mode 1`` is the scaled over the original displacement.

    Parameters
    ----------
    modes : Modes
        Modes of a structure with a mesh.
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
    nodal_shapes = mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))

    def write_file() -> None:
        grid = make_grid_at_rest(mesh)
        for mode_number, (omega, shape) in enumerate(
            zip(modes.omega, nodal_shapes, strict=True), 1
        ):
            magnification = magnification_to_tenth(shape, mesh.size)
            grid.point_data[f"mode {mode_number}: {omega:.1f} rad/s"] = pad_to_space(
                magnification * shape
            )
            grid.field_data[f"magnification of mode {mode_number}"] = [magnification]
        write_file_whole(path, _format_vtu(grid))

    on_root(mesh.structure.comm, write_file)


def write_fronts(found: StressIntensity, path: str | Path) -> None:
    """Write stress intensities along crack fronts as lines of one .vtu file (collective).

    Parameters
    ----------
    found : StressIntensity
        Stress intensities of a solid.
    path : str or Path
        The .vtu file.

    Raises
    ------
    InputError
        The stress intensities are of a plate.

    Notes
    -----
    Each front station, a point on a crack front, has these values:

    - all values in :attr:`StressIntensity.numbers`,
    - ``K_I while closed`` [Pa m^0.5], the error of K_I at a closed front
      (``StressIntensity.closed_front_errors``),
    - ``ahead``, a unit vector: the direction in which the crack would grow straight on.

    Examples
    --------
    >>> along = fc.stress_intensity(fc.solve(solid))  # doctest: +SKIP
    >>> fc.write_fronts(along, "fronts.vtu")  # doctest: +SKIP
    """
    if found.K_III is None:
        raise InputError(
            "found", repr(found), "stress intensities of a solid; a plate has no crack fronts"
        )

    def write_file() -> None:
        front_edges = [
            edge
            for stations in found.station_indices_by_front.values()
            for edge in itertools.pairwise(stations)
        ]
        grid = _make_grid(found.points, np.array(front_edges, dtype=int).reshape(-1, 2), VTK_LINE)
        values_by_name = {
            **found.numbers,
            "K_I while closed": found.closed_front_errors,
            "ahead": found.growth_directions,
        }
        for name, values in values_by_name.items():
            grid.point_data[name] = values
        write_file_whole(path, _format_vtu(grid))

    on_root(found.comm, write_file)


class PeriodFields:
    """Nodal fields of a vibration at n instants in a period, complete on every rank.

    Construction is collective.

    Parameters
    ----------
    solution : PeriodicSolution
        Vibration.
    n_frames : int
        Number n of instants.
    magnification : float, optional
        Factor by which pictures magnify the displacement; default: the largest displacement becomes
        a tenth of the structure's size.
    material : Material, optional
        Material for stresses; default: no stresses are computed.

    Attributes
    ----------
    mesh : NodalMesh
        Mesh of the whole structure.
    time : (n,) [s]
        Instants, equally spaced from 0, without the end of the period.
    displacement, nodal_loads : (n, n_nodes, d) [m], [N]
        Displacements, not magnified, and load forces at the nodes.
    contact_forces, pair_areas : (n, n_pairs) [N], (n_pairs,) [m^2]
        Normal forces on the contact pairs, and the pairs' areas on one crack face.
    nodal_force_per_pair_force : (n_nodes, n_pairs)
        Force at each node for a unit contact force on each pair. The force is 1 at the pair's two
        nodes. In a solid, a pair belongs to a patch, and the force is 1 at the two nodes in the
        patch's middle. All further nodes have 0.
    nodal_weights_of_pair_pressures : (n_nodes, n_pairs)
        Pressure at each node per pressure on each pair, to interpolate the pressure drawn at nodes.
    magnification : float
        Factor by which pictures magnify the displacement.
    material : Material or None
        Material for stresses; None: no stresses are computed.
    has_load_arrow : bool
        True if one arrow can show the load; False without a load and for a bladed disk.
    colour_field_name_and_unit : (str, str)
        Name and unit of the field that colours show: von Mises stress with a material, otherwise
        displacement.
    """

    def __init__(
        self,
        solution: PeriodicSolution,
        n_frames: int = 36,
        magnification: float | None = None,
        material: Material | None = None,
    ) -> None:
        check_count("frames", n_frames, 1)
        if magnification is not None:
            check_number("magnification", magnification, 0.0, excludes_bound=True)
        if material is not None and not isinstance(material, Material):
            raise InputError("material", material, "a Material, such as scene.material, or None")
        structure = solution.structure.whole
        self.mesh, self.material = NodalMesh(structure), material
        assert structure.pair_areas is not None
        self.time = np.arange(n_frames) * solution.period / n_frames
        self.displacement = self.mesh.nodal_vectors(solution.displacement_field(self.time))
        self.magnification = float(
            magnification or magnification_to_tenth(self.displacement, self.mesh.size)
        )
        self.contact_forces = solution.contact_force(self.time)
        self.pair_areas = structure.pair_areas
        load_harmonics = self.mesh.nodal_vectors(structure.force).reshape(len(structure.force), -1)
        self.nodal_loads = evaluate_series(load_harmonics, solution.omega, self.time).reshape(
            self.displacement.shape
        )
        has_global_axes_at_all_nodes = structure.nodes is None or structure.nodes.frames is None
        self.has_load_arrow = bool(np.any(self.nodal_loads)) and has_global_axes_at_all_nodes
        self.colour_field_name_and_unit = (
            ("von Mises stress", "Pa") if material else ("displacement", "m")
        )
        if self.mesh.dimension == 3 and structure.n_pairs:
            self.nodal_force_per_pair_force, self.nodal_weights_of_pair_pressures = (
                self.mesh.pair_centres_and_pressures_at_nodes
            )
        else:
            self.nodal_force_per_pair_force = _find_nodal_force_per_pair_force(structure)
            self.nodal_weights_of_pair_pressures = self.nodal_force_per_pair_force * self.pair_areas
            nodal_area_sums = self.nodal_weights_of_pair_pressures.sum(axis=1, keepdims=True)
            # Sums at crack tips are 0 but for rounding.
            is_area_sum_only_rounding = nodal_area_sums <= 1e-9 * nodal_area_sums.max(initial=0.0)
            nodal_area_sums[is_area_sum_only_rounding] = np.inf
            self.nodal_weights_of_pair_pressures /= nodal_area_sums

    @property
    def has_cracks(self) -> bool:
        """True if the mesh has crack faces."""
        return len(self.mesh.crack_face_sides) > 0

    @cached_property
    def magnified_points(self) -> np.ndarray:
        """Positions of the nodes with magnified displacement: (n, n_nodes, d) [m]."""
        return self.mesh.points + self.magnification * self.displacement

    @cached_property
    def colour_values(self) -> np.ndarray:
        """Values that colours show: (n, n_nodes).

        Von Mises stress [Pa] with a material, otherwise the size of the displacement [m].
        """
        if self.material is None:
            return np.linalg.norm(self.displacement, axis=2)
        return von_mises(self.stress)

    @property
    def colour_scale_end(self) -> float:
        """Upper end of the colour scale for the whole period, [Pa] or [m].

        The scale begins at 0. For displacements the end is the largest value. Stresses are
        unbounded at the tip and under the load. So for stresses the end is lower: at 98 % of the
        nodes, the largest stress in the period is smaller.
        """
        largest_nodal_values = self.colour_values.max(axis=0)
        scale_end = (
            largest_nodal_values.max()
            if self.material is None
            else np.quantile(largest_nodal_values, 0.98)
        )
        return float(scale_end) if scale_end > 0.0 else 1.0

    @cached_property
    def stress(self) -> np.ndarray:
        """Stress components at the nodes [Pa]: (n, n_nodes, 3), in a solid (n, n_nodes, 6).

        Computed by :func:`nodal_stress`; requires a material.
        """
        assert self.material is not None
        return nodal_stress(self.mesh, self.displacement, self.material)

    def make_frame_grid(self, frame_index: int) -> Any:
        """Return the grid at rest with all point fields for one frame.

        :func:`write_period` lists the fields.
        """
        pair_forces, displacement = self.contact_forces[frame_index], self.displacement[frame_index]
        grid = make_grid_at_rest(self.mesh)
        # A node half-way between two pairs is closed if both are closed.
        pair_weight_sums_at_nodes = self.nodal_weights_of_pair_pressures.sum(axis=1)
        is_node_closed = (
            self.nodal_weights_of_pair_pressures @ (pair_forces > 0.0)
            > 0.501 * pair_weight_sums_at_nodes
        )
        point_fields = {
            "displacement": pad_to_space(displacement),
            "contact state": np.where(pair_weight_sums_at_nodes > 0.0, 1.0 * is_node_closed, -1.0),
            "contact force": self.nodal_force_per_pair_force @ pair_forces,
            "contact pressure": self.nodal_weights_of_pair_pressures
            @ (pair_forces / self.pair_areas),
        }
        if self.material is not None:
            point_fields["stress"] = self.stress[frame_index]
            point_fields["von Mises stress"] = von_mises(self.stress[frame_index])
        for name, values in point_fields.items():
            grid.point_data[name] = values.astype(np.float32)  # in half the time and space
        stress = grid.GetPointData().GetArray("stress")
        component_names = STRESS_COMPONENTS_BY_DIMENSION[self.mesh.dimension]
        for component_index, name in enumerate(component_names if self.material else ()):
            stress.SetComponentName(component_index, name)
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

    The nodes of all frames are at rest; ParaView's Warp By Vector moves them by the field
    ``displacement``. A script is written, too: ``paraview --script=NAME_paraview.py`` magnifies the
    displacement, colours by stress or displacement, and plays the period once. Each frame has the
    ``magnification`` in its field data.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to show.
    path : str or Path
        The .pvd file to open in ParaView; a folder of the same name gets the frames (.vtu).
    frames : int
        Number of instants in the period.
    magnification : float, optional
        Scale factor of Warp By Vector in the script; default: the largest displacement becomes a
        tenth of the structure's size.
    material : Material, optional
        Material of the scene, for stresses.

    Returns
    -------
    float
        Displacement scale factor in the script.

    Raises
    ------
    InputError
        The structure has no mesh, an argument cannot be used, or the frames' folder is a link.

    Notes
    -----
    Point fields, in single precision:

    - ``displacement`` [m], not magnified,
    - ``contact state``: 1 on a closed pair of face nodes, 0 on an open one, -1 off the crack faces,
    - ``contact force`` [N] on each node of a pair, or on the two middle nodes of a solid's patch,
    - ``contact pressure`` [Pa]: the force over the pair's area, interpolated between patches. It is
      smooth along the crack faces if the contact stiffness is given per area.
    - with a material ``stress`` (xx, yy, xy; in a solid xx, yy, zz, xy, yz, xz) and ``von Mises
      stress`` [Pa]. At the tip and under a point load, both grow without bound as the mesh is
      refined.

    Examples
    --------
    >>> magnification = fc.write_period(solution, "crack.pvd", frames=4)
    """
    collection_path = Path(path)
    begin_stage(collection_path.name)
    fields = PeriodFields(solution, frames, magnification, material)

    def write_files() -> None:
        check_is_no_link_or_file(collection_path.with_name(collection_path.stem))
        frame_names = [
            f"{collection_path.stem}/frame_{frame:04d}.vtu" for frame in range(len(fields.time))
        ]
        data_set_lines = [
            f'    <DataSet timestep="{instant:.12g}" file={quoteattr(frame_name)}/>'
            for instant, frame_name in zip(fields.time, frame_names, strict=True)
        ]
        collection_text = "\n".join(
            [
                '<VTKFile type="Collection" version="0.1">',
                "  <Collection>",
                *data_set_lines,
                "  </Collection>",
                "</VTKFile>",
                "",
            ]
        )
        colour_name, colour_unit = fields.colour_field_name_and_unit
        script_path = collection_path.with_name(f"{collection_path.stem}_paraview.py")
        script_text = read_packaged_text("draw/paraview_state.txt").format(
            script=script_path.name,
            folder=str(collection_path.parent.resolve()),
            pvd=collection_path.name,
            field=colour_name,
            title=f"{colour_name} [{colour_unit}]",
            end=fields.colour_scale_end,
            mode=f"{fields.mesh.dimension}D",
            camera=PARAVIEW_VIEW_COMMANDS_BY_DIMENSION[fields.mesh.dimension],
            caption=f"displacement x {fields.magnification:.3g}",
            factor=fields.magnification,
        )
        first_files = [(collection_path, collection_text), (script_path, script_text)]
        frame_files = (
            (collection_path.parent / frame_name, _format_vtu(fields.make_frame_grid(frame)))
            for frame, frame_name in enumerate(frame_names)
        )
        write_files_together(itertools.chain(first_files, frame_files))

    on_root(fields.mesh.structure.comm, write_files)
    return fields.magnification


PARAVIEW_VIEW_COMMANDS_BY_DIMENSION = {
    2: "view.ResetActiveCameraToNegativeZ()",
    3: "view.ApplyIsometricView()",
}
"""ParaView's commands to look at a plate and at a solid."""


def _format_vtu(grid: Any) -> str:
    """Return pyvista's grid as the text for a .vtu file.

    VTK does not write the file itself, since it would not report a failure such as a full disk.
    """
    point_data, writer = grid.GetPointData(), vtkXMLUnstructuredGridWriter()
    point_data.SetActiveScalars(point_data.GetArrayName(0))  # ParaView's first colours
    writer.SetInputData(grid)
    writer.SetDataModeToBinary()
    writer.SetCompressionLevel(1)  # 3 times faster, 1 % larger; not all readers know LZ4
    writer.WriteToOutputStringOn()
    writer.Write()
    return str(writer.GetOutputString())


def _find_nodal_force_per_pair_force(structure: Structure) -> np.ndarray:
    """Return the force at each node for a unit contact force on each pair (collective).

    Returns
    -------
    (n_nodes, n_pairs)
        Absolute nodal force divided by the contact force, complete on every rank.
    """
    assert structure.nodes is not None
    dof_by_node_and_axis, gap_matrix = structure.nodes.dofs, structure.gap
    node_and_axis_indices_of_free_dofs = np.nonzero(dof_by_node_and_axis >= 0)
    node_index_of_free_dofs, local_dofs = (
        node_and_axis_indices_of_free_dofs[0],
        dof_by_node_and_axis[node_and_axis_indices_of_free_dofs] - structure.first_dof,
    )
    dof_selection_triplets = (
        np.ones(len(node_index_of_free_dofs)),
        (node_index_of_free_dofs, local_dofs),
    )
    node_dof_matrix = csr_matrix(
        dof_selection_triplets, (len(dof_by_node_and_axis), structure.n_local)
    )
    return gather_rows(
        structure.comm, np.sqrt((node_dof_matrix @ gap_matrix.multiply(gap_matrix)).toarray())
    )
