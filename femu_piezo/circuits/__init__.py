"""Equivalent circuits of a piezoelectric one-port: branches from residues, text for SPICE."""
