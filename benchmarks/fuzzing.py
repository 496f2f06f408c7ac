"""Damaged inputs of every kind, and small structures of every form, through every command.

Whatever a file holds, the program ends with a result, with one line about the input (exit code 2)
or with what did not converge (3). Each case is drawn from the seed and its own number alone, so
that any of them can be repeated by itself (``--first N --cases 1``).

    inputs       scenes (letters, lines, keys and values of their text), gmsh meshes (text and
                 binary), Matrix Market files (.mtx, .gz, .bz2), tables of measurements and of
                 arrivals, results of every kind (bytes changed, left out, cut off; or datasets and
                 attributes changed and the digest made anew), and words on the command line; each
                 through one of the commands that read it
    wheels       the same of bladed disks, loads with harmonics, tables of a periodic load, and
                 friction, and the options of the command ``disk``
    calls        functions of Python with another object for one or two of their arguments
    names        any public function, and what makes its arguments, likewise
    files        files of ``reduce``, sweeps and results, forged: sizes, types, indices, numbers;
                 read in Python, within 10 s and 500 MB
    structures   matrices of 1 to 10 dofs with 0 to as many pairs, every form of damping, fixed and
                 free, both laws, through every command; nothing is damaged

The program runs in a process that is started again where it dies. What is counted as wrong:

    RAW          a traceback, an exit code of 1, more than one line about an input, or a library
                 that speaks for itself on standard error; a structure that is refused
    DEATH        the process ended
    TOO LONG     more than 60 s of processor time, of wheels and calls 20 s
    TOO LARGE    more than 2 GiB of memory beside what the process has at rest

The rows are added to fuzzing.csv in the folder as they are found; a run goes on where it was
stopped. The damaged files of what is wrong are kept beside it.

    OMP_NUM_THREADS=1 python benchmarks/fuzzing.py [--only inputs] [--cases 10000] [--seed S]
        [--first N] [folder]
"""

from __future__ import annotations

import atexit
import bz2
import contextlib
import csv
import functools
import gzip
import inspect
import io
import itertools
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import common
import gmsh
import h5py
import numpy as np

import fenics_crack as fc
from fenics_crack.cli.command_line import main
from fenics_crack.files import store

SECONDS, BYTES = 60.0, 2 * 2**30
QUICK = {"wheels": 20.0, "calls": 20.0, "names": 20.0, "files": 10.0}
PART_MEMORY = {"files": 500 * 10**6}
"""Processor time of a case, of these parts less [s]; memory, of these less [bytes]."""
WRONG = ("RAW", "DEATH", "TOO LONG", "TOO LARGE")
CODES = {0: "done", 2: "refused", 3: "not converged", 4: "above the tolerance"}
COLUMNS = ("part", "case", "what", "outcome", "seconds", "MiB", "message")
SHOWN = 300
"""Characters of a message that are written."""


# --- damage ---------------------------------------------------------------------------------------

VALUES = [
    "0", "-1", "1", "2", "1e300", "-1e300", "1e-300", "1e30", "1e-30", "nan", "-nan", "inf",
    "-inf", "1e400", str(10**400), "9" * 5000, "0x" + "f" * 5000, str(2**31), str(-(2**31) - 1),
    str(2**63), '"x"', "''", '"\\u0000"', '"\\U0001F600"', '"\\u007f"', '"\\n"', '"all"', '"file"',
    "[]", "[1, 2]", "[nan, 1]", "[1e400, 1]", "[true, 1]", "[['a', 1]]", "[[[1]]]",
    "[" * 3000 + "]" * 3000, "{}", "{a = 1}", "[{a = 1}]", "true", "false", "1979-05-27",
    "1979-05-27T07:32:00Z", "07:32:00", "24:00:00", "99999-01-01", "2000-13-01", "0x", "1_000_",
    "{start = 1, stop = 2, count = 3}", "{start = 1, stop = 1e308, count = 3}",
    "{start = 1e-30, stop = 1e30, count = 3, spacing = 'logarithmic'}",
    "{start = 1, stop = 2, count = 1000000000000}", "{start = 1, stop = 2, count = [1]}",
    "{start = 1, stop = 2, count = 3, spacing = []}", "[1, 1.0]",
]  # fmt: skip
NAMES = [
    "a", "crack", "length", "young", "over", "file", "a.b", "''", '"a\\nb"', '"\\u0000"',
    '"\\u007f"', '"excitation.omega"', "'mesh.file'", "'crack.edge'", "[mesh]", "[[crack]]",
]  # fmt: skip
LETTERS = [*"[]{}=\"'\\#.,\n\r\t\0 0-+e_\x7f\x80\u2028\ufeff", "\U0001f600", '"""']
WORDS = [
    b"0", b"-1", b"1", b"2", b"3", b"7", b"99", b"-5", b"15", b"16", b"100", b"1000000000000",
    b"2147483648", b"nan", b"inf", b"1e300", b"x", b'"load"', b'"clamp"', b"$EndNodes",
]  # fmt: skip
MARKET_WORDS = [
    b"0", b"-1", b"1", b"2", b"4", b"1000000000000", b"9223372036854775808", b"9" * 23, b"nan",
    b"inf", b"-inf", b"1e400", b"1e300", b"1e-300", b"x", b"1.5", b"complex", b"pattern",
    b"hermitian", b"skew-symmetric", b"integer", b"array", b"coordinate", b"vector", b"symmetric",
    b"general", b"%%MatrixMarket", b"unsigned-integer",
]  # fmt: skip
CELLS = [
    "", "nan", "inf", "-1", "0", "1e300", "1e-300", "-1e300", "1e30", "1.5", "2", "7", "x", '"',
    '"a,b"', "frequency_open", "frequency_tied", "ratio_2_1", "harmonic_1", "displacement",
    "tip.ux", "1e400", "0x1", "1_0", "\0", "\U0001f600", "100000000", "9" * 400,
]  # fmt: skip
MOST = 10**6
"""Numbers of a dataset that is changed; those that are made may have more."""
NUMBERS = [0.0, -1.0, 1.0, 2.0, 1e300, -1e300, 1e-300, 1e30, 1e9, np.nan, np.inf, 0.5]


def changed_text(text: str, rng: random.Random) -> str:
    """Text with a few mutations of its letters, lines, keys and values."""
    for _ in range(rng.choice([1, 1, 1, 2, 3, 8])):
        lines, position = text.split("\n"), rng.randrange(len(text) + 1)
        given_keys = [i for i, line in enumerate(lines) if "=" in line and line[0] != "#"]
        remarks = [i for i, line in enumerate(lines) if line[:2] == "# " and "=" in line]
        kind = rng.randrange(8)
        if kind == 0:
            text = text[:position] + text[position + rng.randint(1, 3) :]
        elif kind == 1:
            text = text[:position] + rng.choice(LETTERS) + text[position:]
        elif kind == 2:
            text = text[:position] + text[position : position + 2][::-1] + text[position + 2 :]
        elif kind == 3:
            lines.pop(rng.randrange(len(lines)))
            text = "\n".join(lines)
        elif kind == 4:
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = "\n".join(lines)
        elif kind == 5 and remarks:
            line = rng.choice(remarks)
            lines[line] = lines[line][2:]
            text = "\n".join(lines)
        elif kind > 5 and given_keys:
            line = rng.choice(given_keys)
            key, _, value = lines[line].partition("=")
            pair = (rng.choice(NAMES), value) if kind == 6 else (key, rng.choice(VALUES))
            lines[line] = " = ".join(pair)
            text = "\n".join(lines)
    return text


