"""Paths and captions for the pictures of a result."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class PictureFiles:
    """Record paths and captions of pictures, drawn into a folder.

    Attributes
    ----------
    folder : Path
        Folder for all files.
    file_format : str
        Ending of the pictures: "png", "pdf" or "svg".
    has_vtk_files : bool
        True if files for ParaView are written, too.
    captions_by_path : dict of Path to str
        Sentence below each picture; empty for files for ParaView.
    notes : list of str
        Pictures left out, with the reasons.
    """

    folder: Path
    file_format: str = "png"
    has_vtk_files: bool = False
    captions_by_path: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __call__(self, file_stem: str, caption: str, file_format: str = "") -> Path:
        """Return the path of a new picture, and record the caption.

        ``file_stem`` is the file's name without ending. ``file_format`` replaces the common format
        for this picture.
        """
        picture_path = self.folder / f"{file_stem}.{file_format or self.file_format}"
        self.captions_by_path[picture_path] = caption
        return picture_path
