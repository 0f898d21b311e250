"""Poles of one eighth of a plate or bar in NGSolve, the same mesh and order as ours; run by tests.benchmarks.elements.

    PYTHON_WITH_NGSOLVE ngsolve_poles.py < problem.json > result.json

It stands alone (NGSolve, numpy and scipy, not femu_piezo), so that NGSolve may live in another environment.
"""

import json
import sys
import time

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla


def main() -> None:
    import ngsolve as ng
    from ngsolve.meshes import MakeStructured3DMesh

    task = json.load(sys.stdin)
    half, (nx, ny, nz), axis = np.array(task["size"]) / 2, task["divisions"], task["field_axis"]
    ng.SetNumThreads(1)
    start = time.perf_counter()
    mesh = MakeStructured3DMesh(
        hexes=True, nx=nx, ny=ny, nz=nz, mapping=lambda x, y, z: (x * half[0], y * half[1], z * half[2])
    )
    names = faces(mesh, half)
    held = {f"dirichlet{'xyz'[a]}": names[a, 0] for a in range(3)}
    displacement = ng.VectorH1(mesh, order=task["order"], **held)
    potential = ng.H1(mesh, order=task["order"], dirichlet=f"{names[axis, 0]}|{names[axis, 1]}")
    space = displacement * potential
    (u, phi), (v, psi) = space.TnT()
    matrix, scale = np.array(task["constants"]), 1e9

    def strain(w):
        g = ng.Grad(w)
        return ng.CF((g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]))

    def turned(values, rows, columns):
        """Constants of a body poled along x, whose axes go round by one."""
        order6, order3 = ([0, 1, 2, 3, 4, 5], [0, 1, 2]) if axis == 2 else ([2, 0, 1, 5, 3, 4], [2, 0, 1])
        pick = {6: order6, 3: order3}
        values = values[np.ix_(pick[rows], pick[columns])]
        return ng.CF(tuple(float(x) for x in values.ravel()), dims=values.shape)

    c, e, eps = (
        turned(matrix[:6, :6], 6, 6),
        turned(matrix[6:, :6] * scale, 3, 6),
        turned(-matrix[6:, 6:] * scale**2, 3, 3),
    )
    stiffness, mass = ng.BilinearForm(space), ng.BilinearForm(space)
    stiffness += ng.InnerProduct(c * strain(u), strain(v)) * ng.dx
    stiffness += ng.InnerProduct(e * strain(u), ng.grad(psi)) * ng.dx
    stiffness += ng.InnerProduct(e * strain(v), ng.grad(phi)) * ng.dx
    stiffness += -ng.InnerProduct(eps * ng.grad(phi), ng.grad(psi)) * ng.dx
    mass += task["density"] * ng.InnerProduct(u, v) * ng.dx
    stiffness.Assemble(), mass.Assemble()
    free = np.flatnonzero(np.array(list(space.FreeDofs()), dtype=bool))
    k, m = (full(form.mat)[free][:, free].tocsc() for form in (stiffness, mass))
    shift = (2 * np.pi * task["near"]) ** 2
    values = spla.eigsh(k, task["count"], M=m, sigma=shift, return_eigenvectors=False)
    result = {
        "eigenvalues": sorted(values.tolist()),
        "unknowns": int(free.size),
        "seconds": time.perf_counter() - start,
    }
    json.dump(result, sys.stdout)


def full(matrix) -> sp.csr_matrix:
    """An NGSolve matrix for scipy."""
    rows, columns, values = matrix.COO()
    return sp.csr_matrix((np.array(values), (np.array(rows), np.array(columns))), shape=(matrix.height, matrix.width))


def faces(mesh, size) -> dict:
    """(axis, side) → name of the boundary there."""
    import ngsolve as ng

    found = {}
    for name in set(mesh.GetBoundaries()):
        region = mesh.Boundaries(name)
        area = ng.Integrate(ng.CF(1), region)
        means = np.array([ng.Integrate(w, region) / area for w in (ng.x, ng.y, ng.z)]) / size
        axis = int(np.argmax(np.abs(means - 0.5)))
        found[axis, int(means[axis] > 0.5)] = name
    return found


if __name__ == "__main__":
    main()
