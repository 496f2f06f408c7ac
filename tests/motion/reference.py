"""A flow and an orbit that share no code with the package's: each set of closed pairs by the
eigenvectors of its matrix, events by bisection, contact at an instant by least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize


class ReferenceFlow:
    """The flow of a contact flow's equations at one frequency."""

    def __init__(self, flow: Any, omega: float, points: int = 24) -> None:
        """``points``: of the search for events in the period of the fastest set."""
        modes, self.omega, self.points = flow.modes, omega, points
        self.squares, self.pairs = modes.squares, modes.pairs
        self.damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
        self.compliance = flow.residual + np.diag(flow.softness)
        self.force, self.gap, self.fastest = flow.force, flow.gap, max(flow.fastest, omega)
        self.sets: dict = {}

    def set_of(self, closed: tuple) -> tuple:
        """Eigenvalues and vectors of (q, q', 1, cos, sin), and rows of the answers there."""
        if closed in self.sets:
            return self.sets[closed]
        m, here = len(self.squares), np.array(closed, dtype=bool)
        inverse = np.zeros_like(self.compliance)
        inverse[np.ix_(here, here)] = np.linalg.inv(self.compliance[np.ix_(here, here)])
        slow = np.hstack([self.pairs.T, np.zeros((len(closed), m)), self.gap.T])
        answers = np.where(here[:, None], inverse @ slow, (self.compliance @ inverse) @ slow - slow)
        matrix = np.zeros((2 * m + 3,) * 2)
        matrix[:m, m : 2 * m] = np.eye(m)
        matrix[m : 2 * m] = -self.pairs @ inverse @ slow
        matrix[m : 2 * m, :m] -= np.diag(self.squares)
        matrix[m : 2 * m, m : 2 * m] -= self.damping
        matrix[m : 2 * m, 2 * m :] += self.force.T
        matrix[2 * m + 1, 2 * m + 2], matrix[2 * m + 2, 2 * m + 1] = -self.omega, self.omega
        scale = np.concatenate([np.full(m, self.fastest), np.ones(m + 3)])
        values, vectors = np.linalg.eig(scale[:, None] * matrix / scale)
        left = np.linalg.inv(vectors) * scale
        vectors = vectors / scale[:, None]
        self.sets[closed] = found = values, vectors, left, answers @ vectors
        return found

    def contact(self, state: np.ndarray, time: float) -> tuple:
        """The set of closed pairs of a state."""
        waves = np.array([1.0, np.cos(self.omega * time), np.sin(self.omega * time)])
        slow = self.pairs.T @ state[: len(self.squares)] + waves @ self.gap
        root = np.linalg.cholesky(self.compliance)
        force = scipy.optimize.nnls(root.T, np.linalg.solve(root, slow))[0]
        return tuple(force > 0.0)

    def advance(
        self, state: np.ndarray, duration: float, instants: np.ndarray, start: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """The state at the end, q at instants, the derivative by the state, and events."""
        m, now, end, events = len(self.squares), start, start + duration, 0
        tangent, states = np.eye(2 * m), []
        step = 2.0 * np.pi / self.fastest / self.points
        closed = self.contact(state, now)
        while True:
            values, vectors, left, rows = self.set_of(closed)
            waves = [1.0, np.cos(self.omega * now), np.sin(self.omega * now)]
            weights = left @ np.concatenate([state, waves])
            length, found = self.leaves(values, rows * weights, end - now, step)
            times = instants[len(states) :]
            times = times[times <= now + length] if found else times
            states.extend((vectors @ (np.exp(values * (t - now)) * weights)).real for t in times)
            flow = (vectors * np.exp(values * length)) @ left
            tangent = flow[: 2 * m, : 2 * m].real @ tangent
            state = (flow @ np.concatenate([state, waves])).real[: 2 * m]
            now += length
            if not found:
                return state, np.array(states), tangent, events
            closed = tuple(np.array(closed) ^ np.isin(range(len(closed)), found))
            events += len(found)

    def leaves(
        self, values: np.ndarray, rows: np.ndarray, left: float, step: float
    ) -> tuple[float, list[int]]:
        """When the first answers fall through zero, and which; none: what is left."""
        low = 0.0

        def answer(pair: int, time: float) -> float:
            return float((np.exp(values * time) @ rows[pair]).real)

        size = np.abs((np.exp(np.outer(np.linspace(0, left, 50), values)) @ rows.T).real).max(
            axis=0
        )
        while low < left:
            high = min(low + 200 * step, left)
            times = np.linspace(low, high, 201)
            if low == 0.0:
                times[0] = 1e-11 * step  # what is zero there has just changed its sign
            seen = (np.exp(np.outer(times, values)) @ rows.T).real
            roots = []
            for pair in range(len(rows)):
                below = np.flatnonzero(seen[:, pair] < -1e-13 * size[pair])
                inner = seen[1:-1, pair]
                dips = 1 + np.flatnonzero((inner < seen[:-2, pair]) & (inner < seen[2:, pair]))
                first = below[0] if len(below) else len(times)
                found = None
                for dip in dips[dips < first]:
                    bottom = scipy.optimize.minimize_scalar(
                        lambda t, pair=pair: answer(pair, t),
                        bounds=(times[dip - 1], times[dip + 1]),
                        method="bounded",
                        options={"xatol": 1e-9 * step},
                    )
                    if bottom.fun < -1e-13 * size[pair]:
                        found = times[dip - 1], bottom.x
                        break
                if found is None and len(below):
                    found = times[max(first - 1, 0)], times[first]
                if found is None:
                    continue
                if answer(pair, found[0]) <= 0.0:
                    roots.append((found[0], pair))
                    continue
                root = scipy.optimize.brentq(
                    lambda t, pair=pair: answer(pair, t), *found, xtol=1e-300, rtol=1e-15
                )
                roots.append((root, pair))
            if roots:
                when = min(roots)[0]
                return when, [pair for root, pair in roots if root - when < 1e-13 * step]
            low = high
        return left, []
