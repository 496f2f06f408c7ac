"""Share the jobs of a sweep among ranks; rank 0 writes the results.

Each rank has a present and a next job, so that no rank waits for rank 0. Rank 0 solves chunks, too,
and receives results between two cases.

Messages to a rank are jobs, which are short and so arrive while the rank computes, and a message
with the tag ``END``. After ``END`` a rank stops at the end of the present case. Messages from a
rank are the outcomes of chunks, and None after each job.
"""

from __future__ import annotations

import gc
import traceback
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import StopRequest, collect_garbage, wait_until
from fenics_crack.files.store import StoredFile
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import SINGLE_COMPUTATION_FAILURES
from fenics_crack.sweep.case import (
    FREQUENCIES_ONLY_STATUS,
    CaseValues,
    SharedCaseOptions,
    SweepGeometry,
    build_sweep_geometry,
    solve_chunk,
)
from fenics_crack.sweep.file import CaseState, SweepFile
from fenics_crack.sweep.plan import Chunk, Plan


class MessageTag(IntEnum):
    """Tags of messages from rank 0 to another rank.

    JOB: the message is a job to solve. END: the rank must stop.
    """

    JOB = 0
    END = 1


ChunkOutcome = list[CaseValues] | Exception
"""Values of each case in a chunk (up to 16 neighbouring cases), or the error that ends the
sweep."""


class Job(NamedTuple):
    """Work for one rank: chunks of cases with a shared structure.

    A chunk has up to 16 neighbouring cases.

    Attributes
    ----------
    geometry_number : int
        Shared structure's number in the sweep's :class:`Plan`.
    chunk_case_numbers : tuple of (n,) int
        Case numbers in each chunk.
    """

    geometry_number: int
    chunk_case_numbers: tuple[np.ndarray, ...]


class Worker:
    """Solver for one rank's jobs; it also builds the shared structures.

    Parameters
    ----------
    case_options : SharedCaseOptions
        Options that all cases share.
    plan : Plan
        Plan of the sweep.
    """

    def __init__(self, case_options: SharedCaseOptions, plan: Plan) -> None:
        self._case_options, self._plan = case_options, plan
        self._geometry_number = -1
        self._geometry_or_error: SweepGeometry | Exception | None = None
        """Shared structure for the last job, or the error from building it; None at first."""

    def release_geometry(self, *, is_stopped: bool) -> None:
        """Release the memory of the last job's structure.

        ``is_stopped`` is True if a user has stopped the sweep. PETSc errors are then ignored.
        """
        self._geometry_or_error = None
        gc.collect()  # structures and their rotations know each other
        collect_garbage(MPI.COMM_SELF, was_stopped=is_stopped)

    def iterate_chunk_outcomes(
        self, job: Job, may_continue: Callable[[], bool]
    ) -> Iterator[tuple[np.ndarray, ChunkOutcome]]:
        """Solve a job's chunks one after the other, and yield the outcome of each.

        A chunk has up to 16 neighbouring cases.

        Parameters
        ----------
        job : Job
            Chunks to solve.
        may_continue : callable
            Called before each chunk and each case; if it returns False, the job ends. An unexpected
            exception also ends the job.

        Yields
        ------
        case_numbers : (n,) int
            Case numbers, for the cases tried.
        outcome : list of dict, or Exception
            Values by column name for each case, or the error that ends the sweep.
        """
        chunks = list(map(self._plan.make_chunk, job.chunk_case_numbers))
        for chunk in chunks:
            if not may_continue():
                return
            try:
                self._build_geometry(job.geometry_number, chunks)
                yield self._solve_chunk(chunk, may_continue)
            except Exception:
                traceback_text = f"a job of the sweep ended with\n{traceback.format_exc()}"
                yield chunk.case_numbers, RuntimeError(traceback_text)
                return

    def _build_geometry(self, geometry_number: int, chunks: list[Chunk]) -> None:
        """Build the shared structure for a job's cases.

        The attribute ``_geometry_or_error`` gets the structure, or the error if it cannot be built.
        Nothing is built if the last job had the same structure, or if no case is a valid scene.

        Parameters
        ----------
        geometry_number : int
            Structure's number in the plan.
        chunks : list of Chunk
            Chunks of the job; the first valid scene gives the structure.
        """
        scene = next(
            (
                scene_or_reason
                for chunk in chunks
                for scene_or_reason in chunk.scenes_or_reasons
                if isinstance(scene_or_reason, Scene)
            ),
            None,
        )
        if scene is None or geometry_number == self._geometry_number:
            return
        last_geometry = (
            self._geometry_or_error
            if scene.speed and isinstance(self._geometry_or_error, SweepGeometry)
            else None
        )
        try:
            self._geometry_or_error = build_sweep_geometry(
                scene, MPI.COMM_SELF, self._case_options, last_geometry
            )
        except SINGLE_COMPUTATION_FAILURES as error:
            self._geometry_or_error = error
        self._geometry_number = geometry_number

    def _solve_chunk(
        self, chunk: Chunk, may_continue: Callable[[], bool]
    ) -> tuple[np.ndarray, ChunkOutcome]:
        """Solve a chunk with the present job's shared structure.

        Parameters
        ----------
        chunk : Chunk
            Cases to solve.
        may_continue : callable
            Called before each case; if it returns False, the chunk ends.

        Returns
        -------
        case_numbers : (n,) int
            Case numbers, for the cases tried.
        outcome : list of dict, or Exception
            Values by column name for each case. If the structure could not be built, each case has
            the error in the column ``status``. If the structure is too large, and the options end
            the sweep for this reason, the outcome is the error.
        """
        geometry_or_error = self._geometry_or_error
        if isinstance(geometry_or_error, SweepGeometry):
            result_values_of_chunk_cases = solve_chunk(
                geometry_or_error, chunk, self._case_options, may_continue
            )
            return chunk.case_numbers[
                : len(result_values_of_chunk_cases)
            ], result_values_of_chunk_cases
        is_structure_too_large = (
            isinstance(geometry_or_error, InputError)
            and geometry_or_error.key == "reduction.method"
        )
        if geometry_or_error is None or not (
            is_structure_too_large and self._case_options.stops_sweep_if_structure_too_large
        ):
            reasons = [
                scene_or_reason if isinstance(scene_or_reason, str) else str(geometry_or_error)
                for scene_or_reason in chunk.scenes_or_reasons
            ]
            return chunk.case_numbers, [{"status": reason} for reason in reasons]
        return chunk.case_numbers, geometry_or_error