def changed_file(content: bytes, rng: random.Random, words: Sequence[bytes] = WORDS) -> bytes:
    """A file with a few mutations of its bytes, lines and words."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        lines, position = content.split(b"\n"), rng.randrange(len(content) + 1)
        line, kind = rng.randrange(len(lines)), rng.randrange(7)
        if kind == 0:
            content = content[:position] + content[position + rng.randint(1, 4) :]
        elif kind == 1:
            content = (
                content[:position]
                + bytes([rng.randrange(256)])
                + content[position + rng.randrange(2) :]
            )
        elif kind == 2 and rng.random() < 0.2:
            content = content[:position]
        else:
            cells = lines[line].split()
            if kind == 3:
                lines.pop(line)
            elif kind == 4:
                lines.insert(rng.randrange(len(lines)), lines[line])
            elif cells:
                cells[rng.randrange(len(cells))] = rng.choice(words)
                lines[line] = b" ".join(cells)
            content = b"\n".join(lines)
    return content


def changed_table(text: str, rng: random.Random) -> str:
    """A CSV file with a few mutations of its cells and lines, or of its letters."""
    if rng.random() < 0.3:
        return changed_text(text, rng)
    for _ in range(rng.choice([1, 1, 2, 4])):
        lines = text.split("\n")
        line, kind = rng.randrange(len(lines)), rng.randrange(5)
        cells = lines[line].split(",")
        if kind == 0:
            lines[line:] = [] if rng.random() < 0.3 else [""]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[line])
        elif kind == 2:
            cells.insert(rng.randrange(len(cells) + 1), rng.choice(CELLS))
            lines[line] = ",".join(cells)
        else:
            cells[rng.randrange(len(cells))] = rng.choice(CELLS)
            lines[line] = ",".join(cells)
        text = "\n".join(lines) or "\n"
    return text


def changed_bytes(content: bytes, rng: random.Random) -> bytes:
    """Bytes changed, put in, left out, or all from somewhere on."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        position = (
            rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(2048, len(data)))
        )
        kind = rng.randrange(8)
        if kind == 0 and rng.random() < 0.3:
            del data[position + 1 :]
        elif kind == 1:
            del data[position : position + rng.randint(1, 16)]
        elif kind == 2:
            data[position:position] = rng.randbytes(rng.randint(1, 16))
        elif kind == 3:
            data[position : position + 8] = rng.choice([b"\xff", b"\0", b"\x7f"]) * len(
                data[position : position + 8]
            )
        else:
            data[position] ^= 1 << rng.randrange(8)
        data = data or bytearray(b"\0")
    return bytes(data)


@contextlib.contextmanager
def forged(path: Path) -> Iterator[h5py.File]:
    """A result's file to be changed by hand; its digest is made anew, as a forger would."""
    with h5py.File(path, "r+") as file:
        yield file
        if "digest" not in file.attrs:
            return
        with contextlib.suppress(Exception):  # what cannot be read has no digest
            texts, places, column_of = (
                store.attribute_texts,
                store.dataset_location_texts,
                store.locate_dataset_in_file,
            )
            words = {name: h5py.check_string_dtype(item.dtype) for name, item in file.items()}
            parts = {n: item.asstr()[()] if words[n] else item[()] for n, item in file.items()}
            of_sweep = file.attrs.get("kind") == "sweep"
            columns = places({n: column_of(item) for n, item in file.items()}) if of_sweep else {}
            file.attrs["digest"] = store.content_digest(texts(file), columns or parts)


def change_result(path: Path, rng: random.Random, but: str = "") -> None:
    """Change datasets and attributes of a result, ``but`` for one attribute."""
    with forged(path) as file:
        for _ in range(rng.choice([1, 1, 2, 4])):
            names = [name for name, item in file.items() if item.size <= MOST]
            if rng.random() < 0.25 or not names:
                _change_attribute(file, rng, but)
            else:
                _change_dataset(file, rng.choice(sorted(names)), rng)


def _change_attribute(file: h5py.File, rng: random.Random, but: str) -> None:
    name = rng.choice([*sorted({*file.attrs} - {but}), "digest"])
    text = str(file.attrs.get(name, ""))
    kind = rng.randrange(4)
    if kind == 0:
        file.attrs.pop(name, None)
    elif kind == 1:
        file.attrs[name] = rng.choice([0, 1.5, np.nan, "", "x", np.arange(3.0), b"\xff\xfe"])
    else:
        with contextlib.suppress(ValueError):  # HDF5 holds no null characters
            file.attrs[name] = changed_text(text, rng) if text else "a"


