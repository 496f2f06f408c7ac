"""Hide the differences between versions of DOLFINx and gmsh.

Debian 12 has DOLFINx 0.5 and gmsh 4.8, Debian 13 has 0.9 and 4.13, and wheels have 0.11 and 4.15.
DOLFINx 0.10 is provided for.

No other module looks at a version.
"""

from __future__ import annotations

import importlib.metadata
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.caches import load_or_compile_form, replace_unusable_caches
from fenics_crack.basics.errors import report_read_errors
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.machine import remaining_address_space, report_missing_libraries
from fenics_crack.basics.untrusted_files import leave_working_folder


@contextmanager
def _replaced_pkg_resources_context() -> Iterator[None]:
    """Replace setuptools' pkg_resources while UFL 2022.2 and FFCx 0.5 are imported.

    Both use pkg_resources only to find out their version. To import pkg_resources would take a
    tenth of the program's start.
    """
    substitute = ModuleType("pkg_resources")
    vars(substitute)["get_distribution"] = importlib.metadata.distribution
    current_module = sys.modules.setdefault("pkg_resources", substitute)
    try:
        yield
    finally:
        if current_module is substitute:
            del sys.modules["pkg_resources"]


replace_unusable_caches()
with _replaced_pkg_resources_context(), leave_working_folder(), report_missing_libraries():
    import basix
    import dolfinx
    import dolfinx.fem.petsc
    import dolfinx.geometry
    import dolfinx.io
    import dolfinx.plot
    import ffcx
    import ufl

    # DOLFINx and FFCx keep the options that they read first: those of the user in ~/.config, and
    # none from the working folder.
    _OPTIONS = [
        (getattr(module, "get_options", None) or module.get_parameters)()
        for module in (dolfinx.jit, ffcx)
    ]
    """Options for compiling forms, by name: DOLFINx's dict, then FFCx's dict."""

_HAS_FUNCTIONSPACE = hasattr(dolfinx.fem, "functionspace")
"""True for DOLFINx versions with the function ``functionspace``."""
_JIT_KEYWORD = "jit_options" if _HAS_FUNCTIONSPACE else "jit_params"
"""DOLFINx's keyword argument for options when a form is compiled."""
_CACHE_FOLDER = _OPTIONS[0].pop("cache_dir")
"""Folder with compiled forms."""


def gmsh_is_running() -> bool:
    """Return True if gmsh is initialised in this process; always False for gmsh 4.8.

    gmsh 4.8 cannot report the state.
    """
    return bool(getattr(gmsh, "isInitialized", lambda: False)())


def model_to_mesh(model: Any, comm: MPI.Comm, dimension: int) -> tuple[Any, Any, Any]:
    """Distribute rank 0's gmsh model as a DOLFINx mesh (collective).

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
        Mesh with ``dimension`` coordinates.
    cell_tags, facet_tags : dolfinx.mesh.MeshTags
        Tags of gmsh's physical groups.

    Raises
    ------
    MemoryError
        A rank has less than 150 MiB of address space.
    """
    try:
        from dolfinx.io import gmshio
    except ImportError:  # 0.10
        from dolfinx.io import gmsh as gmshio
    # A thread of SCOTCH takes 8 MiB of stack, 128 MiB of heap and some more. Without this memory
    # SCOTCH aborts the program, or DOLFINx loops for ever.
    if comm.allreduce(remaining_address_space() < 150 * 2**20, MPI.LOR):
        raise MemoryError("not enough memory for a thread of the mesh partitioner")
    # DOLFINx 0.5 tries a call that fails, and formats all arrays for an error that is discarded.
    with np.printoptions(threshold=0, edgeitems=1):
        mesh_data = gmshio.model_to_mesh(model, comm, 0, gdim=dimension)
    if isinstance(mesh_data, tuple) and len(mesh_data) == 3:
        return mesh_data
    return mesh_data.mesh, mesh_data.cell_tags, mesh_data.facet_tags


@contextmanager
def _quiet_compiler_context() -> Iterator[None]:
    """Suppress distutils' messages on the root logger while a form is compiled.

    FFCx gives the root logger a handler, and cffi sets the level INFO. Warnings, and messages of
    all other loggers, still appear.
    """

    def is_important(record: logging.LogRecord) -> bool:
        """Return True for a warning or an error."""
        return record.levelno > logging.INFO

    logging.root.addFilter(is_important)
    try:
        yield
    finally:
        logging.root.removeFilter(is_important)


