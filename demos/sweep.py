"""A sweep over the load's frequency, spread over ranks.

Every rank builds the paper's plate (here with k = 1e9 N/m and xi = 0.01) for itself and solves its
share of the frequencies, each starting from the neighbour that it has just found; rank 0 gathers
one table. A frequency that does not converge stays in the table as such.

    mpirun -n 2 python demos/sweep.py [folder for the results]
"""

import csv
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.plot import draw_response

SCENE = Path(__file__).with_name("paper_plate.toml")
FREQUENCIES = np.arange(1000.0, 4001.0, 50.0)  # rad/s
HARMONICS = 10
COLUMNS = ("omega_rad_per_s", "converged", "opening_m", "corner_m", "linear_corner_m", "status")
Row = tuple[float, bool, float, float, float, str]


def main(output: Path = Path("output/sweep"), frequencies: np.ndarray = FREQUENCIES) -> list[Row]:
    """Solve all frequencies and write table.csv and response.png; return the table on rank 0."""
    comm = MPI.COMM_WORLD
    scene = fc.Scene.load(SCENE).replace({"contact.stiffness": 1e9, "damping.ratio": 0.01})
    assert scene.contact is not None
    plate = fc.build_structure(scene, MPI.COMM_SELF)
    law, corner = fc.contact_law(scene.contact, plate), plate.find_dof((0.1, 0.1), "x")

    mine: list[Row] = []
    neighbour = None
    for omega in np.array_split(frequencies, comm.size)[comm.rank]:
        solution = fc.solve_harmonic_balance(
            plate, float(omega), law, harmonics=HARMONICS, initial=neighbour, throw=False
        )
        neighbour = solution if solution.converged else None
        t = np.linspace(0.0, solution.period, 400)
        opening = corner_motion = np.nan
        if solution.converged:
            opening = float(-solution.gap(t).min())
            corner_motion = float(np.ptp(solution.displacement(t, [corner])) / 2.0)
        linear = fc.solve_linear(plate, float(omega)).displacement(t, [corner])
        mine.append(
            (
                float(omega),
                solution.converged,
                opening,
                corner_motion,
                float(np.ptp(linear) / 2.0),
                solution.status,
            )
        )
    gathered = comm.gather(mine)
    if gathered is None:
        return []
    table = [row for part in gathered for row in part]
    output.mkdir(parents=True, exist_ok=True)
    with open(output / "table.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(table)
    numbers = np.array([row[2:5] for row in table])
    draw_response(
        output / "response.png",
        np.array([row[0] for row in table]),
        {"breathing crack": numbers[:, 1], "linear, crack always open": numbers[:, 2]},
        title=f"Force point of the paper's plate, k = 1e9 N/m, H = {HARMONICS}",
        quantity="half peak-to-peak",
    )
    converged = sum(row[1] for row in table)
    print(f"{comm.size} ranks: {converged} of {len(table)} frequencies converged")
    return table


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/sweep")
    main(folder)
