"""The constants of a material as files of other programs, and back: `writers.PROGRAMS` by name."""
