"""Find two notches of one depth in 30 clamped beams from six frequencies of another program.

The frequencies are A. Thada's (MSSP 160, 2021, 107915), computed by Ansys on coarse meshes. The
program solves the modes of the beam in matrices: bending in two planes and torsion with warping.
The springs, the calibration and the regions are this script's. Each notch is a spring in each kind
of motion, of compliance d^n exp(a + b d). The springs, the frequencies without notches and the
scatter of both are fitted to beams whose notches are known (maximum likelihood, Student's t).

    python benchmarks/two_notches.py training.csv parameters.md

prints a cross-validation on the training beams, then the table of the page.
"""

import csv
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.ndimage import find_objects, label
from scipy.optimize import least_squares, minimize

import fenics_crack as fc

LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY = 1.0, 0.1, 0.01, 2e11, 7850.0
SHEAR = YOUNG / 2.6
FREEDOM = 4.0
"""Degrees of freedom of Student's t: some rows of the source belong to other beams."""
LEVEL, MIN_LOG_BAYES_FACTOR, MAX_CHI_SQUARE, MAX_SHARE = 0.95, 3.0, 12.59, 0.1
"""Nominal probability of regions, and what is claimed: evidence of 20 to 1, a fit with a p-value of
5 %, and a region of at most this share of all pairs and depths."""
DEPTHS = np.arange(1, 51) / 10.0
"""Depths looked for [mm]."""
PLACES = np.arange(1, 100) / 100.0
"""Places looked for [m]."""
HALF_CELL = 0.05, 5.0, 5.0
"""Half the spacings of depths and places [mm]."""
N_ELEMENTS = 200


