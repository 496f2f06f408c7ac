"""Run by a program's own Python for ``score.py``: a case on standard input, its answer as JSON.

    PYTHON benchmarks/orbits/worker.py ADAPTER [HARMONICS]

It solves a small case first, so that what is imported and compiled at first use is not timed.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from problem import Answer, Unsupported, problem_of

WARM = Path(__file__).parent / "cases" / "bilinear-1.json"


def answered(solve: Any, case: dict[str, Any]) -> dict[str, Any]:
    """The answer to a case, and processor time [s]; what went wrong in the program's own words."""
    problem, begin = problem_of(case), time.process_time()
    try:
        answer = solve(problem)
    except Unsupported as error:
        return {"unsupported": str(error)}
    except Exception as error:
        answer = Answer(message=f"{type(error).__name__}: {error}")
    answer_row = {**vars(answer), "seconds": time.process_time() - begin}
    for name in ("gap", "tangential"):
        if answer_row[name] is not None:
            values = np.asarray(answer_row[name], dtype=float)
            answer_row[name] = values.tolist() if np.all(np.isfinite(values)) else None
    return {
        name: value.item() if hasattr(value, "item") else value
        for name, value in answer_row.items()
    }


def main() -> None:
    """Answer one case."""
    sys.path.append(str(Path(sys.argv[1]).parent))  # last: adapters have the names of packages
    spec = importlib.util.spec_from_file_location("adapter", sys.argv[1])
    assert spec is not None and spec.loader is not None
    adapter = importlib.util.module_from_spec(spec)
    with contextlib.redirect_stdout(sys.stderr):
        spec.loader.exec_module(adapter)
        if sys.argv[2:]:
            adapter.HARMONICS = int(sys.argv[2])  # type: ignore[attr-defined]
        answered(adapter.solve, json.loads(WARM.read_text()))
        answer = answered(adapter.solve, json.load(sys.stdin))
    source = getattr(adapter, "SOURCE", ("", ""))[1]
    answer["version"] = source or version(adapter.PACKAGE)
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
