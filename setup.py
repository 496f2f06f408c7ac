"""The compiled part of the package; everything else is in pyproject.toml."""

from setuptools import setup

setup(cffi_modules=["fenics_crack/kernel/build.py:builder"])
