"""A program of its own that reads a mesh file: ``msh_reader.py FILE HANDED MEMORY SECONDS MOST``.

A damaged file may crash gmsh or corrupt its memory, so MEMORY and SECONDS are limited, and with
them what it holds. The numbers and positions of the nodes and the physical groups go to the open
file of number HANDED, as .npz; or gmsh's error message.
"""

import os
import resource
import sys

import gmsh
import numpy as np


def main(path: str, handed: int, memory: int, seconds: int, most: int) -> None:
    """Read a file and hand over what it holds."""
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    room = resource.getrlimit(resource.RLIMIT_FSIZE)[1]  # what is handed over lies in memory
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    try:
        gmsh.merge(path)
        numbers, positions, _ = gmsh.model.mesh.getNodes()
        found = {"numbers": numbers, "positions": positions.reshape(-1, 3), **groups()}
    except Exception as error:  # gmsh raises nothing more specific
        found = {"error": np.array(str(error) or "no reason given")}
    with os.fdopen(handed, "wb") as file:
        np.savez(file, **found)


def groups() -> dict[str, np.ndarray]:
    """Of each group and kind of its elements: dimension, tag, kind and number of nodes; its name;
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


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
