"""The program ``fenics-crack``: arguments, exit codes and printed errors."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import gc
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from itertools import dropwhile
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from fenics_crack.basics import machine
from fenics_crack.basics.errors import ConvergenceError, Exit, InputError, StoppedError, WriteError
from fenics_crack.basics.progress import NoteAndWarningLogHandler
from fenics_crack.basics.suggestions import (
    did_you_mean_text,
    find_calls_by_synonyms,
    find_similar_names,
)
from fenics_crack.version import VERSION

if TYPE_CHECKING:
    from fenics_crack.cli.given import CommandInputs, Console

PETSC_OPTION_PREFIXES = tuple(
    f"-crack_{name}_" for name in ("hb", "krylov", "modes", "largest", "factor")
)
"""Prefixes of PETSc options read by solvers.

In this order: SNES of harmonic balance, GMRES, SLEPc for lowest modes, SLEPc for the largest
frequency, factorisations.
"""
MODES_OPTION_PREFIXES = PETSC_OPTION_PREFIXES[2:]
"""Prefixes of options for what a kept structure holds: with them, none is read or kept."""
LIBRARY_ARGUMENT_NAMES_BY_SCENE_TABLE = {
    "curve": ("parameter", "start"),
    "disk": ("families",),
    "excitation": ("omega",),
    "harmonic_balance": ("form", "harmonics", "samples", "tolerance"),
    "integration": ("steps_per_period",),
    "reduction": ("method", "modes"),
    "tip_timing": ("clock", "noise", "probes", "revolutions", "tip_radius"),
}
LIBRARY_DAMPING_ARGUMENT_NAMES = ("mass", "modes", "omegas", "ratio", "ratios", "stiffness")
SCENE_KEY_OR_OPTION_BY_ARGUMENT = {
    **{
        name: f"{table}.{name}"
        for table, names in LIBRARY_ARGUMENT_NAMES_BY_SCENE_TABLE.items()
        for name in names
    },
    **{f"damping {name}": f"damping.{name}" for name in LIBRARY_DAMPING_ARGUMENT_NAMES},
    **dict.fromkeys(("low", "high", "high - low"), "tip_timing.frequencies"),
    "contact law": "contact.law",
    "contact stiffness": "contact.stiffness",
    "count": "--count",
    "end": "curve.stop",
    "more": "disk.modes",
    "record_periods": "integration.periods",
    "start, end": "curve.start, curve.stop",
}
"""Scene key or command-line option to print, by the argument name in an error of the library."""
MAX_ENGINE_ORDER_IN_OPTION = 1000
"""Maximum engine order in the option ``--orders``."""
HELP_EPILOG_TEXT = """\
Start with:

  fenics-crack new plate.toml       a scene with every key explained
  fenics-crack check plate.toml     is it right, and how large?
  fenics-crack solve plate.toml     its steady vibration
  fenics-crack plot output/plate/solution.h5
  fenics-crack report output/plate/*.h5       all of it in one HTML page

Any key can be changed for one run: --set harmonic_balance.harmonics=30 --set crack.length=0.03
On several processors: mpirun -n 4 fenics-crack sweep plate.toml
PETSc's options come last: fenics-crack solve plate.toml -crack_hb_snes_monitor

Exit code: 0 done; 2 bad input; 3 something did not converge, or Ctrl-C has ended it early (what was
found, if anything, is in the files); 4 solved, but the error is above the tolerance or unknown; 130
stopped by Ctrl-C; 1 a full disk, too little memory, or a fault of the program.
"""
"""Text below the program's help."""


def main(command_words: Sequence[str] | None = None) -> int:
    """Run a command of the program and return the exit code, equal on all ranks.

    Errors are printed, not raised. SystemExit is raised only for --help, and for words refused by
    the parser. ``command_words`` are the words after the program's name. None: the words of the
    command line.
    """
    gc.set_threshold(10_000)  # each search visits over 100,000 lasting objects: search less often
    atexit.register(gc.freeze)  # no search at exit: the system frees all memory
    machine.choose_single_openblas_thread()
    if any(
        os.environ.get(mpirun_variable_name, "0") != "0"
        for mpirun_variable_name in machine.MPIRUN_ENVIRONMENT_VARIABLES
    ):
        _discard_output_of_this_rank()
    if sys.stdout is None:
        _print_to_stderr(
            "standard output is closed; open it, or redirect it to a file: > table.txt"
        )
        return Exit.PROGRAM_OR_DISK_FAULT
    try:
        arguments = _parse_arguments(command_words)
        return _run_command(arguments)
    except InputError as error:
        if error.__cause__ is not None and arguments.verbose:
            traceback.print_exception(error.__cause__)
        _print_input_errors((error, *error.others))
        return Exit.PROGRAM_OR_DISK_FAULT if isinstance(error, WriteError) else Exit.BAD_INPUT
    except ConvergenceError as error:
        _print_to_stderr(
            str(error) if isinstance(error, StoppedError) else f"did not converge: {error}"
        )
        return Exit.NOT_CONVERGED
    except KeyboardInterrupt:
        # Print no errors of libraries that were stopped in the middle of a step. The hook
        # registered last is called first.
        atexit.register(setattr, sys, "unraisablehook", lambda _: None)
        _print_to_stderr("stopped")
        _abort_all_ranks(Exit.STOPPED_BY_CTRL_C)
        return Exit.STOPPED_BY_CTRL_C
    except BrokenPipeError:  # the reader of our output has gone
        _redirect_stdout_to_null()
        return Exit.PIPE_READER_GONE
    except Exception as error:
        if "FromOptions()" in (error_message := str(error).rstrip()):  # a value unknown to PETSc
            petsc_option_requirement_text = (
                f"options with values that PETSc accepts ({error_message.rpartition('[0] ')[2]})"
            )
            _print_input_errors(
                [
                    InputError(
                        "PETSc options", " ".join(_petsc_arguments()), petsc_option_requirement_text
                    )
                ]
            )
            return Exit.BAD_INPUT
        if shortage_text := machine.describe_resource_shortage(error):
            _print_to_stderr(shortage_text, sys.__stderr__)
            _redirect_stdout_to_null()
        else:
            traceback.print_exc(file=sys.__stderr__)
        _abort_all_ranks(Exit.PROGRAM_OR_DISK_FAULT)
        return Exit.PROGRAM_OR_DISK_FAULT


def _abort_all_ranks(exit_code: Exit) -> None:
    """End all MPI ranks with an exit code; do nothing for a single rank."""
    if machine.is_started_by_mpirun():
        from mpi4py import MPI

        if MPI.COMM_WORLD.size > 1:
            MPI.COMM_WORLD.Abort(exit_code)


def _parse_arguments(command_words: Sequence[str] | None) -> argparse.Namespace:
    """Parse the program's arguments, without PETSc's options behind them.

    ``command_words`` None stands for the words of the command line. Raises SystemExit after --help,
    and for words refused by the parser.
    """
    try:
        arguments = build_parser().parse_args(
            _arguments_before_petsc() if command_words is None else command_words
        )
    except SystemExit:
        sys.stdout.flush()
        if machine.is_started_by_mpirun():
            from mpi4py import MPI

            MPI.COMM_WORLD.Barrier()  # a rank that fails earlier would silence the one that prints
        raise
    arguments.words = [*(sys.argv[1:] if command_words is None else command_words)]
    return arguments


def _arguments_before_petsc() -> list[str]:
    """Return the words of the command line before the first PETSc option, ``-crack_...``.

    PETSc reads all words from this option on. Raises InputError for a PETSc option with a prefix
    not in :data:`PETSC_OPTION_PREFIXES`.
    """
    for argument in (petsc_arguments := _petsc_arguments()):
        if argument.startswith("-crack_") and not argument.startswith(PETSC_OPTION_PREFIXES):
            raise InputError(
                "PETSc option",
                argument,
                f"an option that begins with {' or '.join(PETSC_OPTION_PREFIXES)}",
            )
    return sys.argv[1 : len(sys.argv) - len(petsc_arguments)]


def _petsc_arguments() -> list[str]:
    """Return the words of the command line from the first PETSc option, ``-crack_...``, on."""
    return [*dropwhile(lambda argument: not argument.startswith("-crack_"), sys.argv[1:])]


def _discard_output_of_this_rank() -> None:
    """Discard all text printed by this MPI rank; tracebacks still reach ``sys.__stderr__``."""
    sys.stdout = sys.stderr = open(os.devnull, "w")


def _print_to_stderr(text: str, stream: TextIO | None = None) -> None:
    """Print a message after "fenics-crack: ", by default to standard error.

    A closed stream is ignored.
    """
    with contextlib.suppress(OSError):
        print(f"fenics-crack: {text}", file=stream or sys.stderr or sys.__stderr__, flush=True)


def _print_input_errors(input_errors: Sequence[InputError]) -> None:
    """Print a line for each input error, and examples for missing keys and tables.

    An error about a missing key ends with an example line for this key. Examples for missing tables
    are printed after all errors.
    """
    example_blocks = []
    for input_error in input_errors:
        scene_key, example_text = (
            SCENE_KEY_OR_OPTION_BY_ARGUMENT.get(input_error.key, input_error.key),
            "",
        )
        if input_error.value is None:
            from fenics_crack.cli.given import find_example_line, find_example_table_text

            example_assignment = (
                ""
                if scene_key in input_error.allowed
                else find_example_line(scene_key, input_error.allowed)
            )
            example_text = f"; for example {example_assignment}" if example_assignment else ""
            example_blocks.append(
                find_example_table_text(scene_key)
                if input_error.example is None
                else input_error.example
            )
        _print_to_stderr(
            f"{type(input_error)(scene_key, input_error.value, input_error.allowed)}{example_text}"
        )
    if all_examples_text := "\n\n".join(filter(None, example_blocks)):
        print(f"for example:\n\n{all_examples_text}", file=sys.stderr)


def _redirect_stdout_to_null() -> None:
    """Redirect standard output to the null device: Python then writes nothing at exit."""
    with contextlib.suppress(OSError):  # it may be no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run_command(arguments: argparse.Namespace) -> Exit:
    """Read a command's inputs, load MPI and PETSc, and call the command.

    Inputs are read before MPI and PETSc are loaded, to refuse wrong input at once. Under mpirun,
    rank 0 reads for all ranks.
    """
    if arguments.command == "doctor":  # checks itself which libraries are there
        return _call_command(arguments, None, None) or Exit.DONE
    machine.check_debian_module_versions()
    from fenics_crack.cli.given import (
        KEPT_STRUCTURE_FILE_NAME,
        Console,
        read_inputs,
        read_prepared_inputs,
    )

    is_under_mpirun = machine.is_started_by_mpirun()
    is_prepared_file = "scene" in arguments and arguments.scene.suffix.lower() == ".h5"
    inputs = None if is_under_mpirun or is_prepared_file else read_inputs(arguments)
    may_need_mesh = is_under_mpirun or not ("scene" in arguments and inputs is None)
    can_use_kept_structure = (
        inputs
        and not vars(arguments).get("fresh", True)
        and (inputs.results_folder / KEPT_STRUCTURE_FILE_NAME).exists()
    )
    needs_mesh = (
        arguments.command not in ("new", "clean")
        and not (is_prepared_file or can_use_kept_structure)
        and may_need_mesh
    )
    if needs_mesh and not (inputs and inputs.scene.structure):
        from fenics_crack.basics import gmsh_process as mesher  # noqa: F401  before MPI: see there
    with machine.set_one_process_mpi_variables():
        from fenics_crack.basics.ranks import (  # starts MPI
            MPI,
            STOP_SIGNALS,
            list_unread_options,
            on_root,
        )
    comm = MPI.COMM_WORLD
    if comm.rank > 0:
        _discard_output_of_this_rank()
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # else PETSc ends the program if a reader leaves
    for stop_signal_number in STOP_SIGNALS:
        signal.signal(stop_signal_number, signal.default_int_handler)
    with machine.run_single_threaded(), NoteAndWarningLogHandler(quiet=arguments.quiet):
        if is_prepared_file:
            inputs = read_prepared_inputs(arguments, comm)
        elif is_under_mpirun:
            inputs = on_root(comm, lambda: read_inputs(arguments))
        picture_format = vars(arguments).get("pictures", "png")
        console = Console(
            comm, arguments.format, arguments.quiet, arguments.verbose, picture_format
        )
        exit_code = _call_command(arguments, inputs, console) or Exit.DONE
        console.print_warnings(
            *map(
                "PETSc option {} had no effect: no solver has read it; check its name".format,
                list_unread_options(),
            )
        )
        return exit_code


def _call_command(
    arguments: argparse.Namespace, inputs: CommandInputs | None, console: Console | None
) -> Exit | None:
    """Prepare the results folder and the stored structure, and call a command.

    The stored structure is a meshed and reduced structure, left in the folder by an earlier
    command. The command may read it unless the option ``--fresh`` is set.

    Parameters
    ----------
    arguments : argparse.Namespace
        Arguments of the command.
    inputs : CommandInputs or None
        Scene and further inputs; None for a command without a scene.
    console : Console or None
        Output of the command.

    Returns
    -------
    Exit or None
        Exit code; None for success, code 0.
    """
    function_path, *_ = HELP_AND_CALL_BY_COMMAND[arguments.command][1].split()
    command_function: Callable[..., Exit | None] = resolve_name(f"fenics_crack.{function_path}")
    if not function_path.startswith("cli."):
        from fenics_crack.cli.commands import run_and_report_function

        command_function = partial(run_and_report_function, command_function)
    if inputs is None or ("output" not in arguments and arguments.command != "check"):
        return command_function(arguments, inputs, console)
    from fenics_crack.basics.atomic_files import remove_hidden_files
    from fenics_crack.basics.ranks import on_root
    from fenics_crack.cli.given import KEPT_STRUCTURE_FILE_NAME, make_writable_folder
    from fenics_crack.study.plausibility import remarks_on_scene
    from fenics_crack.study.sharing import CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST

    assert console is not None
    if arguments.command not in ("check", "clean"):
        make_writable_folder(inputs.results_folder, console.comm)
    if (is_fresh_option_set := vars(arguments).get("fresh")) is not None and not (
        inputs.prepared_study or any(word.startswith(MODES_OPTION_PREFIXES) for word in sys.argv)
    ):
        from fenics_crack.study.shelf import StructureFile

        kept_structure_path = inputs.results_folder / KEPT_STRUCTURE_FILE_NAME
        on_root(console.comm, partial(remove_hidden_files, kept_structure_path))
        can_read_structure = on_root(
            console.comm,
            lambda: kept_structure_path.is_file() and not kept_structure_path.is_symlink(),
        )
        CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST[:] = [
            StructureFile(
                kept_structure_path,
                console.print_notes,
                is_read=can_read_structure and not is_fresh_option_set,
            )
        ]
    if arguments.command != "clean":  # before the mesh, which may take minutes
        console.print_remarks(*remarks_on_scene(inputs.scene))
    try:
        return command_function(arguments, inputs, console)
    finally:
        CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST.clear()


# --- arguments ------------------------------------------------------------------------------------


class OrderRangeAction(argparse.Action):
    """Parse ``--orders FIRST LAST`` into the scene key ``tip_timing.orders``.

    The key gets all whole numbers from FIRST to LAST.
    """

    def __call__(
        self, _: Any, arguments: argparse.Namespace, order_range: Any, option_string: Any = None
    ) -> None:
        """Append the engine orders FIRST to LAST to the assignments of ``--set``.

        argparse calls this with ``order_range``, the two numbers. Raises InputError unless 1 <=
        FIRST <= LAST <= :data:`MAX_ENGINE_ORDER_IN_OPTION`.
        """
        first_order, last_order = order_range
        if not 1 <= first_order <= last_order <= MAX_ENGINE_ORDER_IN_OPTION:
            raise InputError(
                "--orders",
                order_range,
                f"two whole numbers with 1 <= FIRST <= LAST <= {MAX_ENGINE_ORDER_IN_OPTION}",
            )
        engine_orders = [*range(first_order, last_order + 1)]
        arguments.set = [*arguments.set, f"tip_timing.orders={engine_orders}"]


def path(text: str) -> Path:
    """Convert an argument to a path; argparse prints this function's name in errors.

    Raises ValueError for a null character, and for characters without a UTF-8 encoding.
    """
    if b"\0" in text.encode("utf-8"):
        raise ValueError
    return Path(text)


COMMON_ARGUMENT_NAMES = "scene --set --output"
HELP_AND_CALL_BY_COMMAND = {
    "new": (
        "write a commented scene to start from",
        "cli.given:write_new_scene file --blade --timing --identify --solid --disk --cad",
    ),
    "check": (
        "check a scene without solving it: mesh, natural frequencies, resonance, memory",
        "cli.scenes:compute_and_print_key_figures scene --set --fresh",
    ),
    "modes": (
        "natural frequencies and mode shapes, crack open",
        f"runs.solve:modes {COMMON_ARGUMENT_NAMES} --count",
    ),
    "campbell": (
        "natural frequencies over the speed of [rotation], crack open and bonded, and a picture",
        f"study.campbell:campbell {COMMON_ARGUMENT_NAMES} --count --speeds --pictures",
    ),
    "disk": (
        "natural frequencies of a bladed disk over the nodal diameter, and how much random "
        "mistuning amplifies the response of a blade, with pictures",
        f"cli.commands:compute_and_report_bladed_disk {COMMON_ARGUMENT_NAMES} --patterns "
        "--deviation --pictures",
    ),
    "reduce": (
        "write the meshed and reduced structure to a file, with which solve and curve need no mesh",
        "cli.commands:write_prepared_study scene --set --output=FILE.h5",
    ),
    "solve": (
        "steady vibration at excitation.omega",
        f"runs.solve:solve {COMMON_ARGUMENT_NAMES} --fresh",
    ),
    "verify": (
        "contributions of mesh, modes, harmonics and samples to the error of solve: observed "
        "orders, extrapolated values, grid-convergence indices, and a picture",
        f"errors.verify:verify {COMMON_ARGUMENT_NAMES} --fresh --pictures",
    ),
    "curve": (
        "response curve of the table [curve]",
        f"runs.curve:curve {COMMON_ARGUMENT_NAMES} --fresh",
    ),
    "integrate": (
        "motion in time by the table [integration]",
        f"runs.integrate:integrate {COMMON_ARGUMENT_NAMES}",
    ),
    "sweep": (
        "all cases of the table [sweep.over]; continues where it stopped",
        f"cli.commands:run_and_report_sweep {COMMON_ARGUMENT_NAMES} --fresh",
    ),
    "grow": (
        "growth of the crack under the vibration by the table [growth]: length, life, frequencies; "
        "continues where it stopped",
        f"fatigue.growth:grow {COMMON_ARGUMENT_NAMES} --pictures",
    ),
    "timing": (
        "arrival times of the blade tip at the probes of [tip_timing], and the vibration fitted to "
        "them",
        "cli.timing:fit_and_report_timing scene arrivals --blade=N --orders --set --output "
        "--pictures",
    ),
    "identify": (
        "a crack from measured frequencies, harmonics and arrival times, by the table [identify]",
        "cli.commands:identify_and_report_crack scene measurements --arrivals --before --blade=N "
        "--modes --set --output --pictures",
    ),
    "plot": (
        "pictures of a result, of all in a folder, of several curves in one, or of a scene's mesh; "
        "files for ParaView",
        "cli.report:plot_results results --label --output --pictures",
    ),
    "report": (
        "one HTML page with tables and pictures of some results, or of all in a folder",
        "cli.report:write_report_page results --output=FILE",
    ),
    "clean": (
        "remove the structure that earlier commands have kept in the folder for the results",
        f"cli.commands:remove_kept_structure {COMMON_ARGUMENT_NAMES}",
    ),
    "doctor": (
        "versions of the installed libraries, and checks against known numbers",
        "cli.doctor:run_and_print_checks",
    ),
}
"""Help text, and "folder.file:function" followed by command-line arguments, by command name.

A function of ``cli`` takes arguments, inputs and console. Any other function takes a scene, and
arguments by the names of parameters.
"""
HELP_AND_OPTIONS_BY_ARGUMENT: dict[str, tuple[str, dict[str, Any]]] = {
    "file": ("the file to write, for example plate.toml", {"type": path, "metavar": "scene"}),
    "--blade": (
        "scene of a plate on a rotor, with engine order and centrifugal load",
        {"action": "store_true"},
    ),
    "--timing": ("scene of a plate on a rotor, whose tip passes probes", {"action": "store_true"}),
    "--identify": (
        "scene of a plate with an unknown crack, and a CSV file of measurements",
        {"action": "store_true"},
    ),
    "--solid": ("scene of a blade in three dimensions", {"action": "store_true"}),
    "--disk": ("scene of a bladed disk with one cracked blade", {"action": "store_true"}),
    "--cad": (
        "scene of a part from a CAD file, .step, .stp or .brep, with a picture of its faces",
        {"type": path, "metavar": "PART"},
    ),
    "--patterns": (
        "number of random patterns of mistuning, without contact (default: 0)",
        {"type": int, "default": 0, "metavar": "COUNT"},
    ),
    "--deviation": (
        "standard deviation of each sector's stiffness in these patterns (default: 0.01)",
        {"type": float, "default": 0.01},
    ),
    "scene": (
        "the scene, a TOML file; solve and curve also take a file of reduce (.h5), timing also "
        "measured arrivals (.csv)",
        {"type": path},
    ),
    "measurements": (
        "a CSV file with the columns quantity, value, deviation, mode, frequency [Hz], point, "
        "phase [rad], rpm, temperature; or frequency responses (.uff, .unv: dataset 58), whose "
        "peaks are modes 1, 2, ... or --modes; or both; may be left out with --arrivals",
        {"type": path, "nargs": "*"},
    ),
    "--before": (
        "frequency responses of the same structure before it had a crack (.uff, .unv), or the "
        "arrivals of a run-up of it, as for --arrivals",
        {"type": path, "metavar": "FILE"},
    ),
    "--modes": (
        "numbers of the modes that frequency responses show, from the lowest frequency up",
        {"type": int, "nargs": "+", "default": (), "metavar": "N"},
    ),
    "--arrivals": (
        "arrivals at probes, at constant speed or in a run-up through resonances: a CSV file "
        "(docs/tip_timing.md) or the .h5 file of a solution or a curve; [tip_timing] describes the "
        "probes",
        {"type": path, "metavar": "FILE"},
    ),
    "--blade=N": (
        "number of the blade to be used, of a file with the arrivals of several blades",
        {"type": int, "metavar": "N"},
    ),
    "--orders": (
        "engine orders to be tried, from FIRST to LAST, in place of tip_timing.orders (default: "
        "the load's order, or 1 to 24 if it is unknown)",
        {"type": int, "nargs": 2, "metavar": ("FIRST", "LAST"), "action": OrderRangeAction},
    ),
    "arrivals": (
        "source of the arrivals: the .h5 file of a solution or a curve; or a CSV file of arrivals, "
        "measured or computed (default: the scene is solved)",
        {"type": path, "nargs": "?", "metavar": "source"},
    ),
    "results": (
        "a .h5 file that another command has written, a folder of them, several curves to be drawn "
        "in one picture, or a scene",
        {"type": path, "nargs": "+", "metavar": "result"},
    ),
    "--label": (
        "label of a curve among several in one picture, once for each curve (default: what differs "
        "between their scenes)",
        {"action": "append", "default": [], "metavar": "TEXT"},
    ),
    "--set": (
        "change a key of the scene, for example crack.length=0.03; may be repeated",
        {"action": "append", "default": [], "metavar": "KEY=VALUE"},
    ),
    "--output": (
        "folder for the results (default: output/NAME for NAME.toml; plot: folder of the result)",
        {"type": path, "metavar": "FOLDER"},
    ),
    "--fresh": (
        "compute the structure again, and do not read prepared.h5 of an earlier command",
        {"action": "store_true"},
    ),
    "--count": ("number of modes (default: 6, or all if there are fewer)", {"type": int}),
    "--speeds": (
        "first and last speed, and number of speeds, in rpm if the scene gives rpm, else in "
        "rad/s (default: 13 speeds from 0 to 1.5 times the scene's)",
        {"type": float, "nargs": 3, "metavar": ("START", "STOP", "COUNT")},
    ),
    "--output=FILE": (
        "the .html file (default: report.html in the folder of the first result)",
        {"type": path, "metavar": "FILE.html"},
    ),
    "--output=FILE.h5": (
        "the .h5 file (default: output/NAME/NAME.h5 for NAME.toml)",
        {"type": path, "metavar": "FILE.h5"},
    ),
    "--pictures": (
        "kind of the pictures; pdf and svg are vector graphics, for papers (default: png)",
        {"choices": ("png", "pdf", "svg"), "default": "png"},
    ),
    "--format": (
        "format of the printed table",
        {"choices": ("text", "csv", "json"), "default": "text"},
    ),
}


KEY_COMPLETION_FUNCTION_BY_SHELL = {
    "bash": "_fenics_crack_keys", "zsh": "_fenics_crack_keys", "fish": "(_fenics_crack_keys)",
}  # fmt: skip
"""Completion of ``--set`` for shtab, by shell: the name of a shell function.

:data:`KEY_COMPLETION_CODE_BY_SHELL` defines the function.
"""
PATH_COMPLETION_FUNCTION_BY_SHELL = {
    "bash": "_shtab_compgen_files", "zsh": "_files",
    "fish": "(__fish_complete_path (commandline -ct))",
}  # fmt: skip
"""Shell function for shtab to complete paths, by shell."""
KEY_COMPLETION_CODE_BY_SHELL = {
    "bash": '_fenics_crack_keys() {{ compgen -W "{}" -- "$1"; }}',
    "zsh": "_fenics_crack_keys() {{ compadd {}; }}",
    "fish": "function _fenics_crack_keys; string split ' ' '{}'; end",
}
"""Code of the shell function to complete ``--set``, by shell; {} stands for all scene keys."""


class SuggestingParser(argparse.ArgumentParser):
    """Parse arguments; for an unknown command or option, suggest similar names."""

    def error(self, message: str) -> NoReturn:
        """Print argparse's message with suggestions to standard error, and exit with code 2."""
        wrong_word_match = re.search(
            r"invalid choice: '(.*?)'|unrecognized arguments: (-\S+)", message
        )
        if re.search(r"unrecognized arguments: [\w.]+=", message):
            message += "; write --set before each key: --set KEY=VALUE --set KEY=VALUE"
        elif wrong_word_match and wrong_word_match[2]:
            unknown_option = wrong_word_match[2].partition("=")[0]
            commands_with_option = [
                command_name
                for command_name in HELP_AND_CALL_BY_COMMAND
                if unknown_option in list_all_options_of_commands(command_name)
            ]
            all_options = list_all_options_of_commands(*HELP_AND_CALL_BY_COMMAND)
            similar_options = find_similar_names(unknown_option, all_options)
            message += f"; {did_you_mean_text([] if commands_with_option else similar_options)}"
            message += (
                f"it is an option of {', '.join(commands_with_option)} only"
                if commands_with_option
                else ""
            )
        elif wrong_word_match:
            python_calls_text = "\n".join(find_calls_by_synonyms(wrong_word_match[1]))
            suggested_commands = [
                command_name
                for command_name in HELP_AND_CALL_BY_COMMAND
                if re.search(rf"fc\.(run_)?{command_name}\(", python_calls_text)
            ]
            similar_commands = find_similar_names(wrong_word_match[1], HELP_AND_CALL_BY_COMMAND)
            message += f"; {did_you_mean_text(similar_commands or suggested_commands)}"
        super().error(message.rstrip("; "))


class CompletionAction(argparse.Action):
    """Print a shell's code to complete the program's words, and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *call_arguments: Any) -> NoReturn:
        """Print the completion code for a shell; argparse calls this.

        ``call_arguments`` are the namespace, the name of the shell and the option.
        """
        from fenics_crack.scene.keys import known_keys

        try:
            import shtab
        except ImportError:
            parser.error("--completion needs shtab: python -m pip install shtab")
        keys_text = " ".join(known_keys())
        preamble_by_shell = {
            shell: function_code.format(keys_text)
            for shell, function_code in KEY_COMPLETION_CODE_BY_SHELL.items()
        }
        print(shtab.complete(parser, call_arguments[1], preamble=preamble_by_shell))
        parser.exit()


def list_all_options_of_commands(*command_names: str) -> list[str]:
    """Return the options of several commands and the options common to all, each once."""
    command_argument_names = " ".join(
        HELP_AND_CALL_BY_COMMAND[command_name][1] for command_name in command_names
    ).split()
    command_options = [
        command_argument_name.partition("=")[0]
        for command_argument_name in command_argument_names
        if command_argument_name.startswith("--")
    ]
    return list(dict.fromkeys([*command_options, "--format", "--quiet", "--verbose", "--help"]))


def build_parser() -> argparse.ArgumentParser:
    """Build the argparse parser with a subparser for each command."""
    program_parser = SuggestingParser(
        prog="fenics-crack",
        description="Periodic vibration of a plate with a crack that opens and closes.",
        epilog=HELP_EPILOG_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    program_parser.add_argument("--version", action="version", version=f"fenics-crack {VERSION}")
    completion_help = (
        'print what a shell needs to complete words: eval "$(fenics-crack --completion bash)"'
    )
    program_parser.add_argument(
        "--completion",
        action=CompletionAction,
        choices=(*KEY_COMPLETION_CODE_BY_SHELL,),
        help=completion_help,
    )
    command_group = program_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command_name, (
        command_help,
        function_path_and_argument_names,
    ) in HELP_AND_CALL_BY_COMMAND.items():
        command_parser = command_group.add_parser(
            command_name, help=command_help, description=command_help[0].upper() + command_help[1:]
        )
        for command_argument_name in [*function_path_and_argument_names.split()[1:], "--format"]:
            argument_help, argument_options = HELP_AND_OPTIONS_BY_ARGUMENT[command_argument_name]
            added_argument_action = command_parser.add_argument(
                command_argument_name.partition("=")[0], help=argument_help, **argument_options
            )
            if command_argument_name == "--set" or argument_options.get("type") is path:
                completion_function_by_shell = (
                    KEY_COMPLETION_FUNCTION_BY_SHELL
                    if command_argument_name == "--set"
                    else PATH_COMPLETION_FUNCTION_BY_SHELL
                )
                added_argument_action.complete = completion_function_by_shell  # type: ignore[attr-defined]
        verbosity_group = command_parser.add_mutually_exclusive_group()
        verbosity_group.add_argument(
            "--quiet", action="store_true", help="print the table and nothing else"
        )
        verbosity_group.add_argument(
            "--verbose", action="store_true", help="report how long each part took"
        )
    return program_parser
