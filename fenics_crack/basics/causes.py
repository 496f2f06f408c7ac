"""Causes of an answer's error: their names, and what follows if one is not varied."""

MESH_CAUSES = ("mesh", "shift")
"""Parts of the mesh error: at a given distance from the resonance, and by the resonance's shift."""
REDUCTION_CAUSES = ("modes", "harmonics", "mesh")
"""Causes that are varied only of a reduced structure: full models take three times as long."""
CAUSES = (*MESH_CAUSES, "modes", "harmonics", "friction", "samples")
"""All causes, in the order of colours in pictures."""
REQUIRED_CAUSES = ("harmonics", "modes")
"""Causes without which no error is known."""
OPTIONAL_CAUSES = ("mesh", "friction")
"""Causes that the user may leave out; their part is then unknown, not absent."""
OTHER_RUNS = {"mesh": "another mesh", "shift": "a shifted resonance",
              "friction": "a run with friction"}  # fmt: skip
"""Words for the run that shows a cause's part; by default "a run with more modes"."""
MISSING_PART_REASONS = {"friction": "that at the crack tip itself is not known"}
"""Reason why a number has no part of a cause that was varied."""