@_quiet_compiler_context()
def _compile(comm: MPI.Comm, form: Any, make_object: Callable[..., Any], *arguments: Any) -> Any:
    """Make a DOLFINx object whose constructor compiles C code (collective).

    The compiled code is loaded from the cache if possible.

    Parameters
    ----------
    comm : MPI.Comm
        Ranks that make the object together.
    form : ufl form or element
        Form or element to compile. Used to find the code in the cache.
    make_object : callable
        Constructor, called as ``make_object(*arguments, jit_options=...)``.

    Returns
    -------
    Any
        Result of the constructor.
    """
    cache_key = ffcx.naming.compute_signature(
        [form], str((_OPTIONS, PETSc.ScalarType, sys.implementation))
    )
    return load_or_compile_form(
        comm,
        _CACHE_FOLDER / f"{cache_key}.txt",
        lambda options: make_object(*arguments, **{_JIT_KEYWORD: options}),
    )


def lagrange_element(mesh: Any, order: int, *, vectors: bool = True) -> Any:
    """Return the continuous Lagrange element of given order on a mesh's cells.

    Values are vectors with the mesh's dimension, or scalars if ``vectors`` is False.
    """
    if _HAS_FUNCTIONSPACE:
        shape = (mesh.geometry.dim,) if vectors else None
        return basix.ufl.element("Lagrange", mesh.topology.cell_type.name, order, shape=shape)
    make_element = ufl.VectorElement if vectors else ufl.FiniteElement
    return make_element("Lagrange", mesh.ufl_cell(), order)


def function_space(mesh: Any, order: int, *, vectors: bool = True) -> Any:
    """Return the DOLFINx space of continuous Lagrange functions on a mesh (collective).

    Values are vectors with the mesh's dimension, or scalars if ``vectors`` is False.
    """
    element = lagrange_element(mesh, order, vectors=vectors)
    if _HAS_FUNCTIONSPACE:
        return dolfinx.fem.functionspace(mesh, element)
    return _compile(mesh.comm, element, dolfinx.fem.FunctionSpace, mesh, element)


def compile_form(form: Any) -> Any:
    """Compile a UFL form; a compiled form comes back unchanged (collective).

    A compiled form can be assembled repeatedly, with changed values of constants and functions.
    """
    if not isinstance(form, ufl.Form):
        return form
    return _compile(form.ufl_domain().ufl_cargo().comm, form, dolfinx.fem.form, form)


def assembled_petsc_matrix(form: ufl.Form) -> Any:
    """Assemble a bilinear form into a PETSc matrix, without boundary conditions (collective).

    The caller destroys the matrix.
    """
    matrix = dolfinx.fem.petsc.assemble_matrix(compile_form(form))
    matrix.assemble()
    return matrix


