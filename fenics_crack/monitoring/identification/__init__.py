"""Identification of a crack from measurements: length and place with intervals.

``measurements`` holds the measurements, and ``responses`` finds natural frequencies in frequency
responses. ``interpolation`` interpolates smooth forms of swept quantities over the unknowns.
``nuisance`` has the priors of plate, clamp and model error. ``model`` predicts measurements with
their covariance, and fits displacements at probes. ``posterior`` compares predictions and
measurements. ``result`` has the verdict, the intervals and the information in further measurements.
``identify`` solves the sweeps and infers; ``options`` has the numerical settings.
"""
