"""Z and exact ∂Z/∂x of a specimen with effects, x = (material unknowns, effect parameters over their scales).

Where no coefficient depends on ω the closed modal forms hold, an extra inertia going into the mass before the
diagonalisation. Else the reduced system is solved at every frequency; with x(ω) the state driven by one volt the
charge is stationary, so ∂(Q/V)/∂x_i = −xᵗ (∂A/∂x_i) x.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.diagnosis.effect import Effect
from femu_piezo.diagnosis.extended_model import ExtendedModel
from femu_piezo.diagnosis.joint import JointParameters
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import blas_limit

#: Chebyshev nodes in log ω on which coefficients that depend on ω are evaluated; they are smooth.
_NODES = 14
#: Frequencies solved at once.
_BATCH = 64


@dataclass(frozen=True)
class _Active:
    """One effect in the evaluation: its values, and where its slopes go (None for fixed values)."""

    effect: Effect
    values: np.ndarray
    columns: slice | None

    def put(self, target: np.ndarray, slopes: np.ndarray) -> None:
        """Add ∂/∂p (…, n) times the scale to the columns of a tangent array (…, n_x)."""
        if self.columns is not None:
            target[..., self.columns] += slopes * self.effect.scale


@dataclass(frozen=True)
class _Coefficients:
    """Everything that multiplies projected matrices: values (k, n) and tangents (k, n, n_x)."""

    terms: np.ndarray
    stiffness: np.ndarray
    stiffness_tangents: np.ndarray
    masses: list[np.ndarray]
    inertia: np.ndarray
    inertia_tangents: np.ndarray


@dataclass(frozen=True)
class Evaluation:
    """Z of the specimen over a sweep as a function of x, with its exact Jacobian.

    Attributes
    ----------
    omega : (k,) rad/s
    """

    model: ExtendedModel
    omega: np.ndarray
    _identity: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_identity", np.eye(self.model.displacements))

    def impedance(self, parameters: JointParameters, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""
        return self.with_jacobian(parameters, x)[0]

    def with_jacobian(self, parameters: JointParameters, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        active = self._active(parameters, x)
        dispersive = any(item.effect.dispersive for item in active)
        with blas_limit():
            if dispersive:
                nodes, weights = _nodes(self.omega)
                y, slopes = self._solved(self._coefficients(parameters, x, active, nodes), weights)
            else:
                y, slopes = self._closed(self._coefficients(parameters, x, active, self.omega[:1]))
        z, tangents = 1 / y, -slopes / y[:, None] ** 2
        for item in active:
            if item.effect.circuit is not None:
                z, ratio, own = item.effect.circuit(self.omega, z, item.values)
                tangents = tangents * ratio[:, None]
                item.put(tangents, own)
        return z, tangents

    @staticmethod
    def _active(parameters: JointParameters, x: np.ndarray) -> list[_Active]:
        fixed = [_Active(effect, values, None) for effect, values in parameters.fixed]
        fitted = zip(parameters.effects, parameters.values(x), strict=True)
        return fixed + [_Active(effect, values, parameters.columns(i)) for i, (effect, values) in enumerate(fitted)]

    def _coefficients(
        self, parameters: JointParameters, x: np.ndarray, active: list[_Active], omega: np.ndarray
    ) -> _Coefficients:
        e_form, e_tangents = _constants(parameters, x, active, omega)
        factors, factor_tangents = np.ones(3), np.zeros((3, x.size))
        for item in active:
            if item.effect.stretch is not None:
                own, slopes = item.effect.stretch(item.values)
                factor_tangents *= own[:, None]
                item.put(factor_tangents, slopes * factors[:, None])
                factors = factors * own
        stretched = bool(np.any(factors != 1) or np.any(factor_tangents))
        owner = self.model.owner if stretched else np.arange(e_form.shape[1])
        powers = self.model.exponents if stretched else np.zeros((owner.size, 3))
        terms = self.model.strata if stretched else self.model.bulk
        scaling = np.prod(factors**powers, axis=1)
        scaling_tangents = scaling[:, None] * (powers @ (factor_tangents / factors[:, None]))
        values = e_form[:, owner] * scaling
        tangents = e_tangents[:, owner] * scaling[:, None] + e_form[:, owner, None] * scaling_tangents
        volume = np.prod(factors)
        masses, inertia = [self._identity], [np.full(omega.size, volume, dtype=complex)]
        inertia_tangents = [np.tile(volume * np.sum(factor_tangents / factors[:, None], axis=0), (omega.size, 1))]
        stiff, stiff_values, stiff_tangents = [terms], [values], [tangents]
        for item in active:
            for term in item.effect.terms:
                value, slopes = term.coefficient(omega, item.values)
                tangent = np.zeros((omega.size, x.size), dtype=complex)
                item.put(tangent, slopes)
                if term.kind == "inertia":
                    u = self.model.displacements
                    masses.append(self.model.inertia[term.name][:u, :u])
                    inertia.append(value)
                    inertia_tangents.append(tangent)
                else:
                    stiff.append(self.model.stiffness[term.name][None])
                    stiff_values.append(value[:, None])
                    stiff_tangents.append(tangent[:, None, :])
        return _Coefficients(
            terms=stiff[0] if len(stiff) == 1 else np.concatenate(stiff),
            stiffness=np.concatenate(stiff_values, axis=1),
            stiffness_tangents=np.concatenate(stiff_tangents, axis=1),
            masses=masses,
            inertia=np.stack(inertia, axis=1),
            inertia_tangents=np.stack(inertia_tangents, axis=1),
        )

    def _closed(self, c: _Coefficients) -> tuple[np.ndarray, np.ndarray]:
        """Y and ∂Y/∂x by partial fractions; coefficients (1, …)."""
        modal = self._modal(c)
        y = modal.admittance(self.omega)
        slopes = modal.admittance_jacobian(self.omega, c.stiffness_tangents[0])
        moving = np.flatnonzero(np.any(c.inertia_tangents[0] != 0, axis=0))
        if moving.size:
            u, size = self.model.displacements, self.model.size
            masses = np.zeros((len(c.masses), size, size))
            masses[:, :u, :u] = c.masses
            heavy = replace(modal, terms=masses).admittance_jacobian(self.omega, c.inertia_tangents[0][:, moving])
            slopes[:, moving] -= self.omega[:, None] ** 2 * heavy
        return y, slopes

    def _modal(self, c: _Coefficients) -> ModalModel:
        """Closed forms with the mass D = Σ m_j M_j: displacements u = L^-ᵗ w, D = L Lᵗ."""
        stiffness = np.tensordot(c.stiffness[0], c.terms, axes=1)
        u, factor = self.model.displacements, self.model.admittance_factor
        if len(c.masses) == 1:
            root = np.sqrt(c.inertia[0, 0].real)
            transform = np.ones(self.model.size)
            transform[:u] = 1 / root
            modal = diagonalise(stiffness * np.outer(transform, transform), c.terms, u, factor)
            return replace(modal, states=modal.states * transform[:, None])
        mass = sum(value.real * matrix for value, matrix in zip(c.inertia[0], c.masses, strict=True))
        inverse = np.linalg.inv(np.linalg.cholesky(mass)).T
        transform = np.eye(self.model.size)
        transform[:u, :u] = inverse
        modal = diagonalise(transform.T @ stiffness @ transform, c.terms, u, factor)
        return replace(modal, states=transform @ modal.states)

    def _solved(self, c: _Coefficients, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y and ∂Y/∂x by one dense solve per frequency; weights (k, nodes) interpolate the coefficients."""
        u, size = self.model.displacements, self.model.size
        y = np.empty(self.omega.size, dtype=complex)
        slopes = np.empty((self.omega.size, c.stiffness_tangents.shape[2]), dtype=complex)
        flat = c.terms.reshape(len(c.terms), -1)
        at_nodes = c.stiffness @ flat  # (nodes, r²)
        for part in np.array_split(np.arange(self.omega.size), max(1, self.omega.size // _BATCH)):
            w, omega = weights[part], self.omega[part]
            matrix = (w @ at_nodes).reshape(-1, size, size)
            inertia = w @ c.inertia
            for j, mass in enumerate(c.masses):
                matrix[:, :u, :u] -= (omega**2 * inertia[:, j])[:, None, None] * mass
            inner = np.linalg.solve(matrix[:, :-1, :-1], matrix[:, :-1, -1:])[:, :, 0]
            state = np.concatenate([-inner, np.ones((part.size, 1))], axis=1)
            charge = -np.einsum("ki,ki->k", matrix[:, -1, :], state)
            along = _quadratic(c.terms, state)  # (part, n_terms)
            move = np.einsum("kt,kn,ntx->kx", along, w, c.stiffness_tangents, optimize=True)
            heavy = _quadratic(np.array(c.masses), state[:, :u])
            move -= omega[:, None] ** 2 * np.einsum("kj,kn,njx->kx", heavy, w, c.inertia_tangents, optimize=True)
            factor = 1j * omega * self.model.admittance_factor
            y[part] = factor * charge
            slopes[part] = -factor[:, None] * move
        return y, slopes


def _quadratic(terms: np.ndarray, states: np.ndarray) -> np.ndarray:
    """xᵗ A_t x (k, n_terms) for real symmetric A (n_terms, r, r) and complex states (k, r)."""
    real, imag = np.ascontiguousarray(states.real), np.ascontiguousarray(states.imag)
    found = np.empty((len(states), len(terms)), dtype=complex)
    for t, matrix in enumerate(terms):
        found[:, t] = np.einsum("kr,kr->k", real @ matrix + 1j * (imag @ matrix), states)
    return found


def _nodes(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the nodes, and the weights (k, nodes) that interpolate from them in log ω."""
    low, high = np.log([omega.min(), omega.max()])
    at = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    return np.exp(at), BarycentricInterpolator(at, np.eye(_NODES))(np.log(omega))


def _constants(
    parameters: JointParameters, x: np.ndarray, active: list[_Active], omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """e-form constants (k, 10) at each frequency, and their tangents (k, 10, n_x)."""
    material = parameters.material
    own = x[: 2 * material.scale.size]
    theta = np.tile(material.constants(own).vector(), (omega.size, 1))
    tangents = np.zeros((omega.size, 10, x.size), dtype=complex)
    tangents[:, :, : own.size] = material.free.directions @ material.slopes(own)
    for item in active:
        if item.effect.constants is not None:
            theta, tangents, slopes = item.effect.constants(theta, tangents, omega, item.values)
            item.put(tangents, slopes)
    sets = [PiezoConstants.from_vector(row) for row in theta]
    e_form = np.array([constants.to_e_form().vector() for constants in sets])
    jacobians = np.array([constants.e_form_jacobian() for constants in sets])
    return e_form, jacobians @ tangents
