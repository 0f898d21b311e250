"""The figures and formulas of the standards (IEEE 176-1987, EN 50324-2), of a curve alone: no model of the body."""
