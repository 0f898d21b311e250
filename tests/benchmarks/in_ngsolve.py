"""The problems that other benchmarks and tests/verification pose to NGSolve, an independent code.

    PYTHON_WITH_NGSOLVE in_ngsolve.py < problem.json > result.json

It needs only NGSolve, numpy and scipy, not femu_piezo, so that NGSolve may be in another environment. Problems:

    "sweep"  impedance of one eighth of a k31 plate, quadratic hexahedra of a grid (tests.benchmarks.forward)
    "poles"  λ of one eighth of a plate or bar on a grid at some order (tests.benchmarks.elements)
    "slab"   λ of a drawn slab on curved tetrahedra, refined geometrically at electrode rims
             (tests.benchmarks.slabs_in_ngsolve)
"""

import json
import statistics
import sys
import time

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

#: The potential is in GV, so that the entries of the matrices are of similar size.
SCALE = 1e9


def sweep(task: dict) -> dict:
    """Impedance at some frequencies, and median time of a solution, s."""
    import ngsolve as ng

    size = np.array(task["size"]) / 2
    ng.SetNumThreads(task["threads"])
    mesh = grid(size, task["divisions"])
    names = faces(mesh, size)
    matrix = np.array(task["constants_real"]) + 1j * np.array(task["constants_imag"])
    space = fields(mesh, 2, {"xyz"[a]: names[a, 0] for a in range(3)}, f"{names[2, 0]}|{names[2, 1]}", complex=True)
    start = time.perf_counter()
    stiffness, mass = forms(space, matrix, task["density"])
    assembly = time.perf_counter() - start
    lift = ng.GridFunction(space)
    lift.components[1].Set(1.0 / SCALE, definedon=mesh.Boundaries(names[2, 1]))
    operator, solution = stiffness.mat.CreateMatrix(), ng.GridFunction(space)
    load, residual = lift.vec.CreateVector(), lift.vec.CreateVector()
    times, impedance = [], []
    for frequency in task["frequencies"]:
        omega = 2 * np.pi * frequency
        start = time.perf_counter()
        operator.AsVector().data = stiffness.mat.AsVector() - omega**2 * mass.mat.AsVector()
        load.data = -(operator * lift.vec)
        solution.vec.data = operator.Inverse(space.FreeDofs(), inverse=task["inverse"]) * load
        solution.vec.data += lift.vec
        residual.data = operator * solution.vec
        times.append(time.perf_counter() - start)
        charge = -ng.InnerProduct(lift.vec, residual, conjugate=False)
        impedance.append(1 / (1j * omega * charge * task["admittance_factor"]))
    return {
        "version": ng.__version__,
        "unknowns": sum(space.FreeDofs()),
        "assembly_s": assembly,
        "solve_s": statistics.median(times),
        "impedance_real": [z.real for z in impedance],
        "impedance_imag": [z.imag for z in impedance],
    }


def poles(task: dict) -> dict:
    """Short-circuit λ, rad²/s²."""
    import ngsolve as ng

    ng.SetNumThreads(1)
    start, size, axis = time.perf_counter(), np.array(task["size"]) / 2, task["field_axis"]
    mesh = grid(size, task["divisions"])
    names = faces(mesh, size)
    held = {"xyz"[a]: names[a, 0] for a in range(3)}
    space = fields(mesh, task["order"], held, f"{names[axis, 0]}|{names[axis, 1]}")
    matrix = np.array(task["constants"])
    if axis == 0:  # poled along x: the axes are permuted cyclically
        turn = [2, 0, 1, 5, 3, 4, 8, 6, 7]
        matrix = matrix[np.ix_(turn, turn)]
    stiffness, mass = (full(one.mat) for one in forms(space, matrix, task["density"]))
    keep = sp.identity(space.ndof, format="csc")[:, np.flatnonzero(np.array(space.FreeDofs()))]
    return {
        "eigenvalues": eigenvalues(stiffness, mass, keep, task),
        "unknowns": keep.shape[1],
        "seconds": time.perf_counter() - start,
    }


