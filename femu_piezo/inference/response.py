"""Z and exact ∂Z/∂x of a specimen with effects, x = (material unknowns, effect parameters over their scales).

Where no coefficient depends on ω the closed modal forms hold, an extra inertia being part of the diagonalised mass.
Else the reduced system is solved at every frequency, a large one after projection on its states at a few of them. The
charge is stationary in the state x(ω) driven by one volt, so ∂(Q/V)/∂x_i = −xᵗ (∂A/∂x_i) x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import blake2b

import numpy as np
from scipy.linalg import block_diag

from femu_piezo.effects.effect import Effect, LocalHook, LocalTerm
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.inference.coefficients import Active, Coefficients, active_effects, collect, e_form_constants
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.interpolation import chebyshev_nodes
from femu_piezo.measurement.spectrum import evenly
from femu_piezo.threads import blas_limit, made_once

#: Chebyshev nodes in log ω on which coefficients that depend on ω are evaluated; they are smooth.
_NODES = 14
#: Frequencies solved at once.
_BATCH = 64
#: Number of frequencies on whose states a system is projected where it has more displacements than that.
_SAMPLES = 32
#: Modes up to this multiple of the end of the sweep in ω² are summed one by one; number of nodes for the others.
_NEAR, _SMOOTH = 2.0, 10
#: Share of the largest amplitude at resonance below which a mode is left out of slopes.
_FAINT = 1e-6
#: Share of the largest singular value of the states at `_SAMPLES` frequencies below which a direction is left out.
_NEGLIGIBLE = 1e-10


@dataclass(frozen=True)
class Evaluation:
    """Z of the specimen over a sweep as a function of x, with its exact Jacobian.

    Attributes
    ----------
    omega : (k,) rad/s
    """

    model: ExtendedModel
    omega: np.ndarray

    def at(self, factor: float) -> Evaluation:
        """This specimen at frequencies multiplied by a factor."""
        return replace(self, omega=self.omega * factor)

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""
        return self._evaluated(parameters, x, active_effects(parameters, x), 0)[0]

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        return self._evaluated(parameters, x, active_effects(parameters, x), self.omega.size)

    def with_effects(self, parameters: Unknowns, x: np.ndarray, active: list[Active]) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm, with some of the effects at x (n_x,) alone."""
        return self._evaluated(parameters, x, active, self.omega.size)

    def _evaluated(
        self, parameters: Unknowns, x: np.ndarray, active: list[Active], wanted: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,), and its tangents (wanted, n_x) at the first `wanted` frequencies, the effects acting in order."""
        last = max((n for n, item in enumerate(active) if item.effect.acquisition is not None), default=None)
        acquisition = None if last is None else active[last].effect.acquisition
        if last is None or acquisition is None:
            return self._through_circuits(active, *self._body(parameters, x, active, wanted))

        def inside(omega: np.ndarray, *beside: tuple[Effect, np.ndarray], slopes: int | None = None):
            inner = [*active[:last], *(Active(effect, values, None) for effect, values in beside)]
            inner = sorted(inner, key=lambda item: item.effect.place)
            return replace(self, omega=omega)._evaluated(parameters, x, inner, omega.size if slopes is None else slopes)

        item = active[last]
        z, tangents, own = acquisition(inside, self.omega, item.values)
        tangents = tangents[:wanted]
        item.put(tangents, own[:wanted])
        return self._through_circuits(active[last + 1 :], z, tangents)

    def _body(
        self, parameters: Unknowns, x: np.ndarray, active: list[Active], wanted: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) of the body itself, and its tangents (wanted, n_x)."""
        model = self.model.restricted([name for item in active for name in item.effect.sectors])
        dispersive = any(item.effect.dispersive for item in active)
        nodes, weights = _nodes(self.omega) if dispersive else (self.omega[:1], np.ones((1, 1)))
        with blas_limit():
            coefficients = collect(model, parameters, x, active, nodes, tangents=wanted > 0)
            if dispersive:
                y, slopes = _solved(model, self.omega, coefficients, weights, wanted)
            else:
                y, slopes = _closed(model, self.omega, coefficients, wanted)
        return 1 / y, -slopes / y[:wanted, None] ** 2

    def modal(self, parameters: Unknowns, x: np.ndarray) -> ModalModel:
        """Closed forms of the body at x (n_x,) without circuits; laws over frequency as in the middle of the sweep."""
        active = active_effects(parameters, x)
        model = self.model.restricted([name for item in active for name in item.effect.sectors])
        middle = self.omega[[self.omega.size // 2]]
        with blas_limit():
            return _modal(model, collect(model, parameters, x, active, middle, tangents=False))

    def terminals(self, parameters: Unknowns, x: np.ndarray, modal: ModalModel) -> Callable[[np.ndarray], np.ndarray]:
        """Complex ω (m,) → Z at the terminals, which vanishes at a pole and is infinite at a zero.

        modal : of the body at x (n_x,), as by `modal`
        """
        frozen = _frozen(active_effects(parameters, x))

        def impedance(omega: np.ndarray) -> np.ndarray:
            at = replace(self, omega=omega)
            return at._through_circuits(frozen, 1 / modal.admittance(omega), np.zeros((omega.size, 0)))[0]

        return impedance

    def _through_circuits(self, active: list[Active], z: np.ndarray, tangents: np.ndarray):
        """Z (k,) and its tangents (m, n), at the first m frequencies, at the terminals, from those of the body."""
        wanted = len(tangents)
        for item in active:
            if item.effect.circuit is not None:
                z, ratio, own = item.effect.through(self.omega, z, item.values)
                tangents = tangents * ratio[:wanted, None]
                item.put(tangents, own[:wanted])
        return z, tangents

    def slopes_at_sites(self, parameters: Unknowns, x: np.ndarray, effect: Effect) -> np.ndarray:
        """∂Z/∂(sizes) (k, m, s) at size zero of an effect at each of its m sites, added to those at x; ohm per SI unit.

        Where coefficients depend on ω, those at the middle of the sweep are taken: this serves to find starts.
        """
        active = active_effects(parameters, x)
        model = self.model.restricted([name for item in active for name in item.effect.sectors])
        middle = self.omega[[self.omega.size // 2]]
        with blas_limit():
            c = collect(model, parameters, x, active, middle, tangents=False)
            modal = _modal(model, c)
            span, y = _driven_span(modal, self.omega), modal.admittance(self.omega)
            e_form = e_form_constants(parameters, x, [], middle, tangents=False)[0][0]
            sites = placed(effect)[0]
            found = np.array([_site_slopes(model, effect, site, self.omega, span, e_form) for site in sites])
        factor = 1j * self.omega * model.admittance_factor / y**2
        along = (found * factor).transpose(2, 0, 1).reshape(self.omega.size, -1)
        through = self._through_circuits(_frozen(active), 1 / y, along)[1]
        return through.reshape(self.omega.size, *found.shape[:2])


def placed(effect: Effect) -> tuple[np.ndarray, LocalHook]:
    """(m, n) sites of an effect at a place, and its terms near size zero; ValueError where it has no place."""
    onset = effect.local if effect.onset is None else effect.onset
    if effect.sites is None or onset is None:
        raise ValueError(f"{effect.name} has no place")
    return effect.sites, onset


def _frozen(active: list[Active]) -> list[Active]:
    """Active effects without slopes in their parameters."""
    return [replace(item, columns=None) for item in active]


def _site_slopes(model, effect: Effect, site: np.ndarray, omega, span, e_form) -> np.ndarray:
    """xᵗ (∂A/∂size) x (s, k) for every size at a site, with driven states x = basis · weights, `span` holding both."""
    basis, weights = span
    at = site.copy()
    at[effect.sizes] = 0.0
    terms = placed(effect)[1](model.places, omega, at)
    total = np.zeros((effect.sizes.size, omega.size), dtype=complex)
    for row, size in zip(total, effect.sizes, strict=True):
        for kind, matrix, slope in _gathered(terms, e_form, int(size)):
            along = _quadratic_tangents(matrix[None], np.ones((1, 1)), basis[: len(matrix)], weights)[:, 0]
            row += (-(omega**2) if kind == "inertia" else 1.0) * slope * along
    return total


def _gathered(terms: Sequence[LocalTerm], e_form: np.ndarray, size: int) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Kind, matrix (r, r), and slope (k,) or (1,) in a size, of terms; those with slopes even in ω summed by kind."""
    even: dict[str, np.ndarray] = {}
    found = []
    for term in terms:
        if not np.any(term.slopes[:, size]):
            continue
        slope = term.slopes[:, size] * (1.0 if term.constant is None else e_form[term.constant])
        if np.all(slope == slope[0]):
            even[term.kind] = even.get(term.kind, 0.0) + slope[0] * term.matrix
        else:
            found.append((term.kind, term.matrix, slope))
    return [*found, *((kind, matrix, np.ones(1)) for kind, matrix in even.items())]


def _closed(model: ExtendedModel, omega: np.ndarray, c: Coefficients, wanted: int) -> tuple[np.ndarray, np.ndarray]:
    """Y (k,) by partial fractions, ∂Y/∂x (wanted, n_x) from the driven state; coefficients (1, …)."""
    modal = _modal(model, c)
    y, omega = modal.admittance(omega), omega[:wanted]
    if not wanted:
        return y, np.zeros((0, c.stiffness_tangents.shape[2]), dtype=complex)
    basis, weights = _driven_span(modal, omega)
    stiff = np.flatnonzero(np.any(c.stiffness_tangents[0] != 0, axis=1))
    move = _quadratic_tangents(c.terms[stiff], c.stiffness_tangents[0, stiff], basis, weights)
    moving = np.flatnonzero(np.any(c.inertia_tangents[0] != 0, axis=0))
    if moving.size:
        heavy = _quadratic_tangents(
            np.array(c.masses), c.inertia_tangents[0][:, moving], basis[: model.displacements], weights
        )
        move[:, moving] -= omega[:, None] ** 2 * heavy
    return y, -1j * (omega * model.admittance_factor)[:, None] * move


def _driven_span(modal: ModalModel, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Basis (r, m) and weights (k, m) of the state under a volt, x(ω) = x_∞ − Σ g_n x_n/(λ_n − ω²).

    Modes up to a few times the end of the sweep have a column each; what all others add is smooth in ω² and is
    interpolated between Chebyshev nodes, to about (3 + √8)^-nodes.
    """
    squares = omega**2
    top, at, smooth = _smooth_nodes(np.ascontiguousarray(omega).tobytes(), omega.dtype)
    near, strength = np.abs(modal.eigenvalues) < _NEAR * top, np.abs(modal.charges)
    # at resonance a mode has the amplitude g_n/Im λ_n; without loss all are kept
    height = strength / np.maximum(np.abs(modal.eigenvalues.imag), _FAINT * np.abs(modal.eigenvalues))
    bright = near & (height > _FAINT * height[near].max(initial=0.0))
    far = modal.states[:, 1:][:, ~near] @ (modal.charges[~near, None] / (modal.eigenvalues[~near, None] - at))
    basis = np.hstack([modal.states[:, :1], modal.states[:, 1:][:, bright], far])
    weights = np.hstack(
        [
            np.ones((omega.size, 1)),
            -modal.charges[bright] / (modal.eigenvalues[bright] - squares[:, None]),
            -smooth,
        ]
    )
    return basis, weights


@lru_cache(maxsize=8)
def _smooth_nodes(omegas: bytes, dtype: np.dtype) -> tuple[float, np.ndarray, np.ndarray]:
    """End of a sweep in ω², nodes in ω² up to it, and the weights (k, nodes) that interpolate between nodes; kept."""
    omega = np.frombuffer(omegas, dtype)
    top = float(np.max(np.abs(omega)) ** 2)
    return top, *chebyshev_nodes(0.0, top, _SMOOTH, omega**2)


def _quadratic_tangents(terms: np.ndarray, tangents: np.ndarray, basis: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """xᵗ (Σ_t tangents[t, i] A_t) x (k, n) of states x = basis · weights, for real symmetric A (n_terms, r, r)."""
    wanted, size = tangents.shape[1], basis.shape[1]
    if not len(terms):
        return np.zeros((len(weights), wanted), dtype=complex)
    if 2 * wanted < len(terms):  # the terms of each unknown are summed first
        terms = np.tensordot(np.vstack([tangents.real.T, tangents.imag.T]), terms, axes=1)
        tangents = np.vstack([np.eye(wanted), 1j * np.eye(wanted)])
    both = np.hstack([basis.real, basis.imag])
    full = both.T @ (terms.reshape(-1, len(both)) @ both).reshape(len(terms), len(both), 2 * size)
    small = full[:, :size, :size] - full[:, size:, size:] + 1j * (full[:, :size, size:] + full[:, size:, :size])
    if wanted < len(terms):
        small, tangents = np.tensordot(tangents.T, small, axes=1), np.eye(wanted)
    first, second = np.triu_indices(size)  # wᵗ S w of symmetric S from its upper triangle
    packed = small[:, first, second].T * np.where(first == second, 1.0, 2.0)[:, None]
    found = np.empty((len(weights), len(small)), dtype=complex)
    for rows in range(0, len(weights), _BATCH):  # batches keep intermediate arrays in the cache
        batch = weights[rows : rows + _BATCH]
        found[rows : rows + _BATCH] = (batch[:, first] * batch[:, second]) @ packed
    return found @ tangents


def _modal(model: ExtendedModel, c: Coefficients) -> ModalModel:
    """Closed forms with the mass D = Σ m_j M_j: displacements u = T w, TᵗDT = 1; coefficients (1, …).

    The latest are kept: evaluations that differ in circuits, or in effects at rest, need the same ones. A trial step
    may make D indefinite (each effect keeps to its bounds, their sum need not be a mass): T is complex then, and the
    same forms hold.
    """
    stiffness = _weighted_sum(c.stiffness[0], c.terms)
    mass, further = c.inertia[0, 0].real, np.flatnonzero(c.inertia[0, 1:]) + 1
    if further.size:
        mass = sum((c.inertia[0, index].real * c.masses[index] for index in further), mass * c.masses[0])
    key = blake2b(stiffness.tobytes() + np.asarray(mass).tobytes()).digest()
    modal = model.closed_forms.get(key, lambda: _diagonalised(model, stiffness, mass))
    return replace(modal, terms=c.terms)


def _weighted_sum(values: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Σ values[q] matrices[q]; matrices of value 0 do not change a bit of it."""
    acting = np.flatnonzero(values)
    few = acting.size < len(values)
    return np.tensordot(values[acting] if few else values, matrices[acting] if few else matrices, axes=1)


def _diagonalised(model: ExtendedModel, stiffness: np.ndarray, mass: float | np.ndarray) -> ModalModel:
    """Closed forms, without terms, of a stiffness (r, r) and a mass (u, u), or a number times the identity."""
    u, factor, terms = model.displacements, model.admittance_factor, np.empty((0, *stiffness.shape))
    if np.ndim(mass) == 0:
        scale = np.ones(model.size)
        scale[:u] = 1 / np.sqrt(mass)
        modal = diagonalise(stiffness * np.outer(scale, scale), terms, u, factor)
        return replace(modal, states=modal.states * scale[:, None])
    values, vectors = np.linalg.eigh(mass)
    root = np.sqrt(values if values[0] > 0 else values.astype(complex))
    transform = np.eye(model.size, dtype=root.dtype)
    transform[:u, :u] = vectors / root
    modal = diagonalise(transform.T @ stiffness @ transform, terms, u, factor)
    return replace(modal, states=transform @ modal.states)


def _solved(
    model: ExtendedModel, sweep: np.ndarray, c: Coefficients, weights: np.ndarray, wanted: int
) -> tuple[np.ndarray, np.ndarray]:
    """Y (k,) and ∂Y/∂x (wanted, n_x) by one dense solve per frequency; weights (k, nodes) interpolate coefficients."""
    system = _System(c.terms, np.array(c.masses), model.displacements, c, weights)
    if system.displacements > _SAMPLES < sweep.size:
        system = system.on_states_of(sweep, evenly(sweep.size, _SAMPLES))
    y = np.empty(sweep.size, dtype=complex)
    slopes = np.empty((wanted, c.stiffness_tangents.shape[2]), dtype=complex)
    for part in np.array_split(np.arange(sweep.size), max(1, sweep.size // _BATCH)):
        state, charge = system.states(sweep, part)
        y[part] = 1j * sweep[part] * model.admittance_factor * charge
        part = part[part < wanted]
        state, w, omega = state[: part.size], weights[part], sweep[part]
        along = _quadratic(system.terms, state)  # (part, n_terms)
        move = _interpolated(along, w, c.stiffness_tangents)
        heavy = _quadratic(system.masses, state[:, : system.displacements])
        move -= omega[:, None] ** 2 * _interpolated(heavy, w, c.inertia_tangents)
        slopes[part] = -1j * omega[:, None] * model.admittance_factor * move
    return y, slopes


@dataclass(frozen=True)
class _System:
    """Projected terms (n, r, r) and masses (j, u, u) with coefficients at nodes that weights (k, nodes) interpolate."""

    terms: np.ndarray
    masses: np.ndarray
    displacements: int
    coefficients: Coefficients
    weights: np.ndarray

    @made_once
    def _at_nodes(self) -> np.ndarray:
        return self.coefficients.stiffness.astype(complex) @ self.terms.reshape(len(self.terms), -1)  # (nodes, r²)

    @made_once
    def _whole_masses(self) -> np.ndarray:
        rest = self.terms.shape[1] - self.displacements
        return np.pad(self.masses, ((0, 0), (0, rest), (0, rest))).reshape(len(self.masses), -1)  # (j, r²)

    def states(self, sweep: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(p, r) state under a volt and (p,) charge, at the frequencies number `part` of a sweep."""
        size, w = self.terms.shape[1], self.weights[part]
        matrix = (w @ self._at_nodes.view(float)).view(complex)  # real by complex is twice the work for numpy
        matrix -= (sweep[part, None] ** 2 * (w @ self.coefficients.inertia)) @ self._whole_masses
        matrix = matrix.reshape(-1, size, size)
        inner = np.linalg.solve(matrix[:, :-1, :-1], matrix[:, :-1, -1:])[:, :, 0]
        state = np.concatenate([-inner, np.ones((part.size, 1))], axis=1)
        return state, -np.einsum("ki,ki->k", matrix[:, -1, :], state)

    def on_states_of(self, sweep: np.ndarray, samples: np.ndarray) -> _System:
        """The system on its displacements and inner potentials at some frequencies; there Y and its slope are exact.

        Between these, Y is that of a rational interpolant of that degree.
        """
        u, found = self.displacements, self.states(sweep, samples)[0]
        moved, inner = _directions(found[:, :u]), _directions(found[:, u:-1])
        return replace(
            self,
            terms=_projected(self.terms, block_diag(moved, inner, 1.0)),
            masses=_projected(self.masses, moved),
            displacements=moved.shape[1],
        )


def _directions(states: np.ndarray) -> np.ndarray:
    """(r, m) real orthonormal directions of complex states (k, r)."""
    left, singular, _ = np.linalg.svd(np.concatenate([states.real, states.imag]).T, full_matrices=False)
    return left[:, singular > _NEGLIGIBLE * singular.max(initial=0.0)]


def _projected(matrices: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Vᵗ A V (n, m, m) of matrices (n, r, r) on a basis (r, m)."""
    return basis.T @ matrices @ basis


def _quadratic(terms: np.ndarray, states: np.ndarray) -> np.ndarray:
    """xᵗ A_t x (k, n_terms) for real symmetric A (n_terms, r, r) and complex states (k, r)."""
    parts, count = np.concatenate([states.real, states.imag]), len(states)
    images = parts @ terms  # (n_terms, 2k, r)
    real, imag = images[:, :count], images[:, count:]
    squares, crossed = np.einsum("tkr,kr->kt", real, parts[:count]), np.einsum("tkr,kr->kt", real, parts[count:])
    return squares - np.einsum("tkr,kr->kt", imag, parts[count:]) + 2j * crossed


def _interpolated(along: np.ndarray, weights: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Σ_tn along[k, t] weights[k, n] tangents[n, t, x] (k, x), as one product of matrices."""
    nodes, terms, unknowns = tangents.shape
    pairs = weights[:, :, None] * along[:, None, :]
    return pairs.reshape(len(along), nodes * terms) @ tangents.reshape(nodes * terms, unknowns)


def _nodes(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the nodes, and the weights (k, nodes) that interpolate from them in log ω."""
    along = np.log(omega)
    if along.size == 1:
        return omega, np.ones((1, 1))
    at, weights = chebyshev_nodes(along.min(), along.max(), _NODES, along)
    return np.exp(at), weights
