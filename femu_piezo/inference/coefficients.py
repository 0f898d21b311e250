"""Coefficients of the projected matrices at given unknowns: values and tangents over frequency."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor, multiplied
from femu_piezo.effects.effect import Effect, LocalTerm
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.inference.unknowns import Acting, Unknowns
from femu_piezo.material.constants import PiezoConstants


@dataclass(frozen=True)
class Active:
    """An effect with its values (n,), SI, and the columns of x that are its parameters (None where they are fixed)."""

    effect: Effect
    values: np.ndarray
    columns: slice | None

    def put(self, target: np.ndarray, slopes: np.ndarray) -> None:
        """Add ∂/∂p (…, n) times the scale to the columns of a tangent array (…, n_x), if there are any: (…, 0)."""
        if self.columns is not None and target.shape[-1]:
            target[..., self.columns] += slopes * self.effect.scale


def active_effects(parameters: Unknowns, x: np.ndarray) -> list[Active]:
    """The fixed effects and the fitted ones at x (n_x,), in the order in which they act."""
    return _active(parameters.acting, x)


def effects_on_constants(parameters: Unknowns, x: np.ndarray) -> list[Active]:
    """The active effects at x (n_x,) that change the constants alike at all frequencies and in all sweeps, in order."""
    return _active(parameters.acting_on_constants, x)


def _active(acting: Iterable[Acting], x: np.ndarray) -> list[Active]:
    return [
        Active(effect, x[known] * effect.scale, known) if isinstance(known, slice) else Active(effect, known, None)
        for effect, known in acting
    ]


@dataclass(frozen=True)
class Coefficients:
    """Projected matrices with their coefficients at k frequencies, and tangents in n_x unknowns.

    Attributes
    ----------
    terms : (n, r, r) real; stiffness : (k, n) complex; stiffness_tangents : (k, n, n_x)
    masses : m matrices (u, u); inertia : (k, m) complex; inertia_tangents : (k, m, n_x)
    """

    terms: np.ndarray
    stiffness: np.ndarray
    stiffness_tangents: np.ndarray
    masses: list[np.ndarray]
    inertia: np.ndarray
    inertia_tangents: np.ndarray


class _Sum:
    """Terms of one kind as they are collected."""

    def __init__(self) -> None:
        self.matrices: list[np.ndarray] = []
        self.values: list[np.ndarray] = []
        self.tangents: list[np.ndarray] = []

    def add(self, matrices: Sequence[np.ndarray] | np.ndarray, values: np.ndarray, tangents: np.ndarray) -> None:
        """n matrices with values (k, n) and tangents (k, n, n_x)."""
        self.matrices.extend(matrices)
        self.values.append(values)
        self.tangents.append(tangents)

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate(self.values, axis=1), np.concatenate(self.tangents, axis=1)


def collect(
    model: ExtendedModel,
    parameters: Unknowns,
    x: np.ndarray,
    active: list[Active],
    omega: np.ndarray,
    *,
    tangents: bool = True,
) -> Coefficients:
    """The matrices of a model with their coefficients at the unknowns x (n_x,) and frequencies (k,) rad/s.

    tangents : whether to make those in the unknowns; else those of no unknown
    """
    count = x.size if tangents else 0
    e_form, e_tangents = e_form_constants(parameters, x, active, omega, tangents=tangents)
    factors, factor_tangents = _stretch(active, count)
    # with and without tangents the same matrices serve, so that Z is the same to the last bit
    moving = any(item.effect.stretch is not None and item.columns is not None for item in active)
    stretched = moving or bool(np.any(factors != 1))
    constant = model.constant_of_stratum if stretched else np.arange(e_form.shape[1])
    powers = model.exponents if stretched else np.zeros((constant.size, 3))
    terms = model.strata if stretched else model.bulk
    scaling = np.prod(factors**powers, axis=1)
    scaling_tangents = scaling[:, None] * (powers @ (factor_tangents / factors[:, None]))
    values = e_form[:, constant] * scaling
    slopes = e_tangents[:, constant] * scaling[:, None] + e_form[:, constant, None] * scaling_tangents
    volume = np.prod(factors)
    growth = volume * np.sum(factor_tangents / factors[:, None], axis=0)
    density, denser = _density(active, count)
    volume, growth = volume * density, growth * density + volume * denser
    stiff, heavy = _Sum(), _Sum()
    heavy.add(
        [model.mass],
        np.full((omega.size, 1), volume, dtype=complex),
        np.tile(growth, (omega.size, 1, 1)).astype(complex),
    )
    for item in active:
        for term in _extra_terms(model, item, omega):
            value, tangent = term.value, np.zeros((omega.size, count), dtype=complex)
            item.put(tangent, term.slopes)
            if term.constant is not None:
                tangent = tangent * e_form[:, term.constant, None] + value[:, None] * e_tangents[:, term.constant]
                value = value * e_form[:, term.constant]
            (stiff if term.kind == "stiffness" else heavy).add([term.matrix], value[:, None], tangent[:, None, :])
    if stiff.matrices:
        terms = np.concatenate([terms, stiff.matrices])
        values = np.concatenate([values, *stiff.values], axis=1)
        slopes = np.concatenate([slopes, *stiff.tangents], axis=1)
    return Coefficients(terms, values, slopes, heavy.matrices, *heavy.stacked())


def _stretch(active: list[Active], unknowns: int) -> tuple[np.ndarray, np.ndarray]:
    """Factors on the dimensions (3,) of all effects together, and their tangents (3, n_x)."""
    factors, tangents = np.ones(3), np.zeros((3, unknowns))
    for item in active:
        if item.effect.stretch is not None:
            change, slopes = item.effect.stretch(item.values)
            tangents *= change[:, None]
            item.put(tangents, slopes * factors[:, None])
            factors = factors * change
    return factors, tangents


def _density(active: list[Active], unknowns: int) -> tuple[float, np.ndarray]:
    """Factor on the density of all effects together, and its tangent (n_x,)."""
    factor, tangent = 1.0, np.zeros(unknowns)
    for item in active:
        if item.effect.density is not None:
            change, slopes = item.effect.density(item.values)
            tangent *= change
            item.put(tangent, slopes * factor)
            factor *= change
    return factor, tangent


def _extra_terms(model: ExtendedModel, item: Active, omega: np.ndarray) -> list[LocalTerm]:
    """The terms that an effect adds, on the mesh and at a place."""
    effect, u = item.effect, model.displacements
    found = [] if effect.local is None else effect.local(model.places, omega, item.values)
    if effect.reshaping is not None:
        found += model.places.reshaped(effect.reshaping).terms(model.places, omega, item.values)
    for term in effect.terms:
        matrix = model.extra(term.name)
        matrix = matrix[:u, :u] if term.kind == "inertia" else matrix
        found.append(LocalTerm(term.kind, matrix, *term.coefficient(omega, item.values)))
    return found


def even_constants(parameters: Unknowns, x: np.ndarray, active: list[Active]) -> PiezoConstants:
    """The constants at x (n_x,) after the effects `active`, which act alike at all frequencies."""
    return PiezoConstants.from_vector(d_form_constants(parameters, x, active, np.ones(1), tangents=False)[0][0])


def d_form_constants(
    parameters: Unknowns, x: np.ndarray, active: list[Active], omega: np.ndarray, *, tangents: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """d-form constants (k, 10) at each frequency, and their tangents (k, 10, n_x); (k, 10, 0) where not wanted."""
    material = parameters.material
    of_material = x[: parameters.of_material]
    theta = np.tile(material.vector(of_material), (omega.size, 1))
    slopes = np.zeros((omega.size, 10, x.size if tangents else 0), dtype=complex)
    if tangents:
        slopes[:, :, : of_material.size] = material.free.directions @ material.slopes(of_material)
    return _changed(theta, slopes, omega, active)


def _changed(
    theta: np.ndarray, tangents: np.ndarray, omega: np.ndarray, active: Iterable[Active]
) -> tuple[np.ndarray, np.ndarray]:
    """Constants (k, 10) and tangents (k, 10, n_x) after all effects; factors in sequence are applied together."""
    acting = ((item, hook) for item in active if (hook := item.effect.constants) is not None)
    for _, group in groupby(acting, lambda pair: isinstance(pair[1], ConstantFactor)):
        pairs = list(group)
        factors = [(item, hook.index) for item, hook in pairs if isinstance(hook, ConstantFactor)]
        if factors:
            for distinct in _distinct(factors):
                theta, tangents = _multiplied(theta, tangents, distinct)
            continue
        for item, hook in pairs:
            theta, tangents, slopes = hook(theta, tangents, omega, item.values)
            item.put(tangents, slopes)
    return theta, tangents


def _distinct(factors: Iterable[tuple[Active, int]]) -> list[list[tuple[Active, int]]]:
    """Factors, each given with the number of its constant, in parts in which no constant comes twice."""
    found: list[list[tuple[Active, int]]] = []
    for item, index in factors:
        if not found or index in [other for _, other in found[-1]]:
            found.append([])
        found[-1].append((item, index))
    return found


def _multiplied(
    theta: np.ndarray, tangents: np.ndarray, factors: list[tuple[Active, int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Constants (k, 10) and tangents (k, 10, n_x) after factors, each given with the number of its constant."""
    items, which = [item for item, _ in factors], np.array([index for _, index in factors])
    theta, tangents, slopes = multiplied(theta, tangents, which, np.array([item.values for item in items]))
    for number, item in enumerate(items):
        item.put(tangents[:, which[number]], slopes[:, number])
    return theta, tangents


def e_form_constants(
    parameters: Unknowns, x: np.ndarray, active: list[Active], omega: np.ndarray, *, tangents: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """e-form constants (k, 10) at each frequency, and their tangents (k, 10, n_x); (k, 10, 0) where not wanted."""
    theta, slopes = d_form_constants(parameters, x, active, omega, tangents=tangents)
    sets = [PiezoConstants.from_vector(row) for row in theta]
    e_form = np.array([constants.to_e_form().vector() for constants in sets])
    if not tangents:
        return e_form, slopes
    return e_form, np.array([constants.e_form_jacobian() for constants in sets]) @ slopes
