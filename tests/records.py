"""What tests of measured records share: the one of a blisk, computed ones, and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from surroundings import DEMOS

import fenics_crack as fc

RECORD = DEMOS / "blisk_blade.csv"


def marched(omega: np.ndarray, damping: float, push: np.ndarray, step: float) -> np.ndarray:
    """Central differences of a mass whose natural frequency [rad/s] varies, the same as that of the
    differences; from rest."""
    stiff, lost = (2.0 * np.sin(0.5 * omega * step)) ** 2, np.sin(damping * omega * step)
    found = [0.0, 0.0]
    for k, d, f in zip(stiff[1:-1], lost[1:-1], step**2 * push[1:-1], strict=True):
        found.append(((2.0 - k) * found[-1] - (1.0 - d) * found[-2] + f) / (1.0 + d))
    return np.array(found)


def swept(
    modes: list[tuple[float, float, int, float]],
    *,
    line: float = 0.0,
    noise: float = 1e-6,
    wrong: float = 0.0,
    marks: float = 0.0,
    stiffening: float = 0.0,
) -> tuple[fc.ArrivalTimes, np.ndarray]:
    """A record of a tip at 0.5 m that is swept through 100 rad/s, 5 % below and above, up and down,
    and the motion [m] of masses of natural frequencies [rad/s], damping, orders and static
    displacements, integrated exactly for a push that is linear within a step, or, of frequencies
    that follow the speed where their order meets it, by differences; beside it 0.2 mm of one
    frequency. Noise of arrivals, a share of wrong ones, and jitter of marks [s]."""
    middle, turns, radius = 100.0, 240, 0.5
    half = turns * 2.0 * np.pi / middle
    grid = np.linspace(0.0, 2.0 * half, 400_001)
    step, speed = grid[1], middle * (0.95 + 0.1 * (1.0 - np.abs(grid / half - 1.0)))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * step * (speed[1:] + speed[:-1]))])
    motion = np.zeros(len(grid))
    for omega, damping, order, static in modes:
        push = omega**2 * static * np.cos(order * angle)
        if stiffening:
            square = 1.0 + stiffening * ((speed * order / omega) ** 2 - 1.0)  # Southwell
            motion += marched(omega * np.sqrt(square), damping, push, step)
            continue
        root = omega * complex(-damping, np.sqrt(1.0 - damping**2))
        decay = np.exp(root * step)
        first = (decay - 1.0) / root
        second = (first - step) / (root * step)
        pushed = first * push[:-1] + second * np.diff(push)
        motion[1:] += lfilter([1.0], [1.0, -decay], pushed).imag / root.imag
    probes, rng = np.array([0.3, 1.0, 2.2, 4.0]), np.random.default_rng(1)
    count = int(angle[-1] / (2.0 * np.pi)) - 1
    targets = 2.0 * np.pi * np.arange(count)[:, None] + probes
    targets += noise / radius * rng.standard_normal(targets.shape)
    targets += 0.1 * (rng.random(targets.shape) < wrong)  # another blade's
    beside = 2e-4 * np.cos(line * grid) * (line > 0.0)
    arrivals = np.interp(targets, angle + (motion + beside) / radius, grid)
    begins = np.interp(2.0 * np.pi * np.arange(count + 1), angle, grid)
    begins += marks * rng.standard_normal(count + 1)
    return fc.ArrivalTimes(arrivals, begins, probes, radius), motion


def written(path: Path, headings: str, rows: list[list[Any]]) -> Path:
    """A file of some rows."""
    lines = [
        headings,
        *(",".join("" if cell is None else str(cell) for cell in row) for row in rows),
    ]
    path.write_text("# a remark\n" + "\n".join(lines) + "\n")
    return path
