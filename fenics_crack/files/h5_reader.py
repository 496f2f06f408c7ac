"""Reader of HDF5 files by h5py, in a program of its own
(:mod:`fenics_crack.basics.untrusted_files`).

A damaged file may crash HDF5, and a made one may point to other files or announce any size. Read
are texts as attributes, and words and numbers that are in the file itself. Of a sweep, which is
filled in while it is read, only types, shapes and places of its datasets are read.
"""

import json
import math
import os
from typing import Any

import h5py
import numpy as np

MAX_ENTRIES = 10_000
"""Maximum datasets, attributes, and words of a list."""
SWEEP_KIND = "sweep"
"""Kind of file that is filled in while it is read."""
ALLOWED_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
ALLOWED_LAYOUTS = {h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED}


def read(path: str, most: int) -> dict[str, np.ndarray]:
    """The content as JSON, but for its arrays, which are those without a name of their own."""
    with h5py.File(path, "r", locking=False) as file:
        head, arrays = read_content(file, os.path.getsize(path), most)
    numbered = {f"arr_{number}": array for number, array in enumerate(arrays)}
    return {"head": np.array(json.dumps(head)), **numbered}


def read_content(file: h5py.File, size: int, most: int) -> tuple[dict, list[np.ndarray]]:
    """Attributes, words, names of arrays and places of columns; and the arrays."""
    if max(len(file), len(file.attrs)) > MAX_ENTRIES:
        raise ValueError(f"it has more than {MAX_ENTRIES} parts")
    attributes = read_text_attributes(file)
    items = {name: open_checked_dataset(file, name, size, most) for name in file}
    for name, item in items.items():
        attributes |= {f"{name}/{key}": text for key, text in read_text_attributes(item).items()}
    head: dict[str, Any] = {"attributes": attributes, "words": {}, "arrays": [], "columns": {}}
    if attributes.get("kind") == SWEEP_KIND:
        for name, item in items.items():
            place = item.id.get_offset()
            if place is None or place + stated_bytes(item) > size:
                raise ValueError(f"{name!r} is not in one piece in the file")
            head["columns"][name] = (item.dtype.str, item.shape, place)
        return head, []
    if sum(map(stated_bytes, items.values())) > most:
        raise ValueError(f"its numbers would take more than {most} bytes")
    arrays = []
    for name, item in items.items():
        if h5py.check_string_dtype(item.dtype) is None:
            head["arrays"].append(name)
            arrays.append(item[()])
        else:
            head["words"][name] = read_words(item, most)
    return head, arrays


def read_text_attributes(item: h5py.File | h5py.Dataset) -> dict[str, str]:
    """Its attributes."""
    found = {}
    for name, value in item.attrs.items():
        if not isinstance(value, str):
            raise ValueError(f"its attribute {name!r} is no text")
        value.encode()  # what is no UTF-8 cannot be handed over
        found[name] = value
    return found


def open_checked_dataset(file: h5py.File, name: str, size: int, most: int) -> h5py.Dataset:
    """A dataset whose numbers are in the file itself."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name!r} is a link")
    item = file[name]
    if not isinstance(item, h5py.Dataset):
        raise ValueError(f"{name!r} is no dataset")
    plan = item.id.get_create_plist()
    if plan.get_layout() not in ALLOWED_LAYOUTS or plan.get_external_count():
        raise ValueError(f"{name!r} lies in another file")
    if {plan.get_filter(number)[0] for number in range(plan.get_nfilters())} - ALLOWED_FILTERS:
        raise ValueError(f"{name!r} is packed in an unknown way")
    words = h5py.check_string_dtype(item.dtype)
    if item.shape is None or item.ndim > 8 or (words is None and item.dtype.kind not in "biufcS"):
        raise ValueError(f"{name!r} holds neither numbers nor words")
    if plan.get_layout() != h5py.h5d.CHUNKED:
        if stated_bytes(item) > size:
            raise ValueError(f"{name!r} is larger than the file")
    elif math.prod(item.chunks) * item.dtype.itemsize > most:
        raise ValueError(f"the pieces of {name!r} would take more than {most} bytes")
    return item


def stated_bytes(item: h5py.Dataset) -> int:
    """Bytes that its shape and type announce."""
    return math.prod(item.shape) * item.dtype.itemsize


def read_words(item: h5py.Dataset, most: int) -> str | list[str]:
    """A word, or a list of words, of at most so many bytes."""
    if item.ndim > 1 or item.size > MAX_ENTRIES:
        raise ValueError(f"{item.name!r} is no list of words")
    found = item.asstr()[()]
    many = [found] if isinstance(found, str) else [str(word) for word in found]
    if sum(map(len, many)) > most:
        raise ValueError(f"{item.name!r} is too long")
    return found if isinstance(found, str) else many
