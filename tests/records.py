"""What tests of measured records share: the one of a blisk, computed ones, and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from surroundings import DEMOS

import fenics_crack as fc

RECORD = DEMOS / "blisk_blade.csv"


def integrate_mass(omega: np.ndarray, damping: float, load: np.ndarray, step: float) -> np.ndarray:
    """Integrate a mass of varying natural frequency [rad/s] by central differences, from rest.

    The frequency is that of the differences; ``load`` is the force over the mass [m/s^2]."""
    stiffness_terms = (2.0 * np.sin(0.5 * omega * step)) ** 2
    damping_terms = np.sin(damping * omega * step)
    positions = [0.0, 0.0]
    for k, d, f in zip(
        stiffness_terms[1:-1], damping_terms[1:-1], step**2 * load[1:-1], strict=True
    ):
        positions.append(((2.0 - k) * positions[-1] - (1.0 - d) * positions[-2] + f) / (1.0 + d))
    return np.array(positions)


def sweep_record(
    modes: list[tuple[float, float, int, float]],
    *,
    line: float = 0.0,
    noise: float = 1e-6,
    outlier_share: float = 0.0,
    mark_jitter: float = 0.0,
    stiffening: float = 0.0,
) -> tuple[fc.ArrivalTimes, np.ndarray]:
    """Record a tip at 0.5 m that is swept through 100 rad/s, from 5 % below to 5 % above and back.

    Masses (``modes``) have natural frequencies [rad/s], damping, orders and static displacements.
    They are integrated exactly for a load linear in each step, or by differences if frequencies
    follow the speed. ``line`` is the frequency of a further 0.2 mm; there are noise of arrivals, a
    share of outliers, and jitter of marks [s]. Returns the record and the masses' motion [m]."""
    middle, turns, radius = 100.0, 240, 0.5
    half = turns * 2.0 * np.pi / middle
    grid = np.linspace(0.0, 2.0 * half, 400_001)
    step, speed = grid[1], middle * (0.95 + 0.1 * (1.0 - np.abs(grid / half - 1.0)))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * step * (speed[1:] + speed[:-1]))])
    motion = np.zeros(len(grid))
    for omega, damping, order, static_displacement in modes:
        load = omega**2 * static_displacement * np.cos(order * angle)
        if stiffening:
            square = 1.0 + stiffening * ((speed * order / omega) ** 2 - 1.0)  # Southwell
            motion += integrate_mass(omega * np.sqrt(square), damping, load, step)
            continue
        root = omega * complex(-damping, np.sqrt(1.0 - damping**2))
        decay = np.exp(root * step)
        force_integral = (decay - 1.0) / root
        slope_integral = (force_integral - step) / (root * step)
        increments = force_integral * load[:-1] + slope_integral * np.diff(load)
        motion[1:] += lfilter([1.0], [1.0, -decay], increments).imag / root.imag
    probes, rng = np.array([0.3, 1.0, 2.2, 4.0]), np.random.default_rng(1)
    count = int(angle[-1] / (2.0 * np.pi)) - 1
    targets = 2.0 * np.pi * np.arange(count)[:, None] + probes
    targets += noise / radius * rng.standard_normal(targets.shape)
    targets += 0.1 * (rng.random(targets.shape) < outlier_share)  # another blade's
    line_motion = 2e-4 * np.cos(line * grid) * (line > 0.0)
    arrivals = np.interp(targets, angle + (motion + line_motion) / radius, grid)
    marks = np.interp(2.0 * np.pi * np.arange(count + 1), angle, grid)
    marks += mark_jitter * rng.standard_normal(count + 1)
    return fc.ArrivalTimes(arrivals, marks, probes, radius), motion


def write_table(path: Path, headings: str, rows: list[list[Any]]) -> Path:
    """Write a table under a remark, and return its path."""
    lines = [
        headings,
        *(",".join("" if cell is None else str(cell) for cell in row) for row in rows),
    ]
    path.write_text("# a remark\n" + "\n".join(lines) + "\n")
    return path
