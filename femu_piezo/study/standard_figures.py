"""Standard figures of a specimen: those of its sweep by the handbook, beside those of the finite element model."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from femu_piezo.extraction.roots import Pair
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.thin_limits import (
    NARROW_RING,
    thin_bar_frequency,
    thin_disk_frequency,
    thin_ring_frequency,
)
from femu_piezo.geometry.shape import Shape, is_poled_across_field, is_poled_along_field
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Slab
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.starts.many_modes import ManyModes
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.rational_curve import RationalCurve, rational_curve
from femu_piezo.resonances import Resonance
from femu_piezo.specimen.file import Simulation, Specimen
from femu_piezo.standards.figures import (
    STATED,
    CurveFigures,
    StandardFigures,
    is_second_radial,
    read_curve,
    reads_stated,
    standard_figures,
)
from femu_piezo.standards.frequencies import Admittance
from femu_piezo.standards.piece import WORDS, Piece, material_figures
from femu_piezo.study.measured import Measured, Sweep, measure
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.simulate import simulate, visible_resonances
from femu_piezo.units import hertz

#: Factor of the expected frequency within which a pair may be the thickness or shear mode, and its least k_eff; factor
#: within which the lowest pair of a sweep is the fundamental of its body.
_NEAR, _COUPLED, _LOWEST = 1.2, 0.15, 1.5
#: How far beyond the sweep a resonance of the model may lie.
_BEYOND = 1.5
#: Ratio of two dimensions from which a plate counts as wide.
_WIDE = 4.0
#: A body, and a mode, of which the standards give no formula.
_OTHER, _HIGHER = Piece("other", 1.0, None, None, 1.0), Piece("higher mode", 1.0, None, None, 1.0)


def figures_of_specimen(specimen: Specimen, spectrum: Sweep | None = None) -> tuple[StandardFigures, ...]:
    """The figures of a measured sweep of a specimen, beside those of the specimen as its file describes it.

    Of the fundamental, and of the thickness mode where the sweep holds it. InputError where the sweep cannot serve.
    """
    measured = measure(specimen, spectrum)
    frequency = measured.spectrum.frequency

    def curve(start: float, stop: float, points: int) -> RationalCurve:
        sweep = {"start": start, "stop": stop, "points": points, "spacing": "linear", "noise": 0.0}
        wish = (specimen.simulation or Simulation()).model_copy(update=sweep)
        simulated = simulate(specimen.model_copy(update={"simulation": wish})).spectrum
        return rational_curve(simulated.frequency, simulated.impedance)

    def impedance(at: np.ndarray) -> np.ndarray:
        return 1 / curve(float(at[0]), 2 * float(at[0]), 20).admittance(2 * np.pi * at)

    model = curve(float(frequency[0]), float(frequency[-1]), max(801, 2 * frequency.size))
    return _of_modes(measured, measured.problem.fitted, model, capacitance_stated(measured, impedance))


def capacitance_stated(measured: Measured, impedance: Callable[[np.ndarray], np.ndarray]) -> float | None:
    """C of a model at `STATED`, F, its circuits included, where that cannot be read off the sweep; else None.

    impedance : of the model at frequencies (k,) Hz: (k,) ohm
    """
    frequency = measured.spectrum.frequency
    if not measured.holds_fundamental or reads_stated(frequency, measured.pair.pole.frequency_Hz):
        return None
    return float((1 / impedance(np.array([STATED]))[0]).imag / (2 * np.pi * STATED))


def figures_of(
    measured: Measured,
    constants: PiezoConstants,
    curve: np.ndarray,
    capacitance: float | None,
    body: ModalModel,
) -> tuple[StandardFigures, ...]:
    """The figures of a sweep beside those of a computed curve.

    Parameters
    ----------
    constants : from which the curve was computed
    curve : (k,) Z without noise at the frequencies of the sweep, ohm;  capacitance : `capacitance_stated` of the model
    body : of the constants on the body of the file (`body_alone`)

    Empty where the sweep does not hold the fundamental.
    """
    if not measured.holds_fundamental:
        return ()
    return _of_modes(measured, constants, rational_curve(measured.spectrum.frequency, curve), capacitance, body)


def _of_modes(
    measured: Measured,
    constants: PiezoConstants,
    model: RationalCurve,
    capacitance: float | None,
    body: ModalModel | None = None,
) -> tuple[StandardFigures, ...]:
    """`figures_of` for a rational function of the curve; no `body` where the curve itself is that of the body."""
    found = tuple(
        _figures(measured, piece, pair, constants, model, body).with_notes(notes)
        for piece, pair, notes in _modes_told(measured, constants)
    )
    # the model needs no extrapolation
    return found if capacitance is None else tuple(one.with_model("C_T", capacitance) for one in found)


def body_alone(posterior: Posterior, index: int, found: Fit | ManyModes, constants: PiezoConstants) -> ModalModel:
    """Closed forms of constants on the body that the file of sweep number `index` describes.

    Without dimensions, causes and circuits, which a fit has found as well and which are no errors of a formula.
    """
    evaluation, _, _ = posterior.whole_sweep(index, found)
    return evaluation.modal(*Unknowns.of_constants(posterior.several[index].problem.free(constants)))


def _figures(
    measured: Measured,
    piece: Piece,
    pair: Pair,
    constants: PiezoConstants,
    model: RationalCurve,
    body: ModalModel | None,
) -> StandardFigures:
    spectrum, extraction = measured.spectrum, measured.extraction
    overtone = _second_radial(pair.pole, [one.pole for one in extraction.pairs])
    points = (spectrum.frequency, spectrum.impedance)
    noise = measured.relative_noise_of(spectrum)
    read = read_curve(extraction.model.admittance, points, pair.pole, pair.zero, piece, overtone, noise)
    band = _BEYOND * float(model.frequency[-1])
    resonances = model.resonances("pole", band), model.resonances("zero", band)
    by_overtone = overtone is not None  # the same formulas of every curve, also where its resonances reach further
    curve = model.frequency, model.impedance
    computed = _figures_near(pair, piece, model.admittance, curve, *resonances, by_overtone)
    alone = None
    if body is not None:
        curve = model.frequency, body.impedance(2 * np.pi * model.frequency)
        alone = _figures_near(pair, piece, body.admittance, curve, *visible_resonances(body, band), by_overtone)
    found = standard_figures(piece, read, pair.pole, pair.zero, computed, constants, alone)
    return found.with_coupling_std(pair.std_k_eff)


def _figures_near(
    pair: Pair,
    piece: Piece,
    admittance: Admittance,
    points: tuple[np.ndarray, np.ndarray],
    poles: Sequence[Resonance],
    zeros: Sequence[Resonance],
    by_overtone: bool,
) -> CurveFigures | None:
    """The figures of the mode of a computed curve nearest to a measured pair; None where the curve does not hold it.

    by_overtone : whether the Poisson ratio of a disk follows from its second radial mode
    """
    if not poles or not zeros:
        return None
    pole, zero = _nearest(poles, pair.pole), _nearest(zeros, pair.zero)
    overtone = _second_radial(pole, poles) if by_overtone else None
    return read_curve(admittance, points, pole, zero, piece, overtone)


def _nearest(several: Sequence[Resonance], one: Resonance) -> Resonance:
    return min(several, key=lambda other: abs(other.frequency_Hz - one.frequency_Hz))


def _second_radial(pole: Resonance, several: Sequence[Resonance]) -> Resonance | None:
    """The strongest of the poles where the second radial mode of a disk lies."""
    found = [one for one in several if is_second_radial(pole, one)]
    return max(found, key=lambda one: abs(one.residue or 0.0), default=None)


def _modes_told(measured: Measured, constants: PiezoConstants) -> list[tuple[Piece, Pair, tuple[str, ...]]]:
    """The fundamental with the formulas of its body, and the thickness mode where the sweep has it; notes on each."""
    pieces = pieces_of(measured.problem.plate, constants, measured.problem.density)
    if not pieces:
        return [(_OTHER, measured.pair, ())]

    def distance(item: tuple[Piece, float]) -> float:
        return abs(np.log(measured.pair.pole.frequency_Hz / item[1]))

    def strongest(expected: float) -> Pair | None:
        """The pair of the largest coupling near an expected frequency."""
        near = [
            pair
            for pair in measured.extraction.pairs
            if pair.k_eff > _COUPLED and 1 / _NEAR < pair.pole.frequency_Hz / expected < _NEAR
        ]
        return max(near, key=lambda pair: pair.k_eff, default=None)

    nearest = min(pieces, key=distance)
    main, expected = nearest
    # the modes of a shear plate begin with those of flexure, and a sweep may begin above the fundamental
    is_fundamental = main.kind != "shear plate" and distance(nearest) < np.log(_LOWEST)
    pair = measured.pair if is_fundamental else strongest(expected)
    if pair is None:
        without_formula = _HIGHER if measured.pair.pole.frequency_Hz > _LOWEST * expected else _OTHER
        note = f"no pair near {hertz(expected)} Hz is that of the formulas for a {WORDS[main.kind]}, so none is used"
        told = [(without_formula, measured.pair, (note,))]
    else:
        told = [(main, pair, ())]
    for piece, frequency in pieces:
        if piece is not main and piece.kind == "thickness plate" and (found := strongest(frequency)) is not None:
            told.append((piece, found, ()))
    return told


def pieces_of(shape: Shape, constants: PiezoConstants, density: float) -> list[tuple[Piece, float]]:
    """What of the standards applies to a body, and where its pole is expected, Hz; empty where nothing does."""
    gap, area = shape.electrode_gap, shape.electrode_area
    sigma = float((-constants.s12 / constants.s11).real)
    common = {"gap": gap, "area": area, "density": density, "poisson": sigma}
    if is_poled_across_field(shape) and isinstance(shape, Plate):
        lateral = min(size for index, size in enumerate(shape.dimensions) if index != shape.poling_axis)
        piece = Piece("shear plate", gap, **common, aspect=("width/thickness", lateral / gap))
        return [(piece, thin_bar_frequency(constants.s44, density, gap))]
    if not is_poled_along_field(shape):
        return []
    if isinstance(shape, Plate):
        return _of_plate(shape, constants, density, common)
    if isinstance(shape, Slab) and shape.radii is not None:
        return _of_round(shape, constants, density, common)
    return []


def _of_plate(shape: Plate, constants: PiezoConstants, density: float, common: dict) -> list[tuple[Piece, float]]:
    along = float(shape.dimensions[shape.poling_axis])
    narrow, wide = np.sort(np.delete(shape.dimensions, shape.poling_axis)).tolist()
    if along > wide:
        piece = Piece("k33 bar", along, **common, aspect=("length/width", along / wide))
        return [(piece, thin_bar_frequency(constants.s33, density, along))]
    bar = Piece("k31 bar", wide, **common, aspect=("length/width", wide / narrow))
    return [
        (bar, thin_bar_frequency(constants.s11, density, wide)),
        *_thickness(along, narrow / along, constants, density, common),
    ]


def _of_round(shape: Slab, constants: PiezoConstants, density: float, common: dict) -> list[tuple[Piece, float]]:
    inner, outer = shape.radii
    if shape.thickness > 2 * outer:
        piece = Piece("k33 bar", shape.thickness, **common, aspect=("length/diameter", shape.thickness / (2 * outer)))
        return [(piece, thin_bar_frequency(constants.s33, density, shape.thickness))]
    across = outer - inner if inner > 0 else 2 * outer
    thick = _thickness(shape.thickness, across / shape.thickness, constants, density, common)
    if inner > NARROW_RING * outer:
        ratio = ("mean diameter/width", (inner + outer) / (outer - inner))
        ring = Piece("ring", inner + outer, **common, aspect=ratio)
        return [(ring, thin_ring_frequency(constants, density, (inner + outer) / 2)), *thick]
    if inner > 0:
        return thick
    disk = Piece("disk", 2 * outer, **common, aspect=("diameter/thickness", 2 * outer / shape.thickness))
    return [(disk, thin_disk_frequency(constants, density, outer)), *thick]


def _thickness(size: float, ratio: float, constants: PiezoConstants, density: float, common: dict):
    """The thickness mode of a wide plate and its expected pole, that of the free plate below its zero."""
    if ratio < _WIDE:
        return []
    piece = Piece("thickness plate", size, **common, aspect=("width/thickness", ratio))
    stiff = material_figures(constants)
    if not (stiff["c33D"] > 0 and stiff["kt"] < 1):  # of no stable material
        return []
    zero = float(np.sqrt(stiff["c33D"] / density) / (2 * size))
    return [(piece, zero * float(np.sqrt(1 - 8 / np.pi**2 * stiff["kt"] ** 2)))]