def serve_jobs(worker: Worker, comm: MPI.Comm) -> None:
    """Solve the jobs that rank 0 sends, until a message with the tag END arrives.

    ``comm`` has all ranks of the sweep. Each chunk's outcome goes back to rank 0. A chunk has up to
    16 neighbouring cases.
    """
    send_requests_to_rank_0: list[MPI.Request] = []

    def may_continue() -> bool:
        """Return False if the message END has arrived, else True.

        Requests for messages that rank 0 has received completely are dropped.
        """
        send_requests_to_rank_0[:] = [
            send_request_to_rank_0
            for send_request_to_rank_0 in send_requests_to_rank_0
            if not send_request_to_rank_0.Test()
        ]
        return not comm.iprobe(source=0, tag=MessageTag.END)

    message_status = MPI.Status()
    while message_status.tag != MessageTag.END:
        job = _receive_message(comm, message_status)
        if message_status.tag == MessageTag.JOB:
            send_requests_to_rank_0 += [
                comm.isend(case_numbers_and_outcome, 0)
                for case_numbers_and_outcome in worker.iterate_chunk_outcomes(job, may_continue)
            ]
            send_requests_to_rank_0.append(comm.isend(None, 0))
    MPI.Request.waitall(send_requests_to_rank_0)


def _receive_message(comm: MPI.Comm, message_status: MPI.Status) -> Any:
    """Wait for the next message from any rank, and return its content.

    Between checks the process sleeps, as MPI's own wait would keep a processor busy.
    ``message_status`` is filled: it then has the sender and the tag.
    """
    wait_until(lambda: comm.iprobe(status=message_status))
    message_buffer = bytearray(message_status.Get_count(MPI.BYTE))
    receive_request = comm.irecv(message_buffer, message_status.source, message_status.tag)
    wait_until(receive_request.Get_status)
    return receive_request.wait()