def slab(task: dict) -> dict:
    """Short- and open-circuit λ of the part at the positive side of the mirror planes, rad²/s².

    Tetrahedra follow circles by polynomials of the order of the field. Those at electrode rims are divided `levels`
    times, by 0.125 each. Lengths are in mm, so that λ is right where the density is in 1e-6 kg/m³.
    """
    import ngsolve as ng
    from netgen.occ import OCCGeometry

    ng.SetNumThreads(1)
    mesh = ng.Mesh(OCCGeometry(drawing(task)).GenerateMesh(maxh=task["edge"], grading=0.5))
    if task["levels"]:
        mesh.RefineHP(levels=task["levels"], factor=0.125)
    mesh.Curve(task["order"])
    held = {"xyz"[a]: f"mirror_{'xyz'[a]}" for a in task["mirrors"]}
    ground = "mirror_z" if 2 in task["mirrors"] else "ground"
    space = fields(mesh, task["order"], held, f"hot|{ground}")
    stiffness, mass = (full(one.mat) for one in forms(space, np.array(task["constants"]), task["density"] * 1e-6))
    keep = sp.identity(space.ndof, format="csc")[:, np.flatnonzero(np.array(space.FreeDofs()))]
    first = space.components[0].ndof
    together = np.zeros((space.ndof, 1))  # the constant on the hot electrode, of the functions of its vertices
    together[[first + v.nr for element in mesh.Boundaries("hot").Elements() for v in element.vertices]] = 1.0
    return {
        "short": eigenvalues(stiffness, mass, keep, task),
        "open": eigenvalues(stiffness, mass, sp.hstack([keep, sp.csc_matrix(together)], format="csc"), task),
        "unknowns": keep.shape[1],
        "volume": ng.Integrate(ng.CF(1), mesh),
        "hot": ng.Integrate(ng.CF(1), mesh.Boundaries("hot")),
    }


def drawing(task: dict):
    """The computed part as a solid in mm, with named faces and with electrode rims marked for refinement."""
    from netgen.occ import Box, Glue, Pnt

    half, mirrors = task["thickness"] / 2, task["mirrors"]
    far = 1e3
    part = Box(Pnt(*(0 if a in mirrors else -far for a in range(3))), Pnt(far, far, far))
    body = prism(task["outline"], task["holes"], half) * part
    hot = prism(task["hot"], task["hot_holes"], half)
    if task["hot_x"]:
        hot = hot * Box(Pnt(task["hot_x"][0], -far, -far), Pnt(task["hot_x"][1], far, far))
    if task["rims"]:
        under = hot * body
        body = Glue([under, body - under])
    near = 1e-6
    low = 0.0 if 2 in mirrors else -half
    for face in body.faces:
        (x0, y0, z0), (x1, y1, z1) = ((p.x, p.y, p.z) for p in face.bounding_box)
        for axis, (a, b) in enumerate(((x0, x1), (y0, y1), (z0, z1))):
            if axis in mirrors and max(abs(a), abs(b)) < near:
                face.name = f"mirror_{'xyz'[axis]}"
        if abs(z0 - half) < near and abs(z1 - half) < near:
            face.name = "hot" if is_hot(task, face) else "bare"
        if 2 not in mirrors and abs(z0 - low) < near and abs(z1 - low) < near:
            face.name = "ground"
    if task["rims"]:
        tops = {name: [f for f in body.faces if f.name == name] for name in ("hot", "bare")}
        for edge in (e for f in tops["hot"] for e in f.edges):
            if any(edge == other for f in tops["bare"] for other in f.edges):
                edge.hpref = 1
    return body


def is_hot(task: dict, face) -> bool:
    """Whether a piece of the upper face has the area of the hot electrode in the computed part."""
    if not task["rims"]:
        return True
    return abs(face.mass / task["hot_area"] - 1) < 1e-6


def prism(outline: list, holes: list, half: float):
    """A solid between ±half over ["rectangle", l, w, r] or ["trapezoid", l, w, w_end] or ["circle", d, x, y]."""
    from netgen.occ import Axes, Dir, Pnt, WorkPlane, Z

    def face(kind: str, *numbers: float):
        plane = WorkPlane(Axes(Pnt(0, 0, -half), Dir(0, 0, 1), Dir(1, 0, 0)))
        if kind == "circle":
            diameter, x, y = numbers
            return plane.MoveTo(x, y).Circle(diameter / 2).Face()
        if kind == "rectangle":
            length, width, radius = numbers
            plane.MoveTo(-length / 2 + radius, -width / 2)
            for side in (length, width, length, width):
                plane.Line(side - 2 * radius)
                plane = plane.Arc(radius, 90) if radius else plane.Rotate(90)
            return plane.Face()
        length, start, end = numbers
        plane.MoveTo(-length / 2, -start / 2).LineTo(length / 2, -end / 2).LineTo(length / 2, end / 2)
        return plane.LineTo(-length / 2, start / 2).Close().Face()

    found = face(*outline)
    for hole in holes:
        found = found - face(*hole)
    return found.Extrude(2 * half * Z)


