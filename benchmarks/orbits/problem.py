"""A case of the benchmark as a program that is scored gets it, and what it answers. NumPy alone.

    M q'' + C q' + K q + B lambda(g) + B_t lambda_t = f(t),      g = B^T q - g0,

g > 0 is penetration. Of pairs without mass q are modes, and g = B^T q + l(t) - R lambda - g0 with
a flexibility R and a lift l by the load; ``with_faces`` makes their places y degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

INSTANTS = 256
"""Equal instants of the period at which gaps are compared."""


class Unsupported(Exception):
    """A law or a structure that a program does not have."""


@dataclass(kw_only=True)
class Answer:
    """What a program says of a case.

    Attributes
    ----------
    gap : (256, p) or None
        g at 256 equal instants of the period from phase zero; None: nothing was found.
    tangential : (256, p) or None
        B_t^T q of contact with friction, likewise.
    converged : bool
        Whether the program calls it a solution.
    error : float or None
        Its own statement of the error: root mean square over the one of the motion.
    verdict : str or None
        "stable" or "unstable".
    periods : int
        Periods of the load that the 256 instants cover.
    message : str
        The program's own words, or numbers, of how it ended.
    """

    gap: Any = None
    tangential: Any = None
    converged: bool = False
    error: float | None = None
    verdict: str | None = None
    periods: int = 1
    message: str = ""


@dataclass(kw_only=True)
class Problem:
    """A structure under one load.

    Attributes
    ----------
    name : str
        Of the case.
    mass, damping, stiffness : (n, n)
        M, C, K.
    pairs, tangents : (n, p)
        B, B_t; the latter zero where there is no friction.
    mean : (n,)
        f's mean.
    cos, sin : (m, n)
        f's cosines and sines of the orders 1 to m.
    omega : float
        Of the load [rad/s].
    kind : str
        "penalty" lambda = k max(g, 0), "rigid", "smoothed" k g (1/2 + arctan(s g) / pi) or
        "friction": a penalty and Coulomb's law.
    normal : (p,)
        k; inf where rigid.
    clearance : (p,)
        g0.
    sharpness : float
        s.
    coefficient, tangential : (p,)
        mu and k_t of friction.
    flexibility : (p, p) or None
        R; None of pairs with mass.
    lift : (2m+1, p)
        l: mean, and cosine and sine of each order of the load; zero of pairs with mass.
    """

    name: str
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    pairs: np.ndarray
    tangents: np.ndarray
    mean: np.ndarray
    cos: np.ndarray
    sin: np.ndarray
    omega: float
    kind: str
    normal: np.ndarray
    clearance: np.ndarray
    sharpness: float
    coefficient: np.ndarray
    tangential: np.ndarray
    flexibility: np.ndarray | None
    lift: np.ndarray

    def with_faces(self) -> Problem:
        """The same with the places of pairs without mass as the last p degrees of freedom:
        R^-1 (y - B^T q - l) = -lambda, g = y - g0, so that M is singular."""
        if self.flexibility is None:
            return self
        pull, pairs = np.linalg.inv(self.flexibility), self.pairs
        pull = 0.5 * (pull + pull.T)
        held, zero_block, zero = pairs @ pull, 0.0 * pull, 0.0 * pairs
        stiffness = np.block([[self.stiffness + held @ pairs.T, -held], [-held.T, pull]])
        mass, damping = (
            np.block([[matrix, zero], [zero.T, zero_block]]) for matrix in (self.mass, self.damping)
        )
        mean, cos, sin = (
            np.hstack([load_part - lift @ held.T, lift @ pull])
            for load_part, lift in (
                (self.mean, self.lift[0]), (self.cos, self.lift[1::2]), (self.sin, self.lift[2::2])
            )
        )  # fmt: skip
        return replace(
            self, mass=mass, damping=damping, stiffness=stiffness, flexibility=None,
            pairs=np.vstack([zero, np.eye(len(pull))]), mean=mean, cos=cos, sin=sin,
            tangents=np.vstack([self.tangents, zero_block]), lift=0.0 * self.lift,
        )  # fmt: skip

    def in_gaps(self) -> Problem:
        """The same in coordinates whose first p are B^T q, for programs with contact on degrees of
        freedom; where there is friction the next p are B_t^T q.

        Raises
        ------
        Unsupported
            The gaps depend on each other.
        """
        face_problem = self.with_faces()
        rows = face_problem.pairs.T
        if face_problem.kind == "friction":
            rows = np.vstack([rows, face_problem.tangents.T])
        if np.linalg.matrix_rank(rows) < len(rows):
            raise Unsupported("no dependent gaps")
        inverse_rows = np.hstack([np.linalg.pinv(rows), np.linalg.svd(rows)[2][len(rows) :].T])

        def turned(matrix: np.ndarray) -> np.ndarray:
            return np.asarray(inverse_rows.T @ matrix @ inverse_rows)

        return replace(
            face_problem, mass=turned(face_problem.mass), damping=turned(face_problem.damping),
            stiffness=turned(face_problem.stiffness), pairs=inverse_rows.T @ face_problem.pairs,
            tangents=inverse_rows.T @ face_problem.tangents, mean=face_problem.mean @ inverse_rows,
            cos=face_problem.cos @ inverse_rows,
            sin=face_problem.sin @ inverse_rows,
        )  # fmt: skip

    @property
    def period(self) -> float:
        """Of the load [s]."""
        return float(2.0 * np.pi / self.omega)

    def load(self, harmonics: int) -> np.ndarray:
        """Rows of f: mean, cosine and sine of each order up to H: (2H+1, n)."""
        rows = np.zeros((2 * harmonics + 1, len(self.mass)))
        rows[0] = self.mean
        for order in range(1, min(harmonics, len(self.cos)) + 1):
            rows[2 * order - 1 : 2 * order + 1] = self.cos[order - 1], self.sin[order - 1]
        return rows

    def force(self, time: float | np.ndarray) -> np.ndarray:
        """f(t): (n,) or (n, times)."""
        angles = np.multiply.outer(np.arange(1, len(self.cos) + 1), self.omega * np.asarray(time))
        mean = self.mean if np.ndim(time) == 0 else self.mean[:, None]
        return np.asarray(mean + self.cos.T @ np.cos(angles) + self.sin.T @ np.sin(angles))

    def contact(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """lambda and its slope at gaps (..., p), of a penalty or a smoothed law."""
        if self.kind == "smoothed":
            s, share = self.sharpness, 0.5 + np.arctan(self.sharpness * gap) / np.pi
            slope = share + s * gap / (np.pi * (1.0 + (s * gap) ** 2))
            return self.normal * gap * share, self.normal * slope
        self.only("penalty")
        return self.normal * np.maximum(gap, 0.0), self.normal * (gap > 0.0)

    def rate(self, time: Any, state: np.ndarray) -> np.ndarray:
        """z' of z = (q, q') at one time (2n,), or at several at once (2n, times), of pairs with
        mass and a penalty or a smoothed law.

        Raises
        ------
        Unsupported
            Pairs have no mass.
        """
        if self.flexibility is not None:
            raise Unsupported("no pairs without mass")
        n, inverse = len(self.mass), np.linalg.inv(self.mass)
        push = self.contact((self.pairs.T @ state[:n]).T - self.clearance)[0].T
        force = self.force(time) - self.pairs @ push - self.damping @ state[n:]
        return np.concatenate([state[n:], inverse @ (force - self.stiffness @ state[:n])])

    def rate_slope(self, state: np.ndarray) -> np.ndarray:
        """dz'/dz at several times at once: (2n, 2n, times)."""
        n, inverse = len(self.mass), np.linalg.inv(self.mass)
        slope = self.contact((self.pairs.T @ state[:n]).T - self.clearance)[1].T
        slopes = np.zeros((2 * n, 2 * n, state.shape[1]))
        slopes[:n, n:], slopes[n:, n:] = (
            np.eye(n)[:, :, None],
            -(inverse @ self.damping)[:, :, None],
        )
        gap_slope = np.einsum("ip,pl,jp->ijl", inverse @ self.pairs, slope, self.pairs)
        slopes[n:, :n] = -(inverse @ self.stiffness)[:, :, None] - gap_slope
        return slopes

    def only(self, *kinds: str) -> None:
        """Refuse other laws.

        Raises
        ------
        Unsupported
            It is another one.
        """
        if self.kind not in kinds:
            raise Unsupported(f"no {self.kind} contact")

    def linear(self, harmonics: int) -> np.ndarray:
        """Rows of the motion with open contacts: (2H+1, n)."""
        rows, load = np.zeros((2 * harmonics + 1, len(self.mass))), self.load(harmonics)
        rows[0] = np.linalg.lstsq(self.stiffness, load[0], rcond=None)[0]
        for order in range(1, harmonics + 1):
            w = order * self.omega
            dynamic = self.stiffness - w**2 * self.mass + 1j * w * self.damping
            amplitude = np.linalg.solve(dynamic, load[2 * order - 1] - 1j * load[2 * order])
            rows[2 * order - 1 : 2 * order + 1] = amplitude.real, -amplitude.imag
        return rows

    def gap(self, coefficients: np.ndarray) -> np.ndarray:
        """g at the 256 instants, from rows of the motion (2H+1, n).

        Raises
        ------
        ValueError
            Pairs have no mass: ``with_faces`` first.
        """
        if self.flexibility is not None:
            raise ValueError("pairs have no mass: with_faces() or in_gaps() first")
        return at_instants(coefficients) @ self.pairs - self.clearance


