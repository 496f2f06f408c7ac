"""Read mesh files with gmsh, in a separate program (:mod:`fenics_crack.basics.untrusted_files`)."""

import ctypes
from contextlib import suppress

import gmsh
import numpy as np


def read(path: str, _max_bytes: int) -> dict[str, np.ndarray]:
    """Return nodes and physical groups of a mesh file.

    The caller limits memory, so the number of bytes is not checked here.

    Returns
    -------
    dict
        "numbers" (n,) and "positions" (n, 3) of the nodes, and the arrays of
        :func:`physical_groups`.
    """
    with suppress(AttributeError, ValueError):  # as in basics/gmsh_process.py, for FLTK
        ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    gmsh.merge(path)
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    return {"numbers": numbers, "positions": positions.reshape(-1, 3), **physical_groups()}


def physical_groups() -> dict[str, np.ndarray]:
    """Return the elements of all physical groups, block by block.

    A block has one group and one kind of elements.

    Returns
    -------
    dict
        "heads" (m, 4) int: dimension, group's tag, kind of elements, and length in "nodes" of each
        block; "names" (m,): name of the block's group; "nodes": node numbers of all blocks.
    """
    headers, names, nodes = [], [], [np.zeros(0, dtype=np.uint64)]
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            kinds, _, element_nodes = gmsh.model.mesh.getElements(dimension, entity)
            headers += [
                (dimension, tag, element_kind, len(node_list))
                for element_kind, node_list in zip(kinds, element_nodes, strict=True)
            ]
            names += [name] * len(kinds)
            nodes += element_nodes
    return {
        "heads": np.array(headers, dtype=np.int64).reshape(-1, 4),
        "names": np.array(names, dtype=str),
        "nodes": np.concatenate(nodes),
    }
