"""The commands of `python -m pointnetkl`: a module each, with `add`, which says its words, and `run`.

A new one is a file here and its name in NAMES.
"""

NAMES = ("inspect", "predict", "slam", "export", "solve")  # in the order of the help
