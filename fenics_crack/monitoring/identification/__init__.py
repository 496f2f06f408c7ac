"""Identification of a crack from measurements: length and place with intervals.

``measurements`` holds the measurements, and ``responses`` finds natural frequencies in frequency
responses. ``interpolation`` interpolates smooth forms of swept quantities over the unknowns.
``nuisance`` has the priors of plate, clamp and model error. ``model`` has the solved cases, and
``predictor`` predicts measurements with their covariance, and fits displacements at probes.
``posterior`` compares predictions and measurements. ``worth`` has the information in further
measurements, and ``result`` the verdict and the intervals. ``sweeps`` solves the cases, and
``identify`` infers from them; ``options`` has the numerical settings.
"""
