"""One eighth of a k31 plate in NGSolve, the same mesh and element space as ours; run by tests.benchmarks.forward.

    PYTHON_WITH_NGSOLVE ngsolve_plate.py < problem.json > result.json

It stands alone (NGSolve and numpy, not femu_piezo), so that NGSolve may live in another environment.
"""

import json
import statistics
import sys
import time

import numpy as np


def main() -> None:
    import ngsolve as ng
    from ngsolve.meshes import MakeStructured3DMesh

    task = json.load(sys.stdin)
    length, width, thickness = (value / 2 for value in task["size"])
    nx, ny, nz = task["divisions"]
    ng.SetNumThreads(task["threads"])
    mesh = MakeStructured3DMesh(
        hexes=True, nx=nx, ny=ny, nz=nz, mapping=lambda x, y, z: (x * length, y * width, z * thickness)
    )
    names = _faces(mesh, np.array([length, width, thickness]))
    matrix = np.array(task["constants_real"]) + 1j * np.array(task["constants_imag"])
    c, e, eps = matrix[:6, :6], matrix[6:, :6], -matrix[6:, 6:]
    scale = 1e9
    held = "|".join(names[axis, 0] for axis in range(3))
    hot = names[2, 1]
    displacement = ng.VectorH1(
        mesh,
        order=2,
        complex=True,
        dirichletx=names[0, 0],
        dirichlety=names[1, 0],
        dirichletz=names[2, 0],
    )
    potential = ng.H1(mesh, order=2, complex=True, dirichlet=f"{names[2, 0]}|{hot}")
    space = displacement * potential
    (u, phi), (v, psi) = space.TnT()

    def strain(w):
        g = ng.Grad(w)
        return ng.CF((g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]))

    def constant(values):
        return ng.CF(tuple(complex(x) for x in values.ravel()), dims=values.shape)

    cc, ee, pp = constant(c), constant(e * scale), constant(eps * scale**2)
    fields = (ng.grad(phi), ng.grad(psi))
    start = time.perf_counter()
    stiffness = ng.BilinearForm(space, symmetric=True)
    stiffness += ng.InnerProduct(cc * strain(u), strain(v)) * ng.dx
    stiffness += ng.InnerProduct(ee * strain(u), fields[1]) * ng.dx
    stiffness += ng.InnerProduct(ee * strain(v), fields[0]) * ng.dx
    stiffness += -ng.InnerProduct(pp * fields[0], fields[1]) * ng.dx
    stiffness.Assemble()
    mass = ng.BilinearForm(space, symmetric=True)
    mass += task["density"] * ng.InnerProduct(u, v) * ng.dx
    mass.Assemble()
    assembly = time.perf_counter() - start

    lift = ng.GridFunction(space)
    lift.components[1].Set(1.0 / scale, definedon=mesh.Boundaries(hot))
    operator, solution = stiffness.mat.CreateMatrix(), ng.GridFunction(space)
    load, residual = lift.vec.CreateVector(), lift.vec.CreateVector()
    times, impedance = [], []
    for frequency in task["frequencies"]:
        omega = 2 * np.pi * frequency
        start = time.perf_counter()
        operator.AsVector().data = stiffness.mat.AsVector() - omega**2 * mass.mat.AsVector()
        load.data = -(operator * lift.vec)
        inverse = operator.Inverse(space.FreeDofs(), inverse=task["inverse"])
        solution.vec.data = inverse * load
        solution.vec.data += lift.vec
        residual.data = operator * solution.vec
        times.append(time.perf_counter() - start)
        charge = -ng.InnerProduct(lift.vec, residual, conjugate=False)
        impedance.append(1 / (1j * omega * charge * task["admittance_factor"]))
    json.dump(
        {
            "version": ng.__version__,
            "unknowns": sum(space.FreeDofs()),
            "held": held,
            "assembly_s": assembly,
            "solve_s": statistics.median(times),
            "impedance_real": [z.real for z in impedance],
            "impedance_imag": [z.imag for z in impedance],
        },
        sys.stdout,
    )


def _faces(mesh, size) -> dict:
    """(axis, side) → name of the boundary there."""
    import ngsolve as ng

    coordinates = (ng.x, ng.y, ng.z)
    result = {}
    for name in set(mesh.GetBoundaries()):
        region = mesh.Boundaries(name)
        area = ng.Integrate(ng.CF(1), region)
        means = np.array([ng.Integrate(w, region) / area for w in coordinates]) / size
        axis = int(np.argmax(np.abs(means - 0.5)))
        result[axis, int(means[axis] > 0.5)] = name
    return result


if __name__ == "__main__":
    main()