def at_instants(rows: np.ndarray) -> np.ndarray:
    """Values at the 256 instants of the rows mean, cosine and sine of each order: (256, n)."""
    orders = np.arange(1, len(rows) // 2 + 1)
    angles = np.outer(2.0 * np.pi * np.arange(INSTANTS) / INSTANTS, orders)
    return np.asarray(rows[0] + np.cos(angles) @ rows[1::2] + np.sin(angles) @ rows[2::2])


def problem_of(case: dict[str, Any]) -> Problem:
    """That of a case; of its orbits nothing is read."""
    parts, load, law = case["structure"], case["load"], case["law"]
    orders, count = len(load["cos"]), len(case["clearance"])
    pairs, lift = np.array(parts["pairs"], dtype=float), np.zeros((2 * orders + 1, count))
    if is_modal := parts["form"] == "modes":
        stored_lift = np.array(parts["lift"], dtype=float)[: len(lift)]
        lift[: len(stored_lift)] = stored_lift

    def matrix(name: str) -> np.ndarray:
        array = np.array(parts[name], dtype=float)
        return np.diag(array) if array.ndim == 1 else array

    def each(name: str) -> np.ndarray:
        return np.broadcast_to(np.array(law.get(name, 0.0), dtype=float), (count,)).copy()

    rigid = law["kind"] == "rigid"
    return Problem(
        name=case["name"], mass=np.eye(len(pairs)) if is_modal else matrix("mass"),
        damping=matrix("damping"), stiffness=matrix("squares" if is_modal else "stiffness"),
        pairs=pairs, tangents=np.array(parts.get("tangents", 0.0 * pairs), dtype=float),
        mean=np.array(load["mean"], dtype=float), cos=np.array(load["cos"], dtype=float),
        sin=np.array(load["sin"], dtype=float), omega=float(load["omega"]), lift=lift,
        flexibility=matrix("flexibility") if is_modal else None,
        kind=law["kind"], normal=np.full(count, np.inf) if rigid else each("stiffness"),
        clearance=np.array(case["clearance"], dtype=float),
        sharpness=float(law.get("sharpness", 0.0)), coefficient=each("coefficient"),
        tangential=each("tangential_stiffness"),
    )  # fmt: skip


Solve = Callable[[Problem], Answer]
"""The one function of an adapter, by the name ``solve``."""
