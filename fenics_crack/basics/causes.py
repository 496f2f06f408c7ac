"""Name the causes of an answer's error, and say what follows if a cause is not varied."""

MESH_ERROR_CAUSES = ("mesh", "shift")
"""Two causes that together make the error due to the mesh.

"mesh" is the error at a fixed distance from the resonance; "shift" is the error because the mesh
shifts the resonance.
"""
REDUCED_STRUCTURE_ERROR_CAUSES = ("modes", "harmonics", "mesh")
"""Causes whose errors are estimated for a reduced structure only.

For a full structure the runs for comparison take too long: three times as long as the solution.
"""
ERROR_CAUSES = (*MESH_ERROR_CAUSES, "modes", "harmonics", "friction", "samples")
"""All causes of error, in the order of colours in pictures."""
REQUIRED_ERROR_CAUSES = ("harmonics", "modes")
"""Causes that must be known: if their error is unknown, no total error is stated.

The same holds for the mesh, if a run with another mesh fails.
"""
OPTIONAL_ERROR_CAUSES = ("mesh", "friction")
"""Causes that the user may leave out; the total error is then stated as incomplete."""
VARIED_RUN_DESCRIPTION_BY_ERROR_CAUSE = {
    "mesh": "a run with another mesh",
    "shift": "a run with a shifted resonance",
    "friction": "a run with friction",
}
"""Words for the run that varies a cause; by default "a run with more modes"."""
UNKNOWN_ERROR_REASON_BY_CAUSE = {"friction": "the effect of friction at the crack tip is unknown"}
"""Reason, by cause, why the run that varies the cause gives no error of a number."""
