"""List the causes of an answer's error, with the words about each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ErrorCause:
    """Hold the words about a cause of an answer's error.

    Attributes
    ----------
    varied_run_text : str
        Phrase for a run that varies the cause.
    remedy_text : str
        Clause on the remedy, printed if the error is as large as the value.
    parameter_runs_text : str
        For a cause that is a parameter, such as the friction coefficient: phrase for the source of
        the error. Runs with two values of the parameter are then compared. "" if runs have
        different meshes, or different numbers of modes, harmonics or samples.
    missing_number_reason : str
        Reason why the varied run gives no error of a number.
    """

    varied_run_text: str
    remedy_text: str = ""
    parameter_runs_text: str = ""
    missing_number_reason: str = "the run for comparison does not have this number"


MESH_ERROR_CAUSES = ("mesh", "shift")
"""Two causes that together make the error due to the mesh.

"mesh" is the error at a fixed distance from the resonance; "shift" is the error because the mesh
shifts the resonance.
"""
ERROR_CAUSES = {
    "mesh": ErrorCause("a run with another mesh", remedy_text="; use a finer mesh"),
    "shift": ErrorCause("a run with a shifted resonance"),
    "modes": ErrorCause("a run with more modes", remedy_text="; use more modes"),
    "harmonics": ErrorCause("a run with more harmonics", remedy_text="; use more harmonics"),
    "samples": ErrorCause("a run with more samples", remedy_text="; use more samples"),
    "friction": ErrorCause(
        "a run with friction",
        parameter_runs_text="by runs with and without friction",
        missing_number_reason="the effect of friction at the crack tip is unknown",
    ),
}
"""All causes of error by name, in the order of ``verify`` and of colours in pictures."""
ERROR_CAUSES_IF_REDUCED = ("modes", "harmonics", "mesh")
"""Causes whose errors are estimated for a reduced structure only.

For a full structure the runs for comparison take too long: three times as long as the solution.
"""
STATED_ERROR_CAUSES = (
    *ERROR_CAUSES_IF_REDUCED,
    *(cause for cause, words in ERROR_CAUSES.items() if words.parameter_runs_text),
)
"""Causes of error that a command estimates for each solution: all parameters are among them."""
REQUIRED_ERROR_CAUSES = ("harmonics", "modes")
"""Causes that must be known: if their error is unknown, no total error is stated.

The same holds for the mesh, if a run with another mesh fails.
"""
OMITTABLE_ERROR_CAUSES = ("mesh", "friction")
"""Causes that the user may leave out; the total error is then stated as incomplete."""
