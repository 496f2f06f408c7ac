"""The crack from measurements: its length and place, how sure they are, and where to measure.

``measurements`` holds what was measured, ``responses`` finds natural frequencies in frequency
responses, ``interpolation`` makes smooth what sweeps over the unknowns hold and goes between their
values, ``nuisance`` has what else is not as the scene says, and ``model`` makes of these the
predictions with their covariance, and fits the motion to displacements at probes.
``posterior`` compares both, ``result`` says what was found and what one measurement more would
tell; ``identify`` is the call that solves the sweeps and does all of it.
"""
