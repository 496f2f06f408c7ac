"""The version of this program, as pyproject.toml reads it, and the texts that come with it."""

from importlib import resources

VERSION = "0.4.0"


def read_packaged_text(path: str) -> str:
    """A text of the package, by its path in it."""
    return resources.files("fenics_crack").joinpath(path).read_text("utf-8")
