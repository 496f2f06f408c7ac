"""The program ``fenics-crack``: arguments, exit codes, and what happens to errors."""

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

from fenics_crack.basics import threads
from fenics_crack.basics.atomic_files import FULL
from fenics_crack.basics.errors import ConvergenceError, Exit, InputError, StoppedError, WriteError
from fenics_crack.basics.progress import Messages
from fenics_crack.basics.suggestions import in_other_words, meant, near
from fenics_crack.version import VERSION

if TYPE_CHECKING:
    from fenics_crack.cli.given import Console, Inputs

PREFIXES = tuple(f"-crack_{name}_" for name in ("hb", "krylov", "modes", "largest", "factor"))
"""Beginnings of PETSc's options that reach a solver: SNES, GMRES, SLEPc, factorisations."""
OUT_OF_MEMORY = ("PetscMalloc", "failed to map segment")
"""Texts by which PETSc, and the loader of a library, report too little memory."""
TABLES = {
    "curve": ("parameter", "start"),
    "disk": ("families",),
    "excitation": ("omega",),
    "harmonic_balance": ("form", "harmonics", "samples", "tolerance"),
    "integration": ("steps_per_period",),
    "reduction": ("method", "modes"),
    "tip_timing": ("clock", "noise", "probes", "revolutions", "tip_radius"),
}
DAMPING_KEYS = ("mass", "modes", "omegas", "ratio", "ratios", "stiffness")
KEYS = {
    **{name: f"{table}.{name}" for table, names in TABLES.items() for name in names},
    **{f"damping {name}": f"damping.{name}" for name in DAMPING_KEYS},
    **dict.fromkeys(("low", "high", "high - low"), "tip_timing.frequencies"),
    "contact law": "contact.law",
    "contact stiffness": "contact.stiffness",
    "count": "--count",
    "end": "curve.stop",
    "more": "disk.modes",
    "record_periods": "integration.periods",
    "start, end": "curve.start, curve.stop",
}
"""Keys of a scene for the arguments of the library that errors name."""
HIGHEST_ORDER = 1000
"""Maximum engine order of ``--orders``."""
EPILOG = """\
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code; the same on every rank."""
    gc.set_threshold(10_000)  # more than 100,000 objects stay, to be searched again and again
    atexit.register(gc.freeze)  # the system takes back what is left, garbage or not
    if any(os.environ.get(name, "0") != "0" for name in threads.LAUNCHERS):
        _be_silent()
    if sys.stdout is None:
        _say("standard output is closed")
        return Exit.FAULT
    try:
        given = _read(arguments)
        return _run(given)
    except InputError as error:
        if error.__cause__ is not None and given.verbose:
            traceback.print_exception(error.__cause__)
        _explain((error, *error.others))
        return Exit.FAULT if isinstance(error, WriteError) else Exit.BAD_INPUT
    except ConvergenceError as error:
        _say(str(error) if isinstance(error, StoppedError) else f"did not converge: {error}")
        return Exit.NOT_CONVERGED
    except KeyboardInterrupt:
        # Say nothing of what a library cannot end well, as it was stopped in the middle of a step;
        # the last to be registered is the first to be called.
        atexit.register(setattr, sys, "unraisablehook", lambda _: None)
        _say("stopped")
        _end_others(Exit.STOPPED)
        return Exit.STOPPED
    except BrokenPipeError:  # the reader of our output has gone
        _discard_output()
        return Exit.READER_GONE
    except Exception as error:
        if "FromOptions()" in (message := str(error).rstrip()):  # a value unknown to PETSc
            reason = f"with values that PETSc knows ({message.rpartition('[0] ')[2]})"
            _explain([InputError("PETSc options", " ".join(_petsc_options()), reason)])
            return Exit.BAD_INPUT
        if shortage := _shortage(error):
            _say(shortage, sys.__stderr__)
            _discard_output()
        else:
            traceback.print_exc(file=sys.__stderr__)
        _end_others(Exit.FAULT)
        return Exit.FAULT


def _end_others(code: Exit) -> None:
    """End the other ranks, which may wait for this one, and this one, with an exit code."""
    if threads.launched():
        from mpi4py import MPI

        if MPI.COMM_WORLD.size > 1:
            MPI.COMM_WORLD.Abort(code)


