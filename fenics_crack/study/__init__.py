"""From a scene to its results."""
