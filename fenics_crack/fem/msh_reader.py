"""A program of its own that reads a mesh file with gmsh: ``python -I msh_reader.py FILE``.

A damaged file may crash gmsh or corrupt its memory. The result goes to standard output, pickled:
numbers and positions of the nodes, and the physical groups; or gmsh's error message.
"""

import pickle
import sys

import gmsh


def main(path: str) -> None:
    """Read a file and write what it holds."""
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    try:
        gmsh.merge(path)
        numbers, positions, _ = gmsh.model.mesh.getNodes()
        found: object = (numbers, positions.reshape(-1, 3), groups())
    except Exception as error:  # gmsh raises nothing more specific
        found = str(error) or "no reason given"
    sys.stdout.buffer.write(pickle.dumps(found))


def groups() -> list:
    """Dimension, tag and name of each group, and elements of one kind: its number and the nodes."""
    found = []
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
            found += [
                (dimension, tag, name, int(k), own) for k, own in zip(kinds, nodes, strict=True)
            ]
    return found


if __name__ == "__main__":
    main(sys.argv[1])
