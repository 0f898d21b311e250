"""A page for the laboratory: what the commands do, in a browser on the same machine (`femu-piezo serve`).

The page computes nothing itself: every answer is the work of a command in a process of its own (`jobs`), and every
result lies in the folder as that command writes it, so that a page and a terminal can share a lot.
"""