def assembled_vector(form: Any) -> np.ndarray:
    """Assemble a linear form, UFL or compiled, on this rank's dofs: (n_owned_dofs,).

    Contributions from other ranks' cells are included (collective).
    """
    vector = dolfinx.fem.petsc.assemble_vector(compile_form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    owned_entries = vector.array_r.copy()
    vector.destroy()
    return owned_entries


def evaluate_basis(space: Any, order: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the basis functions of a function space at a point (d,) [m].

    ``order`` is the polynomial order of the space. If no cell of this rank has the point, both
    results are empty.

    Returns
    -------
    nodes : (k,) int
        Nodes of a cell with the point, as this rank's local numbers.
    basis_values : (k,)
        Value of each node's basis function at the point.
    """
    mesh = space.mesh
    dimension = mesh.topology.dim
    position = np.append(point, np.zeros(3 - dimension)).astype(float)
    if hasattr(dolfinx.geometry, "bb_tree"):
        bounding_box_tree = dolfinx.geometry.bb_tree(mesh, dimension, padding=1e-10)
        candidate_cells = dolfinx.geometry.compute_collisions_points(bounding_box_tree, position)
        colliding_cells = dolfinx.geometry.compute_colliding_cells(
            mesh, candidate_cells, position
        ).array
    else:
        bounding_box_tree = dolfinx.geometry.BoundingBoxTree(mesh, dimension, padding=1e-10)
        candidate_cells = dolfinx.geometry.compute_collisions(bounding_box_tree, position)
        colliding_cells = np.asarray(
            dolfinx.geometry.compute_colliding_cells(mesh, candidate_cells, position)
        )
    colliding_cells = colliding_cells[
        colliding_cells < mesh.topology.index_map(dimension).size_local
    ]
    if not len(colliding_cells):
        return np.zeros(0, dtype=np.int32), np.zeros(0)
    cell_index = int(colliding_cells[0])
    cell_node_positions = mesh.geometry.x[geometry_dofmap(mesh)[cell_index], :dimension]
    reference_point = mesh.geometry.cmap.pull_back(position[None, :dimension], cell_node_positions)
    cell_name, variant = mesh.topology.cell_type.name, basix.LagrangeVariant.gll_warped
    cell_type = getattr(basix.CellType, cell_name)
    reference_element = basix.create_element(basix.ElementFamily.P, cell_type, order, variant)
    basis_values = reference_element.tabulate(0, reference_point)[0, 0].ravel()
    return np.asarray(space.dofmap.cell_dofs(cell_index)), basis_values


def are_facet_tags_of(tags: Any, mesh: Any) -> bool:
    """Return True if DOLFINx tags belong to a mesh and tag facets, not other entities."""
    tagged_topology, mesh_topology = (
        (tags.topology, mesh.topology) if _HAS_FUNCTIONSPACE else (tags.mesh, mesh)
    )
    return (
        _cpp_object(tagged_topology) is _cpp_object(mesh_topology)
        and tags.dim == mesh.topology.dim - 1
    )


def _cpp_object(wrapper: Any) -> Any:
    """Return the C++ object behind a DOLFINx object in Python; a C++ object itself unchanged."""
    return getattr(wrapper, "_cpp_object", getattr(wrapper, "_mesh", wrapper))


def constrained_dof_mask(space: Any, conditions: Any) -> np.ndarray:
    """Return True for each of this rank's dofs held at zero by Dirichlet conditions: (n_dofs,).

    Raises
    ------
    InputError
        A condition is on another space, or holds at another value than zero. The key is "bcs".
    """
    cpp_space = space._cpp_object
    n_dofs = space.dofmap.index_map.size_local * space.mesh.geometry.dim
    zeros_after_conditions, ones_after_conditions = start_values = np.array([[0.0], [1.0]]).repeat(
        n_dofs, axis=1
    )
    with report_read_errors(
        "bcs", type(conditions).__name__, "Dirichlet conditions of value 0 on the function space"
    ):
        conditions = list(conditions)
        if not all(
            cpp_space.contains(_cpp_object(condition.function_space)) for condition in conditions
        ):
            raise ValueError("one is on another function space")
        for start_array in start_values:
            start_vector = PETSc.Vec().createWithArray(start_array, comm=MPI.COMM_SELF)
            dolfinx.fem.petsc.set_bc(start_vector, conditions)
        if np.any(zeros_after_conditions):
            raise ValueError("one has a value other than 0")
    return np.asarray(ones_after_conditions == 0.0)


def facet_corner_nodes(mesh: Any, facets: np.ndarray) -> np.ndarray:
    """Return the nodes at the corners of facets, in cyclic order: (n, k) int.

    ``facets`` (n,) are local numbers of facets. The results are local numbers of the mesh
    geometry's nodes. k is 2 for edges of a plate, 3 or 4 for facets of a solid.
    """
    topology, dimension = mesh.topology, mesh.topology.dim
    for connected_dimensions in (
        (dimension - 1, 0),
        (dimension - 1, dimension),
        (dimension, dimension - 1),
    ):
        topology.create_connectivity(*connected_dimensions)
    corner_order = [0, 1, 3, 2] if topology.cell_type.name == "hexahedron" else [*range(dimension)]
    if not len(facets):  # DOLFINx 0.9 divides by their number
        return np.zeros((0, len(corner_order)), dtype=np.int32)
    if _HAS_FUNCTIONSPACE:
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dimension - 1, facets)
    else:
        nodes = dolfinx.cpp.mesh.entities_to_geometry(
            _cpp_object(mesh), dimension - 1, facets, False
        )
    return np.asarray(nodes)[:, corner_order]


def geometry_dofmap(mesh: Any) -> np.ndarray:
    """Return the nodes of each of this rank's cells: (n_cells, n_nodes) int.

    Nodes are local numbers of the mesh's geometry, as rows of ``mesh.geometry.x``.
    """
    dofmap = mesh.geometry.dofmap
    if isinstance(dofmap, np.ndarray):
        return dofmap
    return dofmap.array.reshape(dofmap.num_nodes, -1)


def vtk_cells_and_type(space: Any) -> tuple[np.ndarray, int]:
    """Return this rank's cells with nodes in VTK's order. Used for pictures.

    Returns
    -------
    cells : (n_cells, n_nodes) int
        Nodes of each cell, as local numbers of the function space.
    vtk_type : int
        VTK's number of the cell type; 0 if there are no cells.
    """
    make_vtk_arrays = getattr(dolfinx.plot, "vtk_mesh", None) or dolfinx.plot.create_vtk_mesh
    cells, cell_types, _ = make_vtk_arrays(space)
    n_nodes_per_cell = int(cells[0]) if len(cells) else 1
    return cells.reshape(-1, n_nodes_per_cell + 1)[:, 1:], int(cell_types[0]) if len(
        cell_types
    ) else 0
