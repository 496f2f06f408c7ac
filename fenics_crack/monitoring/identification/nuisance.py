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
standard deviation (:func:`compute_crack_geometry_deviations`).

Young's modulus E and density change the elastic part e_j of w_j^2, not the part by rotation:

    d ln w_j / d ln E = e_j / 2,      e_j = phi_j^T K_0 phi_j / w_j^2,

with the stiffness K_0 at rest and the mode phi_j at its speed. A soft clamp has the compliances c_r
to rotation and c_t to translation. It reduces w_j^2 by

    c_r m_r^2 + c_t m_t^2,      (m_r, m_t) = R^T K_0 phi_j,

with the moment m_r and the force m_t at the clamp in the mode. R are rigid motions about the
clamp's middle; at rest R^T K_0 phi_j = w_j^2 R^T M phi_j, with the mass M (Rayleigh's quotient).
The two compliances are independent: a loose bolt lets the clamp turn, slipping jaws let it move.
Their ratio is c_t / c_r = q^2, as for a uniformly soft clamp with the radius of gyration q about
its middle. Their size follows from the first natural frequency, which both together change by one
standard deviation.

Modes at other speeds or with another modulus follow from the stiffness a K_0 + s (K - K_0). Here K
is the stiffness at the scene's speed, a the factor of the modulus, and s the square of the speed
over the scene's. The modes at rest and at the scene's speed span the space.

Temperature and clamp may change between the measurements before the crack (baseline) and after.
Each natural frequency then changes at each speed. The stiffening by rotation may change, too, by
the blade's seat or a wrong speed. Together with a temperature change it can change all frequencies
by the same ratio.

Shapes: n modes, s priors, r motions, q measurements, m points x of d unknowns, f features.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from fenics_crack.basics.errors import N_NATURAL_MODES_PER_CRACK_STATE, InputError
from fenics_crack.basics.ranks import MPI
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN
from fenics_crack.fem.loads import rigid_motion_displacements
from fenics_crack.model.modes import Modes, multiply_columns, solve_modes
from fenics_crack.monitoring.identification.interpolation import (
    Feature,
    compute_log_factors_by_first_harmonic,
    find_frequency_ratios_and_pole_factors,
    replace_by_driving_first_harmonics,
)
from fenics_crack.monitoring.identification.measurements import Measurement, Measurements
from fenics_crack.scene.result_tables import Identify
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import prepare

CRACK_SIZE_KEYS = ("crack.length", "crack.depth")
"""Keys of the crack's size in a scene."""
FACTOR_FROM_HZ_BY_MISTAKEN_UNIT = {"rad/s": 2.0 * np.pi, "kHz": 1e-3, "mHz": 1e3}
"""Factor from Hz to each unit that a frequency might have by mistake."""


