"""pyvista without mypy, which it would load for a plugin of its own where that is installed: a
third of the time that it takes to load."""

from __future__ import annotations

import sys
from typing import Any

modules: dict[str, Any] = sys.modules
absent = modules.setdefault("mypy", None) is None
try:
    import pyvista
finally:
    if absent:
        del modules["mypy"]

__all__ = ["pyvista"]
