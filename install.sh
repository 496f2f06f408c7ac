#!/bin/sh
# Sets this project up: .venv beside this file.
#
#     sh install.sh            what the program needs
#     sh install.sh --tests    also what its tests and the site of its documentation need
#
# On Debian 12 and 13 DOLFINx, PETSc, SLEPc and gmsh are Debian's packages, installed by apt first.
# On other systems, and where packages are missing and there is no root, they are wheels from PyPI,
# for which a Python 3.12 or newer is looked for. docs/install.md has the other ways.
#
# It may be run again at any time. When everything is in place it changes nothing, needs no
# network and no root rights, and takes a second or two. What --tests has added stays.
set -eu

extras= tools=
case $#${1:-} in
0) ;;
1--tests) extras=test,docs ;;
1--help | 1-h)
    echo 'usage: sh install.sh [--tests]    (--tests: also what tests and documentation need)'
    exit 0
    ;;
*)
    echo "install.sh: '$*' is not an option: sh install.sh, or sh install.sh --tests" >&2
    exit 2
    ;;
esac

fail() {
    printf 'install.sh: %s\n' "$*" >&2
    exit 1
}

# step NAME COMMAND...  Runs the command with its output kept aside. If it fails, shows the
# end of that output and stops with a message that names the step.
step() {
    step_name=$1
    shift
    printf 'install.sh: %s ...\n' "$step_name"
    if ! "$@" >"$log" 2>&1; then
        tail -n 30 "$log" >&2
        fail "this step failed: $step_name (its last lines of output are above)"
    fi
}

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P) || fail "cannot find my own folder"
cd "$here"
log=$(mktemp) || fail "cannot make a temporary file"
trap 'rm -f "$log"' EXIT
trap 'exit 1' HUP INT TERM

# Modules of another Python must not be found by Debian's.
unset PYTHONPATH PYTHONHOME

# --- Debian's packages ------------------------------------------------------------------

# by_wheels: why not by Debian's packages; empty: by these.
system=$( (. /etc/os-release && printf '%s %s' "${ID:-}" "${VERSION_ID:-}") 2>/dev/null) || system=
case $system in
'debian 12' | 'debian 13') by_wheels= ;;
*) by_wheels="this system (${system:-unknown}) is neither Debian 12 nor 13" ;;
esac

# gcc and python3-dev: DOLFINx compiles every form when it first meets it; the kernel is built.
# openmpi-bin: mpirun.
# libopenblas0-pthread: dense algebra, several times faster than Debian's reference BLAS.
# libegl1 and libgl1-mesa-dri: pyvista's VTK, which brings no OpenGL of its own, draws through
# them into memory where there is no screen.
packages='
    python3-dolfinx python3-petsc4py python3-slepc4py python3-mpi4py
    gmsh python3-gmsh
    python3-scipy python3-matplotlib python3-h5py python3-tqdm python3-cffi python3-venv
    libopenblas0-pthread
    gcc python3-dev
    openmpi-bin
    libegl1 libgl1-mesa-dri
'
# strace: nightly tests look at system calls, and are skipped without it.
if [ -n "$extras" ] && { [ "$(id -u)" -eq 0 ] || command -v sudo >/dev/null; }; then
    packages="$packages strace"
fi

missing=
[ -n "$by_wheels" ] || for package in $packages; do
    dpkg-query -W -f '${db:Status-Status}\n' "$package" 2>/dev/null | grep -qx installed ||
        missing="$missing $package"
done

if [ -n "$missing" ]; then
    if [ "$(id -u)" -eq 0 ]; then
        as_root=
    elif command -v sudo >/dev/null; then
        as_root=sudo
    else
        by_wheels="there is neither root nor sudo to install Debian's packages$missing"
        missing=
    fi
