"""The forward model: predictions of measurements from the unknowns, and their covariance.

Prediction errors are not independent, since a single sweep makes all predictions. Their covariance
is a sum of three. The interpolation's part comes from leave-one-out errors in all quantities at
once. The mesh's part comes from the changes by a finer mesh, with half the variance common to all
quantities. The third part comes from the priors
(:mod:`fenics_crack.monitoring.identification.nuisance`).

Shapes: m points x of d unknowns, q measurements, f features. A feature is an interpolated natural
frequency or harmonic (:class:`fenics_crack.monitoring.identification.interpolation.Feature`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fenics_crack.basics.errors import N_LOWEST_MODES
from fenics_crack.monitoring.identification.interpolation import SolvedCases
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.nuisance import (
    CRACK_SIZE_KEYS,
    UncrackedPlate,
    compute_deviations_from_equivalent_crack,
)
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import is_response_proportional_to_load


class ForwardModel:
    """Forward model: measurements predicted from values of the unknowns, with covariance.

    Parameters
    ----------
    scene : Scene
        Scene with the damping and the table ``[identify]``.
    uncracked_plate : UncrackedPlate
        Plate without its crack.
    coarse_finer_halfway_cases : three SolvedCases or None
        Solved cases on the grid of the unknowns, on a finer mesh, and halfway between the values of
        the grid. The last two may be None.
    word_by_key : dict of str to object
        Values of the unknowns with text values, such as "left" for crack.edge.
    """

    def __init__(
        self,
        scene: Scene,
        uncracked_plate: UncrackedPlate,
        coarse_finer_halfway_cases: Sequence[SolvedCases | None],
        *,
        word_by_key: Mapping[str, Any],
    ) -> None:
        self.scene = scene
        self.identify_table = scene.given("identify")
        self.uncracked_plate = uncracked_plate
        coarse_cases, self.finer_cases, self.halfway_cases = coarse_finer_halfway_cases
        assert coarse_cases is not None
        self.coarse_cases = coarse_cases
        self.word_by_key = dict(word_by_key)
        self.unknown_keys = coarse_cases.unknown_keys
        self.unknown_grid = coarse_cases.unknown_grid

    def get_damping_ratio_of_points(self, x: np.ndarray) -> np.ndarray:
        """Return the damping ratio at values x (m, d) of the unknowns: (m, 1).

        An unknown damping ratio is in x. Otherwise all are equal: the scene's ratio, the mean of
        the scene's ratios, or 0.01 without either.
        """
        if "damping.ratio" in self.unknown_keys:
            return x[:, [self.unknown_keys.index("damping.ratio")]]
        scene_damping_ratios, damping_table = None, self.scene.damping
        if damping_table is not None:
            scene_damping_ratios = (
                damping_table.ratios if damping_table.ratio is None else damping_table.ratio
            )
        return np.full(
            (len(x), 1), 0.01 if scene_damping_ratios is None else np.mean(scene_damping_ratios)
        )  # of a matrix

    def compute_crack_sizes_relative_to_largest(self, x: np.ndarray) -> np.ndarray:
        """Return crack sizes at values x (m, d), relative to the largest: (m,).

        A size is the product of length and depth, each over its upper bound; 1 if neither is an
        unknown.
        """
        size_unknown_indices = [
            unknown_index
            for unknown_index, key in enumerate(self.unknown_keys)
            if key in CRACK_SIZE_KEYS
        ]
        return np.asarray(
            np.prod(
                x[:, size_unknown_indices] / self.unknown_grid.upper_bounds[size_unknown_indices],
                axis=1,
            )
        )

    def compute_deviations_from_equivalent_crack(self, x: np.ndarray) -> np.ndarray:
        """Return standard deviations of a real crack from the equivalent straight, sharp one.

        Shape (m, d), at values x (m, d) of the unknowns.
        """
        return compute_deviations_from_equivalent_crack(x, self.unknown_keys, self.scene)

    def list_candidates(self) -> tuple[Measurement, ...]:
        """List candidates for further measurements.

        Candidates are natural frequencies of all modes, and the ratios of harmonics "ratio_2_1" and
        "ratio_3_1" at all points and solved load frequencies.
        """
        quantity_names = ["frequency_open", "frequency_tied", "frequency_resonance"]
        if self.coarse_cases.uncracked_cases is not None:
            quantity_names.append("frequency_uncracked")
        candidate_rows = [
            Measurement(quantity_name, 1.0, 1.0, mode + 1)
            for quantity_name in quantity_names
            for mode in range(N_LOWEST_MODES)
        ]
        load_frequencies = self.coarse_cases.swept_loads.frequencies
        ratio_names = ("ratio_2_1", "ratio_3_1")
        point_names = ["", *self.coarse_cases.sweep_result.scene.label_by_point_name]
        for load_frequency, point_name, ratio_name in itertools.product(
            load_frequencies, point_names, ratio_names
        ):
            candidate_rows.append(
                Measurement(ratio_name, 1.0, 1.0, frequency=load_frequency, point=point_name)
            )
        return tuple(candidate_rows)


def has_load_independent_motion_shape(scene: Scene) -> bool:
    """Return True if the motion is proportional to the load's size.

    This holds for unilateral contact without rotation, clearance, preload and steady load
    (``excitation.force_mean``).
    """
    return is_response_proportional_to_load(scene) and not any(scene.excitation.force_mean)
