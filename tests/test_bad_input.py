"""Every bad input that the program can meet, and the one line that it answers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from helpers import ROOT

from fenics_crack import Scene
from fenics_crack.command_line import main
