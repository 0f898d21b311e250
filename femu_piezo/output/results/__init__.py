"""The results of the commands: results of `femu_piezo.study` with methods that show, draw, tabulate and save them.

The files of a command are written here and nowhere else; one module for each command.
"""