fi
if [ -n "$missing" ]; then
    apt="$as_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y"
    apt="$apt -o Dpkg::Use-Pty=0 -o DPkg::Lock::Timeout=300"
    # A package source that does not answer is no reason to stop: the install step decides.
    printf 'install.sh: %s ...\n' "refreshing the package lists"
    $apt update >"$log" 2>&1 || {
        tail -n 5 "$log" >&2
        printf 'install.sh: warning: not all package lists could be refreshed\n' >&2
    }
    # shellcheck disable=SC2086  # the lists are meant to fall apart into words
    step "installing Debian packages (a few minutes)" \
        $apt install --no-install-recommends $missing
fi

# --- Python -----------------------------------------------------------------------------

# suits PYTHON: wheels of DOLFINx are for it, and it can make a virtual environment.
suits() {
    "$1" -c '
import ensurepip, platform, sys, venv
library, version = platform.libc_ver()
assert sys.version_info >= (3, 12) and platform.machine() == "x86_64"
assert library == "glibc" and [*map(int, version.split("."))] >= [2, 34]
' 2>/dev/null
}

# find_python: the file of such a Python itself, not of an environment that was made of it.
find_python() {
    for name in python3.13 python3.14 python3.12 python3 python; do
        if suits "$name"; then
            "$name" -c 'import sys; print(getattr(sys, "_base_executable", sys.executable))'
            return
        fi
    done
    return 1
}

if [ -z "$by_wheels" ]; then
    python=/usr/bin/python3 site=' --system-site-packages' extra=
