"""Forms of your own: a cracked plate of graded modulus, whose foot stands on springs.

The mesh is gmsh's, the forms are UFL's; what ParaView shows is in plate.pvd.

    python demos/own_forms.py [folder for the results]
"""

import sys
from contextlib import suppress
from pathlib import Path

with suppress(ImportError):
    import dolfinx_solver  # noqa: F401  DOLFINx of wheels finds MPI through it

import gmsh
import ufl
from dolfinx import fem, io
from mpi4py import MPI

import fenics_crack as fc

try:
    from dolfinx.io import gmsh as gmshio
except ImportError:  # before DOLFINx 0.10
    from dolfinx.io import gmshio

MESH = Path(__file__).parents[1] / "meshes" / "inclined_crack.msh"
FOOT, LOWER, UPPER = 2, 3, 4  # its physical curves


def main(output: Path = Path("output/own_forms"), springs: float = 1e13) -> fc.PeriodicSolution:
    """Solve the plate on springs [N/m^3] near its first resonance, and write the motion."""
    gmsh.initialize(["", "-v", "1"])
    gmsh.open(str(MESH))
    mesh, _, tags, *_ = gmshio.model_to_mesh(gmsh.model, MPI.COMM_WORLD, 0, gdim=2)
    gmsh.finalize()
    if hasattr(fem, "functionspace"):
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    else:  # DOLFINx 0.5
        V = fem.VectorFunctionSpace(mesh, ("Lagrange", 2))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    t, density, nu = 0.01, 7800.0, 0.3
    young = 2e11 * (1.0 - 4.0 * ufl.SpatialCoordinate(mesh)[1])  # half of it at the top
    strain = ufl.sym(ufl.grad(u))
    stress = young / (1 + nu) * (strain + nu / (1 - nu) * ufl.tr(strain) * ufl.Identity(2))
    foot = ufl.ds(domain=mesh, subdomain_data=tags)(FOOT)
    plate = fc.structure_from_forms(
        V,
        t * ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx + t * springs * ufl.inner(u, v) * foot,
        t * density * ufl.inner(u, v) * ufl.dx,
        loads=(None, t * density * 100.0 * v[0] * ufl.dx, None),  # shaken: 100 m/s^2 along x
        crack=(tags, LOWER, UPPER),
        thickness=t,
        damping=fc.ModalDamping(0.005),
    )
    omega = 0.95 * fc.bilinear_frequencies(plate).omega_bilinear[0]
    solution = fc.solve_harmonic_balance(plate, omega, fc.UnilateralPenalty(1e9), tolerance=1e-2)
    output.mkdir(parents=True, exist_ok=True)
    with io.VTKFile(MPI.COMM_WORLD, str(output / "plate.pvd"), "w") as file:
        for time in [frame / 20 * solution.period for frame in range(20)]:
            file.write_function(solution.function(time), time)
    print(plate, fc.solve_modes(plate, 3), solution, sep="\n")
    return solution


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/own_forms"))
