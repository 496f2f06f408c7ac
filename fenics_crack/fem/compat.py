"""Everything that differs between the versions of DOLFINx and gmsh in use.

DOLFINx 0.5 and gmsh 4.8 are Debian 12's, 0.9 and 4.13 Debian 13's, 0.11 and 4.15 those of wheels;
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

from fenics_crack.basics.caches import settle_caches
from fenics_crack.basics.errors import reading
from fenics_crack.basics.form_cache import load_form
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.installation import loading
from fenics_crack.basics.threads import addresses_left
from fenics_crack.basics.untrusted_files import away


@contextmanager
def _versions_by_metadata() -> Iterator[None]:
    """Spare UFL 2022.2 and FFCx 0.5 setuptools' pkg_resources, a tenth of a start: they ask it for
    their own version and nothing else."""
    asked = ModuleType("pkg_resources")
    vars(asked)["get_distribution"] = importlib.metadata.distribution
    before = sys.modules.setdefault("pkg_resources", asked)
    try:
        yield
    finally:
        if before is asked:
            del sys.modules["pkg_resources"]


settle_caches()
with _versions_by_metadata(), away(), loading():
    import basix
    import dolfinx
    import dolfinx.fem.petsc
    import dolfinx.geometry
    import dolfinx.io
    import dolfinx.plot
    import ffcx
    import ufl

    # They keep the settings that they read first: the user's own in ~/.config, none from here.
    _READ = [(getattr(m, "get_options", None) or m.get_parameters)() for m in (dolfinx.jit, ffcx)]

_NEW = hasattr(dolfinx.fem, "functionspace")
_JIT = "jit_options" if _NEW else "jit_params"
_CACHE = _READ[0].pop("cache_dir")


def gmsh_is_running() -> bool:
    """Return True if gmsh is initialised; gmsh 4.8 does not report it, which is taken as False."""
    return bool(getattr(gmsh, "isInitialized", lambda: False)())


def model_to_mesh(model: Any, comm: MPI.Comm, dimension: int) -> tuple[Any, Any, Any]:
    """Distribute the gmsh model of rank 0 as a mesh in a plane or in space: (mesh, cell tags, facet
    tags)."""
    try:
        from dolfinx.io import gmshio
    except ImportError:  # 0.10
        from dolfinx.io import gmsh as gmshio
    # A thread of SCOTCH takes 8 MiB of stack, 128 MiB of heap and some more: without them it ends
    # with words of its own, or DOLFINx loops for ever.
    if comm.allreduce(addresses_left() < 150 * 2**20, MPI.LOR):
        raise MemoryError("no room for a thread")
    # DOLFINx 0.5 tries a call whose error, seen by nobody, shows all arrays.
    with np.printoptions(threshold=0, edgeitems=1):
        data = gmshio.model_to_mesh(model, comm, 0, gdim=dimension)
    if isinstance(data, tuple) and len(data) == 3:
        return data
    return data.mesh, data.cell_tags, data.facet_tags


@contextmanager
def _quiet_compiler() -> Iterator[None]:
    """Hold back what distutils logs of each form that is compiled, on the root logger itself.

    FFCx gives that logger a handler, and cffi sets its level to INFO meanwhile. What other loggers
    tell is heard, and so are warnings.
    """

    def important(record: logging.LogRecord) -> bool:
        return record.levelno > logging.INFO

    logging.root.addFilter(important)
    try:
        yield
    finally:
        logging.root.removeFilter(important)


@_quiet_compiler()
def _compiled(comm: MPI.Comm, form: Any, make: Callable[..., Any], *given: Any) -> Any:
    """Make what a form, or an element, is compiled for (collective)."""
    key = ffcx.naming.compute_signature([form], str((_READ, PETSc.ScalarType, sys.implementation)))
    return load_form(comm, _CACHE / f"{key}.txt", lambda options: make(*given, **{_JIT: options}))


def lagrange_element(mesh: Any, order: int, *, vectors: bool = True) -> Any:
    """Continuous piecewise polynomials of the given order: vectors, or numbers."""
    if _NEW:
        shape = (mesh.geometry.dim,) if vectors else None
        return basix.ufl.element("Lagrange", mesh.topology.cell_type.name, order, shape=shape)
    make = ufl.VectorElement if vectors else ufl.FiniteElement
    return make("Lagrange", mesh.ufl_cell(), order)


def function_space(mesh: Any, order: int, *, vectors: bool = True) -> Any:
    """The space of :func:`element`."""
    of_mesh = lagrange_element(mesh, order, vectors=vectors)
    if _NEW:
        return dolfinx.fem.functionspace(mesh, of_mesh)
    return _compiled(mesh.comm, of_mesh, dolfinx.fem.FunctionSpace, mesh, of_mesh)


def compile_form(form: Any) -> Any:
    """Compile a form (collective), to be assembled several times with other values of its constants
    and functions; return one that is compiled as it is."""
    if not isinstance(form, ufl.Form):
        return form
    return _compiled(form.ufl_domain().ufl_cargo().comm, form, dolfinx.fem.form, form)


def assembled_matrix(form: ufl.Form) -> Any:
    """Assemble a bilinear form without boundary conditions into a PETSc matrix (collective)."""
    matrix = dolfinx.fem.petsc.assemble_matrix(compile_form(form))
    matrix.assemble()
    return matrix


def assembled_vector(form: Any) -> np.ndarray:
    """Assemble a linear form, compiled or not; return the entries of the dofs that this rank owns
    (collective)."""
    vector = dolfinx.fem.petsc.assemble_vector(compile_form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    owned = vector.array_r.copy()
    vector.destroy()
    return owned


def evaluate_basis(space: Any, order: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the cell of this rank that holds a point, and their basis functions' values there.

    Both are empty where no cell of this rank holds the point.
    """
    mesh = space.mesh
    dimension = mesh.topology.dim
    where = np.append(point, np.zeros(3 - dimension)).astype(float)
    if hasattr(dolfinx.geometry, "bb_tree"):
        tree = dolfinx.geometry.bb_tree(mesh, dimension, padding=1e-10)
        near = dolfinx.geometry.compute_collisions_points(tree, where)
        hits = dolfinx.geometry.compute_colliding_cells(mesh, near, where).array
    else:
        tree = dolfinx.geometry.BoundingBoxTree(mesh, dimension, padding=1e-10)
        near = dolfinx.geometry.compute_collisions(tree, where)
        hits = np.asarray(dolfinx.geometry.compute_colliding_cells(mesh, near, where))
    hits = hits[hits < mesh.topology.index_map(dimension).size_local]
    if not len(hits):
        return np.zeros(0, dtype=np.int32), np.zeros(0)
    cell = int(hits[0])
    corners = mesh.geometry.x[geometry_dofmap(mesh)[cell], :dimension]
    reference = mesh.geometry.cmap.pull_back(where[None, :dimension], corners)
    kind, variant = mesh.topology.cell_type.name, basix.LagrangeVariant.gll_warped
    of_cell = getattr(basix.CellType, kind)
    reference_element = basix.create_element(basix.ElementFamily.P, of_cell, order, variant)
    values = reference_element.tabulate(0, reference)[0, 0].ravel()
    return np.asarray(space.dofmap.cell_dofs(cell)), values


