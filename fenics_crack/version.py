"""The version of this program, as pyproject.toml reads it, and the texts that come with it."""

from importlib import resources

VERSION = "0.4.0"


def read_packaged_text(path_in_package: str) -> str:
    """Return a text that the package holds, by the path in the package."""
    return resources.files("fenics_crack").joinpath(path_in_package).read_text("utf-8")
