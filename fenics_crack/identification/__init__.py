"""The crack from measurements: its length and place, how sure they are, and where to measure.

``measurements`` holds what was measured, ``sweeps`` solves the scene over the unknowns,
``features`` makes what they hold smooth, ``interpolation`` goes between their values, ``probes``
fits the motion to displacements, and ``model`` makes of these the predictions with their
covariance. ``posterior`` compares both, ``where_to_measure`` looks at one measurement more,
``result`` says what was found; ``identify`` is the call that does all of it.
"""
