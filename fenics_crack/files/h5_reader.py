"""Read HDF5 files by h5py, in a separate program (:mod:`fenics_crack.basics.untrusted_files`).

A damaged file may crash HDF5, and a malicious file may point to other files or announce any size.
Only text attributes, words and numbers in the file itself are read. A sweep is filled in while it
is read: only types, shapes and offsets are read for its datasets.
"""

import json
import math
import os
from typing import Any

import h5py
import numpy as np

MAX_ENTRIES_IN_FILE = 10_000
"""Maximum number for each: datasets, attributes, and words in a list."""
SWEEP_FILE_KIND = "sweep"
"""Kind in a sweep's file, whose numbers are read later, while cases are added."""
ALLOWED_COMPRESSION_FILTERS = {
    h5py.h5z.FILTER_DEFLATE,
    h5py.h5z.FILTER_SHUFFLE,
    h5py.h5z.FILTER_FLETCHER32,
}
"""Allowed compression filters: HDF5's own."""
ALLOWED_DATASET_LAYOUTS = {h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED}
"""Allowed dataset layouts: data in the file itself."""


def read(path: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return an HDF5 file's contents as arrays by name.

    Parameters
    ----------
    path : str
        The file.
    max_bytes : int [byte]
        Maximum total size for all numbers.

    Returns
    -------
    dict of str to array
        "head": JSON text with the attributes, texts, array names and sweep columns, as in
        :func:`read_contents_and_arrays`. "arr_0", "arr_1", ...: arrays, in the same order as the
        array names.
    """
    with h5py.File(path, "r", locking=False) as file:
        contents, arrays = read_contents_and_arrays(file, os.path.getsize(path), max_bytes)
    array_by_numbered_name = {
        f"arr_{array_index}": array for array_index, array in enumerate(arrays)
    }
    return {"head": np.array(json.dumps(contents)), **array_by_numbered_name}


def read_contents_and_arrays(
    file: h5py.File, file_size: int, max_bytes: int
) -> tuple[dict, list[np.ndarray]]:
    """Read an open file's attributes, texts and arrays.

    A sweep's file is still being written. Instead of a dataset's numbers, the type, shape and
    offset are read.

    Parameters
    ----------
    file : h5py.File
        The open file.
    file_size, max_bytes : int [byte]
        File size, and maximum size for all numbers.

    Returns
    -------
    contents : dict
        "attributes" and "words": texts by name. "arrays": names for the returned arrays. "columns":
        type, shape and offset [byte] by dataset name, for a sweep only.
    arrays : list of array
        Datasets with numbers, in the same order as these names; empty for a sweep.

    Raises
    ------
    ValueError
        The file has contents that no result has, or too many numbers.
    """
    if max(len(file), len(file.attrs)) > MAX_ENTRIES_IN_FILE:
        raise ValueError(f"it has more than {MAX_ENTRIES_IN_FILE} datasets or attributes")
    text_by_attribute = read_text_attributes(file)
    dataset_by_name = {
        name: open_checked_dataset(file, name, file_size, max_bytes) for name in file
    }
    for name, dataset in dataset_by_name.items():
        text_by_attribute |= {
            f"{name}/{attribute_name}": text
            for attribute_name, text in read_text_attributes(dataset).items()
        }
    contents: dict[str, Any] = {
        "attributes": text_by_attribute,
        "words": {},
        "arrays": [],
        "columns": {},
    }
    if text_by_attribute.get("kind") == SWEEP_FILE_KIND:
        for name, dataset in dataset_by_name.items():
            offset = dataset.id.get_offset()
            if offset is None or offset + stated_bytes(dataset) > file_size:
                raise ValueError(f"{name!r} is not contiguous in the file")
            contents["columns"][name] = (dataset.dtype.str, dataset.shape, offset)
        return contents, []
    if sum(map(stated_bytes, dataset_by_name.values())) > max_bytes:
        raise ValueError(f"its numbers would take more than {max_bytes} bytes")
    arrays = []
    for name, dataset in dataset_by_name.items():
        if h5py.check_string_dtype(dataset.dtype) is None:
            contents["arrays"].append(name)
            arrays.append(dataset[()])
        else:
            contents["words"][name] = read_words(dataset, max_bytes)
    return contents, arrays


def read_text_attributes(file_or_dataset: h5py.File | h5py.Dataset) -> dict[str, str]:
    """Return a file's or dataset's attributes by name.

    ValueError unless all are texts.
    """
    text_by_name = {}
    for name, attribute in file_or_dataset.attrs.items():
        if not isinstance(attribute, str):
            raise ValueError(f"its attribute {name!r} is not a text")
        attribute.encode()  # what is no UTF-8 cannot be handed over
        text_by_name[name] = attribute
    return text_by_name


def open_checked_dataset(
    file: h5py.File, name: str, file_size: int, max_bytes: int
) -> h5py.Dataset:
    """Open a dataset after checking that its data are in the file itself.

    Parameters
    ----------
    file : h5py.File
        The open file.
    name : str
        Dataset name.
    file_size, max_bytes : int [byte]
        File size, and maximum data size.

    Raises
    ------
    ValueError
        The name is a link, the data are in another file, or the compression filter is unknown. Or
        the data are larger than ``file_size`` or ``max_bytes`` allow.
    """
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name!r} is a link")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError(f"{name!r} is not a dataset")
    creation_properties = dataset.id.get_create_plist()
    if (
        creation_properties.get_layout() not in ALLOWED_DATASET_LAYOUTS
        or creation_properties.get_external_count()
    ):
        raise ValueError(f"{name!r} is stored in another file")
    if {
        creation_properties.get_filter(filter_index)[0]
        for filter_index in range(creation_properties.get_nfilters())
    } - ALLOWED_COMPRESSION_FILTERS:
        raise ValueError(f"{name!r} is compressed by an unknown filter")
    string_type = h5py.check_string_dtype(dataset.dtype)
    if (
        dataset.shape is None
        or dataset.ndim > 8
        or (string_type is None and dataset.dtype.kind not in "biufcS")
    ):
        raise ValueError(f"{name!r} holds neither numbers nor words")
    if creation_properties.get_layout() != h5py.h5d.CHUNKED:
        if stated_bytes(dataset) > file_size:
            raise ValueError(f"{name!r} is larger than the file")
    elif math.prod(dataset.chunks) * dataset.dtype.itemsize > max_bytes:
        raise ValueError(f"the chunks of {name!r} would take more than {max_bytes} bytes")
    return dataset


def stated_bytes(dataset: h5py.Dataset) -> int:
    """Return a dataset's size [byte] according to its shape and type."""
    return math.prod(dataset.shape) * dataset.dtype.itemsize


def read_words(dataset: h5py.Dataset, max_characters: int) -> str | list[str]:
    """Return the word in a dataset, or the list of words.

    ValueError for more than one dimension, more than 10,000 words, or more than ``max_characters``
    characters.
    """
    if dataset.ndim > 1 or dataset.size > MAX_ENTRIES_IN_FILE:
        raise ValueError(f"{dataset.name!r} is not a list of words")
    word_or_words = dataset.asstr()[()]
    word_list = (
        [word_or_words] if isinstance(word_or_words, str) else [str(word) for word in word_or_words]
    )
    if sum(map(len, word_list)) > max_characters:
        raise ValueError(f"{dataset.name!r} is too long")
    return word_or_words if isinstance(word_or_words, str) else word_list
