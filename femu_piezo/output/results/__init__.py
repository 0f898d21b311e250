"""The results of the commands: those of `femu_piezo.study`, which can show, draw, tabulate and save themselves.

What a command writes is written here, and nowhere else; one file for each command.
"""
