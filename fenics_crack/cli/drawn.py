"""Pictures of a result, as they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Drawn:
    """Pictures of a result in a folder.

    Attributes
    ----------
    folder : Path
        Where they are.
    kind : str
        Their kind, "png".
    meshes : bool
        True if files for ParaView are written, too.
    files : dict of Path to str
        What is drawn, with a sentence each; files for ParaView have none.
    notes : list of str
        What is left out, and why.
    """

    folder: Path
    kind: str = "png"
    meshes: bool = False
    files: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __call__(self, name: str, sentence: str, kind: str = "") -> Path:
        """The path of a picture, which has its own kind or that of all."""
        path = self.folder / f"{name}.{kind or self.kind}"
        self.files[path] = sentence
        return path
