"""Prove orbits of small cases: Krawczyk's operator in the intervals of python-flint.

With w = (q, q', 1, cos(w t), sin(w t), ...) a motion with the pairs A closed is w' = G_A w, and
w(t) = exp(G_A t) w(0). Unknown are x = (q, q') at phase zero and the times t_1 < ... < t_n of the
crossings, at which a gap is zero: F(x, t) = (x(T) - x, g(t_1), ..., g(t_n)) = 0. In a box X around
an approximation m, with Y near the inverse of F', one zero lies in X, and no other, if

    m - Y F(m) + (I - Y F'(X)) (X - m)   is in the interior of X.

The zero is an orbit only if no other gap changes its sign: each gap is enclosed over each part of
the period, by pieces halved until its sign is sure; at a crossing its slope has one sign. Mass at
the pairs and linear springs are assumed. `pip install python-flint` in an environment of its own:

    python benchmarks/orbits/proof.py [NAME ...]      writes proofs.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, ctx  # type: ignore[import-not-found]

HERE = Path(__file__).parent
ctx.prec = 192
RADIUS, DEEPEST, FAR = arb(2) ** -70, 24, 1e-9
"""Of the box relative to the state; halvings of a part of the period; most from the reference."""


class Unproved(Exception):
    """Nothing is proved."""


class Flow:
    """Exponentials of one case, as dictionaries from its file have them."""

    def __init__(self, case: dict[str, Any]) -> None:
        parts, load = case["structure"], case["load"]
        if parts["form"] != "matrices" or case["law"]["kind"] != "penalty":
            raise Unproved("not a penalty of pairs with mass")
        self.B, self.k = arb_mat(parts["pairs"]), case["law"]["stiffness"]
        self.n, self.g0, orders = self.B.nrows(), case["clearance"], len(load["cos"])
        self.size = 2 * self.n + 1 + 2 * orders
        self.omega = arb(load["omega"])
        force = [
            load["mean"],
            *(row for pair in zip(load["cos"], load["sin"], strict=True) for row in pair),
        ]
        self.force = arb_mat(force).transpose()
        self.inverse = arb_mat(parts["mass"]).inv()
        self.K, self.C = arb_mat(parts["stiffness"]), arb_mat(parts["damping"])

    def row(self, j: int) -> arb_mat:
        """g_j = row w."""
        values = [self.B[i, j] for i in range(self.n)] + [arb(0)] * (self.size - self.n)
        values[2 * self.n] = -arb(self.g0[j])
        return arb_mat([values])

    def matrix(self, closed: tuple[bool, ...]) -> arb_mat:
        """G_A."""
        n, found = self.n, arb_mat(self.size, self.size)
        K, load = self.K, self.force
        for j in (j for j, on in enumerate(closed) if on):
            column = arb_mat([[self.B[i, j]] for i in range(n)])
            K = K + column * column.transpose() * arb(self.k[j])
            mean = column * arb(self.k[j]) * arb(self.g0[j])
            load = load + mean * arb_mat([[1] + [0] * (load.ncols() - 1)])
        blocks = (
            (n, 0, -(self.inverse * K)),
            (n, n, -(self.inverse * self.C)),
            (n, 2 * n, self.inverse * load),
        )
        for top, left, block in blocks:
            for i in range(block.nrows()):
                for j in range(block.ncols()):
                    found[top + i, left + j] = block[i, j]
        for i in range(n):
            found[i, n + i] = arb(1)
        for k in range(1, (self.size - 2 * n) // 2 + 1):
            c = 2 * n + 2 * k - 1
            found[c, c + 1], found[c + 1, c] = -k * self.omega, k * self.omega
        return found

    def start(self, x: list[arb]) -> arb_mat:
        """w at phase zero."""
        return arb_mat([[v] for v in [*x, arb(1), *[arb(1), arb(0)] * ((self.size - len(x)) // 2)]])

    def value(
        self, X: list[arb], sets: list, pairs: list[int], T: arb
    ) -> tuple[list[arb], arb_mat]:
        """F and F' at states and times (of intervals)."""
        m, count = 2 * self.n, len(pairs)
        times, w = [arb(0), *X[m:], T], self.start(X[:m])
        slopes = arb_mat(self.size, m + count)  # of w by all unknowns
        for i in range(m):
            slopes[i, i] = arb(1)
        F, J = [], arb_mat(m + count, m + count)
        for i, closed in enumerate(sets):
            G = self.matrix(closed)
            E = (G * (times[i + 1] - times[i])).exp()
            rate = G * w
            w, moved = E * w, E * slopes
            for a, sign in ((i - 1, -1), (i, 1)):  # the times at which this part begins and ends
                if 0 <= a < count:
                    change = E * rate
                    for r in range(self.size):
                        moved[r, m + a] += sign * change[r, 0]
            slopes = moved
            if i < count:
                row = self.row(pairs[i])
                F.append((row * w)[0, 0])
                part = row * slopes
                for c in range(m + count):
                    J[m + i, c] = part[0, c]
        for r in range(m):
            for c in range(m + count):
                J[r, c] = slopes[r, c] - (1 if r == c else 0)
        return [w[r, 0] - X[r] for r in range(m)] + F, J

    def signs(self, X: list[arb], sets: list, pairs: list[int], T: arb) -> None:
        """Enclose the sign of every gap in every part of the period."""
        times, w = [arb(0), *X[2 * self.n :], T], self.start(X[: 2 * self.n])
        for i, closed in enumerate(sets):
            G, length = self.matrix(closed), times[i + 1] - times[i]
            for j, on in enumerate(closed):
                zeros = (i > 0 and pairs[i - 1] == j, i < len(pairs) and pairs[i] == j)
                rows = self.row(j) * (1 if on else -1)
                self._part(rows, G, w, arb(0), arb(length.upper()), zeros, DEEPEST)
            w = (G * length).exp() * w

    def _part(
        self, row: arb_mat, G: arb_mat, w: arb_mat, low: arb, high: arb, zeros: tuple, left: int
    ) -> None:
        """row w > 0 between two times, but for zeros at their ends, near which it is monotonic."""
        inside = (G * low.union(high)).exp() * w
        if (row * inside)[0, 0] > 0:
            return
        slope = (row * G * inside)[0, 0]
        if (zeros[0] and not zeros[1] and slope > 0) or (zeros[1] and not zeros[0] and slope < 0):
            return
        if not left:
            raise Unproved("a gap whose sign between crossings is not enclosed")
        middle = (low + high).mid() / 2
        self._part(row, G, w, low, middle, (zeros[0], False), left - 1)
        self._part(row, G, w, middle, high, (False, zeros[1]), left - 1)


