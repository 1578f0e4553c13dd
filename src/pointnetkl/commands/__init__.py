"""The commands of `python -m pointnetkl`: a module each, with `add`, which declares its arguments, and `run`.

To add a command, put a module here and its name in NAMES.
"""

NAMES = ("correct", "demo", "inspect", "predict", "slam", "export", "solve")  # in the order of the help