def are_facet_tags_of(tags: Any, mesh: Any) -> bool:
    """Return True if tags are those of facets of a mesh."""
    tagged, whole = (tags.topology, mesh.topology) if _NEW else (tags.mesh, mesh)
    return _in_cpp(tagged) is _in_cpp(whole) and tags.dim == mesh.topology.dim - 1


def _in_cpp(thing: Any) -> Any:
    """The object of C++ behind one of Python, in the words of any version."""
    return getattr(thing, "_cpp_object", getattr(thing, "_mesh", thing))


def constrained_dofs(space: Any, conditions: Any) -> np.ndarray:
    """This rank's dofs of a space that Dirichlet conditions hold at zero: (n_dofs,) bool.

    Raises
    ------
    InputError
        One is of another space, or has a value that is not zero; the key is "bcs".
    """
    whole, count = space._cpp_object, space.dofmap.index_map.size_local * space.mesh.geometry.dim
    zeros, ones = values = np.array([[0.0], [1.0]]).repeat(count, axis=1)
    with reading("bcs", type(conditions).__name__, "Dirichlet conditions of zero on the space"):
        conditions = list(conditions)
        if not all(whole.contains(_in_cpp(condition.function_space)) for condition in conditions):
            raise ValueError("one is of another space")
        for row in values:
            vector = PETSc.Vec().createWithArray(row, comm=MPI.COMM_SELF)
            dolfinx.fem.petsc.set_bc(vector, conditions)
        if np.any(zeros):
            raise ValueError("one holds at another value than zero")
    return np.asarray(ones == 0.0)


def facet_corners(mesh: Any, facets: np.ndarray) -> np.ndarray:
    """Corners of facets of this rank, in turn, by their local numbers in the geometry: (n, k)."""
    topology, d = mesh.topology, mesh.topology.dim
    for pair in ((d - 1, 0), (d - 1, d), (d, d - 1)):
        topology.create_connectivity(*pair)
    in_turn = [0, 1, 3, 2] if topology.cell_type.name == "hexahedron" else [*range(d)]
    if not len(facets):  # by whose number 0.9 divides
        return np.zeros((0, len(in_turn)), dtype=np.int32)
    if _NEW:
        nodes = dolfinx.mesh.entities_to_geometry(mesh, d - 1, facets)
    else:
        nodes = dolfinx.cpp.mesh.entities_to_geometry(_in_cpp(mesh), d - 1, facets, False)
    return np.asarray(nodes)[:, in_turn]


def geometry_dofmap(mesh: Any) -> np.ndarray:
    """Geometry nodes of each local cell: (n_cells, n_nodes)."""
    dofmap = mesh.geometry.dofmap
    if isinstance(dofmap, np.ndarray):
        return dofmap
    return dofmap.array.reshape(dofmap.num_nodes, -1)


def vtk_cells(space: Any) -> tuple[np.ndarray, int]:
    """Local nodes of each owned cell in VTK's order, (n_cells, n_nodes), and VTK's cell type."""
    make = getattr(dolfinx.plot, "vtk_mesh", None) or dolfinx.plot.create_vtk_mesh
    cells, kinds, _ = make(space)
    nodes = int(cells[0]) if len(cells) else 1
    return cells.reshape(-1, nodes + 1)[:, 1:], int(kinds[0]) if len(kinds) else 0
