"""Prove orbits of small cases: Krawczyk's operator in the intervals of python-flint.

With w = (q, q', 1, cos(w t), sin(w t), ...) a motion with the pairs A closed is w' = G_A w, and
w(t) = exp(G_A t) w(0); gaps are R w. Unknown are x = (q, q') at phase zero and the times d from one
crossing, where a gap is zero, to the next: F(x, d) = (x(T) - x, g(t_1), ..., g(t_n)) = 0. In a box
X around an approximation m, with Y near the inverse of F', one zero lies in X, and no other, if
m - Y F(m) + (I - Y F'(X)) (X - m) is in the interior of X.

The zero is an orbit only if no other gap changes its sign: each gap is enclosed over each part of
the period, by pieces halved until its sign is sure; at a crossing its slope has one sign. Mass at
the pairs and linear springs are assumed. `pip install python-flint` in an environment of its own:

    python benchmarks/orbits/proof.py      writes proofs.json: orbits of 2 to 4 crossings
"""

import json
from itertools import accumulate
from pathlib import Path

from flint import arb, arb_mat, ctx  # type: ignore[import-not-found]

HERE = Path(__file__).parent
ctx.prec, RADIUS, DEEPEST = 192, arb(2) ** -70, 24
"""Bits; of the box relative to the state; most halvings of a part of the period."""


def require(holds: bool, what: str) -> None:
    """Prove nothing where a condition does not hold."""
    if not holds:
        raise ValueError(f"not proved: {what}")


