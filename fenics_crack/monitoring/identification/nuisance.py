"""Nuisance parameters: the material, the clamp, damping, and the error of the model itself.

Each has a prior, a normal distribution about the scene's value. Its width is in ``[identify]`` with
its source. To first order a standard deviation changes the natural frequency of mode j by a
relative a_j, and the size of harmonics by a relative b. Through their poles
(:mod:`fenics_crack.monitoring.identification.interpolation`) it changes the harmonics U_k by

    d ln U_k = b - sum_j (2 r^2 - 2 i z r) / (1 - r^2 + 2 i z r) a_j,      r = k W / w_j,

and by the change of the first harmonic, which drives the k-th. Here W is the load frequency, w_j a
natural frequency and z the damping ratio. Nothing is solved again. These changes are common errors
in all predictions: with the crack, without the crack, and before the crack. Measurements before the
crack therefore calibrate the plate.

An inclined crack acts like a straight crack at the height of the crack tip (0.87 to 1.11 times as
much, for ten edge cracks inclined by 10 degrees). A wider or softer crack acts like a longer or
shorter sharp crack. Measurements determine this equivalent crack; the real crack has a larger
standard deviation (:func:`compute_deviations_from_equivalent_crack`).

Young's modulus E and density change the elastic part e_j of w_j^2, not the part by rotation:

    d ln w_j / d ln E = e_j / 2,      e_j = phi_j^T K_0 phi_j / w_j^2,

with the stiffness K_0 at rest and the mode phi_j at its speed. A soft clamp takes from w_j^2

    m_j^2 times its softness to turning and (m_x^2 + m_y^2) times that to pushing,

with m = R^T K_0 phi_j, the moment and the forces at the clamp in the mode. R are rigid motions
about the clamp's middle; at rest m = w_j^2 R^T M phi_j (Rayleigh's quotient). The two are
independent: a loose bolt lets the clamp turn, slipping jaws let it move. Their ratio is q^2, as for
a uniformly soft clamp with the radius of gyration q about its middle. Their size is by what both
take from the first mode.

Modes at other speeds or with another modulus follow from a K_0 + s (K - K_0). Here a is the factor
of the modulus and s the squared speed over the scene's. The modes at rest and at the scene's speed
span the space. Temperature and clamp change between the record before there was a crack and the one
since, and so move each mode at each speed. The stiffening by rotation may change, too, by the
blade's seat or the measured speed. Together with a temperature it can change all frequencies by the
same ratio.

Shapes: n modes, s priors, r motions, q measurements, m points x of d unknowns, f features.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from fenics_crack.basics.errors import N_LOWEST_MODES, InputError
from fenics_crack.basics.ranks import MPI
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN
from fenics_crack.fem.loads import rigid_motion_displacements
from fenics_crack.model.modes import Modes, multiply_columns, solve_modes
from fenics_crack.monitoring.identification.interpolation import (
    Feature,
    compute_log_factors_by_first_harmonic,
    compute_ratios_and_pole_factors,
    list_first_harmonic_features,
)
from fenics_crack.monitoring.identification.measurements import Measurement, Measurements
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Identify
from fenics_crack.study.prepare import prepare

CRACK_SIZE_KEYS = ("crack.length", "crack.depth")
"""Keys of a crack's size."""
FACTOR_FROM_HZ_BY_UNIT = {"rad/s": 2.0 * np.pi, "kHz": 1e-3, "mHz": 1e3}
"""Factor from Hz to each unit, by unit."""


