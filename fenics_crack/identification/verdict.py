"""Whether there is a crack at all: two hypotheses, by what each explains and how likely it is."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from fenics_crack.arrivals.harmonics import MISFIT
from fenics_crack.identification.posterior import Posterior

__all__ = ["log_bayes_factor", "misfit_of", "verdict_of"]

EXPLAINS = 0.05
"""Probability of more misfit by chance from which a plate without a crack explains what is seen."""
STRONG = 3.0
"""Logarithm of the ratio of evidences, 20 to 1, from which a hypothesis is preferred."""


def log_bayes_factor(cracked: Posterior, plain: Posterior | None) -> float:
    """log of the evidence of a crack over that of none; nan where none was not considered."""
    return cracked.log_evidence - (np.nan if plain is None else plain.log_evidence)


def verdict_of(cracked: Posterior, plain: Posterior | None) -> tuple[str, str]:
    """The verdict "crack", "no crack" or "cannot be told", and the reason for it."""
    open_question = "cannot be told"
    if plain is None:
        return open_question, "there is no plate without a crack to compare with"
    ratio = log_bayes_factor(cracked, plain)
    fits, healthy = misfit_of(cracked)[1], misfit_of(plain)[1]
    told = f"log Bayes factor {ratio:.3g}, crack over no crack"
    if max(fits, healthy) < MISFIT:
        why = "neither a crack of this kind nor a plate without one explains the measurements"
        return open_question, f"{why} ({told})"
    if ratio > STRONG and healthy >= EXPLAINS:
        why = "a plate without a crack explains the measurements, as little as is known of it"
        return open_question, f"{why} ({told})"
    verdict = "crack" if ratio > STRONG else "no crack" if ratio < -STRONG else open_question
    return verdict, told


def misfit_of(posterior: Posterior) -> tuple[float, float]:
    """chi^2 where a likelihood is largest, and the probability of more by chance."""
    name, x = posterior.best
    likelihood = posterior.branches[name].likelihood
    total = float(np.sum(likelihood.residuals(x[None])[0, :-1] ** 2))
    count = len(likelihood.values) - likelihood.quantities(x[None]).free.shape[2]
    return total, float(chdtrc(max(count, 1), total))
