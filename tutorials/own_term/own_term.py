# %% [markdown]
# # Writing your own term: a mass on the ends of a bar
#
# Everything here is one sum, A(ω, θ) = Σ_q c_q(ω, θ) A_q − ω² M. A new physical effect is one more matrix A_q and its
# coefficient c_q: here the inertia of solder dots on the two ends of a k31 bar. A_q is a surface integral of v·u over
# the end face, its coefficient −ω² m/A with the mass m on each end. The matrix is at once the exact derivative.

# %%
import os
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import skfem
from matplotlib.figure import Figure
from scipy.optimize import brentq

from femu_piezo.extraction import extract
from femu_piezo.forward.dispersive import dispersive_response
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.library import library_material
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.folder import prepare_folder, write_figure

OUT = prepare_folder(Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "own_term")

pzt = library_material("pzt-5h")
lossless = {name: value.real for name, value in pzt.constants.as_dict().items()}
ceramic = PiezoConstants.from_real(lossless, {"s11": 0.015, "d31": 0.013, "eps33T": 0.016})
constants = ceramic.to_e_form()
bar = Plate(length=30e-3, width=2e-3, thickness=1e-3)
domain = bar.domain(divisions=(10, 1, 1))  # one eighth of the bar: what is put on its end is on both ends of the bar
MASS, SECTION = bar.volume * pzt.density, 2e-3 * 1e-3

# %% [markdown]
# ## The form
#
# Written as in a paper, assembled by scikit-fem on the end face, and placed on the three displacements; the potential
# has no inertia. The end face is found by where it is.


# %%
@skfem.BilinearForm
def inertia(u, v, _):
    return u * v


scalar = ElectroelasticModel(domain, pzt.density).basis
end = domain.mesh.facets_satisfying(lambda x: x[0] > bar.length / 2 - 1e-9)
face = skfem.FacetBasis(domain.mesh, scalar.elem, facets=end, intorder=4)
surface = inertia.assemble(face)
assert np.isclose(surface.sum(), SECTION / 4)  # a quarter of the end face belongs to the eighth
term = sp.block_diag([surface, surface, surface, sp.csr_matrix(surface.shape)])

model = ElectroelasticModel(domain, pzt.density, extra_terms={"end mass": term})
print(f"terms: {', '.join(model.terms)}; {model.size} unknowns")

# %% [markdown]
# ## What the mass does
#
# A thin bar with a mass m on each end has its pole where cot X = 2 (m/M) X, f = X/(π L √(ρ s11)), M the mass of the
# bar. The finite element bar is swept by full solves, its pole extracted from the curve as from a measurement.

# %%
frequency = np.linspace(35e3, 62e3, 109)


def sweep(mass):
    """Z with a mass on each end, kg; one direct solve per frequency."""
    load = [{"end mass": -((2 * np.pi * f) ** 2) * mass / SECTION} for f in frequency]
    return np.array([full_impedance(model, constants, [f], extra)[0] for f, extra in zip(frequency, load, strict=True)])


def thin_bar_pole(share):
    x = brentq(lambda x: np.cos(x) - 2 * share * x * np.sin(x), 0.3, np.pi / 2 + 1e-9)
    return x / (np.pi * bar.length * np.sqrt(pzt.density * pzt.constants.s11.real))


shares = np.array([0.0, 0.02, 0.05, 0.10])
curves = [sweep(share * MASS) for share in shares]
poles = [extract(ImpedanceSpectrum(frequency, z)).resonances.poles[0].frequency_Hz for z in curves]
exact = np.array([thin_bar_pole(share) for share in shares])
print(f"\n{'m/M':>6s}{'pole (Hz)':>12s}{'shift':>10s}{'thin bar':>10s}")
for share, pole, thin in zip(shares, poles, exact, strict=True):
    print(f"{share:6.2f}{pole:12.1f}{100 * (pole / poles[0] - 1):8.3f} %{100 * (thin / exact[0] - 1):8.3f} %")
# Lateral inertia (w = L/15) moves all poles alike to 0.1 %; of the shifts it changes 2 % at most.
assert np.allclose(np.array(poles) / poles[0] - 1, exact / exact[0] - 1, rtol=0.02, atol=1e-9)

# %% [markdown]
# ## The derivative, for nothing
#
# ∂λ/∂c_q = xᵗA_q x with the mode x normalised by uᵗM u = 1; with c = −λ m/A that is dλ/dm = −λ xᵗA_q x / A, exact
# where m = 0. No step size, no second solve.

# %%
short = solve_eigen(model, constants, "short", count=3, near_Hz=poles[0], extra={"end mass": 0.0})
mode = short.dominant(poles[0])
eigenvalue = short.eigenvalues[mode]
slope = -eigenvalue * short.sensitivity(model, mode, ["end mass"])[0] / SECTION
small = 1e-4 * MASS
moved = solve_eigen(
    model, constants, "short", count=3, near_Hz=poles[0], extra={"end mass": -eigenvalue * small / SECTION}
)
change = moved.eigenvalues[moved.dominant(poles[0])] - eigenvalue
print(f"\nd log λ / d(m/M): exact derivative {(slope / eigenvalue * MASS).real:.5f}", end="")
print(f", by a step of 1e-4 {(change / eigenvalue / 1e-4).real:.5f}, thin bar −4")
assert abs(change / small / slope - 1) < 1e-3  # the second derivative times the step
assert abs((slope / eigenvalue).real * MASS + 4) < 0.02  # thin bar: X = π/2 (1 − 2 m/M), λ ∝ X²

# %% [markdown]
# ## On the reduced model
#
# The reduced model carries the new term like any other, so a sweep with a coefficient that varies with frequency costs
# milliseconds, with the Jacobian for a fit beside it. It is trained without the mass and with a heavy one. This is how
# the effects of `femu_piezo.diagnosis` are built.

# %%
heavy = {"end mass": -((2 * np.pi * 50e3) ** 2) * 0.1 * MASS / SECTION}
reduced = reduce_model(model, [ceramic, (ceramic, heavy)], frequency[-1])


def coefficients(omega):
    material = np.broadcast_to(constants.vector(), (omega.size, 10))
    return np.column_stack([material, -(omega**2) * 0.05 * MASS / SECTION])


response = dispersive_response(reduced, coefficients, 2 * np.pi * frequency)
error = np.max(np.abs(response.impedance / curves[2] - 1))
print(f"reduced to {reduced.size} unknowns: largest relative error of Z {error:.1e}")
assert error < 1e-4  # reduce_model promises 1e-5 at its training points; this mass lies between them

figure = Figure(figsize=(8.0, 4.5), layout="constrained")
axes = figure.subplots()
for share, z, color in zip(shares, curves, ("#222222", "#1f4e79", "#148f77", "#c0392b"), strict=True):
    axes.semilogy(frequency * 1e-3, np.abs(z), color=color, label=f"{100 * share:.0f} % of the bar's mass on each end")
axes.semilogy(frequency * 1e-3, np.abs(response.impedance), ":", color="#000000", label="5 %, reduced model")
axes.set(xlabel="frequency (kHz)", ylabel="|Z| (Ω)", title="k31 bar 30 × 2 × 1 mm with masses on its ends")
axes.legend(frameon=False)
write_figure(OUT / "end_mass.png", figure)
print(f"picture is in {OUT}")
