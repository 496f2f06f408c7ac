"""Fifty guesses at a name: what somebody tries who has not read the reference.

Ten questions, five natural names for each, written down before the package's names were looked
at. A guess names the thing it is tried on: the package itself (``fc``) or what one of its calls
gave (``solution``, ``curve``, ``history``, ``scene``, ``sweep``).
"""

from __future__ import annotations

GUESSES = {
    "peak": ("curve.peak", "curve.max", "curve.resonance", "curve.maximum", "curve.find_peak"),
    "2/1 over length": (
        "sweep.indicators",
        "solution.indicators",
        "solution.ratio",
        "solution.second_harmonic",
        "solution.harmonic_ratio",
    ),
    "stable?": (
        "solution.stable",
        "solution.is_stable",
        "solution.stability",
        "curve.stable",
        "fc.stability",
    ),
    "time integration": (
        "fc.integrate",
        "fc.time_integration",
        "fc.simulate",
        "fc.transient",
        "fc.time_integrate",
    ),
    "save and load": ("solution.save", "fc.load", "fc.save", "curve.save", "fc.read"),
    "pandas": (
        "curve.to_dataframe",
        "curve.to_pandas",
        "curve.dataframe",
        "curve.to_csv",
        "history.to_dataframe",
    ),
    "own axes": ("curve.plot", "fc.plot", "fc.plot_curve", "solution.plot", "fc.draw_curve"),
    "modes": (
        "fc.modes",
        "fc.eigenmodes",
        "fc.natural_frequencies",
        "fc.eigenfrequencies",
        "fc.modal",
    ),
    "stress at the tip": (
        "solution.stress_intensity",
        "fc.stress_intensity_factor",
        "solution.sif",
        "solution.tip_stress",
        "solution.stress",
    ),
    "sweep": ("fc.sweep", "fc.run_sweep", "fc.parameter_sweep", "fc.parameter_study", "fc.study"),
}


def test_there_are_five_guesses_for_each_of_ten_questions():
    assert [len(names) for names in GUESSES.values()] == [5] * 10
