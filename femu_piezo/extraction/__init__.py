"""Poles and zeros of measured impedance sweeps, with uncertainties and without any model of the specimen."""

from femu_piezo.extraction.extraction import extract
from femu_piezo.extraction.result import Extraction

__all__ = ["Extraction", "extract"]
