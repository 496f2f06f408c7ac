"""Name the causes of an answer's error, and say what follows if a cause is not varied."""

MESH_ERROR_CAUSES = ("mesh", "shift")
"""Parts of the mesh error.

"mesh" is the error at a fixed distance from the resonance, "shift" the error by the resonance's
shift.
"""
REDUCED_STRUCTURE_ERROR_CAUSES = ("modes", "harmonics", "mesh")
"""Causes that are varied for a reduced structure: a full model takes three times as long."""
ERROR_CAUSES = (*MESH_ERROR_CAUSES, "modes", "harmonics", "friction", "samples")
"""All causes of error, in the order of colours in pictures."""
REQUIRED_ERROR_CAUSES = ("harmonics", "modes")
"""Causes that must be known for an error to be stated.

Also the mesh, if the solution on the second mesh fails.
"""
OPTIONAL_ERROR_CAUSES = ("mesh", "friction")
"""Causes that the user may leave out: this part is then unknown, not absent."""
RUN_WORDS_BY_CAUSE = {"mesh": "a run with another mesh", "shift": "a run with a shifted resonance",
              "friction": "a run with friction"}  # fmt: skip
"""Words for the run that varies a cause; by default "a run with more modes"."""
MISSING_PART_REASON_BY_CAUSE = {"friction": "the effect of friction at the crack tip is unknown"}
"""Reason why a number has no part from a varied cause."""