def _read(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the arguments, of the program's own those before PETSc's; SystemExit after --help, and
    for words that the parser refuses."""
    try:
        given = parser().parse_args(_without_petsc() if arguments is None else arguments)
    except SystemExit:
        sys.stdout.flush()
        if threads.launched():
            from mpi4py import MPI

            MPI.COMM_WORLD.Barrier()  # a rank that fails earlier would silence the one that prints
        raise
    given.words = [*(sys.argv[1:] if arguments is None else arguments)]
    return given


def _without_petsc() -> list[str]:
    """The program's arguments up to the first ``-crack_``, from which on PETSc takes them as in
    scripts (``basics/ranks.py``); InputError for a prefix that no solver has."""
    for word in (options := _petsc_options()):
        if word.startswith("-crack_") and not word.startswith(PREFIXES):
            raise InputError("PETSc option", word, f"one that begins with {' or '.join(PREFIXES)}")
    return sys.argv[1 : len(sys.argv) - len(options)]


def _petsc_options() -> list[str]:
    """Return the words of the command line from the first of PETSc's options on."""
    return [*dropwhile(lambda word: not word.startswith("-crack_"), sys.argv[1:])]


def _be_silent() -> None:
    """Discard what this rank prints; faults of the program go to the true standard error."""
    sys.stdout = sys.stderr = open(os.devnull, "w")


def _say(text: str, stream: TextIO | None = None) -> None:
    """Print the last line, if that is possible."""
    with contextlib.suppress(OSError):
        print(f"fenics-crack: {text}", file=stream or sys.stderr or sys.__stderr__, flush=True)


def _explain(errors: Sequence[InputError]) -> None:
    """Print a line for each error, of a missing key with an example, and lines to be pasted where
    tables are missing."""
    blocks = []
    for error in errors:
        key, example = KEYS.get(error.key, error.key), ""
        if error.value is None:
            from fenics_crack.cli.given import line_of, lines_of

            line = "" if key in error.allowed else line_of(key, error.allowed)
            example = f"; for example {line}" if line else ""
            blocks.append(lines_of(key) if error.example is None else error.example)
        _say(f"{type(error)(key, error.value, error.allowed)}{example}")
    if lines := "\n\n".join(filter(None, blocks)):
        print(f"for example:\n\n{lines}", file=sys.stderr)


def _discard_output() -> None:
    """Spare Python the attempt to write at its end what could not be written before."""
    with contextlib.suppress(OSError):  # it may be no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _shortage(error: Exception) -> str:
    """Describe the resource that ran out if an error is due to that, else return ""."""
    said = any(words in str(error) for words in OUT_OF_MEMORY)
    # Few libraries name their need.
    near_limit = threads.memory_of_process("VmPeak") > 0.9 * threads.address_limit()
    if isinstance(error, MemoryError) or said or near_limit:
        return "memory was not enough"
    if isinstance(error, OSError) and error.errno in FULL:
        return f"{error.filename or 'standard output'} cannot be written ({error.strerror})"
    return ""


def _run(given: argparse.Namespace) -> Exit:
    """Read what a command is given, prepare this process, and call it.

    MPI and PETSc take longer to load than most input to be refused. Where mpirun has started this
    process, rank 0 reads for all.
    """
    if given.command == "doctor":  # which asks what is there
        return _command(given, None, None) or Exit.DONE
    threads.check_modules()
    from fenics_crack.cli.given import STRUCTURE_FILE, Console, read_inputs, read_prepared

    launched = threads.launched()
    prepared = "scene" in given and given.scene.suffix.lower() == ".h5"
    inputs = None if launched or prepared else read_inputs(given)
    of_scene = launched or not ("scene" in given and inputs is None)
    has_structure_file = (
        inputs and not vars(given).get("fresh", True) and (inputs.folder / STRUCTURE_FILE).exists()
    )
    meshes = (
        given.command not in ("new", "clean") and not (prepared or has_structure_file) and of_scene
    )
    if meshes and not (inputs and inputs.scene.structure):
        from fenics_crack.basics import gmsh_process as mesher  # noqa: F401  before MPI: see there
    with threads.one_process_settings():
        from fenics_crack.basics.ranks import MPI, STOPS, on_root, unread_options  # starts MPI
    comm = MPI.COMM_WORLD
    if comm.rank > 0:
        _be_silent()
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # else PETSc ends the program if a reader leaves
    for number in STOPS:
        signal.signal(number, signal.default_int_handler)
    with threads.alone(), Messages(quiet=given.quiet):
        if prepared:
            inputs = read_prepared(given, comm)
        elif launched:
            inputs = on_root(comm, lambda: read_inputs(given))
        pictures = vars(given).get("pictures", "png")
        console = Console(comm, given.format, given.quiet, given.verbose, pictures)
        exit_code = _command(given, inputs, console) or Exit.DONE
        console.warn(*map("PETSc option {}: no solver has read it".format, unread_options()))
        return exit_code


def _command(
    given: argparse.Namespace, inputs: Inputs | None, console: Console | None
) -> Exit | None:
    """Call a command; return how it ended where that may differ."""
    name, *_ = COMMANDS[given.command][1].split()
    command: Callable[..., Exit | None] = resolve_name(f"fenics_crack.{name}")
    if not name.startswith("cli."):
        from fenics_crack.cli.commands import compute

        command = partial(compute, command)
    if inputs is None or ("output" not in given and given.command != "check"):
        return command(given, inputs, console)
    from fenics_crack.basics.ranks import on_root
    from fenics_crack.cli.given import STRUCTURE_FILE, make_writable
    from fenics_crack.study.plausibility import remarks_on_scene
    from fenics_crack.study.sharing import STRUCTURE_FILES

    assert console is not None
    if given.command not in ("check", "clean"):
        make_writable(inputs.folder, console.comm)
    if (fresh := vars(given).get("fresh")) is not None and inputs.prepared is None:
        from fenics_crack.study.shelf import StructureFile

        path = inputs.folder / STRUCTURE_FILE
        is_read = on_root(console.comm, lambda: path.is_file() and not path.is_symlink())
        STRUCTURE_FILES[:] = [StructureFile(path, console.note, is_read=is_read and not fresh)]
    if given.command != "clean":  # before the mesh, which may take minutes
        console.remark(*remarks_on_scene(inputs.scene))
    try:
        return command(given, inputs, console)
    finally:
        STRUCTURE_FILES.clear()


# --- arguments ------------------------------------------------------------------------------------


class OrderRange(argparse.Action):
    """Changes ``tip_timing.orders`` to the whole numbers of a range."""

    def __call__(self, _: Any, words: argparse.Namespace, ends: Any, option: Any = None) -> None:
        """Called by argparse with the first order and the last one."""
        first_order, last_order = ends
        if not 1 <= first_order <= last_order <= HIGHEST_ORDER:
            allowed_range = f"whole numbers, 1 <= FIRST <= LAST <= {HIGHEST_ORDER}"
            raise InputError("--orders", ends, allowed_range)
        orders = [*range(first_order, last_order + 1)]
        words.set = [*words.set, f"tip_timing.orders={orders}"]


def path(text: str) -> Path:
    """A path that can be opened, and written in the files of results; argparse refuses others."""
    if b"\0" in text.encode("utf-8"):
        raise ValueError
    return Path(text)


SOLVED = "scene --set --output"
COMMANDS = {
    "new": (
        "write a commented scene to start from",
        "cli.given:new file --blade --timing --identify --solid --disk --cad",
    ),
    "check": (
        "mesh and assemble a scene without solving it",
        "cli.scenes:check scene --set --fresh",
    ),
    "modes": (
        "natural frequencies and mode shapes, crack open",
        f"runs.solve:modes {SOLVED} --count",
    ),
    "campbell": (
        "natural frequencies over the speed of [rotation], crack open and bonded, and a picture",
        f"study.campbell:campbell {SOLVED} --count --speeds --pictures",
    ),
    "disk": (
        "natural frequencies of a bladed disk over the nodal diameter, and how much random "
        "mistuning amplifies the response of a blade, with pictures",
        f"cli.commands:disk {SOLVED} --patterns --deviation --pictures",
    ),
    "reduce": (
        "write what a scene's mesh gives to a file with which solve and curve need no mesh",
        "cli.commands:reduce scene --set --output=FILE.h5",
    ),
    "solve": ("steady vibration at excitation.omega", f"runs.solve:solve {SOLVED} --fresh"),
    "verify": (
        "contributions of mesh, modes, harmonics and samples to the error of solve: observed "
        "orders, extrapolated values, grid-convergence indices, and a picture",
        f"errors.verify:verify {SOLVED} --fresh --pictures",
    ),
    "curve": ("response curve of the table [curve]", f"runs.curve:curve {SOLVED} --fresh"),
    "integrate": (
        "motion in time by the table [integration]",
        f"runs.integrate:integrate {SOLVED}",
    ),
    "sweep": (
        "all cases of the table [sweep.over]; goes on where it stopped",
        f"cli.commands:sweep {SOLVED} --fresh",
    ),
    "grow": (
        "growth of the crack under the vibration by the table [growth]: length, life, frequencies; "
        "goes on where it stopped",
        f"fatigue.growth:grow {SOLVED} --pictures",
    ),
    "timing": (
        "arrivals of the blade tip at the probes of [tip_timing], and the vibration in them",
        "cli.timing:timing scene arrivals --blade=N --orders --set --output --pictures",
    ),
    "identify": (
        "a crack from measured frequencies, harmonics and arrivals, by the table [identify]",
        "cli.commands:identify scene measurements --arrivals --before --blade=N --modes --set "
        "--output --pictures",
    ),
    "plot": (
        "pictures of a result, of all in a folder, of several curves in one, or of a scene's mesh; "
        "files for ParaView",
        "cli.report:plot_results results --label --output --pictures",
    ),
    "report": (
        "one HTML page with all of some results, or of a folder, to be read anywhere",
        "cli.report:report results --output=FILE",
    ),
    "clean": (
        "remove the structure that earlier commands have kept in the folder for the results",
        f"cli.commands:clean {SOLVED}",
    ),
    "doctor": (
        "what this installation consists of, and whether it computes known numbers",
        "cli.doctor:doctor",
    ),
}
"""Description of each command; its function and its own arguments. A function of ``cli`` takes
these, any other one a scene and what else it takes of them."""
ARGUMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "file": ("the file to write, for example plate.toml", {"type": path, "metavar": "scene"}),
    "--blade": ("of a plate on a rotor: engine order, centrifugal load", {"action": "store_true"}),
    "--timing": ("of one with probes that its tip passes", {"action": "store_true"}),
    "--identify": ("of one whose crack is looked for, by a CSV file", {"action": "store_true"}),
    "--solid": ("of a blade in three dimensions", {"action": "store_true"}),
    "--disk": ("of a bladed disk with one cracked blade", {"action": "store_true"}),
    "--cad": (
        "of a part from a CAD file, .step, .stp or .brep, with a picture of its faces",
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
        "the scene, a TOML file; of solve and curve also a file of reduce, of timing a measured "
        "record, a CSV file",
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
        "arrivals of a run-up of it, as of --arrivals",
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
        "number of the blade whose arrivals are taken from a file of several",
        {"type": int, "metavar": "N"},
    ),
    "--orders": (
        "engine orders that may be in the arrivals, from FIRST to LAST; those of "
        "tip_timing.orders (default: the load's, or 1 to 24 where it is not known)",
        {"type": int, "nargs": 2, "metavar": ("FIRST", "LAST"), "action": OrderRange},
    ),
    "arrivals": (
        "source of the arrivals: the .h5 file of a solution or a curve; or a CSV file of them, "
        "measured or computed (default: the scene, solved)",
        {"type": path, "nargs": "?", "metavar": "source"},
    ),
    "results": (
        "a .h5 file that another command has written, a folder of them, several curves to be drawn "
        "in one picture, or a scene",
        {"type": path, "nargs": "+", "metavar": "result"},
    ),
    "--label": (
        "name of a result among several (default: what differs between their scenes)",
        {"action": "append", "default": [], "metavar": "TEXT"},
    ),
    "--set": (
        "change a key of the scene, for example crack.length=0.03; may be given often",
        {"action": "append", "default": [], "metavar": "KEY=VALUE"},
    ),
    "--output": (
        "for the results (default: output/NAME of the scene; for plot, the folder of the result)",
        {"type": path, "metavar": "FOLDER"},
    ),
    "--fresh": (
        "compute the structure anew, and do not take that of an earlier command from the folder",
        {"action": "store_true"},
    ),
    "--count": ("how many modes (default: 6, or all of fewer)", {"type": int}),
    "--speeds": (
        "first and last speed, and how many, in rpm where the scene gives rpm, else in rad/s "
        "(default: from 0 to 1.5 times the scene's, 13)",
        {"type": float, "nargs": 3, "metavar": ("START", "STOP", "COUNT")},
    ),
    "--output=FILE": (
        "the .html file (default: report.html in the folder of the first result)",
        {"type": path, "metavar": "FILE.html"},
    ),
    "--output=FILE.h5": (
        "the .h5 file (default: output/NAME/NAME.h5, NAME being that of the scene)",
        {"type": path, "metavar": "FILE.h5"},
    ),
    "--pictures": (
        "kind of the pictures; pdf and svg are vector graphics, for papers (default: png)",
        {"choices": ("png", "pdf", "svg"), "default": "png"},
    ),
    "--format": (
        "of the table that is printed",
        {"choices": ("text", "csv", "json"), "default": "text"},
    ),
}


