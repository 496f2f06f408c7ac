"""Reader of mesh files by gmsh, in a program of its own
(:mod:`fenics_crack.basics.untrusted_files`)."""

import ctypes
from contextlib import suppress

import gmsh
import numpy as np


def read(path: str, most: int) -> dict[str, np.ndarray]:
    """Numbers and positions of the nodes, and the physical groups; their bytes are those of the
    memory, which is limited."""
    with suppress(AttributeError, ValueError):  # as in basics/gmsh_process.py, for FLTK
        ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    gmsh.merge(path)
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    return {"numbers": numbers, "positions": positions.reshape(-1, 3), **physical_groups()}


def physical_groups() -> dict[str, np.ndarray]:
    """Groups by kinds of elements: dimension, tag, kind and number of nodes of each; its name;
    and the nodes, one after the other."""
    heads, names, nodes = [], [], [np.zeros(0, dtype=np.uint64)]
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            kinds, _, own = gmsh.model.mesh.getElements(dimension, entity)
            heads += [(dimension, tag, k, len(o)) for k, o in zip(kinds, own, strict=True)]
            names += [name] * len(kinds)
            nodes += own
    return {
        "heads": np.array(heads, dtype=np.int64).reshape(-1, 4),
        "names": np.array(names, dtype=str),
        "nodes": np.concatenate(nodes),
    }