def _change_dataset(file: h5py.File, name: str, rng: random.Random) -> None:
    """Its numbers, its shape, its kind, or whether it is there."""
    dataset, kind = file[name], rng.randrange(8)
    value = dataset.asstr()[()] if h5py.check_string_dtype(dataset.dtype) else dataset[()]
    del file[name]
    array = np.array(value)
    numeric = array.dtype.kind in "iufcb"
    if kind == 0:
        return
    if kind == 1:
        file[name] = rng.choice([0.0, -1, "x", np.zeros(0), np.zeros((2, 3)), np.arange(5)])
    elif kind == 2:
        file.create_dataset(name, (10 ** rng.choice([3, 9, 12]),), float, chunks=(1000,))
    elif kind == 3 and array.ndim:
        part = array[: len(array) // 2] if rng.random() < 0.5 else array[..., :1]
        file[name] = part if numeric else _as_words(part)
    elif kind == 4 and numeric:
        file[name] = array.astype(rng.choice(["f4", "i4", "i1", "c16", "u8"]))
    elif kind == 5 and numeric and array.ndim > 1:
        file[name] = np.ascontiguousarray(array.T)
    elif numeric and array.size and array.dtype.kind != "b":
        flat_array = array.astype(complex if array.dtype.kind == "c" else float).reshape(-1)
        places = [
            rng.randrange(flat_array.size) for _ in range(rng.choice([1, 1, flat_array.size]))
        ]
        flat_array[places] = rng.choice(NUMBERS)
        with np.errstate(all="ignore"):
            file[name] = flat_array.reshape(array.shape).astype(array.dtype)
    else:
        file[f"{name}_"] = value if numeric else _as_words(array)


def _as_words(array: np.ndarray) -> np.ndarray:
    """Also of none HDF5 has to know that they are words."""
    return array.astype(object).astype(h5py.string_dtype())


# --- what is damaged ------------------------------------------------------------------------------

PLATE = """\
[geometry]
width = 0.1
height = 0.1
thickness = 0.01
[crack]
edge = "left"
height = 0.05
length = 0.05
# clearance = 1e-6
[material]
young = 2e9
poisson = 0.3
density = 7800.0
[damping]
ratio = 0.02
# modes = 3
[excitation]
omega = 2000.0
point = [0.1, 0.1]
force_sin = [1.0, 0.0]
# force_mean = [0.1, 0.0]
[contact]
stiffness = 1e7
# sharpness = 1e6
[mesh]
layout = "grid"
columns = 2
rows = 2
# order = 2
[harmonic_balance]
harmonics = 3
# tolerance = 0.1
[curve]
start = 2000.0
stop = 2100.0
# parameter = "load"
[integration]
periods = 2
# method = "events"
[sweep.over]
"excitation.omega" = [1900.0, 2000.0]
# [reduction]
# modes = 5
# method = "massless"
[output.points]
tip = [0.1, 0.1]
[identify]
finer = 1.0
[identify.unknown]
"material.young" = { start = 1.8e9, stop = 2.2e9, count = 4 }
[tip_timing]
probes = [0.0, 20.0, 41.0, 63.0, 88.0]
tip_radius = 0.45
revolutions = 4
"""
ORDER = "order = 2\n"
ROTOR = "\n[rotation]\nspeed = 100.0\nhub_radius = 0.1\n"
MEASURED = """\
quantity,value,deviation,mode,frequency [Hz],point,phase [rad]
frequency_bilinear,400.0,4.0,1,,,
frequency_open,1500.0,15.0,2,,,
ratio_2_1,0.01,0.005,,318,tip.ux,
"""
CHAIN = """\
[structure]
mass = "mass.mtx"
stiffness = "stiffness.mtx"
gap = "gap.mtx.gz"
force_sin = "force.mtx"
clearance = "clearance.mtx.bz2"
# damping = "damping.mtx"
"""
OF_CHAIN = """\
[damping]
ratio = 0.02
[excitation]
omega = 0.9
[contact]
stiffness = 10.0
[harmonic_balance]
harmonics = 3
[curve]
start = 0.8
stop = 0.9
[integration]
periods = 2
[sweep.over]
"excitation.omega" = [0.8, 0.9]
"""
WHEEL = """\
[geometry]
width = 0.012
height = 0.08
thickness = 0.02
[disk]
sectors = 6
inner_radius = 0.05
outer_radius = 0.1
cracked = 1
deviation = 0.01
seed = 3
families = 2
# center = [0.0, 0.0]
# axis = [1.0, 0.0, 0.0]
[crack]
edge = "left"
height = 0.012
length = 0.004
[material]
young = 2.1e11
poisson = 0.3
density = 7800.0
[damping]
ratio = 0.02
[excitation]
order = 2
point = [0.0, 0.08]
force_cos = [1.0, 0.0]
frequency = 1300.0
# [[excitation.harmonics]]
# order = 2
# sin = [0.5, 0.0]
[contact]
law = "unilateral"
# friction = 0.2
[harmonic_balance]
harmonics = 3
[mesh]
layout = "graded"
order = 1
size = 0.02
lip_elements = 2
error = false
# [rotation]
# rpm = 3000.0
[curve]
parameter = "frequency"
start = 1240.0
stop = 1260.0
[integration]
periods = 2
[sweep.over]
"disk.seed" = [1, 2]
# "disk.deviation" = [0.0, 0.01]
"""
FRICTION = """
[[excitation.harmonics]]
order = 2
cos = [0.5, 0.0]
sin = [0.0, 0.1]
[[excitation.harmonics]]
order = 3
amplitude = [0.2, 0.0]
phase = 30.0
# [[loads]]
# edge = "top"
# pressure_sin = 1.0
# [[loads.harmonics]]
# order = 2
# cos = 1.0
# [[base.harmonics]]
# order = 2
# cos = [1e-3, 0.0]
"""
CONTACT = "[contact]\nfriction = 0.3"
OF_WAVE = 'wave = "wave.csv"\nwave_harmonics = 3'
WAVE = "t,fx,fy\n0,1,0\n0.5,1,0\n0.5,-1,0\n1,-1,0\n"
COMPLETE = "complete"
"""A file that is written when all others are."""
SCENES = ("plate.toml", "rotor.toml", "file.toml", "chain.toml")
MESHES = ("plate.msh", "plate_22.msh", "plate_binary.msh")
OF_SCENES = ("check", "modes", "solve", "verify", "curve", "integrate", "sweep")
WHEELS = ("wheel.toml", "friction.toml", "wave.toml")
OF_DISKS = [
    "--patterns=5", "--patterns=0", "--patterns=-1", "--patterns=1e3", "--patterns=1000000000",
    "--patterns=" + "9" * 400, "--patterns=x", "--deviation=0", "--deviation=0.05",
    "--deviation=0.5", "--deviation=-1", "--deviation=nan", "--deviation=inf", "--deviation=1e400",
    "--deviation=1e-300", "--deviation", "--pictures=svg", "--pictures=x", "--pictures",
]  # fmt: skip
OF_WHEELS = [
    "disk.sectors=2", "disk.sectors=3", "disk.sectors=1", "disk.sectors=0", "disk.sectors=7",
    "disk.sectors=1e9", "disk.sectors=1000000", "disk.sectors=none", "disk.cracked=[]",
    "disk.cracked=[1,4]", "disk.cracked=[1,1]", "disk.cracked=7", "disk.cracked=0",
    "disk.cracked='x'", "disk.cracked=none", "disk.mistuning=none", "disk.mistuning=0.01",
    "disk.mistuning=[0.01]", "disk.mistuning=[0.01,0,0,0,0,-0.01]", "disk.mistuning=[-1,0,0,0,0,0]",
    "disk.mistuning={}", "disk.seed=-1", "disk.seed=1e400",
    "disk.seed=99999999999999999999999", "disk.deviation=1",
    "disk.deviation=0.05", "disk.families=0", "disk.families=1",
    "disk.families=100000",
    "disk.families='all'", "disk.inner_radius=0", "disk.inner_radius=0.1", "disk.inner_radius=1e-9",
    "disk.outer_radius=0.05", "disk.outer_radius=0.01", "disk.outer_radius=1e9", "disk=none",
    "disk.axis=[0,0,0]", "disk.center=[1,2,3]", "disk.axis=[0,0,1]", "mesh.layout=grid",
    "mesh.layout=file", "mesh.file=a.msh", "mesh.lip_elements=1", "mesh.lip_elements=1000000",
    "excitation.order=0", "excitation.order=-2", "excitation.order=1000000000",
    "excitation.order=6", "excitation.order=2.5", "excitation.order=none",
    "excitation.frequency=none", "excitation.frequency=0", "rotation.rpm=3000", "rotation.rpm=1e9",
    "rotation.speed=100", "rotation.hub_radius=0.1", "geometry.kind=solid", "geometry.width=0.2",
    "geometry.width=1e-9", "crack.height=0", "crack.height=0.08", "crack.length=0.012",
    "crack.edge=right", "crack.height=0.02", "crack.length=0.008", "contact.friction=0.3",
    "contact.friction=0", "contact.friction=1e9", "contact.friction=-1", "contact.friction=nan",
    "contact.friction=[0.1]", "contact.friction=true", "contact.law=smoothed",
    "contact.law=penalty", "excitation.wave=wave.csv", "excitation.wave=missing.csv",
    "excitation.wave=.", "excitation.wave=/dev/null", "excitation.wave=''",
    "excitation.wave_harmonics=5", "excitation.wave_harmonics=0",
    "excitation.wave_harmonics=1000000", "excitation.wave_harmonics=1e400",
    "excitation.harmonics=[]", "excitation.harmonics=1", "excitation.harmonics=none",
    "excitation.harmonics=[{order=1,cos=[1,0]}]", "excitation.harmonics=[{order=100000,cos=[1,0]}]",
    "excitation.harmonics=[{order=2}]", "excitation.harmonics=[{cos=[1,0]}]",
    "excitation.harmonics=[{order=2,cos=1}]", "excitation.harmonics=[{order=2,cos=[nan,0]}]",
    "excitation.harmonics=[{order=2,cos=[1,0]},{order=2,sin=[1,0]}]",
    "excitation.harmonics=[{order=2,amplitude=[1,0]}]",
    "excitation.harmonics=[{order=2,amplitude=[1,0],phase=1e400}]",
    "excitation.harmonics=[{order=2,phase=1}]", "excitation.harmonics=[[1,2]]",
    "excitation.harmonics.1.order=3", "excitation.harmonics.0.order=3",
    "excitation.harmonics.9.order=3", "sweep.over={'contact.friction'=[0,0.1]}",
    "sweep.over={'disk.seed'=[1,'x']}", "sweep.over={'disk.sectors'=[3,4]}",
    "sweep.over={'disk.cracked'=[1,2]}", "sweep.over={'excitation.order'=[1,2]}",
    "sweep.over={'disk.seed'={start=1,stop=2,count=2}}",
    "sweep.over={'excitation.harmonics'=[1]}", "curve.parameter=friction",
    "curve.parameter=load", "curve.parameter=disk", "harmonic_balance.tolerance=0.1",
    "damping.ratio=0", "integration.method=events",
    "integration.method=central", "reduction.modes=3",
]  # fmt: skip
"""Changes of wheels, of loads with harmonics, and of friction."""
SETTINGS = [
    "", "=", "a", "a=", "=1", "a=1", "crack=none", "contact=none", "crack=1", "mesh.columns=4",
    "mesh.columns=1e9", "mesh.rows=3", "mesh.rows=[", "crack.length=0.03", "crack.length=nan",
    "crack.length='", "crack.edge=right", "crack.edge=top", "material.young=" + "9" * 5000,
    "material.young=" + "[" * 2000, "material.poisson=0.4999999", "damping.ratio=[0.1,0.2]",
    "damping.ratio=0", "damping.modes=2", "damping.modes=1000", "damping.ratio=none",
    "damping.mass=10", "damping.stiffness=1e-6", "damping.stiffness=1", "excitation.omega=-1",
    "excitation.omega=3000", "excitation.point=[0,0]", "excitation.force_sin=[0,0]",
    "contact.law=unilateral", "contact.stiffness=none", "contact.stiffness=1e30",
    "contact.stiffness_per_area=1e9", "contact.sharpness=1e6", "contact.law=smoothed",
    "contact.pairs=mouth", "harmonic_balance.harmonics=1", "harmonic_balance.harmonics=100000000",
    "harmonic_balance.samples=13", "harmonic_balance.samples=2000000000", "reduction.modes=2",
    "reduction.modes=100", "reduction.method=off", "curve=none",
    "curve.parameter=load", "curve.parameter=clearance", "curve.parameter=damping",
    "curve.start=0", "curve.stop=0", "curve.stop=2000", "curve.stability=false",
    "integration.method=events", "integration.method=euler",
    "integration.method=exponential", "reduction.method=massless",
    "integration.steps_per_period=1", "integration.steps_per_period=100", "integration.settle=none",
    "sweep.over={}", "sweep.over={'crack.length'=[1]}", "mesh.file=a.msh", "mesh.layout=file",
    "crack.first_omega=2000", "crack.clearance=1e-6", "crack.clearance=-1e-6", "\ud800=1",
    "excitation.frequency=300", "curve.parameter=frequency", "loads.1.edge=top",
    "loads.1.pressure_sin=1", "loads.1.point=[0.05,0.1]", "loads.2.force_cos=[1,0]", "loads=none",
    "base.acceleration_sin=[1,0]", "base.acceleration_cos=[1e-6,0]", "structure.mass=a",
    "structure.stiffness=b", "structure.force_sin=c", "reduction=off",
    "harmonic_balance.tolerance=0.1", "excitation.point=none",
    "mesh.file=\udcff", "crack.edge=a\nb", "geometry.width=1e-7", "geometry.thickness=none",
]  # fmt: skip


def market(array: Any) -> bytes:
    """A Matrix Market file of an array."""
    columns = np.atleast_2d(np.asarray(array, dtype=float).T).T
    sizes = " ".join(map(str, columns.shape))
    numbers = "\n".join(repr(float(value)) for value in columns.T.ravel())
    return f"%%MatrixMarket matrix array real general\n{sizes}\n{numbers}\n".encode()


def make_base(folder: Path) -> None:
    """Scenes, meshes, matrices, tables and results that are right."""
    folder.mkdir(parents=True)
    loads = PLATE.index("[material]")
    of_file = "[geometry]\nthickness = 0.01\n[crack]\n# clearance = 1e-6\n" + PLATE[loads:]
    grid = of_file.index("[mesh]"), of_file.index("[harmonic_balance]")
    of_file = (
        of_file[: grid[0]] + '[mesh]\nlayout = "file"\nfile = "plate.msh"\n' + of_file[grid[1] :]
    )
    of_file = of_file.replace("point = [0.1, 0.1]\n", "")
    texts = {
        "plate.toml": PLATE + ORDER, "rotor.toml": PLATE.replace("omega = 2000.0", "order = 20")
        + ROTOR, "file.toml": of_file + ORDER, "chain.toml": CHAIN + OF_CHAIN,
        "measured.csv": MEASURED, "wheel.toml": WHEEL, "wave.csv": WAVE,
        "friction.toml": PLATE.replace("[contact]", CONTACT) + ORDER + FRICTION,
        "wave.toml": PLATE.replace("force_sin = [1.0, 0.0]", OF_WAVE) + ORDER,
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    fc.write_msh(fc.Scene.load(folder / "plate.toml"), folder / "plate.msh")
    with_gmsh(folder)
    ring = 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    parts = {
        "mass": np.diag([1.0, 2.0, 1.0]), "stiffness": ring, "force": [1.0, 0.0, 0.0],
        "gap": np.eye(3)[:, :2], "clearance": [0.1, 0.0], "damping": 0.1 * ring,
    }  # fmt: skip
    for name, part in parts.items():
        content = market(part)
        (folder / f"{name}.mtx").write_bytes(content)
        (folder / f"{name}.mtx.gz").write_bytes(gzip.compress(content, mtime=0))
        (folder / f"{name}.mtx.bz2").write_bytes(bz2.compress(content))
    for name, command in itertools.product(("plate", "chain"), ("modes", *OF_SCENES[2:])):
        if command != "verify":
            code, errors = call(
                [command, str(folder / f"{name}.toml"), "--output", str(folder / name)]
            )
            if code not in (0, 3, 4):
                raise RuntimeError(errors)
    solution = folder / "plate" / "solution.h5"
    assert (
        call(["timing", str(folder / "plate.toml"), str(solution), "--output", str(folder)])[0] == 0
    )
    massless = {"reduction.method": "massless", "reduction.modes": 4, "mesh.order": 2}
    prepared_plate = fc.prepare(fc.Scene.load(folder / "plate.toml").replace(massless))
    fc.save_prepared(prepared_plate, folder / "prepared.h5")
    (folder / COMPLETE).touch()


def with_gmsh(folder: Path) -> None:
    """The mesh in an older format, and in binary."""
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(folder / "plate.msh"))
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(folder / "plate_binary.msh"))
        gmsh.option.setNumber("Mesh.Binary", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
        gmsh.write(str(folder / "plate_22.msh"))
    finally:
        gmsh.finalize()


# --- inputs ---------------------------------------------------------------------------------------


def damaged_input(
    rng: random.Random, folder: Path, kind: Callable[..., Any] | None = None
) -> tuple[str, list[str]]:
    """Damage one file in a folder with copies of all; what has been done, and the words of a
    command that reads it."""
    kind = kind or rng.choices(*zip(*KINDS.items(), strict=True))[0]
    description, words = kind(rng, folder)
    if words[0] not in ("check", "new", "report"):
        words = [*words, "--output", str(folder / "out")]
    if rng.random() < 0.1:
        words.append(rng.choice(["--quiet", "--verbose", "--format=json", "--format=csv"]))
    return description, words


def _run_scene(name: str, rng: random.Random, folder: Path) -> list[str]:
    """A command on a scene."""
    path = str(folder / name)
    commands = [*OF_SCENES, "identify", "timing", "campbell", "plot"]
    command = rng.choice(["check", "modes", "solve", *commands])
    options_by_command = {
        "modes": ["--count", "3"],
        "campbell": ["--count", "2", "--speeds", "0", "100", "3"],
        "identify": [str(folder / "measured.csv")],
        "timing": rng.choice([[], [str(folder / "plate" / "solution.h5")]]),
    }
    return [command, path, *options_by_command.get(command, [])]


def _scene(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    name = rng.choice(SCENES)
    path = folder / name
    if rng.random() < 0.1:
        path.write_bytes(changed_bytes(path.read_bytes(), rng))
    else:
        text = changed_text(path.read_text(encoding="utf-8"), rng)
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
    return name, _run_scene(name, rng, folder)


def _mesh(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    name = rng.choice(MESHES)
    content = (folder / name).read_bytes()
    change_content = changed_bytes if "binary" in name and rng.random() < 0.8 else changed_file
    (folder / "plate.msh").write_bytes(change_content(content, rng))
    command = rng.choice(["check", "check", "modes", "solve", "plot"])
    return name, [command, str(folder / "file.toml")]


def _matrix(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    name = rng.choice(["mass", "stiffness", "gap", "force", "clearance", "damping"])
    scene = folder / "chain.toml"
    text = scene.read_text()
    if name == "damping":
        text = text.replace("# damping", "damping").replace("[damping]\nratio = 0.02\n", "")
    packing_suffix = rng.choice(["", ".gz", ".bz2"])
    for suffix in ("", ".gz", ".bz2"):
        text = text.replace(f'"{name}.mtx{suffix}"', f'"{name}.mtx{packing_suffix}"')
    scene.write_text(text)
    path = folder / f"{name}.mtx{packing_suffix}"
    if packing_suffix and rng.random() < 0.5:
        path.write_bytes(changed_bytes(path.read_bytes(), rng))
    else:
        content = changed_file((folder / f"{name}.mtx").read_bytes(), rng, MARKET_WORDS)
        path.write_bytes(
            {".gz": gzip.compress, ".bz2": bz2.compress}.get(packing_suffix, bytes)(content)
        )
    return path.name, [rng.choice(["check", *OF_SCENES]), str(scene)]


def _wheel(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    """A scene of a wheel, of harmonics or friction, its text or a table that it names damaged, or
    changed by words."""
    name, kind = rng.choice(WHEELS), rng.random()
    path = folder / name
    if kind < 0.4:
        text = changed_text(path.read_text(encoding="utf-8"), rng)
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
    elif kind < 0.5:
        name, table = "wave.csv", folder / "wave.csv"
        path = folder / "wave.toml"
        if rng.random() < 0.3:
            table.write_bytes(changed_bytes(table.read_bytes(), rng))
        else:
            table.write_text(changed_table(WAVE, rng), errors="surrogatepass")
    commands = [*OF_SCENES, "check", "solve", "disk", "disk", "plot", "campbell", "timing"]
    command = rng.choice(commands)
    words = [command, str(path)]
    if command == "campbell":
        words += ["--count", "2", "--speeds", "0", "100", "3"]
    if command == "disk":
        words += rng.sample(OF_DISKS, rng.choice([0, 1, 1, 2]))
    if kind >= 0.5 and command != "plot":
        of_disk = name == "wheel.toml" or rng.random() < 0.1
        changes = [one for one in OF_WHEELS if of_disk or not one.startswith("disk")]
        for change in rng.sample(changes, rng.choice([0, 1, 1, 1, 2, 3])):
            words += ["--set", change]
    return name, words


def _measurements(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    path = folder / "measured.csv"
    path.write_text(changed_table(MEASURED, rng), errors="surrogatepass")
    return path.name, ["identify", str(folder / "plate.toml"), str(path)]


def _arrivals(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    path, scene = folder / "arrivals.csv", str(folder / "plate.toml")
    path.write_text(changed_table(path.read_text(), rng), errors="surrogatepass")
    words = ["timing", scene, str(path)]
    if rng.random() < 0.2:
        words = ["identify", scene, "--arrivals", str(path)]
    return path.name, words


def _result(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    path = rng.choice(sorted(folder.glob("*/*.h5")))
    is_forged = rng.random() < 0.6
    if is_forged:
        change_result(path, rng)
    else:
        path.write_bytes(changed_bytes(path.read_bytes(), rng))
    scene, command = (
        str(folder / f"{path.parent.name}.toml"),
        rng.choice(["plot", "plot", "report"]),
    )
    words = [command, str(path)]
    if command == "report":
        words += ["--output", str(folder / "report.html")]
    if path.stem in ("solution", "curve") and rng.random() < 0.2:
        words = ["timing", scene, str(path)]
    if path.stem == "solution" and rng.random() < 0.1:
        words = ["identify", scene, "--arrivals", str(path)]
    if path.stem == "sweep" and rng.random() < 0.3:  # it goes on with it
        (folder / "out").mkdir()
        shutil.copy(path, folder / "out")
        words = ["sweep", scene]
    return f"{path.name} {'forged' if is_forged else 'damaged'}", words


def _words(rng: random.Random, folder: Path) -> tuple[str, list[str]]:
    if rng.random() < 0.1:
        places = ["new.toml", "plate.toml", "plate", "a\0b", "\udcff.toml", "x/y/z.toml", "a" * 300]
        return "words", ["new", str(folder / rng.choice(places))]
    words = _run_scene(rng.choice(SCENES), rng, folder)
    for _ in range(rng.choice([1, 1, 2, 3])):
        words += ["--set", rng.choice(SETTINGS)]
    odd_options = [
        "--count=0",
        "--count=1e3",
        "--count=1000",
        "--format=xml",
        "--wrong",
        "",
        "--help",
    ]
    if rng.random() < 0.1:
        words.insert(rng.randrange(len(words)), rng.choice(odd_options))
    return "words", words


KINDS: dict[Callable[[random.Random, Path], tuple[str, list[str]]], int] = {
    _scene: 30, _mesh: 10, _matrix: 12, _measurements: 6, _arrivals: 6, _result: 26, _words: 10,
}  # fmt: skip
"""Ways to damage an input, and how often each is taken."""


# --- structures -----------------------------------------------------------------------------------

DAMPINGS = {
    "all modes": "ratio = 0.02",
    "the first mode": "ratio = 0.02\nmodes = 1",
    "mode by mode": "ratio = {ratios}",
    "none": "ratio = 0.0",
    "mass": "mass = 0.05",
    "stiffness": "stiffness = 0.02",
    "mass and stiffness": "mass = 0.05\nstiffness = 0.02",
    "two ratios": "ratios = [0.02, 0.03]\nomegas = [0.5, 1.0]",
    "a matrix": "",
}
LAWS = {"penalty": "stiffness = 10.0", "unilateral": "law = 'unilateral'"}
EVERY_COMMAND = (*OF_SCENES, "campbell", "timing", "identify")
REFUSED = {"campbell": "rotation", "timing": "tip_timing", "identify": "measurements"}
"""Commands that need what a structure does not have, and what they ask for."""
FORMS = [
    (dofs, pairs, damping, law, free, command)
    for dofs in range(1, 11)
    for pairs in range(dofs + 1)
    for damping, law, free in itertools.product(
        DAMPINGS, LAWS if pairs else ["none"], (False, True)
    )
    for command in EVERY_COMMAND
]
"""All that are tried: in the order of the case numbers, mixed, so that the first are a sample."""
random.Random(0).shuffle(FORMS)


def small_structure(form: tuple[Any, ...], folder: Path) -> tuple[str, list[str]]:
    """Write a structure's files; what it is, and the words of the command."""
    dofs, pairs, damping, law, is_free, command = form
    rng = np.random.default_rng(dofs)
    springs = rng.uniform(1.0, 3.0, dofs + 1)
    if is_free:
        springs[[0, -1]] = 0.0
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    gap = np.eye(dofs)[:, :pairs]  # to the ground, and every other one between two masses
    gap[np.arange(0, pairs - 1, 2), np.arange(1, pairs, 2)] = -1.0
    parts = {
        "mass": np.diag(rng.uniform(1.0, 2.0, dofs)), "stiffness": stiffness,
        "force": rng.normal(size=dofs), "gap": gap, "damping": 0.02 * stiffness,
    }  # fmt: skip
    for name, part in parts.items():
        (folder / f"{name}.mtx").write_bytes(market(part))
    lines = ["[structure]", "mass = 'mass.mtx'", "stiffness = 'stiffness.mtx'"]
    lines += ["force_sin = 'force.mtx'"]
    if pairs:
        lines += ["gap = 'gap.mtx'", "[contact]", LAWS[law]]
    if damping == "a matrix":
        lines.insert(1, "damping = 'damping.mtx'")
    else:
        ratios = [0.01 * (place + 1) for place in range(dofs)]
        lines += ["[damping]", DAMPINGS[damping].format(ratios=ratios)]
    of_chain = OF_CHAIN[OF_CHAIN.index("[harmonic_balance]") :]
    text = "\n".join([*lines, "[excitation]", "omega = 0.9", of_chain])
    if damping == "none":  # curves of what nothing damps are long
        text = text.replace("stop = 0.9", "stop = 0.82\nstability = false")
    (folder / "small.toml").write_text(text)
    words = [command, str(folder / "small.toml")]
    if command != "check":
        words += ["--output", str(folder / "out")]
    end_condition = "free" if is_free else "fixed"
    return f"{dofs} dofs, {pairs} pairs, {damping}, {law}, {end_condition}, {command}", words


def expected(form: tuple[Any, ...]) -> str:
    """The key that a command refuses a structure by; empty where it does not."""
    _, pairs, _, law, _, command = form
    if command in ("curve", "integrate") and not pairs:
        return "structure.gap"
    if command == "curve" and law == "unilateral":
        return "contact.law"
    return REFUSED.get(command, "")


# --- calls ----------------------------------------------------------------------------------------

ODD: list[Any] = [
    None, "", "x", b"x", [], [[]], {}, {"a": 1}, {1: 2}, object(), len, int, range(3), True, 0.0,
    -1.0, 1, 1j, 7, 1000, 10**9, 2**63, 10**400, -(10**400), 1e-30, 1e30, float("nan"), np.inf,
    "1e5", Path("missing"), "/", ".", "a\0b", [1, 2, 3], [1, None, 3], ["1", "2"], [[1], [2, 3]],
    np.array([object()]), np.array(["a", "b"]), np.datetime64("2020"), np.ones(3), np.ones((3, 2)),
    np.eye(6), np.zeros((0, 0)), np.zeros(0), np.full((3, 3), np.nan), np.eye(3) * 1j,
    np.float32(1), np.int8(3), np.bool_(True), (1, 2), {1: (1.0, None)}, {2: ([1.0], [2.0, 3.0])},
    fc.UnilateralConstraint(), fc.UnilateralPenalty(1e6), fc.ModalDamping(0.1), fc.Scene, fc,
]  # fmt: skip
"""Objects that somebody may give a function, and that most refuse."""
CALLS: dict[str, tuple[str, ...]] = {
    "Scene.schema": (), "Scene.load": ("path", "changes"), "Scene.from_mapping": ("tables",),
    "scene.replace": ("changes",), "solve": ("scene",), "prepare": ("scene",), "curve": ("scene",),
    "nodal_diameters": ("wheel_scene", "families"), "blades": ("run", "dof"),
    "amplification": ("wheel_scene", "patterns", "deviation", "seed"),
    "reduce_wheel": ("wheel", "families"), "arrivals_of_blades": ("wheel_scene", "source"),
    "write_record": ("blades", "path", "probes"), "draw_wheel": ("solution",),
    "draw_nodal_diameters": ("diameters",), "draw_amplification": ("amplified",),
    "draw_blades": ("response",), "load_harmonics": ("time", "values", "harmonics"),
    "structure.with_added_load_harmonics": ("by_order",), "structure.with_tangential_pairs": (),
    "CoulombFriction": ("contact", "friction"), "UnilateralPenalty": ("stiffness",),
    "draw_friction_loops": ("solution",), "draw_mesh": ("structure",),
    "solve_harmonic_balance": ("structure", "omega", "contact"),
    "continue_frequency": ("structure", "omega", "omega_end", "contact"),
    "run_sweep": ("scene", "path"), "load": ("path",), "load_run": ("path",), "save": ("solution",),
    "read_record": ("path",),
}  # fmt: skip
"""Functions and methods, and which of their arguments are given."""


def changed_call(rng: random.Random, folder: Path) -> tuple[str, Callable[[], object]]:
    """A call with other objects for some arguments: its words, and what calls it."""
    name = rng.choice(sorted(CALLS))
    scene = fc.Scene.load(folder / rng.choice(WHEELS))
    of_wheel = fc.Scene.load(folder / "wheel.toml")
    make_argument_by_name: dict[str, Callable[[], Any]] = {
        "scene": lambda: scene, "wheel_scene": lambda: of_wheel, "tables": dict,
        "path": lambda: folder / "wheel.toml", "changes": dict, "families": lambda: 1,
        "patterns": lambda: 3, "deviation": lambda: 0.01, "seed": lambda: 1,
        "wheel": lambda: fc.build_structure(of_wheel), "run": lambda: fc.solve(of_wheel),
        "dof": lambda: 0, "solution": lambda: fc.solve(scene).result, "source": lambda: None,
        "response": lambda: fc.curve(of_wheel).result, "probes": lambda: [0.0, 0.3],
        "diameters": lambda: fc.nodal_diameters(of_wheel), "blades": dict, "time": lambda: [0, 1],
        "amplified": lambda: fc.amplification(of_wheel, patterns=2), "values": lambda: [1.0, -1.0],
        "harmonics": lambda: 3, "by_order": lambda: {2: (None, None)}, "friction": lambda: 0.1,
        "structure": lambda: fc.build_structure(scene),
        "contact": lambda: fc.prepare(scene).contact, "stiffness": lambda: 1e6,
        "omega": lambda: 2000.0, "omega_end": lambda: 2001.0,
    }  # fmt: skip
    names = CALLS[name]
    odd_arguments = {
        argument_name: rng.choice(ODD)
        for argument_name in rng.sample(names, min(len(names), rng.choice([0, 1, 1, 2])))
    }
    more_arguments = (
        {f"{rng.choice(['harmonic', 'modes', 'comm', 'x'])}": 1} if rng.random() < 0.1 else {}
    )

    def attempt() -> object:
        owner, _, method = name.rpartition(".")
        place = {"Scene": lambda: fc.Scene, "": lambda: fc}.get(owner) or make_argument_by_name[
            owner
        ]
        arguments = {
            one: odd_arguments[one] if one in odd_arguments else make_argument_by_name[one]()
            for one in names
        }
        return getattr(place(), method)(*arguments.values(), **more_arguments)

    return (
        f"{name}({', '.join(f'{key}={type(x).__name__}' for key, x in odd_arguments.items())})",
        attempt,
    )


METHODS = (
    "Scene.load", "Scene.from_text", "Scene.from_mapping", "Structure.from_matrices",
    "RayleighDamping.from_ratios", "Measurements.read", "Measurements.from_arrays",
    "Measurements.from_csv", "Measurements.from_responses", "ArrivalTimes.from_csv",
    *(f"{name}.load" for name in ("Amplification", "Campbell", "Growth", "NodalDiameters",
                                  "SweepResult", "Timing", "Verification")),
)  # fmt: skip
"""Functions of classes that are meant to be called."""
CONSTRUCTORS = (
    "Problem", "Continuation", "UnilateralPenalty", "UnilateralConstraint", "SmoothedPenalty",
    "CoulombFriction", "ModalDamping", "RayleighDamping", "ArrivalTimes", "Measurement",
    "Measurements", "Wheel", "Wave",
)  # fmt: skip
"""Classes of which users make instances; of all others functions do."""


@functools.cache
def argument_values() -> dict[str, Any]:
    """Values that fit arguments by their names, of a small structure."""
    structure, law = common.two_masses(), fc.UnilateralPenalty(5.0)
    solution = fc.solve_harmonic_balance(structure, 0.7, law)
    curve = fc.continue_frequency(structure, 0.5, 0.52, law, harmonics=3)
    scene = fc.Scene.from_text(PLATE)
    time, marks = np.linspace(0.01, 1.99, 4).reshape(2, 2), np.array([0.0, 1.0, 2.0])
    arrivals = fc.ArrivalTimes(time, marks, np.array([0.1, 3.0]), 0.5)
    folder = tempfile.mkdtemp(prefix="fenics_crack-calls-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return {
        "structure": structure, "contact": law, "law": law, "omega": 0.7, "solution": solution,
        "curve": curve, "problem": fc.Problem(structure, 0.7, law, 5), "scene": scene,
        "modes": 2, "count": 2, "dof": 0, "omega_start": 0.5, "omega_end": 0.52, "start": 0.5,
        "end": 0.52, "parameter": "omega", "periods": 2, "steps_per_period": 32, "orders": (1, 2),
        "path": Path(folder) / "file", "folder": Path(folder), "arrivals": arrivals, "time": time,
        "marks": marks, "probes": [0.1, 3.0], "tip_radius": 0.5, "harmonics": 3, "laws": {"a": law},
        "closing": np.linspace(-1.0, 1.0, 5), "x": np.arange(3.0), "y": np.arange(2.0),
        "result": solution, "tables": {}, "text": PLATE, "mass": np.eye(2), "stiffness": np.eye(2),
        "gap": [1.0, 0.0], "ratio": 0.1, "ratios": [0.1, 0.2], "omegas": [1.0, 2.0], "low": 0.1,
        "high": 0.5, "speeds": [0.0, 10.0], "speed": 3.0, "order": 1, "tip": 0, "stop": 0.9,
        "blades": {1: arrivals}, "sizes": [4.0, 2.0, 1.0], "quantity": "frequency_open",
        "value": 1.0, "deviation": 0.1, "rows": (), "sharpness": 100.0, "coefficient": 0.3,
        "label": "a", "points": [[0.0, 0.0]], "passages": (), "x_label": "x",
        "y_label": "y", "value_label": "z", "settle": 0, "near": None, "deviations": [0.1],
        "values": [1.0, 1.1, 1.12], "curves": {"a": np.arange(3.0)}, "waves": [], "changes": {},
    }  # fmt: skip


def public_call(rng: random.Random, folder: Path) -> tuple[str, Callable[[], object]]:
    """A call of any public name with another object for one or two arguments."""
    functions = [name for name in fc.__all__ if not isinstance(getattr(fc, name), type)]
    name = rng.choice([*functions, *METHODS, *CONSTRUCTORS])
    function = functools.reduce(getattr, name.split("."), fc)
    value_by_name, arguments, parameter_names = argument_values(), {}, []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        parameter_names.append(parameter.name)
        if parameter.name in value_by_name and parameter.default is parameter.empty:
            arguments[parameter.name] = value_by_name[parameter.name]
        elif parameter.default is parameter.empty:
            arguments[parameter.name] = rng.choice(ODD)
    if "draw_" in name:
        parameter_names.append("path")
    damaged_names = rng.sample(parameter_names, min(len(parameter_names), rng.choice([1, 1, 2])))
    arguments |= {
        parameter_name: rng.choice(ODD)
        for parameter_name in damaged_names
        if parameter_name != "comm" or rng.random() < 0.3
    }

    def attempt() -> object:
        return function(**arguments)

    words = ", ".join(
        f"{key}={value!r}"[:40] for key, value in arguments.items() if key in damaged_names
    )
    return f"{name}({words})", attempt


def called(attempt: Callable[[], object]) -> tuple[int, str]:
    """How a call ends, as an exit code and the last line of the program would say it: a result, an
    InputError or a TypeError of the arguments themselves, or what did not converge."""
    try:
        attempt()
    except fc.InputError as error:
        return 2, f"fenics-crack: {error}"
    except fc.ConvergenceError as error:
        return 3, str(error)
    except Exception as error:
        *_, frame = traceback.extract_tb(error.__traceback__)
        if isinstance(error, TypeError) and frame.name in ("attempt", "call"):  # as of any function
            return 2, f"fenics-crack: {error}"
        return (1, f"{type(error).__name__}: {error} ({Path(frame.filename).name}:{frame.lineno})")
    return 0, ""


# --- the program, in a process of its own ---------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """How a case ended."""

    part: str
    case: int
    what: str
    outcome: str
    seconds: float
    mebibytes: float
    message: str

    @property
    def wrong(self) -> bool:
        """Whether this is what the program never does."""
        return self.outcome in WRONG


def call(words: list[str]) -> tuple[int, str]:
    """Exit code and standard error of the program."""
    errors, earlier_stderr = io.StringIO(), sys.__stderr__
    sys.__stderr__ = errors  # type: ignore[misc]
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            try:
                code = int(main(words))
            except SystemExit as ending:  # argparse
                code = int(ending.code or 0)
    finally:
        sys.__stderr__ = earlier_stderr  # type: ignore[misc]
    return code, errors.getvalue()


def outcome_of(code: int, errors: str, noise: str) -> tuple[str, str]:
    """The outcome of a call, and what was said."""
    lines = errors.strip().splitlines()
    last_line = lines[-1] if lines else ""
    if code not in CODES or ("Traceback" in errors and code != 2):
        return "RAW", f"exit code {code}: {last_line}"
    if noise.strip():
        return "RAW", f"a library says: {noise.strip().splitlines()[0]}"
    if code == 2 and "for example:" in lines:  # lines to paste
        lines = lines[: lines.index("for example:")]
        last_line = lines[-1]
    message_lines = [line for line in lines if line.startswith("fenics-crack: ")]
    of_keys = len(message_lines) > 1 and all(
        re.search(": must be |: not allowed|: give ", line) for line in message_lines
    )
    if (
        code == 2
        and "usage: " not in errors
        and message_lines != (lines if of_keys else [last_line])
    ):
        return "RAW", f"{len(lines)} lines: {' | '.join(lines)}"
    return CODES[code], last_line if code else ""


def solve_prepared(path: Path) -> object:
    """Solve a prepared structure."""
    return fc.solve(fc.load_prepared(path))


def read_sweep(path: Path) -> object:
    """Read a sweep, its table and the waves of its cases."""
    sweep = fc.SweepResult.load(path)
    case_indices = np.argwhere(sweep.converged).tolist()
    return sweep.table(), [sweep.gap(tuple(case_index)) for case_index in case_indices]


STORED: dict[str, Callable[[Path], object]] = {
    "prepared.h5": solve_prepared, "plate/sweep.h5": read_sweep, "timing.h5": fc.Timing.load,
}  # fmt: skip
"""Files that results are read from, and what reads them."""


def forged_file(rng: random.Random, folder: Path) -> tuple[str, Callable[[], object]]:
    """A file of ``reduce``, a sweep or a result by itself, forged or damaged.

    Its scene stays, which may ask for a computation of any length.
    """
    name = rng.choice([*STORED, "prepared.h5"])
    path = folder / name
    if rng.random() < 0.75:
        change_result(path, rng, but="scene")
    else:
        path.write_bytes(changed_bytes(path.read_bytes(), rng))
    return name, partial(STORED[name], path)


CALLERS = {"calls": changed_call, "names": public_call, "files": forged_file}
"""Parts that call Python."""


def draw(
    part: str, case: int, seed: int, folder: Path
) -> tuple[str, list[str] | Callable[[], object]]:
    """The files of a case in a folder, and the command or the call."""
    if part == "structures":
        return small_structure(FORMS[case % len(FORMS)], folder)
    rng = random.Random(f"{seed} {case}")
    if part in CALLERS:
        return CALLERS[part](rng, folder)
    return damaged_input(rng, folder, _wheel if part == "wheels" else None)


def work(connection: Connection, base: Path, folder: Path) -> None:
    """The process that tries cases until it is told to end."""
    os.setsid()
    folder.mkdir(parents=True, exist_ok=True)
    log = os.open(folder.with_suffix(".log"), os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 2)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    np.seterr(all="ignore")
    at_rest = _memory("VmRSS:")
    memory_limit = int(_memory("VmSize:") + 2 * BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (memory_limit, memory_limit))
    while (request := connection.recv()) is not None:
        part, case, seed = request
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(base, folder)
        description, words = draw(part, case, seed, folder)
        connection.send(description if callable(words) else f"{description}: {' '.join(words)}")
        os.ftruncate(log, 0)
        os.lseek(log, 0, os.SEEK_SET)
        Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        start_time = _processor_time()
        code, errors = called(words) if callable(words) else call(words)
        seconds, peak = _processor_time() - start_time, _memory("VmHWM:") - at_rest
        noise = os.pread(log, 10_000, 0).decode(errors="replace")
        outcome, message = outcome_of(code, errors, noise)
        if outcome == "refused" and part == "structures":
            key = expected(FORMS[case % len(FORMS)])
            if not (key and message.startswith(f"fenics-crack: {key}")):
                outcome = "RAW"
        if outcome not in WRONG and peak > PART_MEMORY.get(part, BYTES):
            outcome = "TOO LARGE"
        if outcome not in WRONG and seconds > QUICK.get(part, SECONDS):
            outcome = "TOO LONG"
        connection.send(
            Outcome(part, case, description, outcome, seconds, peak / 2**20, message[:SHOWN])
        )


def _memory(name: str) -> float:
    """Of this process [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def _processor_time() -> float:
    """Of this process and of those that it has started and that have ended [s]."""
    process_times = os.times()
    return (
        process_times.user
        + process_times.system
        + process_times.children_user
        + process_times.children_system
    )


class Trial:
    """Tries cases in another process, which is started again where it ends."""

    def __init__(self, base: Path, folder: Path) -> None:
        self._base, self.folder = base, folder
        self._process: Any = None
        self._before = 0.0

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._process is not None:
            self._connection.send(None)
            self._process.join()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, child_connection = context.Pipe()
        self._process = context.Process(
            target=work, args=(child_connection, self._base, self.folder)
        )
        self._process.start()
        child_connection.close()

    def _end(self) -> None:
        """End the process and those it has started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.join()
        self._process = None

    def attempt(self, part: str, case: int, seed: int) -> Outcome:
        """One case."""
        if self._process is None:
            self._start()
        self._before = 0.0
        self._before = self._used()
        self._connection.send((part, case, seed))
        description, begun = "", time.monotonic()
        try:
            description = self._connection.recv()
            # Where other work slows the machine down, the clock says little.
            while not self._connection.poll(SECONDS):
                if time.monotonic() - begun > 5 * SECONDS or self._used() > 1.5 * SECONDS:
                    self._end()
                    seconds = time.monotonic() - begun
                    return Outcome(
                        part, case, description, "TOO LONG", seconds, np.nan, description
                    )
            answer = self._connection.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            code, self._process = self._process.exitcode, None
            log = self.folder.with_suffix(".log").read_text(errors="replace")[-SHOWN:]
            message = f"exit code {code}: {description} {' '.join(log.split())}"
            return Outcome(
                part, case, description, "DEATH", time.monotonic() - begun, np.nan, message
            )
        assert isinstance(answer, Outcome)
        return answer

    def _used(self) -> float:
        """Processor time of the process since it began [s]."""
        cells = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, cells[11:15])) / os.sysconf("SC_CLK_TCK") - self._before


def attempts(
    part: str, cases: Iterable[int], seed: int, base: Path, keep: Path | None = None
) -> Iterator[Outcome]:
    """Try cases; the files of those that go wrong are kept in a folder."""
    with tempfile.TemporaryDirectory() as place, Trial(base, Path(place) / "case") as trial:
        for case in cases:
            outcome = trial.attempt(part, case, seed)
            if outcome.wrong and keep is not None:
                kept = keep / f"{part}_{seed}_{case}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(trial.folder, kept, dirs_exist_ok=True)
            yield outcome


# --- the command ----------------------------------------------------------------------------------


def try_part(part: str, arguments: common.Arguments) -> None:
    """Try the cases of a part that the file does not have yet; print what they came to."""
    folder, path = arguments.folder / "fuzzing", arguments.folder / "fuzzing.csv"
    base = (folder / "base").absolute()
    if not (base / COMPLETE).exists():
        shutil.rmtree(base, ignore_errors=True)
        make_base(base)
    max_cases = {"structures": len(FORMS)}.get(part, 10_000)
    count = arguments.cases or (300 if arguments.quick else max_cases)
    cases = range(arguments.first, arguments.first + count)
    rows = _rows(path, part, cases)
    done_cases = {int(row[1]) for row in rows}
    is_new_file = not path.exists()
    with open(path, "a", newline="", encoding="utf-8", errors="backslashreplace") as file:
        writer = csv.writer(file)
        if is_new_file:
            writer.writerow(COLUMNS)
        open_cases = [case for case in cases if case not in done_cases]
        for outcome in attempts(part, open_cases, arguments.seed, base, folder):
            rows.append([str(cell) for cell in vars(outcome).values()])
            writer.writerow(rows[-1])
            file.flush()
            if outcome.wrong:
                print(
                    f"{part} {outcome.case}: {outcome.outcome}: {outcome.what}: {outcome.message}",
                    flush=True,
                )
    counts = Counter(row[3] for row in rows)
    summary = ", ".join(f"{number} {name}" for name, number in counts.most_common())
    slowest, largest_memory = (
        max((float(row[column]) for row in rows), default=0.0) for column in (4, 5)
    )
    print(f"{part}, seed {arguments.seed}: {len(rows)} cases: {summary}")
    print(f"the slowest {slowest:.1f} s of processor time, the largest {largest_memory:.0f} MiB")


def _rows(path: Path, part: str, cases: range) -> list[list[str]]:
    """Rows of a file that is there."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if len(row) == len(COLUMNS)]
    return [row for row in rows[1:] if row[0] == part and int(row[1]) in cases]


if __name__ == "__main__":
    common.run(
        __doc__,
        {
            part: partial(try_part, part)
            for part in ("inputs", "wheels", "calls", "names", "files", "structures")
        },
        cases={"type": int, "help": "how many of each part (default: 10000, all structures)"},
        seed={"type": int, "default": 1},
        first={"type": int, "default": 0, "help": "number of the first case"},
    )
