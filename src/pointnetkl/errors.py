"""The root of this package's exceptions: each module defines its own one below it."""


class PointNetKLError(Exception):
    """Bad input or an impossible request, told in one sentence: what, where, and what to do."""