def beam_modes(
    bending: float, shear: float, tension: float, mass: float, rotary: float, n_modes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve a clamped beam of Timoshenko, or Vlasov's torsion with its warping, by the program.

    Returns
    -------
    Squares of angular frequencies (n_modes,); slopes, and their derivatives, at the nodes.
    """
    h = LENGTH / N_ELEMENTS
    phi = 12.0 * bending / (shear * h * h)
    turn = np.diag([1.0, h, 1.0, h])
    cubic = [
        [12, 6, -12, 6],
        [6, 4 + phi, -6, 2 - phi],
        [-12, -6, 12, -6],
        [6, 2 - phi, -6, 4 + phi],
    ]
    slopes = np.array([[36, 3, -36, 3], [3, 4, -3, -1], [-36, -3, 36, -3], [3, -1, -3, 4]])
    values = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    element_stiffness = (
        bending / (h**3 * (1.0 + phi)) * np.array(cubic) + tension / (30.0 * h) * slopes
    )
    element_mass = mass * h / 420.0 * values + rotary / (30.0 * h) * slopes
    matrices = np.zeros((2, 2 * N_ELEMENTS + 2, 2 * N_ELEMENTS + 2))
    for element in range(N_ELEMENTS):
        part = slice(2 * element, 2 * element + 4)
        matrices[:, part, part] += turn @ np.array([element_stiffness, element_mass]) @ turn
    stiffness, inertia = matrices[:, 2:-2, 2:-2]
    modes = fc.solve_modes(
        fc.Structure.from_matrices(inertia, stiffness, gap=np.eye(len(inertia))[0]), n_modes
    )
    turns = np.pad(np.array(modes.shapes), ((2, 2), (0, 0)))[1::2]
    return modes.omega**2, turns, np.gradient(turns, h, axis=0, edge_order=2)


def families() -> list[tuple]:
    """Return the beam's bending in two planes and its torsion.

    Returns
    -------
    Of each: squares of frequencies, resultants over the root of the stiffness (one or two), the
    modes used, and their columns of the table.
    """
    beam_families = []
    area = WIDTH * THICKNESS
    for size, other_size, mode_numbers, columns, n_modes in (
        (THICKNESS, WIDTH, [0, 1, 2, 3], [0, 1, 2, 4], 8),
        (WIDTH, THICKNESS, [0], [5], 5),
    ):
        second = other_size * size**3 / 12.0
        squares, _, curvatures = beam_modes(
            YOUNG * second, SHEAR * area / 1.2, 0.0, DENSITY * area, DENSITY * second, n_modes
        )
        beam_families.append(
            (squares, [np.sqrt(YOUNG * second) * curvatures], mode_numbers, columns)
        )
    torsion = SHEAR * WIDTH * THICKNESS**3 / 3.0 * (1.0 - 0.63 * THICKNESS / WIDTH)
    warping_stiffness = YOUNG * (WIDTH * THICKNESS) ** 3 / 144.0
    polar = DENSITY * area * (WIDTH**2 + THICKNESS**2) / 12.0
    squares, twists, changes = beam_modes(warping_stiffness, np.inf, torsion, polar, 0.0, 5)
    resultants = [np.sqrt(torsion) * twists, np.sqrt(warping_stiffness) * changes]
    return [*beam_families, (squares, resultants, [0], [3])]


FAMILIES = families()


# --- frequencies, and what is known of their errors -----------------------------------------------
#
# Parameters p: a, b of the springs of bending, bending in the plane, torsion and warping (8), and
# log f of the six modes without notches. Scatter s: a triangle (21) of the modes' own, a logarithm
# of the share of a notch's drop that all modes have in common, that each of the three families has,
# and that each mode has.


def predict(p: np.ndarray, beams: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return log f (n, 6) of beams (n, 3) of d [mm], l1, l2 [m], and each notch's share (n, 6, 2).

    With flexible springs F_kl = delta_kl / w_k^2 + sum c M_k M_l / (w_k w_l)^2 in the modes.
    """
    depth, springs = beams[:, 0], iter(np.reshape(p[:8], (4, 2)))
    logs, drops = np.zeros((len(beams), 6)), np.zeros((len(beams), 6, 2))
    for (squares, resultants, mode_numbers, columns), power in zip(
        FAMILIES, (2, 2, 1), strict=True
    ):
        flexibility = np.tile(np.diag(1.0 / squares), (len(beams), 1, 1))
        for resultant in resultants:
            a, b = next(springs)
            compliance = 1e-3 * depth**power * np.exp(a + b * depth)
            for notch in (0, 1):
                place = np.round(beams[:, 1 + notch] / LENGTH * N_ELEMENTS).astype(int)
                moment = resultant[place] / squares
                flexibility += compliance[:, None, None] * moment[:, :, None] * moment[:, None]
                drop = (
                    -0.5
                    * compliance[:, None]
                    * moment[:, mode_numbers] ** 2
                    * squares[mode_numbers]
                )
                drops[:, columns, notch] += drop
        flexibility_values = np.linalg.eigvalsh(flexibility)[:, ::-1]
        logs[:, columns] = -0.5 * np.log(
            flexibility_values[:, mode_numbers] * squares[mode_numbers]
        )
    return logs + p[8:], drops


def covariances(s: np.ndarray, drops: np.ndarray) -> np.ndarray:
    """Return covariances (n, 6, 6) of log f of beams whose notches have some shares (n, 6, 2)."""
    factor = np.zeros((6, 6))
    factor[np.tril_indices(6)] = 1e-3 * s[:21]
    groups = [np.ones(6), *([k in family[3] for k in range(6)] for family in FAMILIES), *np.eye(6)]
    sizes = np.exp(s[[21, 22, 23, 24, *[25] * 6]])
    notch_errors = [
        size * drops * np.array(group)[:, None] for size, group in zip(sizes, groups, strict=True)
    ]
    errors = np.concatenate(notch_errors, axis=2)
    return factor @ factor.T + errors @ errors.transpose(0, 2, 1)


def whiten(covariance: np.ndarray, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return chi^2 and log det / 2 of residuals (n, 6)."""
    factor = np.linalg.cholesky(covariance)
    rows = np.linalg.solve(factor, residuals[..., None])[..., 0]
    return np.sum(rows**2, axis=1), np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)


def log_likelihood(chi_square: np.ndarray, half_log: np.ndarray) -> np.ndarray:
    """Return the logarithm of Student's t of six numbers, up to a constant."""
    return -half_log - 0.5 * (FREEDOM + 6.0) * np.log1p(chi_square / FREEDOM)


def calibrate(beams: np.ndarray, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return p and s of beams (n, 3) whose notches are known, by their frequencies (n, 6)."""
    log_frequencies = np.log(frequencies)
    springs = [-0.5, 0.0, -1.7, 0.1, 0.0, 0.0, 1.0, 0.0]
    p = np.r_[springs, np.quantile(log_frequencies, 0.9, axis=0)]
    s = np.zeros(26)
    s[:21] = np.diag([0.8, 1.2, 1.2, 0.4, 1.3, 0.08])[np.tril_indices(6)]
    s[21:] = np.log(0.07)
    for _ in range(3):
        covariance = covariances(s, predict(p, beams)[1])
        factor = np.linalg.cholesky(covariance)

        def residuals(p: np.ndarray, factor: np.ndarray = factor) -> np.ndarray:
            log_differences = (log_frequencies - predict(p, beams)[0])[..., None]
            return np.linalg.solve(factor, log_differences).ravel()

        p = least_squares(
            residuals, p, loss="soft_l1", x_scale=[0.1] * 8 + [1e-3] * 6, max_nfev=15
        ).x
        logs, drops = predict(p, beams)

        def cost(
            s: np.ndarray,
            drops: np.ndarray = drops,
            log_residuals: np.ndarray = log_frequencies - logs,
        ) -> float:
            likelihoods = log_likelihood(*whiten(covariances(s, drops), log_residuals))
            return float(0.5 * np.sum((s[21:] - np.log(0.07)) ** 2) - likelihoods.sum())

        s = minimize(cost, s, method="L-BFGS-B", options={"maxiter": 60}).x
    return p, s


# --- regions --------------------------------------------------------------------------------------


class Finder:
    """Posteriors of depth and places on a grid; a uniform prior of depths and pairs of places."""

    def __init__(self, beams: np.ndarray, frequencies: np.ndarray) -> None:
        """Calibrate by beams (n, 3) whose frequencies (n, 6) are known."""
        self.p, self.s = calibrate(beams, frequencies)
        grid = np.stack(np.meshgrid(DEPTHS, PLACES, PLACES, indexing="ij"), axis=-1)
        self.grid_mask = (grid[..., 1] < grid[..., 2]) & (
            grid[..., 1] + grid[..., 2] < LENGTH + 1e-9
        )
        self.cells = grid[self.grid_mask]
        self.logs, drops = predict(self.p, self.cells)
        factor = np.linalg.cholesky(covariances(self.s, drops))
        self.inverse = np.linalg.inv(factor)
        self.half_log = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)

    def find(self, frequencies: np.ndarray) -> dict:
        """Return the estimate, the region's boxes and cells, and what speaks for a claim."""
        log_frequencies = np.log(frequencies)
        rows = (self.inverse @ (log_frequencies - self.logs)[..., None])[..., 0]
        chi_square = np.sum(rows**2, axis=1)
        height = log_likelihood(chi_square, self.half_log)
        plain_covariance = covariances(self.s, np.zeros((1, 6, 2)))
        plain_likelihood = log_likelihood(
            *whiten(plain_covariance, (log_frequencies - self.p[8:])[None])
        )[0]
        mass = np.exp(height - height.max())
        factor = np.log(mass.mean()) + height.max() - plain_likelihood
        mass /= mass.sum()
        order = np.argsort(-mass)
        region = order[: np.searchsorted(np.cumsum(mass[order]), LEVEL) + 1]
        region_cells = np.zeros(self.grid_mask.shape, dtype=bool)
        region_cells[tuple(np.argwhere(self.grid_mask)[region].T)] = True
        numbers, _ = label(region_cells, np.ones((3, 3, 3)))
        boxes, box_cells = [], np.zeros_like(region_cells)
        for box in find_objects(numbers):
            box_cells[box] = True
            axes = zip((DEPTHS, 1e3 * PLACES, 1e3 * PLACES), box, HALF_CELL, strict=True)
            ends = [(axis[part][0] - half, axis[part][-1] + half) for axis, part, half in axes]
            boxes.append(np.transpose(ends))
        share = np.mean(box_cells[self.grid_mask])
        is_claimed = (
            factor > MIN_LOG_BAYES_FACTOR
            and chi_square.min() < MAX_CHI_SQUARE
            and share < MAX_SHARE
        )
        return {
            "estimate": self.cells[order[0]] * [1.0, 1e3, 1e3], "boxes": boxes, "share": share,
            "log Bayes factor": factor, "chi^2": chi_square.min(), "claimed": is_claimed,
        }  # fmt: skip


def is_held(boxes: list[np.ndarray], depth: float, first_place: float, second_place: float) -> bool:
    """Return True if a box holds the notches, or their mirror image."""
    if first_place + second_place > 1000.0:
        first_place, second_place = 1000.0 - second_place, 1000.0 - first_place
    truth = np.array([depth, first_place, second_place])
    return any(bool(np.all((box[0] <= truth) & (truth <= box[1]))) for box in boxes)


def training_beams(path: str) -> np.ndarray:
    """Read d, l1, l2 [mm] and six frequencies [Hz]: (n, 9), without the beam without notches."""
    table = defaultdict(dict)
    with Path(path).open() as lines:
        for row in csv.DictReader(lines):
            key = tuple(float(row[name]) for name in ("depth", "l1", "l2"))
            table[key][int(float(row["Mode"]))] = float(row["Frequency"])
    return np.array(
        [[*key, *(row[k] for k in range(1, 7))] for key, row in sorted(table.items()) if key[0]]
    )


def main(training_path: str, parameters_path: str) -> None:
    """Print the cross-validation, and the table of the page."""
    beams = training_beams(training_path)
    beams[:, 1:3] /= 1e3
    group = np.random.default_rng(0).permutation(len(beams)) % 5
    count = defaultdict(lambda: np.zeros(4, dtype=int))
    for number in range(5):
        finder = Finder(beams[group != number, :3], beams[group != number, 3:])
        for beam in beams[group == number]:
            answer = finder.find(beam[3:])
            holds_truth = is_held(answer["boxes"], beam[0], *(1e3 * beam[1:3]))
            counts = np.array(
                [1, holds_truth, answer["claimed"], holds_truth and answer["claimed"]]
            )
            for key in (beam[0], "all"):
                count[key] += counts
            if answer["claimed"] and not holds_truth:
                print("missed:", beam[:3], answer["estimate"], flush=True)
    print("depth, beams, held, claimed, claimed and held")
    for key, row in count.items():
        print(key, *row)
    finder = Finder(beams[:, :3], beams[:, 3:])
    print("p", finder.p.round(4).tolist())
    for line in Path(parameters_path).read_text().splitlines():
        words = line.split()
        if len(words) == 7 and words[0][0] == "B" and words[0][1:].isdigit():
            answer = finder.find(np.array(words[1:], dtype=float))
            d, first_place, second_place = answer["estimate"]
            box_texts = "; ".join(
                " x ".join(f"{box_start:g}-{box_end:g}" for box_start, box_end in box.T)
                for box in answer["boxes"]
            )
            print(
                f"| {words[0]} | {'claim' if answer['claimed'] else 'no claim'} | {d:.1f} "
                f"| {first_place:.0f} | {second_place:.0f} | {box_texts} | {answer['share']:.2%} "
                f"| {answer['log Bayes factor']:.1f} | {answer['chi^2']:.1f} |"
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