class UncrackedPlate:
    """Plate without its crack, and frequency changes by uncertain properties of the plate.

    A crack that cannot be removed is bonded. The plate is solved on this rank alone. The uncertain
    properties are material, thickness, clamp, model error and stiffening by rotation. Each has a
    prior, a normal distribution with the standard deviation in ``[identify]``.

    To be fast, modes are computed in the space of r motions: the modes at rest and at the scene's
    rotor speed, made orthogonal, with modal mass 1.

    Attributes
    ----------
    rotor_speed : float [rad/s]
        Rotor speed of the scene.
    elastic_and_rotation_stiffness : (2, r, r) [1/s^2]
        Two matrices, projected on the r motions: stiffness at rest, and the additional stiffness by
        rotation at the scene's rotor speed.
    clamp_reactions : (r, d)
        d forces and moments at the clamp in each motion. Forces come first, multiplied by the
        clamp's radius of gyration to get the unit of moments. d = 0 if the clamped nodes are
        unknown.
    n_reaction_forces : int
        Number of forces among the d reactions.
    identify_table : Identify
        Table ``[identify]`` with the priors.
    """

    def __init__(self, scene: Scene, identify_table: Identify) -> None:
        if (
            identify_table.temperature_deviation is None
        ):  # 10 K: temperature of a room; 25 K: of blades that gas or drag warms
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
        mode_gram_eigenvalues, mode_gram_eigenvectors = eigh(
            mode_shapes.T @ multiply_columns(plate_modes.structure.mass, mode_shapes)
        )
        is_independent_motion = (
            mode_gram_eigenvalues > np.sqrt(np.finfo(float).eps) * mode_gram_eigenvalues[-1]
        )  # independent motions
        orthonormal_basis = mode_shapes @ (
            mode_gram_eigenvectors[:, is_independent_motion]
            / np.sqrt(mode_gram_eigenvalues[is_independent_motion])
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
        """Return the plate's natural frequencies at the scene's speed: (n,) [Hz]."""
        return self.solve_modes_at(1.0)[0] / RAD_PER_TURN

    def solve_modes_at(
        self, speed_ratio: float, modulus_ratio: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve the plate's modes at another rotor speed and Young's modulus.

        ``speed_ratio`` and ``modulus_ratio`` are relative to the scene's rotor speed and Young's
        modulus.

        Returns
        -------
        omega : (n,) [rad/s]
            Natural frequencies in ascending order.
        mode_vectors : (r, n)
            Amplitudes of the r motions (:class:`UncrackedPlate`) in each of the n modes.
        """
        squared_omega, mode_vectors = eigh(
            modulus_ratio * self.elastic_and_rotation_stiffness[0]
            + speed_ratio**2 * self.elastic_and_rotation_stiffness[1]
        )
        n_modes = min(N_NATURAL_MODES_PER_CRACK_STATE, len(squared_omega))
        return np.sqrt(np.maximum(squared_omega[:n_modes], 0.0)), mode_vectors[:, :n_modes]

    def compute_elastic_fractions(self, speed_ratio: float) -> np.ndarray:
        """Return the fraction e_j of each squared natural frequency due to elasticity: (n,).

        The rest, 1 - e_j, comes from rotation. ``speed_ratio`` is the rotor speed divided by the
        scene's rotor speed.
        """
        natural_omega, mode_vectors = self.solve_modes_at(speed_ratio)
        return np.asarray(
            np.sum(mode_vectors * (self.elastic_and_rotation_stiffness[0] @ mode_vectors), axis=0)
            / natural_omega**2
        )

    def compute_frequency_factors_by_modulus(
        self, speed_ratio: float, modulus_ratio: float
    ) -> np.ndarray:
        """Return the ratios of natural frequencies after and before a modulus change: (n,).

        ``modulus_ratio`` is Young's modulus after the change, divided by the scene's modulus.
        ``speed_ratio`` is the rotor speed divided by the scene's rotor speed.
        """
        return (
            self.solve_modes_at(speed_ratio, modulus_ratio)[0] / self.solve_modes_at(speed_ratio)[0]
        )

    def compute_clamp_sensitivities(self, speed_ratio: float) -> np.ndarray:
        """Return relative reductions of n natural frequencies by a soft clamp: (n, 2).

        Column 0 is for a clamp that turns under its moments, column 1 for a clamp that moves under
        its forces. A reduction is proportional to the squared reactions at the clamp, divided by
        the squared frequency. All entries are scaled by the same number: at the scene's rotor
        speed, the root sum square of both entries for mode 1 is 1.

        If the clamped nodes are unknown, column 0 has the elastic fractions
        (:meth:`compute_elastic_fractions`), column 1 is 0. ``speed_ratio`` is the rotor speed
        divided by the scene's rotor speed.
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
        """Return relative changes of n natural frequencies by uncertain properties: (n, s).

        Each of the s columns is for a change by one prior standard deviation. The columns are
        Young's modulus, density, thickness, a turning clamp and a moving clamp. Then follow n
        columns for the model error of each mode, and n for the stiffening of each mode by rotation.
        ``speed_ratio`` is the rotor speed divided by the scene's rotor speed.
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
        damping_ratio_of_points: np.ndarray,
        frequency_drop_root_and_frequencies: np.ndarray,
        mode_sensitivities: np.ndarray,
    ) -> np.ndarray:
        """Return relative changes of features by uncertain properties: (m, f, s + n + 1).

        Each column is the change by one prior standard deviation. The s columns of
        ``mode_sensitivities`` come first. Then follow n columns: in column j, the effect of the
        crack on mode j is larger than modelled. The last column is for larger damping.

        For a natural frequency with the crack, the feature here is ln(frequency with the crack /
        frequency without). Uncertain properties of the uncracked plate do not change this ratio.

        Parameters
        ----------
        features : sequence of Feature
            f natural frequencies and harmonics.
        damping_ratio_of_points : (m, 1)
            Damping ratios at m values of the unknowns.
        frequency_drop_root_and_frequencies : (m, f, 1 + 2 n)
            :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature,
            with n modes.
        mode_sensitivities : (f, n, s)
            :meth:`compute_prior_sensitivities` at the rotor speed of each feature.
        """
        identify_table, n_modes = self.identify_table, mode_sensitivities.shape[1]
        is_natural_frequency, is_cracked_frequency = (
            np.array([getattr(feature, feature_flag_name) for feature in features])[:, None]
            for feature_flag_name in ("is_natural_frequency", "is_cracked_frequency")
        )
        mode_numbers = np.array([feature.mode for feature in features])[:, None]
        slope_shape = len(frequency_drop_root_and_frequencies), len(mode_numbers), n_modes
        slopes_by_mode = np.broadcast_to(
            is_natural_frequency & (mode_numbers == 1 + np.arange(n_modes)), slope_shape
        )
        with np.errstate(invalid="ignore"):
            log_bilinear_frequencies, log_uncracked_frequencies = np.split(
                np.log(frequency_drop_root_and_frequencies[..., 1:]), 2, axis=2
            )
        log_frequency_shifts_by_crack = np.nan_to_num(
            log_bilinear_frequencies - log_uncracked_frequencies
        )[..., :n_modes]
        pole_slopes, damping_slopes = _differentiate_harmonic_logs(
            features, damping_ratio_of_points, frequency_drop_root_and_frequencies
        )
        first_harmonic_pole_slopes, first_harmonic_damping_slopes = _differentiate_harmonic_logs(
            replace_by_driving_first_harmonics(features),
            damping_ratio_of_points,
            frequency_drop_root_and_frequencies,
        )
        pole_slopes = (
            pole_slopes
            + compute_log_factors_by_first_harmonic(first_harmonic_pole_slopes, features)
        )[..., :n_modes]
        damping_slopes = damping_slopes + compute_log_factors_by_first_harmonic(
            first_harmonic_damping_slopes, features
        )
        slopes_by_crack_effect_on_modes = np.where(
            is_natural_frequency,
            slopes_by_mode * is_cracked_frequency,
            pole_slopes * log_frequency_shifts_by_crack,
        )
        slopes_by_mode = np.where(is_natural_frequency, slopes_by_mode, pole_slopes)
        harmonic_size_changes = np.zeros(mode_sensitivities.shape[2])
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
            independent_crack_deviation * slopes_by_crack_effect_on_modes,
            (0.0 if is_damping_unknown else identify_table.damping_deviation)
            * damping_slopes.sum(axis=2, keepdims=True),
        ]
        return np.concatenate(sensitivity_blocks, axis=2)

    @property
    def _young_density_thickness_deviations(self) -> list[float]:
        """Return relative standard deviations of Young's modulus, density and thickness.

        0 for a quantity that is an unknown.
        """
        unknown_keys = {unknown_axis.key for unknown_axis in self.identify_table.unknown}
        deviation_by_key = {
            "material.young": self.identify_table.young_deviation,
            "material.density": self.identify_table.density_deviation,
            "geometry.thickness": self.identify_table.thickness_deviation,
        }
        return [
            0.0 if key in unknown_keys else relative_deviation
            for key, relative_deviation in deviation_by_key.items()
        ]

    def compute_clamp_and_temperature_sensitivities(
        self, speed_ratio: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return relative frequency changes by changed clamp and temperature.

        Clamp and temperature may change between the baseline and later measurements. The baseline
        are natural frequencies measured before the crack. ``speed_ratio`` is the rotor speed
        divided by the scene's rotor speed.

        Returns
        -------
        clamp_sensitivities : (n, 3 + n)
            Relative changes of n natural frequencies, each column by one prior standard deviation.
            Columns 0 to 2: a clamp that turns, a clamp that moves, and stiffening by rotation. Then
            follows a column for each mode, in which this frequency changes alone.
        temperature_sensitivities : (n, 1 + n) [1/K]
            Column 0: relative change of each frequency by 1 K. Column j: standard deviation of this
            change for mode j, 0 for other modes. It comes from the uncertain stiffening by
            rotation.
        """
        identify_table = self.identify_table
        elastic_fractions = self.compute_elastic_fractions(speed_ratio)
        identity_matrix = np.eye(len(elastic_fractions))
        frequency_changes_by_clamp = np.column_stack(
            [
                self.compute_clamp_sensitivities(speed_ratio),
                1.0 - elastic_fractions,
                identify_table.before_scatter * elastic_fractions * identity_matrix,
            ]
        )
        changes_per_kelvin = 0.5 * identify_table.temperature_coefficient * elastic_fractions
        deviations_of_changes_per_kelvin = (
            identify_table.stiffening_deviation
            * (1.0 - elastic_fractions)
            * changes_per_kelvin
            * identity_matrix
        )
        return identify_table.before_deviation * frequency_changes_by_clamp, np.column_stack(
            [changes_per_kelvin, deviations_of_changes_per_kelvin]
        )

    def check_units_and_modes(
        self,
        measurements: Measurements,
        load_frequencies: Sequence[float],
        *,
        may_be_other_plate: bool,
    ) -> None:
        """Raise InputError for measured frequencies that seem to have a wrong unit or mode.

        A load frequency is compared with the nearest of ``load_frequencies`` [Hz]. A natural
        frequency is compared with this plate's frequency of the same mode. A load frequency must
        not seem to be in kHz or mHz, a natural frequency not in rad/s, kHz or mHz.

        ``may_be_other_plate`` is True if an unknown belongs neither to crack nor to contact, for
        example the thickness. The unit rad/s then causes an error only if all natural frequencies
        seem to have this unit. If ``may_be_other_plate`` is False, the modes are checked, too: a
        frequency without the crack must be nearest to this plate's frequency of the stated mode.
        """
        for row in [
            row for row in measurements.rows if load_frequencies and not row.is_natural_frequency
        ]:
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
        natural_frequency_rows = [
            row
            for row in measurements.rows
            if row.is_natural_frequency
            and row.value > 0.0
            and row.mode <= len(self.natural_frequencies_hz)
        ]
        plate_frequencies_of_rows = []
        for row in natural_frequency_rows:
            speed_ratio = (
                1.0 if np.isnan(row.rpm) else RAD_PER_S_PER_RPM * row.rpm / self.rotor_speed
            )
            plate_frequencies_of_rows.append(self.solve_modes_at(speed_ratio)[0] / RAD_PER_TURN)
        guessed_unit_names = [
            _guess_frequency_unit_or_empty(row.value / plate_frequencies[row.mode - 1])
            for row, plate_frequencies in zip(
                natural_frequency_rows, plate_frequencies_of_rows, strict=True
            )
        ]
        for unit_name in FACTOR_FROM_HZ_BY_MISTAKEN_UNIT:
            is_row_in_guessed_unit = [
                guessed_unit_name == unit_name for guessed_unit_name in guessed_unit_names
            ]
            if natural_frequency_rows and (
                all(is_row_in_guessed_unit)
                if may_be_other_plate and unit_name == "rad/s"
                else any(is_row_in_guessed_unit)
            ):
                row = natural_frequency_rows[is_row_in_guessed_unit.index(True)]
                plate_frequencies = plate_frequencies_of_rows[is_row_in_guessed_unit.index(True)]
                or_of_another_mode_text = (
                    ""
                    if all(is_row_in_guessed_unit) and len(natural_frequency_rows) > 1
                    else ", or of another mode"
                )
                allowed_text = (
                    f"in Hz; this plate has about {plate_frequencies[row.mode - 1]:.4g} Hz, "
                    f"so that the value seems to be in {unit_name}{or_of_another_mode_text}"
                )
                raise InputError(f"measurements.value, {row.name}", row.value, allowed_text)
        for row, plate_frequencies in (
            zip(natural_frequency_rows, plate_frequencies_of_rows, strict=True)
            if not may_be_other_plate
            else ()
        ):
            nearest_mode = int(np.abs(np.log(row.value / plate_frequencies)).argmin()) + 1
            if row.quantity == "frequency_uncracked" and nearest_mode != row.mode:
                stated_mode_frequency_text, nearest_frequency_text = (
                    f"{plate_frequencies[mode - 1]:.4g} Hz" for mode in (row.mode, nearest_mode)
                )
                stated_mode_text = (
                    f"near {stated_mode_frequency_text} of this plate's mode {row.mode}"
                )
                allowed_text = (
                    f"{stated_mode_text}; nearer is mode {nearest_mode} with "
                    f"{nearest_frequency_text}: correct the mode, or the scene"
                )
                raise InputError(f"measurements.value, {row.name}", row.value, allowed_text)


def _guess_frequency_unit_or_empty(frequency_ratio: float) -> str:
    """Guess a frequency's unit from its ratio to the expected value in Hz.

    Return "rad/s", "kHz" or "mHz" if the ratio fits within a factor exp(0.3), otherwise "".
    """
    # No crack changes a frequency by a factor of exp(0.3).
    matching_unit_names = (
        unit_name
        for unit_name, unit_factor in FACTOR_FROM_HZ_BY_MISTAKEN_UNIT.items()
        if abs(np.log(frequency_ratio / unit_factor)) < 0.3
    )
    return next(matching_unit_names, "")


class BaselineChanges:
    """Possible changes of natural frequencies between the baseline and now.

    The baseline are natural frequencies measured before the crack. Since then, clamp and
    temperature of the plate may have changed. Each array has a row for each of q measurements. A
    row has changes only if the measurement is a natural frequency of one of the plate's n modes.
    Rows for other measurements are 0, and their factors are 1. In an array of changes, each column
    has the effect of a single cause, changed by one standard deviation.

    Attributes
    ----------
    temperature_frequency_factors : (q,)
        Predicted frequencies are multiplied by this factor, for the temperature stated with the
        measurement. The factor is 1 at the present temperature, or if no temperature is stated.
    clamp_frequency_changes : (q, 3 + n)
        Relative changes of baseline frequencies by the clamp. Columns 0 to 2: a clamp that turns, a
        clamp that moves, and stiffening by rotation. Column 2 + j, with j from 1: only the
        frequency of mode j changes.
    unknown_temperature_frequency_changes : (q, 1 + n)
        Relative changes of baseline frequencies by an unknown temperature difference. Column 0: the
        temperature difference itself. Column j, with j from 1: error of column 0 for mode j, as the
        stiffening by rotation is uncertain.
    temperature_error_frequency_changes : (q, 2 + n)
        Relative changes by errors of known temperature differences. Column 0: error of the
        temperature coefficient. Column 1: error of the thermometer. Column 1 + j, with j from 1:
        uncertain stiffening of mode j by rotation.
    """

    def __init__(
        self,
        rows: Sequence[Measurement],
        speed_ratios: Sequence[float],
        uncracked_plate: UncrackedPlate,
    ) -> None:
        """Compute the changes for q measurements.

        ``speed_ratios`` (q,) are rotor speeds at the measurements, divided by the scene's rotor
        speed. The present temperature is the mean of the temperatures stated for measurements with
        the crack. A baseline measurement has a known temperature difference if its temperature and
        the present temperature are stated; otherwise the difference is unknown.
        """
        identify_table = uncracked_plate.identify_table
        n_modes = len(uncracked_plate.natural_frequencies_hz)
        is_baseline = np.array(
            [measurement.quantity == "frequency_uncracked" for measurement in rows]
        )
        stated_temperatures = np.array([measurement.temperature for measurement in rows])
        stated_temperatures_with_crack = stated_temperatures[
            ~is_baseline & np.isfinite(stated_temperatures)
        ]
        temperature_offsets = np.nan_to_num(
            stated_temperatures
            - (
                stated_temperatures_with_crack.mean()
                if len(stated_temperatures_with_crack)
                else np.nan
            )
        )
        has_known_temperature_offset = (
            is_baseline
            & np.isfinite(stated_temperatures)
            & (len(stated_temperatures_with_crack) > 0)
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
            if measurement.is_natural_frequency and measurement.mode <= n_modes:
                frequency_changes_by_clamp, temperature_sensitivities = (
                    sensitivities_by_speed_ratio[speed_ratio]
                )
                self.clamp_frequency_changes[row_index] = (
                    is_baseline[row_index] * frequency_changes_by_clamp[measurement.mode - 1]
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
        has_unknown_temperature_offset = (is_baseline & ~has_known_temperature_offset)[:, None]
        self.unknown_temperature_frequency_changes = (
            -identify_table.inference_setting_by_key["temperature_deviation"]
            * has_unknown_temperature_offset
            * changes_per_kelvin
        )
        temperature_error_blocks = [
            identify_table.coefficient_deviation
            * temperature_offsets[:, None]
            * changes_per_kelvin[:, :1],
            identify_table.thermometer_deviation
            * has_known_temperature_offset[:, None]
            * changes_per_kelvin[:, :1],
            temperature_offsets[:, None] * changes_per_kelvin[:, 1:],
        ]
        self.temperature_error_frequency_changes = np.hstack(temperature_error_blocks)

    @property
    def frequency_changes(self) -> np.ndarray:
        """Return all relative changes of q predictions since the baseline: (q, 6 + 3 n).

        Each column is for a change by one standard deviation. First come 1 + n columns for an
        unknown temperature. 3 + n columns for the clamp follow, then 2 + n for errors of known
        temperatures. n is the number of modes.
        """
        return np.hstack(
            [
                self.unknown_temperature_frequency_changes,
                self.clamp_frequency_changes,
                self.temperature_error_frequency_changes,
            ]
        )

    def with_change_deviation_factors(
        self, clamp_factor: float, temperature_factor: float
    ) -> BaselineChanges:
        """Return a copy in which changes since the baseline are more or less likely.

        ``clamp_factor`` multiplies the prior standard deviation of the clamp's change.
        ``temperature_factor`` multiplies the prior standard deviation of an unknown temperature
        difference. The factor 0 excludes a change.
        """
        scaled_changes = copy(self)
        scaled_changes.clamp_frequency_changes = clamp_factor * self.clamp_frequency_changes
        scaled_changes.unknown_temperature_frequency_changes = (
            temperature_factor * self.unknown_temperature_frequency_changes
        )
        return scaled_changes


def _solve_plate_modes(scene: Scene) -> Modes:
    """Solve a scene's lowest modes on this rank, with any crack bonded."""
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    n_modes = min(N_NATURAL_MODES_PER_CRACK_STATE, structure.n_dofs - structure.n_pairs)
    return solve_modes(structure, n_modes, lips="tied" if structure.n_pairs else "open")


def _build_rigid_clamp_motions(modes: Modes) -> tuple[np.ndarray, int]:
    """Build rigid motions of the plate about the middle of its clamped nodes.

    Used to sum the reactions of the clamped nodes to forces and moments of the clamp.

    Returns
    -------
    motion_columns : (n, d)
        Displacements of n dofs in d rigid motions: translations, then rotations by 1 rad. A
        translation is as long as the clamp's radius of gyration. d = 0 if fewer than two nodes are
        clamped, or the nodes are unknown.
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
    rigid_motions_of_all_nodes = rigid_motion_displacements(
        structure_nodes.points - clamped_points.mean(axis=0)
    )
    motion_columns = np.zeros((modes.structure.n_local, len(rigid_motions_of_all_nodes)))
    dofs_of_all_nodes = structure_nodes.dofs.ravel()
    motion_columns[dofs_of_all_nodes[dofs_of_all_nodes >= 0]] = rigid_motions_of_all_nodes[
        :, dofs_of_all_nodes >= 0
    ].T
    n_translations = structure_nodes.points.shape[1]
    motion_columns[:, :n_translations] *= np.sqrt(np.sum(np.var(clamped_points, axis=0)))
    return motion_columns, n_translations


def _differentiate_harmonic_logs(
    features: Sequence[Feature],
    damping_ratio_of_points: np.ndarray,
    frequency_drop_root_and_frequencies: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives of ln(harmonic) by frequencies and damping of all modes.

    A harmonic is inversely proportional to its pole factors
    (:func:`find_frequency_ratios_and_pole_factors`). These factors alone are differentiated.

    Parameters
    ----------
    features : sequence of Feature
        f natural frequencies and harmonics; derivatives of natural frequencies are 0.
    damping_ratio_of_points : (m, 1)
        Damping ratios z at m values of the unknowns.
    frequency_drop_root_and_frequencies : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature.

    Returns
    -------
    frequency_slopes : (m, f, modes) complex
        Derivatives by ln w_j, with the natural frequency w_j of mode j.
    damping_slopes : (m, f, modes) complex
        Part of mode j in the derivative by ln z. The sum over all modes is the derivative.
    """
    harmonic_to_mode_ratios, pole_factors = find_frequency_ratios_and_pole_factors(
        features, damping_ratio_of_points, frequency_drop_root_and_frequencies
    )
    damping_slopes = (
        2j * damping_ratio_of_points[..., None] * harmonic_to_mode_ratios / pole_factors
    )
    return damping_slopes - 2.0 * harmonic_to_mode_ratios**2 / pole_factors, -damping_slopes


def compute_crack_geometry_deviations(
    x: np.ndarray, unknown_keys: Sequence[str], scene: Scene
) -> np.ndarray:
    """Return standard deviations of a real crack about its equivalent crack: (m, d).

    The equivalent crack is straight and sharp, and has the same effect on vibration.

    Parameters
    ----------
    x : (m, d)
        m points, each with values of the d unknowns.
    unknown_keys : sequence of str
        Keys of the d unknowns, such as "crack.length".
    scene : Scene
        Scene with the table ``[identify]``.

    Returns
    -------
    (m, d)
        Standard deviations of crack size and crack height, in the unit of each unknown; 0 for all
        remaining unknowns.
    """
    identify_table = scene.given("identify")
    crack_geometry_deviations = np.zeros_like(x)
    crack_extents = np.zeros(len(x))
    for size_key in CRACK_SIZE_KEYS:  # the last size given is the extent: depth, else length
        crack_sizes = np.full(
            len(x), getattr(scene.crack, size_key.removeprefix("crack."), None) or 0.0
        )
        if size_key in unknown_keys:
            crack_sizes = x[:, unknown_keys.index(size_key)]
            common_relative_deviation = identify_table.crack_deviation * np.sqrt(
                identify_table.crack_correlation
            )
            # Frequencies change with the square of the size: half the relative deviation.
            crack_geometry_deviations[:, unknown_keys.index(size_key)] = (
                common_relative_deviation / 2.0 * crack_sizes
            )
        crack_extents = np.where(crack_sizes > 0.0, crack_sizes, crack_extents)
    if "crack.height" in unknown_keys:
        tan_of_angle_deviation = np.tan(np.radians(identify_table.angle_deviation))
        crack_geometry_deviations[:, unknown_keys.index("crack.height")] = (
            tan_of_angle_deviation * crack_extents
        )
    return crack_geometry_deviations
