"""From a scene to its structure: gmsh meshes, DOLFINx assembles."""
