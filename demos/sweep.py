"""A sweep over the crack's length and the load's frequency, spread over ranks.

The table of all cases, table.csv, is drawn over the frequency, response.png, and as a map,
map.png. The cases are kept in sweep.h5 as they are solved: a run that was stopped goes on from
there, a complete one only draws again.

    mpirun -n 2 python demos/sweep.py [folder for the results]
"""

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.plot import draw_response
from fenics_crack.sweep import SweepResult, run_sweep

SCENE = Path(__file__).with_name("sweep.toml")


def main(output: Path = Path("output/sweep"), scene: fc.Scene | None = None) -> SweepResult:
    """Solve all cases of a scene, whose axes are crack lengths and frequencies; draw them."""
    result = run_sweep(scene or fc.Scene.load(SCENE), output / "sweep.h5", progress=True)
    if MPI.COMM_WORLD.rank != 0:
        return result
    columns, rows = result.table()
    with open(output / "table.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)
    lengths, omega = (np.array(axis.values) for axis in result.axes)
    draw_response(
        output / "response.png",
        omega,
        {f"crack of {1e3 * lengths[i]:.0f} mm": result["response"][i]
         for i in (0, len(lengths) // 2, len(lengths) - 1)},
        title="Force point of a plate with a breathing crack",
        quantity="half peak-to-peak",
    )  # fmt: skip
    draw_map(output / "map.png", omega, 1e3 * lengths, 1e6 * result["response"])
    peaks = omega[np.nanargmax(np.where(result.converged, result["response"], 0.0), axis=1)]
    print(
        f"{MPI.COMM_WORLD.size} ranks: {np.count_nonzero(result.converged)} of "
        f"{result['state'].size} cases converged; largest response from "
        f"{peaks[0]:.0f} rad/s (crack of {1e3 * lengths[0]:.0f} mm) "
        f"to {peaks[-1]:.0f} rad/s ({1e3 * lengths[-1]:.0f} mm)"
    )
    return result


def draw_map(path: Path, omega: np.ndarray, lengths: np.ndarray, response: np.ndarray) -> None:
    """Draw the response [µm] over frequency [rad/s] and crack length [mm]; white where failed."""
    figure = Figure(figsize=(7.0, 3.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    picture = axes.pcolormesh(omega, lengths, np.log10(response), shading="nearest")
    bar = figure.colorbar(picture, ax=axes, label="half peak-to-peak [µm]")
    decades = np.arange(np.ceil(picture.norm.vmin), np.floor(picture.norm.vmax) + 1.0)
    bar.set_ticks(decades, labels=[f"{10.0**decade:g}" for decade in decades])
    axes.set_xlabel("load frequency [rad/s]")
    axes.set_ylabel("crack length [mm]")
    figure.savefig(path)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/sweep")
    main(folder)