COMPLETED_KEYS = {
    "bash": "_fenics_crack_keys", "zsh": "_fenics_crack_keys", "fish": "(_fenics_crack_keys)",
}  # fmt: skip
COMPLETED_PATHS = {
    "bash": "_shtab_compgen_files", "zsh": "_files",
    "fish": "(__fish_complete_path (commandline -ct))",
}  # fmt: skip
"""Completion of ``--set`` and of paths, by shell, as shtab takes it; the function behind the first,
whose body has the keys of scenes."""
KEY_FUNCTIONS = {
    "bash": '_fenics_crack_keys() {{ compgen -W "{}" -- "$1"; }}',
    "zsh": "_fenics_crack_keys() {{ compadd {}; }}",
    "fish": "function _fenics_crack_keys; string split ' ' '{}'; end",
}


class Parser(argparse.ArgumentParser):
    """Asks what may be meant by a command, or an option, that there is not."""

    def error(self, message: str) -> NoReturn:
        """Print the error and suggestions, and exit."""
        wrong = re.search(r"invalid choice: '(.*?)'|unrecognized arguments: (-\S+)", message)
        if re.search(r"unrecognized arguments: [\w.]+=", message):
            message += "; each key takes its own --set: --set KEY=VALUE --set KEY=VALUE"
        elif wrong and wrong[2]:
            option = wrong[2].partition("=")[0]
            takers = [name for name in COMMANDS if option in options_of(name)]
            message += f"; {meant([] if takers else near(option, options_of(*COMMANDS)))}"
            message += f"of {', '.join(takers)} alone" if takers else ""
        elif wrong:
            calls = "\n".join(in_other_words(wrong[1]))
            others = [name for name in COMMANDS if re.search(rf"fc\.(run_)?{name}\(", calls)]
            message += f"; {meant(near(wrong[1], COMMANDS) or others)}"
        super().error(message.rstrip("; "))


