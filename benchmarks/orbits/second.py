"""The second reference: motions of a case by SciPy's DOP853 from event to event.

It reads the case alone and shares no code with the package. With s = B^T q + l(t), while a set A of
pairs is closed

    M q'' + C q' + K q + B lambda = f(t),   (R + diag 1/k)_AA lambda_A = s_A,   g = s - R lambda,

where R is the flexibility of the pairs without mass (zero where they have mass). A set ends where a
force or an open gap changes its sign. With friction lambda_t = k_t (g_t - h) while a pair sticks,
and +-mu lambda_n while it slips. A smoothed law is integrated by Radau's method of order 5.
"""

# ruff: noqa: B023, as the functions of a set are used within its turn of the loop

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize
from scipy.integrate import solve_ivp

INSTANTS = 256
"""Of the gap over a period."""
RELATIVE, STEP = 1e-13, 0.2
"""Accuracy of DOP853, and its longest step over the period of the fastest motion / 2 pi."""
MOMENT = 1e-7
"""Of a period, after which the set of closed pairs is checked."""
NOTHING = 1e-12
"""Beyond zero, relative to the motion: the pair that has just changed is there."""
MOST_EVENTS = 2_000
"""In one period."""
OPEN, STICK, UP, DOWN = range(4)
"""States of a pair with friction; of one without it a closed pair sticks."""


