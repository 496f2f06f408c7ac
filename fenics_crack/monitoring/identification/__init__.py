"""Identification of a crack from measurements: its length and place with their intervals.

``measurements`` holds the measurements, ``responses`` finds natural frequencies in frequency
responses, ``interpolation`` interpolates smooth forms of the quantities of sweeps over the
unknowns, ``nuisance`` has the priors of the plate, its clamp and the model, and ``model`` the
predictions with their covariance, with a fit to displacements at probes. ``posterior`` compares
both, ``result`` has the verdict, the intervals and the information of further measurements;
``identify`` is the call that solves the sweeps and infers. ``options`` has the numerical settings.
"""