class Completion(argparse.Action):
    """Print what a shell needs to complete the program's words, and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        """Called by argparse: the namespace, the shell, and the option."""
        from fenics_crack.scene.scene import known_keys

        try:
            import shtab
        except ImportError:
            parser.error("--completion needs shtab: python -m pip install shtab")
        keys = " ".join(known_keys())
        preamble = {shell: text.format(keys) for shell, text in KEY_FUNCTIONS.items()}
        print(shtab.complete(parser, given[1], preamble=preamble))
        parser.exit()


def options_of(*commands: str) -> list[str]:
    """The options of some commands, each once."""
    words = " ".join(COMMANDS[name][1] for name in commands).split()
    own = [word.partition("=")[0] for word in words if word.startswith("--")]
    return list(dict.fromkeys([*own, "--format", "--quiet", "--verbose", "--help"]))


def parser() -> argparse.ArgumentParser:
    """The arguments of all commands."""
    whole = Parser(
        prog="fenics-crack",
        description="Periodic vibration of a plate with a crack that opens and closes.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"fenics-crack {VERSION}")
    shell = 'print what a shell needs to complete words: eval "$(fenics-crack --completion bash)"'
    whole.add_argument("--completion", action=Completion, choices=(*KEY_FUNCTIONS,), help=shell)
    group = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (text, words) in COMMANDS.items():
        command = group.add_parser(name, help=text, description=text[0].upper() + text[1:])
        for argument in [*words.split()[1:], "--format"]:
            explained, options = ARGUMENTS[argument]
            added = command.add_argument(argument.partition("=")[0], help=explained, **options)
            if argument == "--set" or options.get("type") is path:
                shells = COMPLETED_KEYS if argument == "--set" else COMPLETED_PATHS
                added.complete = shells  # type: ignore[attr-defined]
        loud = command.add_mutually_exclusive_group()
        loud.add_argument("--quiet", action="store_true", help="print the table and nothing else")
        loud.add_argument("--verbose", action="store_true", help="report how long each part took")
    return whole