class Motion:
    """Equations of a case of the benchmark, a dictionary as its file has it."""

    def __init__(self, case: dict[str, Any]) -> None:
        parts = case["structure"]
        self.omega, self.law = case["load"]["omega"], case["law"]
        self.pairs = np.array(parts["pairs"], float)
        n, p = self.pairs.shape
        if parts["form"] == "modes":
            self.mass, self.stiffness = np.eye(n), np.diag(parts["squares"])
            self.flexibility = np.array(parts["flexibility"], float).reshape(p, p)
            self.lift = np.array(parts["lift"], float)
        else:
            self.mass, self.stiffness = np.array(parts["mass"]), np.array(parts["stiffness"])
            self.flexibility, self.lift = np.zeros((p, p)), np.zeros((1, p))
        self.lift = self.lift - np.eye(len(self.lift), 1) * np.array(case["clearance"])
        damping = np.array(parts["damping"], float)
        self.damping = np.diag(damping) if damping.ndim == 1 else damping
        load = case["load"]
        waves = zip(load["cos"], load["sin"], strict=True)
        self.force = np.array([load["mean"], *(row for pair in waves for row in pair)], float)
        k = np.array([np.inf if one is None else one for one in self.law["stiffness"]], float)
        self.compliance = self.flexibility + np.diag(1.0 / k)
        self.normal = k
        self.friction = self.law["kind"] == "friction"
        if self.friction:
            self.tangents = np.array(parts["tangents"], float)
            self.coefficient = np.array(self.law["coefficient"], float)
            self.tangential = np.array(self.law["tangential_stiffness"], float)
        inverse = np.linalg.inv(self.mass)
        self.inverse = inverse
        if self.law["kind"] != "smoothed":
            closed_stiffness = self.stiffness + self.pairs @ np.linalg.solve(
                self.compliance, self.pairs.T
            )
            if self.friction:
                closed_stiffness = (
                    closed_stiffness + (self.tangents * self.tangential) @ self.tangents.T
                )
            self.fastest = float(
                np.sqrt(np.abs(np.linalg.eigvals(inverse @ closed_stiffness)).max())
            )
        self.size = 2 * n

    def waves(self, time: float, count: int) -> np.ndarray:
        """1, cos(w t), sin(w t), cos(2 w t), ... at a time: (count,)."""
        angle = self.omega * time * np.arange(1, count // 2 + 1)
        return np.append(1.0, np.column_stack([np.cos(angle), np.sin(angle)]).ravel())

    def slow(self, time: float, state: np.ndarray) -> np.ndarray:
        """s = B^T q + l(t)."""
        return state @ self.pairs + self.waves(time, len(self.lift)) @ self.lift

    def forces(self, closed: np.ndarray) -> np.ndarray:
        """lambda = forces @ s of a set of closed pairs."""
        found, closed_block = np.zeros_like(self.compliance), np.ix_(closed, closed)
        found[closed_block] = np.linalg.inv(self.compliance[closed_block])
        return found

    def holds(self, closed: np.ndarray, slow: np.ndarray) -> bool:
        """True if a set of closed pairs is right at a slow gap."""
        force = self.forces(closed) @ slow
        gap = slow - self.compliance @ force
        return bool(np.all(force >= 0.0) and np.all(gap[~closed] <= 0.0))

    def closed_set(self, slow: np.ndarray) -> np.ndarray:
        """Pairs that are closed at a slow gap: lambda, D lambda - s >= 0, one of both 0."""
        size = np.sqrt(np.diag(self.compliance))
        root = np.linalg.cholesky(self.compliance / np.outer(size, size))
        right_side = np.linalg.solve(root, slow / size)
        scale = np.abs(right_side).max() or 1.0
        return np.asarray(scipy.optimize.nnls(root.T, right_side / scale)[0] > 0.0)

    def period(
        self, state: np.ndarray, subharmonic: int, tangent: bool = False
    ) -> dict[str, np.ndarray]:
        """Follow a state (q, q') over a period: its end, gaps at 256 instants (256, p), the loss by
        damping and friction, and where asked for the monodromy matrix."""
        if self.law["kind"] == "smoothed":
            return self._smooth(state, subharmonic)
        if self.friction:
            return self._rubbing(state, subharmonic)
        n, period = self.size // 2, 2.0 * np.pi * subharmonic / self.omega
        moments = period * np.arange(INSTANTS) / INSTANTS
        columns = np.eye(self.size) if tangent else np.zeros((self.size, 0))
        packed_state = np.append(np.column_stack([state, columns]).ravel(), 0.0)
        shape, gap, current_time = (
            (self.size, columns.shape[1] + 1),
            np.empty((INSTANTS, len(self.normal))),
            0.0,
        )
        size = float((np.abs(state[:n]) @ np.abs(self.pairs)).max()) + 1e-300
        # The set a moment after the start, by the velocity.
        moment = MOMENT * period
        closed_pairs = self.closed_set(self.slow(moment, state[:n] + moment * state[n:]))
        for _ in range(MOST_EVENTS):
            answer = self.forces(closed_pairs)
            held_stiffness = self.stiffness + self.pairs @ answer @ self.pairs.T
            sign = np.where(closed_pairs[:, None], -np.diag(self.compliance)[:, None] * answer,
                            np.eye(len(closed_pairs)) - self.flexibility @ answer)  # fmt: skip

            def rate(time: float, values: np.ndarray) -> np.ndarray:
                state_columns = values[:-1].reshape(shape)
                push = -held_stiffness @ state_columns[:n] - self.damping @ state_columns[n:]
                wave = self.waves(time, len(self.force)) @ self.force
                lift = self.waves(time, len(self.lift)) @ self.lift
                push[:, 0] += wave - self.pairs @ (answer @ lift)
                lost_power = state_columns[n:, 0] @ self.damping @ state_columns[n:, 0]
                return np.append(
                    np.vstack([state_columns[n:], self.inverse @ push]).ravel(), lost_power
                )

            def event(time: float, values: np.ndarray) -> float:
                slow = self.slow(time, values[:-1].reshape(shape)[:n, 0])
                return float((sign @ slow).max() - NOTHING * size)

            event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
            inner_moments = moments[(moments >= current_time - 1e-14 * period)]
            run = solve_ivp(
                rate, (current_time, period), packed_state, "DOP853", rtol=RELATIVE,
                atol=1e-15 * size,
                max_step=STEP / self.fastest, events=event, t_eval=np.append(inner_moments, period),
            )  # fmt: skip
            for time, values in zip(run.t, np.transpose(run.y), strict=False):
                index = int(np.rint(time / period * INSTANTS))
                if index < INSTANTS:
                    slow = self.slow(time, values[:-1].reshape(shape)[:n, 0])
                    gap[index] = slow - self.flexibility @ (answer @ slow)
            if run.status == 0:
                packed_state = run.y[:, -1]
                break
            current_time, packed_state = run.t_events[0][0], run.y_events[0][0]
            motion = packed_state[:-1].reshape(shape)[:, 0]
            slow_gap = self.slow(current_time + moment, motion[:n] + moment * motion[n:])
            guess = closed_pairs.copy()
            guess[np.argmax(sign @ self.slow(current_time, motion[:n]))] ^= True
            closed_pairs = guess if self.holds(guess, slow_gap) else self.closed_set(slow_gap)
        else:
            raise RuntimeError("events without end")
        end = packed_state[:-1].reshape(shape)
        return {"state": end[:, 0], "gap": gap, "loss": packed_state[-1], "monodromy": end[:, 1:]}

    def _smooth(self, state: np.ndarray, subharmonic: int) -> dict[str, np.ndarray]:
        n, period = self.size // 2, 2.0 * np.pi * subharmonic / self.omega
        k, s = self.normal, self.law["sharpness"]

        def rate(time: float, values: np.ndarray) -> np.ndarray:
            gap = self.slow(time, values[:n])
            push = self.waves(time, len(self.force)) @ self.force - self.stiffness @ values[:n]
            push -= self.damping @ values[n:-1]
            push -= self.pairs @ (k * gap * (0.5 + np.arctan(s * gap) / np.pi))
            lost_power = values[n:-1] @ self.damping @ values[n:-1]
            return np.concatenate([values[n:-1], self.inverse @ push, [lost_power]])

        times = period * np.arange(INSTANTS + 1) / INSTANTS
        run = solve_ivp(
            rate, (0.0, period), np.append(state, 0.0), "Radau", rtol=1e-10, atol=1e-13,
            t_eval=times,
        )  # fmt: skip
        slow = [self.slow(*one) for one in zip(times[:-1], run.y[:n, :-1].T, strict=True)]
        return {"state": run.y[:-1, -1], "gap": np.array(slow), "loss": run.y[-1, -1]}

    def _rubbing(self, state: np.ndarray, subharmonic: int) -> dict[str, np.ndarray]:
        """With friction of springs; states (q, q', h) with the places of the sliders."""
        n, period = self.size // 2, 2.0 * np.pi * subharmonic / self.omega
        k, kt, mu = self.normal, self.tangential, self.coefficient
        place, motion = state[2 * n :].copy(), np.append(state[: 2 * n], 0.0)
        moments = period * np.arange(INSTANTS) / INSTANTS
        gaps, tangential_gaps, current_time = (
            np.empty((INSTANTS, len(k))),
            np.empty((INSTANTS, len(k))),
            0.0,
        )

        def parts(time: float, values: np.ndarray) -> tuple[np.ndarray, ...]:
            q, v = values[:n], values[n : 2 * n]
            return (
                q @ self.pairs + self.lift[0],
                v @ self.pairs,
                q @ self.tangents,
                v @ self.tangents,
            )

        def begin(gap: Any, rise: Any, across: Any, slide: Any, j: int) -> int:
            """State of a pair that closes, or is closed at the start."""
            pull = kt[j] * (across[j] - place[j])
            friction_limit = mu[j] * k[j] * max(gap[j], 0.0)
            if abs(pull) < friction_limit * (1.0 - 1e-9):
                return STICK
            if friction_limit == 0.0 or abs(pull) <= 1e-12 + friction_limit * 1e-9:
                speed = kt[j] * slide[j]
                return (
                    STICK if abs(speed) <= mu[j] * k[j] * rise[j] else (UP if speed > 0 else DOWN)
                )
            return UP if pull > 0.0 else DOWN

        start_parts = parts(0.0, motion)
        states = [
            begin(*start_parts, j) if start_parts[0][j] > 0.0 else OPEN for j in range(len(k))
        ]
        for _ in range(MOST_EVENTS):
            kinds = np.array(states)
            slips = np.where(kinds == UP, 1.0, np.where(kinds == DOWN, -1.0, 0.0))

            def pulls(gap: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                normal = np.where(kinds == OPEN, 0.0, k * gap)
                tangential_force = np.where(
                    kinds == STICK, kt * (across - place), slips * mu * normal
                )
                return normal, tangential_force

            def rate(time: float, values: np.ndarray) -> np.ndarray:
                gap, _, across, slide = parts(time, values)
                normal, held = pulls(gap, across)
                v = values[n : 2 * n]
                push = self.waves(time, len(self.force)) @ self.force - self.stiffness @ values[:n]
                push -= self.damping @ v + self.pairs @ normal + self.tangents @ held
                lost_power = v @ self.damping @ v + held @ slide
                return np.concatenate([v, self.inverse @ push, [lost_power]])

            def ends(time: float, values: np.ndarray) -> np.ndarray:
                gap, rise, across, slide = parts(time, values)
                normal, held = pulls(gap, across)
                leave = np.where(kinds == OPEN, gap, -gap)
                slider = -slips * (slide - slips * mu * k * rise / kt) / self.fastest
                turn = np.where(kinds == STICK, (np.abs(held) - mu * normal) / kt, slider)
                turn[kinds == OPEN] = -1.0
                return np.concatenate([leave, turn])

            def event(time: float, values: np.ndarray) -> float:
                return float(ends(time, values).max() - NOTHING)

            event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
            run = solve_ivp(
                rate, (current_time, period), motion, "DOP853", rtol=1e-12, atol=1e-14,
                max_step=STEP / self.fastest, events=event,
                t_eval=np.append(moments[moments >= current_time - 1e-14 * period], period),
            )  # fmt: skip
            for time, values in zip(run.t, np.transpose(run.y), strict=False):
                index = int(np.rint(time / period * INSTANTS))
                if index < INSTANTS:
                    gaps[index], _, tangential_gaps[index], _ = parts(time, values)
            if run.status == 0:
                motion = run.y[:, -1]
                break
            current_time, motion = run.t_events[0][0], run.y_events[0][0]
            event_index = int(np.argmax(ends(current_time, motion)))
            gap, rise, tangential_gap, slide = parts(current_time, motion)
            j, leaves = event_index % len(k), event_index < len(k)
            if kinds[j] == OPEN:
                place[j] = tangential_gap[j]
                states[j] = begin(0.0 * gap, rise, tangential_gap, slide, j)
            elif leaves:
                states[j] = OPEN
            elif kinds[j] == STICK:
                states[j] = UP if tangential_gap[j] > place[j] else DOWN
            else:
                place[j] = tangential_gap[j] - slips[j] * mu[j] * k[j] * gap[j] / kt[j]
                states[j] = STICK
        else:
            raise RuntimeError("events without end")
        return {
            "state": motion[:-1],
            "gap": gaps,
            "loss": motion[-1],
            "tangential_gap": tangential_gaps,
        }