class UncrackedPlate:
    """The plate without a crack, or with a bonded crack, and the sensitivities to the priors.

    It is solved on this rank alone.

    Attributes
    ----------
    rotor_speed : float [rad/s]
        Speed of the rotor.
    elastic_and_rotation_stiffness : (2, r, r) [1/s^2]
        Stiffness at rest, and the addition by rotation at that speed, in r mass-normalised motions.
    clamp_reactions : (r, d)
        Forces and moments at the clamp by these motions, relative to a clamp of uniform compliance;
        d = 0 if the clamped nodes are unknown.
    n_reaction_forces : int
        Number of forces among the reactions; they precede the moments.
    identify_table : Identify
        Table ``[identify]`` with the widths of the priors.
    """

    def __init__(self, scene: Scene, identify_table: Identify) -> None:
        if (
            identify_table.temperature_deviation is None
        ):  # of a room; of blades that their gas or drag warms
            identify_table = replace(
                identify_table, temperature_deviation=25.0 if scene.speed else 10.0
            )
        self.rotor_speed = scene.speed
        self.identify_table = identify_table
        plate_modes = _solve_plate_modes(scene)
        modes_at_rest = (
            _solve_plate_modes(scene.without_rotation()) if scene.speed > 0.0 else plate_modes
        )
        mode_shapes = (
            np.hstack([modes_at_rest.shapes, plate_modes.shapes])
            if scene.speed > 0.0
            else plate_modes.shapes
        )
        gram_eigenvalues, gram_eigenvectors = eigh(
            mode_shapes.T @ multiply_columns(plate_modes.structure.mass, mode_shapes)
        )
        is_independent = (
            gram_eigenvalues > np.sqrt(np.finfo(float).eps) * gram_eigenvalues[-1]
        )  # independent motions
        orthonormal_basis = mode_shapes @ (
            gram_eigenvectors[:, is_independent] / np.sqrt(gram_eigenvalues[is_independent])
        )
        rest_stiffness_times_basis = multiply_columns(
            modes_at_rest.structure.stiffness, orthonormal_basis
        )
        elastic_stiffness = orthonormal_basis.T @ rest_stiffness_times_basis
        rotation_stiffness = (
            orthonormal_basis.T
            @ multiply_columns(plate_modes.structure.stiffness, orthonormal_basis)
            - elastic_stiffness
        )
        rigid_motions_at_clamp, self.n_reaction_forces = _build_rigid_clamp_motions(plate_modes)
        self.elastic_and_rotation_stiffness = np.stack([elastic_stiffness, rotation_stiffness])
        self.clamp_reactions = rest_stiffness_times_basis.T @ rigid_motions_at_clamp

    @cached_property
    def natural_frequencies_hz(self) -> np.ndarray:
        """Return natural frequencies (n,) [Hz], with a bonded crack if it cannot be removed."""
        return self.solve_modes_at(1.0)[0] / RAD_PER_TURN

    def solve_modes_at(
        self, speed_ratio: float, modulus_ratio: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve modes at another speed and Young's modulus, both relative to the scene's.

        Returns
        -------
        omega : (n,) [rad/s]
        mode_vectors : (r, n)
        """
        squared_omega, mode_vectors = eigh(
            modulus_ratio * self.elastic_and_rotation_stiffness[0]
            + speed_ratio**2 * self.elastic_and_rotation_stiffness[1]
        )
        n_modes = min(N_LOWEST_MODES, len(squared_omega))
        return np.sqrt(np.maximum(squared_omega[:n_modes], 0.0)), mode_vectors[:, :n_modes]

    def compute_elastic_fractions(self, speed_ratio: float) -> np.ndarray:
        """Return the elastic fraction of squared frequencies at a relative speed: (n,)."""
        natural_omega, mode_vectors = self.solve_modes_at(speed_ratio)
        return np.asarray(
            np.sum(mode_vectors * (self.elastic_and_rotation_stiffness[0] @ mode_vectors), axis=0)
            / natural_omega**2
        )

    def compute_frequency_factors_by_modulus(
        self, speed_ratio: float, modulus_ratio: float
    ) -> np.ndarray:
        """Return factors (n,) of frequencies by a factor of Young's modulus.

        The speed is relative to the scene's.
        """
        return (
            self.solve_modes_at(speed_ratio, modulus_ratio)[0] / self.solve_modes_at(speed_ratio)[0]
        )

    def compute_clamp_sensitivities(self, speed_ratio: float) -> np.ndarray:
        """Return relative changes of natural frequencies by a soft clamp.

        (n, 2) at a speed relative to the rotor's: by a turning clamp and by a moving clamp, over
        the change of the first frequency at the rotor's speed by both. If the clamp is unknown,
        they are the same for all modes and by turning only, as of a slender beam.
        """
        if not self.clamp_reactions.shape[1]:
            return np.outer(self.compute_elastic_fractions(speed_ratio), [1.0, 0.0])

        def compute_clamp_reductions(speed_ratio: float) -> np.ndarray:
            natural_omega, mode_vectors = self.solve_modes_at(speed_ratio)
            squared_reactions = (self.clamp_reactions.T @ mode_vectors) ** 2 / natural_omega**2
            moment_parts = squared_reactions[self.n_reaction_forces :]
            force_parts = squared_reactions[: self.n_reaction_forces]
            return np.stack([moment_parts.sum(axis=0), force_parts.sum(axis=0)])

        return np.asarray(
            (
                compute_clamp_reductions(speed_ratio)
                / np.hypot(*compute_clamp_reductions(1.0)[:, 0])
            ).T
        )

    def compute_prior_sensitivities(self, speed_ratio: float) -> np.ndarray:
        """Return relative changes of frequencies by a standard deviation of each prior: (n, s).

        They are at a speed relative to the rotor's.
        """
        young_deviation, density_deviation, _ = self._young_density_thickness_deviations
        elastic_fractions = self.compute_elastic_fractions(speed_ratio)
        identity_matrix = np.eye(len(elastic_fractions))
        return np.column_stack(
            [
                np.outer(elastic_fractions, [0.5 * young_deviation, -0.5 * density_deviation, 0.0]),
                -self.identify_table.clamp_deviation
                * self.compute_clamp_sensitivities(speed_ratio),
                self.identify_table.model_deviation * elastic_fractions * identity_matrix,
                0.5
                * self.identify_table.stiffening_deviation
                * (1.0 - elastic_fractions)
                * identity_matrix,
            ]
        )

    def compute_feature_sensitivities(
        self,
        features: Sequence[Feature],
        damping_ratios: np.ndarray,
        split_root_and_frequencies: np.ndarray,
        mode_sensitivities: np.ndarray,
    ) -> np.ndarray:
        """Return relative changes of features by a standard deviation of each prior, (m, f, s).

        Features are natural frequencies without the crack, its additions to their logarithms, and
        harmonics.

        Parameters
        ----------
        features : sequence of Feature
            f features.
        damping_ratios : (m, 1)
        split_root_and_frequencies : (m, f, 1 + 2 n)
            :attr:`SolvedCases.split_root_and_frequencies` at the load of each feature.
        mode_sensitivities : (f, n, s)
            :meth:`compute_prior_sensitivities` at the speed of each feature.
        """
        identify_table, n_modes = self.identify_table, mode_sensitivities.shape[1]
        is_natural_frequency, is_cracked_frequency = (
            np.array([getattr(feature, attribute_name) for feature in features])[:, None]
            for attribute_name in ("is_natural_frequency", "is_cracked_frequency")
        )
        mode_numbers = np.array([feature.mode for feature in features])[:, None]
        slope_shape = len(split_root_and_frequencies), len(mode_numbers), n_modes
        slopes_by_mode = np.broadcast_to(
            is_natural_frequency & (mode_numbers == 1 + np.arange(n_modes)), slope_shape
        )
        slopes_by_crack = slopes_by_mode * is_cracked_frequency
        slopes_by_damping = np.zeros((*slope_shape[:2], 1))
        if not is_natural_frequency.all():
            with np.errstate(invalid="ignore"):
                log_bilinear_frequencies, log_uncracked_frequencies = np.split(
                    np.log(split_root_and_frequencies[..., 1:]), 2, axis=2
                )
            log_frequency_shifts_by_crack = np.nan_to_num(
                log_bilinear_frequencies - log_uncracked_frequencies
            )[..., :n_modes]
            pole_slopes, damping_slopes = _differentiate_harmonic_logs(
                features, damping_ratios, split_root_and_frequencies
            )
            first_pole_slopes, first_damping_slopes = _differentiate_harmonic_logs(
                list_first_harmonic_features(features), damping_ratios, split_root_and_frequencies
            )
            pole_slopes = (
                pole_slopes + compute_log_factors_by_first_harmonic(first_pole_slopes, features)
            )[..., :n_modes]
            slopes_by_mode = np.where(is_natural_frequency, slopes_by_mode, pole_slopes)
            slopes_by_crack = np.where(
                is_natural_frequency, slopes_by_crack, pole_slopes * log_frequency_shifts_by_crack
            )
            slopes_by_damping = (
                damping_slopes
                + compute_log_factors_by_first_harmonic(first_damping_slopes, features)
            ).sum(axis=2)[..., None]
        harmonic_size_changes = np.zeros(mode_sensitivities.shape[2])  # of harmonics
        harmonic_size_changes[:3] = np.multiply(
            self._young_density_thickness_deviations, (-1.0, 0.0, -1.0)
        )
        independent_crack_deviation = identify_table.crack_deviation * np.sqrt(
            1.0 - identify_table.crack_correlation
        )
        is_damping_unknown = any(
            unknown_axis.key == "damping.ratio" for unknown_axis in identify_table.unknown
        )
        sensitivity_blocks = [
            np.einsum("mfn,fns->mfs", slopes_by_mode * ~is_cracked_frequency, mode_sensitivities)
            + ~is_natural_frequency * harmonic_size_changes,
            independent_crack_deviation * slopes_by_crack,
            (0.0 if is_damping_unknown else identify_table.damping_deviation) * slopes_by_damping,
        ]
        return np.concatenate(sensitivity_blocks, axis=2)

    @property
    def _young_density_thickness_deviations(self) -> list[float]:
        """Return relative standard deviations of Young's modulus, density and thickness.

        That of an unknown is 0.
        """
        identify_table = self.identify_table
        unknown_keys = {unknown_axis.key for unknown_axis in self.identify_table.unknown}
        prior_keys = ("material.young", "material.density", "geometry.thickness")
        relative_deviations = (
            identify_table.young_deviation,
            identify_table.density_deviation,
            identify_table.thickness_deviation,
        )
        keys_and_deviations = zip(prior_keys, relative_deviations, strict=True)
        return [
            0.0 if key in unknown_keys else relative_deviation
            for key, relative_deviation in keys_and_deviations
        ]

    def compute_clamp_and_temperature_sensitivities(
        self, speed_ratio: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return relative changes between the plate before it had a crack and now.

        They are at a speed relative to the rotor's, a standard deviation each.

        Returns
        -------
        (n, 3 + n)
            Changes by a turning clamp, by a moving clamp, by the stiffening of all modes, and of
            each mode by itself.
        (n, 1 + n)
            Changes by a kelvin, and their uncertainty due to rotation.
        """
        identify_table = self.identify_table
        elastic_fractions = self.compute_elastic_fractions(speed_ratio)
        identity_matrix = np.eye(len(elastic_fractions))
        clamp_sensitivities = np.column_stack(
            [
                self.compute_clamp_sensitivities(speed_ratio),
                1.0 - elastic_fractions,
                identify_table.before_scatter * elastic_fractions * identity_matrix,
            ]
        )
        changes_per_kelvin = 0.5 * identify_table.temperature_coefficient * elastic_fractions
        rotation_uncertainties = (
            identify_table.stiffening_deviation
            * (1.0 - elastic_fractions)
            * changes_per_kelvin
            * identity_matrix
        )
        return identify_table.before_deviation * clamp_sensitivities, np.column_stack(
            [changes_per_kelvin, rotation_uncertainties]
        )

    def check_units_and_modes(
        self,
        measurements: Measurements,
        load_frequencies: Sequence[float],
        *,
        may_be_other_plate: bool,
    ) -> None:
        """Raise InputError for frequencies that seem to have another unit or mode.

        Load frequencies must not seem to be in kHz or mHz by those of the scene [Hz]. Natural
        frequencies must not seem to be in rad/s, kHz or mHz. If the plate may be another one, rad/s
        is refused only for all of them together. Otherwise a frequency without the crack must be
        nearest to its own mode.
        """
        for row in [row for row in measurements.rows if load_frequencies and not row.natural]:
            nearest_load_frequency = load_frequencies[
                int(np.abs(np.log(np.divide(load_frequencies, row.frequency))).argmin())
            ]
            if (
                unit_name := _guess_frequency_unit_or_empty(row.frequency / nearest_load_frequency)
            ) in ("kHz", "mHz"):
                allowed_text = (
                    f"in Hz; the scene has {nearest_load_frequency:.4g} Hz, "
                    f"so that the value seems to be in {unit_name}"
                )
                raise InputError(f"measurements.frequency, {row.name}", row.frequency, allowed_text)
        rows = [row for row in measurements.rows if row.natural and row.value > 0.0]
        rows = [row for row in rows if row.mode <= len(self.natural_frequencies_hz)]
        speed_ratios = [
            1.0 if np.isnan(row.rpm) else RAD_PER_S_PER_RPM * row.rpm / self.rotor_speed
            for row in rows
        ]
        plate_frequencies_of_rows = [
            self.solve_modes_at(speed_ratio)[0] / RAD_PER_TURN for speed_ratio in speed_ratios
        ]
        rows_and_frequencies = zip(rows, plate_frequencies_of_rows, strict=True)
        guessed_unit_names = [
            _guess_frequency_unit_or_empty(row.value / plate_frequencies[row.mode - 1])
            for row, plate_frequencies in rows_and_frequencies
        ]
        for unit_name in FACTOR_FROM_HZ_BY_UNIT:
            have_unit = [guessed_unit_name == unit_name for guessed_unit_name in guessed_unit_names]
            if rows and (
                all(have_unit) if may_be_other_plate and unit_name == "rad/s" else any(have_unit)
            ):
                row = rows[have_unit.index(True)]
                plate_frequencies = plate_frequencies_of_rows[have_unit.index(True)]
                modes_text = "" if all(have_unit) and len(rows) > 1 else ", or of another mode"
                allowed_text = (
                    f"in Hz; this plate has about {plate_frequencies[row.mode - 1]:.4g} Hz, "
                    f"so that the value seems to be in {unit_name}{modes_text}"
                )
                raise InputError(f"measurements.value, {row.name}", row.value, allowed_text)
        for row, plate_frequencies in (
            zip(rows, plate_frequencies_of_rows, strict=True) if not may_be_other_plate else ()
        ):
            nearest_mode = int(np.abs(np.log(row.value / plate_frequencies)).argmin()) + 1
            if row.quantity == "frequency_uncracked" and nearest_mode != row.mode:
                own_frequency_text, nearest_frequency_text = (
                    f"{plate_frequencies[mode - 1]:.4g} Hz" for mode in (row.mode, nearest_mode)
                )
                own_mode_text = f"near {own_frequency_text} of this plate's mode {row.mode}"
                allowed_text = (
                    f"{own_mode_text}; nearer is mode {nearest_mode} with "
                    f"{nearest_frequency_text}: correct the mode, or the scene"
                )
                raise InputError(f"measurements.value, {row.name}", row.value, allowed_text)


def _guess_frequency_unit_or_empty(frequency_ratio: float) -> str:
    """Guess a number's unit by its ratio to the number in Hz.

    Empty for Hz or no match.
    """
    # No crack changes a frequency by a factor of exp(0.3).
    matching_unit_names = (
        unit_name
        for unit_name, unit_factor in FACTOR_FROM_HZ_BY_UNIT.items()
        if abs(np.log(frequency_ratio / unit_factor)) < 0.3
    )
    return next(matching_unit_names, "")


class BaselineChanges:
    """Changes in q measurements between the record before the crack and the record since.

    They are 0 for measurements other than natural frequencies, and for unknown modes.

    Attributes
    ----------
    temperature_frequency_factors : (q,)
        Factors of predictions by known temperatures.
    clamp_frequency_changes : (q, s)
        Relative changes by the clamp, a standard deviation each.
    unknown_temperature_frequency_changes : (q, s)
        Relative changes by an unknown temperature, in the first column, and its uncertainty.
    temperature_error_frequency_changes : (q, s)
        Relative changes by errors of known temperatures: by the coefficient, the thermometer and
        rotation.
    """

    def __init__(
        self,
        rows: Sequence[Measurement],
        speed_ratios: Sequence[float],
        uncracked_plate: UncrackedPlate,
    ) -> None:
        """Take measurements, each at a speed relative to the rotor's.

        Records since the crack are at the mean of their stated temperatures, if any is stated.
        Records before it are at the stated temperature, or at an unknown one.
        """
        identify_table = uncracked_plate.identify_table
        n_modes = len(uncracked_plate.natural_frequencies_hz)
        is_baseline = np.array(
            [measurement.quantity == "frequency_uncracked" for measurement in rows]
        )
        stated_temperatures = np.array([measurement.temperature for measurement in rows])
        current_temperatures = stated_temperatures[~is_baseline & np.isfinite(stated_temperatures)]
        temperature_offsets = np.nan_to_num(
            stated_temperatures
            - (current_temperatures.mean() if len(current_temperatures) else np.nan)
        )
        has_known_offset = (
            is_baseline & np.isfinite(stated_temperatures) & (len(current_temperatures) > 0)
        )
        self.temperature_frequency_factors = np.ones(len(rows))
        changes_per_kelvin = np.zeros((len(rows), 1 + n_modes))
        self.clamp_frequency_changes = np.zeros((len(rows), 3 + n_modes))
        sensitivities_by_speed_ratio = {
            speed_ratio: uncracked_plate.compute_clamp_and_temperature_sensitivities(speed_ratio)
            for speed_ratio in set(speed_ratios)
        }
        for row_index, (measurement, speed_ratio) in enumerate(
            zip(rows, speed_ratios, strict=True)
        ):
            if measurement.natural and measurement.mode <= n_modes:
                clamp_sensitivities, temperature_sensitivities = sensitivities_by_speed_ratio[
                    speed_ratio
                ]
                self.clamp_frequency_changes[row_index] = (
                    is_baseline[row_index] * clamp_sensitivities[measurement.mode - 1]
                )
                changes_per_kelvin[row_index] = temperature_sensitivities[measurement.mode - 1]
                modulus_ratio = (
                    1.0 + identify_table.temperature_coefficient * temperature_offsets[row_index]
                )
                self.temperature_frequency_factors[row_index] = (
                    uncracked_plate.compute_frequency_factors_by_modulus(
                        speed_ratio, modulus_ratio
                    )[measurement.mode - 1]
                )
        has_unknown_offset = (is_baseline & ~has_known_offset)[:, None]
        self.unknown_temperature_frequency_changes = (
            -identify_table.inference_setting_by_key["temperature_deviation"]
            * has_unknown_offset
            * changes_per_kelvin
        )
        temperature_error_blocks = [
            identify_table.coefficient_deviation
            * temperature_offsets[:, None]
            * changes_per_kelvin[:, :1],
            identify_table.thermometer_deviation
            * has_known_offset[:, None]
            * changes_per_kelvin[:, :1],
            temperature_offsets[:, None] * changes_per_kelvin[:, 1:],
        ]
        self.temperature_error_frequency_changes = np.hstack(temperature_error_blocks)

    @property
    def frequency_changes(self) -> np.ndarray:
        """Return all relative changes of frequencies: (q, s)."""
        return np.hstack(
            [
                self.unknown_temperature_frequency_changes,
                self.clamp_frequency_changes,
                self.temperature_error_frequency_changes,
            ]
        )

    def with_change_factors(
        self, clamp_factor: float, temperature_factor: float
    ) -> BaselineChanges:
        """Return a copy with the changes by clamp and unknown temperature multiplied."""
        scaled_changes = copy(self)
        scaled_changes.clamp_frequency_changes = clamp_factor * self.clamp_frequency_changes
        scaled_changes.unknown_temperature_frequency_changes = (
            temperature_factor * self.unknown_temperature_frequency_changes
        )
        return scaled_changes


def _solve_plate_modes(scene: Scene) -> Modes:
    """Solve the first modes of a scene on this rank, with a bonded crack."""
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    n_modes = min(N_LOWEST_MODES, structure.n_dofs - structure.n_pairs)
    return solve_modes(structure, n_modes, lips="tied" if structure.n_pairs else "open")


def _build_rigid_clamp_motions(modes: Modes) -> tuple[np.ndarray, int]:
    """Build rigid motions about the clamp's middle, translations first.

    Returns
    -------
    motion_columns : (n, d)
        Translations are times the clamp's radius of gyration. d = 0 if no node is clamped or the
        nodes are unknown.
    n_translations : int
        Number of translations.
    """
    structure_nodes = modes.structure.nodes
    clamped_points = (
        np.zeros((0, 0))
        if structure_nodes is None
        else structure_nodes.points[(structure_nodes.dofs < 0).all(axis=1)]
    )
    if structure_nodes is None or len(clamped_points) < 2:
        return np.zeros((modes.structure.n_local, 0)), 0
    node_motions = rigid_motion_displacements(structure_nodes.points - clamped_points.mean(axis=0))
    motion_columns = np.zeros((modes.structure.n_local, len(node_motions)))
    dofs_of_nodes = structure_nodes.dofs.ravel()
    motion_columns[dofs_of_nodes[dofs_of_nodes >= 0]] = node_motions[:, dofs_of_nodes >= 0].T
    n_translations = structure_nodes.points.shape[1]
    motion_columns[:, :n_translations] *= np.sqrt(np.sum(np.var(clamped_points, axis=0)))
    return motion_columns, n_translations


def _differentiate_harmonic_logs(
    features: Sequence[Feature], damping_ratios: np.ndarray, split_root_and_frequencies: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate logarithms of harmonics through their poles: (m, f, modes) each.

    The first slopes are by ln w_j, the second by the logarithm of the damping ratio.
    """
    r, pole_factors = compute_ratios_and_pole_factors(
        features, damping_ratios, split_root_and_frequencies
    )
    damping_slopes = 2j * damping_ratios[..., None] * r / pole_factors
    return damping_slopes - 2.0 * r**2 / pole_factors, -damping_slopes


def compute_deviations_from_equivalent_crack(
    x: np.ndarray, unknown_keys: Sequence[str], scene: Scene
) -> np.ndarray:
    """Return standard deviations (m, d) of a crack from the equivalent one.

    The equivalent crack is straight and sharp. They are for values x (m, d) of the unknowns.
    """
    identify_table = scene.given("identify")
    equivalence_deviations = np.zeros_like(x)
    crack_extents = np.zeros(len(x))
    for size_key in CRACK_SIZE_KEYS:  # that of a part-through crack is its depth
        crack_sizes = np.full(
            len(x), getattr(scene.crack, size_key.removeprefix("crack."), None) or 0.0
        )
        if size_key in unknown_keys:
            crack_sizes = x[:, unknown_keys.index(size_key)]
            common_relative_deviation = identify_table.crack_deviation * np.sqrt(
                identify_table.crack_correlation
            )
            # Frequencies change with its square.
            equivalence_deviations[:, unknown_keys.index(size_key)] = (
                common_relative_deviation / 2.0 * crack_sizes
            )
        crack_extents = np.where(crack_sizes > 0.0, crack_sizes, crack_extents)
    if "crack.height" in unknown_keys:
        tilt_slope = np.tan(np.radians(identify_table.angle_deviation))
        equivalence_deviations[:, unknown_keys.index("crack.height")] = tilt_slope * crack_extents
    return equivalence_deviations
