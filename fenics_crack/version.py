"""The version of this program, as pyproject.toml reads it."""

VERSION = "0.2.0"