def grid(size: np.ndarray, divisions: list[int]):
    """Hexahedra of a box from the origin to `size`."""
    from ngsolve.meshes import MakeStructured3DMesh

    nx, ny, nz = divisions
    return MakeStructured3DMesh(
        hexes=True, nx=nx, ny=ny, nz=nz, mapping=lambda x, y, z: (x * size[0], y * size[1], z * size[2])
    )


def faces(mesh, size: np.ndarray) -> dict:
    """(axis, side) → name of the boundary of the box there."""
    import ngsolve as ng

    found = {}
    for name in set(mesh.GetBoundaries()):
        region = mesh.Boundaries(name)
        area = ng.Integrate(ng.CF(1), region)
        means = np.array([ng.Integrate(w, region) / area for w in (ng.x, ng.y, ng.z)]) / size
        axis = int(np.argmax(np.abs(means - 0.5)))
        found[axis, int(means[axis] > 0.5)] = name
    return found


def fields(mesh, order: int, held: dict, electrodes: str, **more):
    """Space of displacements, with components held on named boundaries, and of the potential, given on the
    electrodes.
    """
    import ngsolve as ng

    boundaries = {f"dirichlet{axis}": name for axis, name in held.items()}
    return ng.VectorH1(mesh, order=order, **boundaries, **more) * ng.H1(mesh, order=order, dirichlet=electrodes, **more)


def forms(space, matrix: np.ndarray, density: float) -> tuple:
    """Assembled stiffness and mass; `matrix` (9, 9) is [[c, eᵗ], [e, −ε]] in SI units."""
    import ngsolve as ng

    (u, phi), (v, psi) = space.TnT()

    def strain(w):
        g = ng.Grad(w)
        return ng.CF((g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]))

    def constant(values):
        return ng.CF(tuple(values.ravel().tolist()), dims=values.shape)

    c, e, eps = matrix[:6, :6], matrix[6:, :6] * SCALE, -matrix[6:, 6:] * SCALE**2
    stiffness, mass = ng.BilinearForm(space, symmetric=True), ng.BilinearForm(space, symmetric=True)
    stiffness += ng.InnerProduct(constant(c) * strain(u), strain(v)) * ng.dx
    stiffness += ng.InnerProduct(constant(e) * strain(u), ng.grad(psi)) * ng.dx
    stiffness += ng.InnerProduct(constant(e) * strain(v), ng.grad(phi)) * ng.dx
    stiffness += -ng.InnerProduct(constant(eps) * ng.grad(phi), ng.grad(psi)) * ng.dx
    mass += density * ng.InnerProduct(u, v) * ng.dx
    stiffness.Assemble(), mass.Assemble()
    return stiffness, mass


def full(matrix) -> sp.csr_matrix:
    """A symmetric NGSolve matrix, which keeps its lower triangle, as a full matrix of scipy."""
    rows, columns, values = (np.array(one) for one in matrix.COO())
    lower = sp.csr_matrix((values, (rows, columns)), shape=(matrix.height, matrix.width))
    return lower + sp.tril(lower, -1).T if not np.any(columns > rows) else lower


def eigenvalues(stiffness, mass, keep, task: dict) -> list[float]:
    """The eigenvalues nearest to a frequency, in the space spanned by the columns of `keep`."""
    k, m = ((keep.T @ one @ keep).tocsc() for one in (stiffness, mass))
    shift = (2 * np.pi * task["near"]) ** 2
    return sorted(spla.eigsh(k, task["count"], M=m, sigma=shift, return_eigenvectors=False).tolist())


if __name__ == "__main__":
    problem = json.load(sys.stdin)
    json.dump({"sweep": sweep, "poles": poles, "slab": slab}[problem["problem"]](problem), sys.stdout)