def equations(case: dict) -> tuple[arb_mat, arb_mat, arb_mat]:
    """G of open pairs; what closed ones take from it is (their stiffness times P) R; R."""
    parts, load, B = case["structure"], case["load"], arb_mat(case["structure"]["pairs"])
    waves = [row for pair in zip(load["cos"], load["sin"], strict=True) for row in pair]
    force, inverse = arb_mat([load["mean"], *waves]).transpose(), arb_mat(parts["mass"]).inv()
    n, p, more = B.nrows(), B.ncols(), len(waves)
    arb_parts = (-arb_mat(parts["stiffness"]), -arb_mat(parts["damping"]), force)
    blocks = [(inverse * matrix).tolist() for matrix in arb_parts]
    G = [[int(j == n + i) for j in range(2 * n + 1 + more)] for i in range(n)]
    G += [[*a, *b, *c] for a, b, c in zip(*blocks, strict=True)] + [[0] * len(G[0])]
    for i in range(more):  # cosines fall by sines, sines rise by cosines
        rate, other = (i // 2 + 1) * arb(load["omega"]), 2 * n + 1 + (i ^ 1)
        G += [[(rate if i % 2 else -rate) * int(j == other) for j in range(len(G[0]))]]
    R = [[*b, *[0] * n, -arb(g0), *[0] * more]
         for b, g0 in zip(B.transpose().tolist(), case["clearance"], strict=True)]  # fmt: skip
    P = [[0] * p] * n + (inverse * B).tolist() + [[0] * p] * (1 + more)
    return arb_mat(G), arb_mat(P), arb_mat(R)


def value(X: list[arb], parts: list, R: arb_mat, pairs: list, T: arb) -> tuple[arb_mat, ...]:
    """F, F' at states and times (of intervals); generator, start and length of each part."""
    size, m, path, F, J = R.ncols(), len(X) - len(pairs), [], [], []
    w = arb_mat([[v] for v in [*X[:m], 1, *[1, 0] * ((size - m) // 2)]])
    slopes = start = arb_mat([[int(i == j < m) for j in range(len(X))] for i in range(size)])
    for i, G in enumerate(parts):
        length = X[m + i] if i < len(pairs) else T - sum(X[m:], arb(0))
        longer = [int(a == m + i) if i < len(pairs) else -int(a >= m) for a in range(len(X))]
        path.append((G, w, length))
        E = (G * length).exp()
        w = E * w
        slopes = E * slopes + G * w * arb_mat([longer])
        if i < len(pairs):
            F, J = [*F, (R * w).tolist()[pairs[i]]], [*J, (R * slopes).tolist()[pairs[i]]]
    F, J = [[w[r, 0] - X[r]] for r in range(m)] + F, (slopes - start).tolist()[:m] + J
    return arb_mat(F), arb_mat(J), path


def prove(case: dict, orbit: dict) -> dict:
    """Prove an orbit of a case near its state and its crossings."""
    require(case["law"]["kind"] == "penalty", "not a penalty")
    (times, pairs), start_contact_set = zip(*orbit["crossings"], strict=True), orbit["first"]
    sets = [[on ^ (pairs[:part].count(j) % 2 == 1) for j, on in enumerate(start_contact_set)]
            for part in range(len(pairs) + 1)]  # fmt: skip
    require(sets[0] == sets[-1], "the last set is not the first")
    (G, P, R), k, states = equations(case), case["law"]["stiffness"], len(orbit["state"])
    parts = [G - P * arb_mat([[arb(k[i]) * int(on and i == j) for j in range(len(k))]
                              for i, on in enumerate(closed_pairs)]) * R
             for closed_pairs in sets]  # fmt: skip
    T = 2 * arb.pi() * orbit["subharmonic"] / arb(case["load"]["omega"])
    m = [arb(v) for v in orbit["state"]]
    m += [arb(b) - arb(a) for a, b in zip((0, *times), times, strict=False)]
    for _ in range(8):  # Newton's method, of midpoints
        F, J, _ = value(m, parts, R, pairs, T)
        m = [(a - step[0]).mid() for a, step in zip(m, (J.mid().inv() * F).tolist(), strict=True)]
    X = [v + arb(0, (max(abs(v) for v in m[:states]) * RADIUS).upper()) for v in m]
    F, J, _ = value(m, parts, R, pairs, T)
    Y, (_, slopes, path) = J.mid().inv().mid(), value(X, parts, R, pairs, T)
    push = arb_mat([[v - a] for v, a in zip(X, m, strict=True)])
    moved = ((1 - Y * slopes) * push - Y * F).tolist()
    inside = [b.contains_interior(a + c[0]) for b, a, c in zip(X, m, moved, strict=True)]
    require(all(inside), "the operator does not map the box into itself")
    pieces = [(i, j, arb(0), arb(path[i][2].upper()), i > 0 and pairs[i - 1] == j,
               i < len(pairs) and pairs[i] == j, 0)
              for i, closed_pairs in enumerate(sets) for j in range(len(closed_pairs))]  # fmt: skip
    while pieces:  # a gap over a piece of a part; is it zero at the piece's first, last instant?
        i, j, left_end, right_end, rises, falls, halvings = pieces.pop()
        (G, w, _), sign, middle = path[i], 1 if sets[i][j] else -1, (left_end + right_end).mid() / 2
        over = (G * left_end.union(right_end)).exp() * w
        gap, slope = sign * (R * over)[j, 0], sign * (R * G * over)[j, 0]
        if not (gap > 0 or (rises > falls and slope > 0) or (falls > rises and slope < 0)):
            require(halvings < DEEPEST, "the sign of a gap between crossings is open")
            pieces += [(i, j, left_end, middle, rises, False, halvings + 1),
                       (i, j, middle, right_end, False, falls, halvings + 1)]  # fmt: skip
    crossings = [[float(t), j] for t, j in zip(accumulate(m[states:]), pairs, strict=True)]
    return {"crossings": crossings, "first": start_contact_set, "radius": float(RADIUS),
            "state": [v.str(25, radius=False) for v in m[:states]]}  # fmt: skip


if __name__ == "__main__":
    proofs: dict = {}
    for place in sorted((HERE / "cases").glob("*.json")):
        case = json.loads(place.read_text())
        for number, orbit in enumerate(case["orbits"]):
            if 2 <= len(orbit.get("crossings", ())) <= 4:
                try:
                    proofs[f"{place.stem}/{number}"] = prove(case, orbit)
                except (ZeroDivisionError, ValueError) as error:
                    print(place.stem, number, error, flush=True)
    (HERE / "proofs.json").write_text(json.dumps(proofs, indent=1) + "\n")
