"""Measured sweeps: the spectrum, readers of instrument files, checks for faults, and the noise."""