def prove(case: dict[str, Any], orbit: dict[str, Any]) -> dict[str, Any]:
    """Prove an orbit of a case near its state and its crossings."""
    crossings, first = orbit["crossings"], orbit["first"]
    flow, T = Flow(case), 2 * arb.pi() * orbit["subharmonic"] / arb(case["load"]["omega"])
    pairs, sets = [j for _, j in crossings], [tuple(first)]
    for j in pairs:
        sets.append(tuple(on ^ (i == j) for i, on in enumerate(sets[-1])))
    if sets[0] != sets[-1]:
        raise Unproved("the last set is not the first")
    m = [arb(v) for v in [*orbit["state"], *(t for t, _ in crossings)]]
    for _ in range(8):  # Newton's method, of midpoints
        F, J = flow.value(m, sets, pairs, T)
        step = J.mid().inv() * arb_mat([[v] for v in F])
        m = [(a - step[i, 0]).mid() for i, a in enumerate(m)]
    size = max(abs(v) for v in m[: 2 * flow.n])
    F, J = flow.value(m, sets, pairs, T)
    Y = J.mid().inv().mid()
    radius = size * RADIUS
    X = [v + arb(0, radius.upper()) for v in m]
    rest = Y * flow.value(X, sets, pairs, T)[1]
    off, push = Y * arb_mat([[v] for v in F]), arb_mat([[v - a] for v, a in zip(X, m, strict=True)])
    moved = (arb_mat([[int(i == j) for j in range(len(m))] for i in range(len(m))]) - rest) * push
    for i, box in enumerate(X):
        if not box.contains_interior(m[i] - off[i, 0] + moved[i, 0]):
            raise Unproved("the operator does not map the box into itself")
    flow.signs(X, sets, pairs, T)
    away = [abs(v - a) for v, a in zip(m, orbit["state"], strict=False)]
    distance = float(max(away) / size)
    if not distance < FAR:
        raise Unproved(f"the orbit proved is {distance:.0e} from the reference")
    return {
        "crossings": [[float(t), j] for t, j in zip(m[2 * flow.n :], pairs, strict=True)],
        "first": list(first),
        "state": [v.str(25, radius=False) for v in m[: 2 * flow.n]],
        "radius": float((radius / size).upper()),
        "distance": distance,
    }  # fmt: skip


def main() -> None:
    """Prove the orbits of 2 to 4 crossings in the cases named, by default in all."""
    proofs: dict[str, Any] = {}
    for path in sorted((HERE / "cases").glob("*.json")):
        case = json.loads(path.read_text()) if path.stem in (sys.argv[1:] or [path.stem]) else {}
        for number, orbit in enumerate(case.get("orbits", ())):
            if 2 <= len(orbit.get("crossings", ())) <= 4:
                name = f"{path.stem}/{number}"
                try:
                    proofs[name] = found = prove(case, orbit)
                    print(f"{name:20} radius {found['radius']:.0e}", flush=True)
                except (Unproved, ZeroDivisionError, ValueError) as error:
                    print(f"{name:20} not proved: {error}", flush=True)
    if not sys.argv[1:]:
        (HERE / "proofs.json").write_text(json.dumps(proofs, indent=1) + "\n")


if __name__ == "__main__":
    main()
