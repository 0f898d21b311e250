"""Poles and zeros of measured impedance sweeps, with uncertainties and without any model of the specimen."""

from femu_piezo.extraction.extract import Extraction, extract

__all__ = ["Extraction", "extract"]
