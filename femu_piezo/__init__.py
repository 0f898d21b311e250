"""femu_piezo: complex material parameters of piezoceramic plates from impedance sweeps."""

__version__ = "0.1.0"