else
    echo "install.sh: $by_wheels:"
    python=$(find_python) || fail "DOLFINx comes from PyPI then, for Linux on x86-64 with glibc" \
        "2.34 or newer, and Python 3.12 or newer with its module venv: none is on PATH. Get one" \
        "by 'uv python install 3.13', pyenv or conda; other ways are in docs/install.md"
    site= extra=dolfinx
    missing=$("$python" -B -c '
from fenics_crack.basics.machine import InputError, find_c_compiler
try:
    find_c_compiler()
except InputError as error:
    print(error)
')
    [ -z "$missing" ] || fail "$missing"
    echo "install.sh: DOLFINx comes from PyPI, for $python"
fi

# --- the virtual environment ------------------------------------------------------------

# make_venv: pip's own wheel is unpacked. By venv, pip would install itself and compile all its
# modules, 3 s of processor time, of which few are used.
make_venv() {
    "$python" -m venv --without-pip$site .venv &&
        .venv/bin/python -c '
import ensurepip, pathlib, sysconfig, zipfile
bundled = pathlib.Path(ensurepip.__file__).parent / "_bundled"
[wheel] = pathlib.Path(sysconfig.get_config_var("WHEEL_PKG_DIR") or bundled).glob("pip-*.whl")
zipfile.ZipFile(wheel).extractall(sysconfig.get_path("purelib"))
' &&
        printf '#!/bin/sh\nexec "%s/.venv/bin/python" -m pip "$@"\n' "$here" >.venv/bin/pip &&
        chmod +x .venv/bin/pip
}

# sound_venv: .venv was made in this place by such a command, and is whole.
sound_venv() {
    grep -qxF -e "command = $python -m venv --without-pip$site $here/.venv" \
        -e "command = $python -m venv$site $here/.venv" .venv/pyvenv.cfg 2>/dev/null &&
        .venv/bin/python -m pip --version >/dev/null 2>&1
}

# libraries_load PYTHON [MODULE...]: the libraries, and these modules, can be loaded.
libraries_load() {
    loading=$1
    shift
    (cd / && "$loading" -c '
import sys
from importlib.util import find_spec
if find_spec("dolfinx_solver"):
    import dolfinx_solver
import dolfinx.fem, gmsh, h5py, matplotlib, mpi4py.MPI, petsc4py.PETSc, scipy, slepc4py.SLEPc, tqdm
for name in sys.argv[1:]:
    __import__(name)
' "$@")
}
everything_imports() {
    libraries_load "$here/.venv/bin/python" cffi jinja2 pyvista
}

# These modules are found, and the program is that of this folder. Its code is not run: a mistake in
# that is a matter for the tests.
everything_is_found() {
    (cd / && "$here/.venv/bin/python" -c '
import sys
from importlib.util import find_spec
for name in sys.argv[2:]:
    if find_spec(name) is None:
        raise ImportError("there is no module " + name)
if find_spec("fenics_crack").origin != sys.argv[1] + "/fenics_crack/__init__.py":
    raise ImportError("fenics_crack is that of another folder")
' "$here" fenics_crack $tools)
}

# versions PYTHON [OPTION]: of those of Debian's packages that PyPI has, too.
versions() {
    (cd / && "$@" -c '
from importlib.metadata import version
for name in ("cffi", "numpy", "scipy", "matplotlib", "mpi4py", "pillow", "tqdm"):
    print(f"{name}=={version(name)}")
')
}

# Debian's compiled modules need Debian's NumPy and MPI: no others may stand before them.
debian_is_first() {
    found=$(versions "$here/.venv/bin/python") || return 1
    [ "$found" = "$pins" ] && return
    echo "Debian's modules are" $pins
    echo "but others stand before them:" $found
    (cd / && "$here/.venv/bin/python" -c 'import numpy; print(numpy.__file__)')
    return 1
}

pins=
[ -n "$by_wheels" ] || pins=$(versions "$python" -I) ||
    fail "the versions of Debian's Python packages cannot be read"
stamp=.venv/fenics_crack.stamp
case $(cat "$stamp" 2>/dev/null) in *test,docs) extras=test,docs ;; esac
[ -z "$extras" ] || tools='furo hypothesis mypy myst_parser numpydoc pytest ruff shtab sphinx xdist'
extras=${extra:+$extra${extras:+,}}$extras

# What .venv depends on: when any of it changes, pip runs again, and builds the kernel again.
wanted=$({
    cat pyproject.toml setup.py install.sh fenics_crack/kernel/*.[ch] fenics_crack/kernel/build.py
    "$python" -VV
    echo "$here" "$pins"
} | sha256sum)
wanted="${wanted%% *} $extras"

# compile_program: its bytecode. Where Python may not write that itself (PYTHONDONTWRITEBYTECODE,
# a folder of somebody else), each start would take a third of a second more.
compile_program() {
    .venv/bin/python -m compileall -q fenics_crack >/dev/null 2>&1 || :
}

if ! { sound_venv && { [ -n "$by_wheels" ] || debian_is_first; } && everything_imports; } >/dev/null 2>&1; then
    # If the fault is not in .venv, say so and leave it alone.
    [ -n "$by_wheels" ] || [ ! -e .venv ] ||
        step "checking that Debian's packages can be imported" libraries_load "$python"
    rm -rf .venv
    step "making .venv" make_venv
elif [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ] && everything_is_found >/dev/null 2>&1; then
    compile_program
    echo "install.sh: everything is in place"
    exit 0
fi
echo "unfinished $extras" >"$stamp"

# write_pins: pip obeys them whenever it runs in .venv, and leaves Debian's modules where they are.
# Later ones of matplotlib-inline, of which notebooks draw, need another Matplotlib than Debian 12's.
write_pins() {
    printf '%s\n' "$pins" 'matplotlib-inline<0.2' >.venv/debian-pins.txt
    .venv/bin/python -c '
import pathlib
print("[install]", "constraint = " + pathlib.Path(".venv/debian-pins.txt").absolute().as_uri(), sep="\n")
' >.venv/pip.conf
}
[ -n "$by_wheels" ] || step "pinning the versions of Debian's packages" write_pins
# Bytecode is written when a module is first used, of which there are few of all that pip unpacks.
step "installing PyPI packages and the project into .venv (a minute)" \
    env PIP_NO_COMPILE=1 .venv/bin/python -m pip install --editable ".${extras:+[$extras]}"
[ -n "$by_wheels" ] || step "checking that Debian's packages come first" debian_is_first
step "checking that everything can be imported" everything_imports
step "checking that everything is there" everything_is_found
compile_program

printf '%s\n' "$wanted" >"$stamp"
echo "install.sh: done; use .venv/bin/python"
