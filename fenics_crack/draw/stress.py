"""Stresses at points of a vibrating structure, or along a line, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.paraview import in_space, moved_grid, nodal_stress
from fenics_crack.draw.vtk import pyvista
from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.matrices import numbers
from fenics_crack.study.run import Run, check_motion
from fenics_crack.time.march import TimeHistory

__all__ = ["stress_at"]

STRESS_INSTANTS = 128
"""Of a period."""


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
        What :func:`solve` or :func:`integrate` returns, of a mesh.
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
    check_motion(run)
    found, structure = run.result, run.structure
    mesh, places = NodalMesh(structure), numbers(points)
    if places.ndim != 2 or places.shape[1] != mesh.dimension or not np.all(np.isfinite(places)):
        raise InputError("points", points, f"rows of {mesh.dimension} finite numbers [m]")
    if isinstance(found, TimeHistory):
        time = found.time
        if len(found.recorded_dofs) < structure.n_local:
            raise InputError("dofs", "some", "None, to record all displacements")
        moved = structure.expand(found.recorded)
    else:
        time = np.arange(STRESS_INSTANTS) * found.period / STRESS_INSTANTS
        moved = found.displacement_field(time)
    nodal = nodal_stress(mesh, mesh.field(moved), run.scene.material)
    grid, columns = moved_grid(mesh), np.moveaxis(nodal, -2, 0)
    grid["stress"] = columns.reshape(len(columns), -1)
    seen = pyvista.PolyData(in_space(places)).sample(grid)
    off = np.flatnonzero(np.asarray(seen["vtkValidPointMask"]) == 0)
    if len(off):
        raise InputError("points", places[off[0]].tolist(), "on the mesh")
    stress = np.asarray(seen["stress"]).reshape(len(places), len(time), -1)
    return time, np.moveaxis(stress, 0, 1)
