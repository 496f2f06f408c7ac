#!/bin/sh
# Sets this project up on Debian 12 or 13: Debian's packages first, then .venv beside this file.
#
#     sh install.sh
#
# It may be run again at any time. When everything is in place it changes nothing, needs no
# network and no root rights, and takes a second or two.
set -eu

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

system=$( (. /etc/os-release && printf '%s %s' "${ID:-}" "${VERSION_ID:-}") 2>/dev/null) || system=
case $system in
'debian 12' | 'debian 13') ;;
*) fail "only Debian 12 and Debian 13 are supported; this system is '${system:-unknown}'" ;;
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

missing=
for package in $packages; do
    dpkg-query -W -f '${db:Status-Status}\n' "$package" 2>/dev/null | grep -qx installed ||
        missing="$missing $package"
done

if [ -n "$missing" ]; then
    if [ "$(id -u)" -eq 0 ]; then
        as_root=
    elif command -v sudo >/dev/null; then
        as_root=sudo
    else
        fail "these Debian packages are missing and installing them needs root or sudo:$missing"
    fi
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

# --- the virtual environment ------------------------------------------------------------

# sound_venv: .venv was made in this place by exactly this command, and is whole.
sound_venv() {
    grep -qxF "command = /usr/bin/python3 -m venv --system-site-packages $here/.venv" \
        .venv/pyvenv.cfg 2>/dev/null && .venv/bin/python -m pip --version >/dev/null 2>&1
}

# What the project needs can be loaded. Its own code is only looked for, not run: a mistake in
# that is a matter for the tests.
debian_imports() {
    (cd / && "$1" -c '
import dolfinx.fem, gmsh, h5py, matplotlib, mpi4py.MPI, petsc4py.PETSc, scipy, slepc4py.SLEPc, tqdm
')
}
everything_imports() {
    debian_imports "$here/.venv/bin/python" && (cd / && "$here/.venv/bin/python" -c '
import importlib.util
import cffi, hypothesis, pytest, pyvista, xdist
for name in ("fenics_crack", "furo", "mypy", "myst_parser", "numpydoc", "ruff", "sphinx"):
    if importlib.util.find_spec(name) is None:
        raise ImportError("there is no module " + name)
')
}

# What .venv depends on: when any of it changes, pip runs again, and builds the kernel again.
wanted=$({ cat pyproject.toml setup.py install.sh fenics_crack/kernel/*.[ch] fenics_crack/kernel/build.py; /usr/bin/python3 -VV; echo "$here"; } | sha256sum)
stamp=.venv/fenics_crack.stamp

# compile_program: its bytecode. Where Python may not write that itself (PYTHONDONTWRITEBYTECODE,
# a folder of somebody else), each start would take a third of a second more.
compile_program() {
    .venv/bin/python -m compileall -q fenics_crack >/dev/null 2>&1 || :
}

if sound_venv && everything_imports >/dev/null 2>&1; then
    if [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ]; then
        compile_program
        echo "install.sh: everything is in place"
        exit 0
    fi
    rm -f "$stamp"
else
    # If the fault is not in .venv, say so and leave it alone.
    step "checking that Debian's packages can be imported" debian_imports /usr/bin/python3
    rm -rf .venv
    step "making .venv" /usr/bin/python3 -m venv --system-site-packages .venv
fi

# Debian's compiled modules need Debian's numpy and MPI: pip must not put others before them.
write_pins() {
    .venv/bin/python -c '
from importlib.metadata import version
for name in ("cffi", "numpy", "scipy", "matplotlib", "mpi4py", "pillow", "tqdm"):
    print(f"{name}=={version(name)}")
' >.venv/debian-pins.txt
}
step "reading the versions of Debian's packages" write_pins
step "installing PyPI packages and the project into .venv" \
    .venv/bin/python -m pip install --constraint .venv/debian-pins.txt pyvista --editable '.[test,docs]'
step "checking that everything can be imported" everything_imports
compile_program

printf '%s\n' "$wanted" >"$stamp"
echo "install.sh: done; use .venv/bin/python"
