"""Results of commands, read from their files with scene, structure and law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors.verification import read_verification_or_none
from fenics_crack.files.results import Result, result_class, unpack_result
from fenics_crack.files.store import StoredFile, read_result_file
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.runs.curve import iterate_curve_studies_with_more_modes
from fenics_crack.runs.run import Run
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.time.march import TimeHistory


def load_run(path: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[Result]:
    """Read a command's result file, with scene, structure and contact law (collective).

    The structure is built again from the scene in the file; the result is only read. Mesh and
    matrix files named by the scene must be unchanged (compared by SHA-256). For a structure that
    exists already, use :func:`fenics_crack.load`; for a sweep ``SweepResult.load``.

    Parameters
    ----------
    path : path
        Result file.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, contact law and result.

    Raises
    ------
    InputError
        The file is damaged, of an older version, a sweep, no result, or without a scene. Or a file
        named by the scene has changed.

    Examples
    --------
    >>> fc.solve(scene).save("solution.h5")
    >>> run = fc.load_run("solution.h5")
    """
    return make_run_from_file(read_result_file(path, comm), comm)


def make_run_from_file(
    result_file: StoredFile, comm: MPI.Comm = MPI.COMM_WORLD, *, with_reference: bool = True
) -> Run[Result]:
    """Build scene, structure and law for the result in an open file (collective).

    Raises as :func:`load_run`.

    Parameters
    ----------
    result_file : StoredFile
        Open file with the result.
    comm : MPI.Comm
        Ranks that share the structure.
    with_reference : bool
        Also build a reference structure with more modes, for the reduction error.
    """
    result_type, scene = result_class(result_file), result_file.scene()
    if scene is None:
        raise InputError(
            "path",
            str(result_file.path),
            f"a {result_type.KIND} saved with its scene, as Run.save does",
        )
    on_root(comm, lambda: result_file.check_files(scene))
    if issubclass(result_type, ResponseCurve) and scene.curve is not None:
        study = next(iterate_curve_studies_with_more_modes(scene, comm))
    else:
        study = prepare(scene, comm, whole=result_type is Modes, judged=with_reference)
    if result_type is TimeHistory and scene.integration is not None and scene.integration.free:
        study = study_under_mean_load_alone(study)
    try:
        result = unpack_result(result_file, study.structure, study.contact)
    except InputError as error:
        if error.key == "path":
            raise
        requirement_text = (
            f"a result that fits this version: {error.key} must be {error.allowed}; "
            "compute it again"
        )
        raise InputError("path", str(result_file.path), requirement_text) from None
    law = getattr(result, "contact", None)
    if friction_of(law) is not None:
        study = replace(study, contact=law)  # along the lines of the file
    return Run(**vars(study), result=result, stated=read_verification_or_none(result_file))


def make_run_on_this_rank(result_file: StoredFile) -> Run[Result]:
    """Build scene, structure and law for an open result file.

    The structure lies on this rank alone (MPI.COMM_SELF). A periodic solution gets no reference
    structure for the reduction error, because the file has the stated errors.
    """
    return make_run_from_file(
        result_file, MPI.COMM_SELF, with_reference=result_file.kind != PeriodicSolution.KIND
    )


def study_under_mean_load_alone(study: Study) -> Study:
    """Return a study under the load's mean alone.

    A free decay is integrated under this constant load.
    """
    structure = structure_under_static_load(study.structure, 0.0).watching(study.watched[0].dof)
    return replace(study, structure=structure)


def structure_under_static_load(structure: Structure, first_harmonic_fraction: float) -> Structure:
    """Return a structure under the constant load f_0 + c (a_1 + b_1).

    Parameters
    ----------
    structure : Structure
        Structure with a periodic load: mean f_0, cosine part a_1 and sine part b_1 of the first
        harmonic.
    first_harmonic_fraction : float
        Factor c. With 0, only the mean load is left.
    """
    load_weight_matrix = np.zeros((len(structure.force),) * 2)
    load_weight_matrix[0, :3] = 1.0, first_harmonic_fraction, first_harmonic_fraction
    return structure.varied(load=load_weight_matrix)
