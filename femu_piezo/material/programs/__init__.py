"""The constants of a material as files of other programs: `writers.PROGRAMS` by name."""