class Manager:
    """Manager on rank 0: sends jobs to all ranks, and writes the results.

    Parameters
    ----------
    plan : Plan
        Plan of the sweep.
    sweep_file : SweepFile
        Open file; cases already in it are not solved again.
    n_ranks : int
        Number of ranks that solve cases, with rank 0.
    progress : bool
        Show a progress bar.
    """

    def __init__(self, plan: Plan, sweep_file: SweepFile, n_ranks: int, *, progress: bool) -> None:
        self._first_error: BaseException | None = None
        self.plan, self._sweep_file, self._n_ranks = plan, sweep_file, n_ranks
        chunk_case_numbers_by_geometry = {
            geometry_number: [
                case_numbers_of_chunk
                for case_numbers_of_chunk in case_numbers_of_chunks
                if np.any(sweep_file.case_states.flat[case_numbers_of_chunk] == CaseState.PENDING)
            ]
            for geometry_number, case_numbers_of_chunks in enumerate(
                plan.chunk_case_numbers_by_geometry
            )
        }
        # The longest jobs first: the last ones are what ranks wait for.
        ordered_geometry_numbers = sorted(
            chunk_case_numbers_by_geometry,
            key=plan.max_pair_counts_and_first_crack_lengths.__getitem__,
            reverse=True,
        )
        self._remaining_case_numbers_by_geometry = {
            geometry_number: chunk_case_numbers_by_geometry[geometry_number]
            for geometry_number in ordered_geometry_numbers
            if chunk_case_numbers_by_geometry[geometry_number]
        }
        self._geometry_number_by_rank: dict[int, int] = {}
        """Number of the shared structure in the present or next job, by rank."""
        self._n_jobs_at_other_ranks, self._n_recorded_chunks = 0, 0
        """Unfinished jobs at other ranks, and chunks written to the file."""
        self._n_failed_cases = int(np.count_nonzero(sweep_file.case_states == CaseState.FAILED))
        from tqdm import tqdm

        bar_options = {"desc": "sweep", "unit": "case", "disable": not progress}
        self._progress_bar = tqdm(
            total=sweep_file.case_states.size, initial=self._n_finished_cases, **bar_options
        )

    @property
    def _n_finished_cases(self) -> int:
        """Number of converged and failed cases in the file."""
        return int(np.count_nonzero(self._sweep_file.case_states != CaseState.PENDING))

    def progress_text(self) -> str:
        """Return the progress as text: "3 of 8 cases of the sweep"."""
        return f"{self._n_finished_cases} of {self._sweep_file.case_states.size} cases of the sweep"

    @property
    def sweep_header(self) -> StoredFile:
        """Header of the finished file, after :meth:`run`.

        If an error ended the sweep, it is raised here.
        """
        if self._first_error is not None:
            raise self._first_error
        return self._sweep_file.sweep_header

    def run(self, worker: Worker, comm: MPI.Comm, stop_request: StopRequest) -> None:
        """Distribute and solve all jobs, then close the file.

        The first error is kept and raised by :attr:`sweep_header`. After an error, a new file
        without results is removed.

        Parameters
        ----------
        worker : Worker
            Solver on rank 0.
        comm : MPI.Comm
            All ranks of the sweep.
        stop_request : StopRequest
            Request to stop by Ctrl-C.
        """
        other_ranks = range(1, comm.size)

        def may_continue() -> bool:
            """Receive messages that have arrived; return False after an error or Ctrl-C."""
            while self._n_jobs_at_other_ranks and comm.iprobe():
                if stop_request.is_requested(MPI.COMM_SELF):
                    self._remaining_case_numbers_by_geometry.clear()  # no further job
                self._receive_outcome(comm)
            return self._first_error is None and not stop_request.is_requested(MPI.COMM_SELF)

        try:
            for receiving_rank in other_ranks:
                self._send_job(comm, receiving_rank)
            job = self._take_next_job(0)
            for receiving_rank in other_ranks:  # a second job, to go on with
                self._send_job(comm, receiving_rank)
            while job is not None and may_continue():
                for case_numbers, outcome in worker.iterate_chunk_outcomes(job, may_continue):
                    self._record_outcome(case_numbers, outcome)
                job = self._take_next_job(0)
            while may_continue() and self._n_jobs_at_other_ranks:
                self._receive_outcome(comm)
        except BaseException as error:
            is_second_interrupt = isinstance(
                error, KeyboardInterrupt
            ) and stop_request.is_requested(MPI.COMM_SELF)
            if not is_second_interrupt:  # else what is written is all
                self._keep_error_and_discard_jobs(error)
        self._remaining_case_numbers_by_geometry.clear()
        for receiving_rank in other_ranks:
            comm.send(None, receiving_rank, tag=MessageTag.END)
        while self._n_jobs_at_other_ranks:
            self._receive_outcome(comm)
        self._progress_bar.close()
        is_useless_file = (
            self._sweep_file.is_new
            and self._n_recorded_chunks == 0
            and self._first_error is not None
        )
        try:
            self._sweep_file.close(remove=is_useless_file)
        except InputError as error:
            self._keep_error_and_discard_jobs(error)

    def _send_job(self, comm: MPI.Comm, rank: int) -> None:
        """Send a job to a rank if one remains."""
        job = self._take_next_job(rank)
        if job is not None:
            comm.send(job, rank, tag=MessageTag.JOB)
            self._n_jobs_at_other_ranks += 1

    def _receive_outcome(self, comm: MPI.Comm) -> None:
        """Receive a message from another rank, and act on it.

        A message with a chunk's outcome is written to the file. A message after a finished job
        sends the next job to that rank.
        """
        message_status = MPI.Status()
        case_numbers_and_outcome = _receive_message(comm, message_status)
        if case_numbers_and_outcome is not None:
            self._record_outcome(*case_numbers_and_outcome)
            return
        self._n_jobs_at_other_ranks -= 1
        self._send_job(comm, message_status.source)

    def _take_next_job(self, rank: int) -> Job | None:
        """Choose the next job for a rank; None if no cases remain.

        The cases with the same structure (mesh and modes) are divided into chunks, with up to 16
        neighbouring cases each. A job has one or more chunks with the same structure.

        A rank first goes on with the structure of its last job. If no chunk of this structure
        remains, the rank gets a structure that no rank works on. If ranks work on all structures,
        the rank gets the structure with most chunks left.

        A job takes all remaining chunks of its structure in two cases: there is only one rank, or
        there are more structures without a rank than ranks. Otherwise the job takes fewer: the
        remaining chunks divided by twice the number of ranks, rounded up. The ranks then finish
        together.
        """
        if not self._remaining_case_numbers_by_geometry:
            return None
        unassigned_geometry_numbers = [
            geometry_number
            for geometry_number in self._remaining_case_numbers_by_geometry
            if geometry_number not in self._geometry_number_by_rank.values()
        ]
        geometry_number = self._geometry_number_by_rank.get(rank, -1)
        if geometry_number not in self._remaining_case_numbers_by_geometry:
            geometry_number = max(
                unassigned_geometry_numbers[:1] or self._remaining_case_numbers_by_geometry,
                key=lambda number: len(self._remaining_case_numbers_by_geometry[number]),
            )
        self._geometry_number_by_rank[rank] = geometry_number
        case_numbers_of_chunks = self._remaining_case_numbers_by_geometry[geometry_number]
        is_whole_geometry = self._n_ranks == 1 or len(unassigned_geometry_numbers) > self._n_ranks
        n_job_chunks = (
            len(case_numbers_of_chunks)
            if is_whole_geometry
            else -(-len(case_numbers_of_chunks) // (2 * self._n_ranks))
        )
        self._remaining_case_numbers_by_geometry[geometry_number] = case_numbers_of_chunks[
            n_job_chunks:
        ]
        if not self._remaining_case_numbers_by_geometry[geometry_number]:
            del self._remaining_case_numbers_by_geometry[geometry_number]
        return Job(geometry_number, tuple(case_numbers_of_chunks[:n_job_chunks]))

    def _record_outcome(self, case_numbers: np.ndarray, outcome: ChunkOutcome) -> None:
        """Write the outcome of a chunk (up to 16 neighbouring cases) to the file.

        If the outcome is an error, or writing fails, the error is kept and ends the sweep.
        """
        if isinstance(outcome, Exception):
            self._keep_error_and_discard_jobs(outcome)
            return
        try:
            self._sweep_file.write_cases_unless_already_stored(case_numbers, outcome)
        except InputError as error:
            self._keep_error_and_discard_jobs(error)
            return
        self._n_recorded_chunks += 1
        values_without_solution = (
            value_by_column for value_by_column in outcome if "gap" not in value_by_column
        )
        self._n_failed_cases += sum(
            value_by_column["status"] != FREQUENCIES_ONLY_STATUS
            for value_by_column in values_without_solution
        )
        if self._n_failed_cases:
            self._progress_bar.set_postfix_str(f"{self._n_failed_cases} failed", refresh=False)
        self._progress_bar.update(len(outcome))

    def _keep_error_and_discard_jobs(self, error: BaseException) -> None:
        """Keep the first error, and drop all jobs not yet sent."""
        self._first_error = self._first_error or error
        self._remaining_case_numbers_by_geometry.clear()
