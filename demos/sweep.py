"""A sweep over the crack's length and the load's frequency, spread over ranks.

The table of all cases, table.csv, is drawn over the frequency, response.png, and as a map,
map.png. The cases are kept in sweep.h5 as they are solved: a run that was stopped goes on from
there, a complete one only draws again.

    mpirun -n 2 python demos/sweep.py [folder for the results]
"""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fenics_crack as fc

SCENE = Path(__file__).with_name("sweep.toml")


def main(output: Path = Path("output/sweep"), scene: fc.Scene | None = None) -> fc.SweepResult:
    """Solve all cases of a scene, whose axes are crack lengths and frequencies; draw them."""
    result = fc.run_sweep(scene or fc.Scene.load(SCENE), output / "sweep.h5", progress=True)
    if MPI.COMM_WORLD.rank != 0:
        return result
    result.to_csv(output / "table.csv")
    lengths, omega = (np.array(axis.values) for axis in result.axes)
    fc.draw_response(
        omega,
        {f"crack of {1e3 * lengths[i]:.0f} mm": result["response"][i]
         for i in (0, len(lengths) // 2, len(lengths) - 1)},
        quantity="half peak-to-peak",
        path=output / "response.png",
        title="Force point of a plate with a breathing crack",
    )  # fmt: skip
    fc.draw_map(
        omega,
        1e3 * lengths,
        1e6 * np.where(result.converged, result["response"], np.nan),
        x_label="load frequency [rad/s]",
        y_label="crack length [mm]",
        value_label="half peak-to-peak [µm]",
        path=output / "map.png",
        title="Force point of a plate with a breathing crack",
    )
    peaks = omega[np.nanargmax(np.where(result.converged, result["response"], 0.0), axis=1)]
    print(
        f"{MPI.COMM_WORLD.size} ranks: {np.count_nonzero(result.converged)} of "
        f"{result['state'].size} cases converged; largest response from "
        f"{peaks[0]:.0f} rad/s (crack of {1e3 * lengths[0]:.0f} mm) "
        f"to {peaks[-1]:.0f} rad/s ({1e3 * lengths[-1]:.0f} mm)"
    )
    return result


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/sweep")
    main(folder)
