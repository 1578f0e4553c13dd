"""The root of this package's exceptions: each module defines its own one below it."""


class PointNetKLError(Exception):
    """Bad input or an impossible request, told in one sentence: what, where, and what to do."""


def printable(told: object) -> str:
    """Return what a file or a library says, cut to 200 letters, in one line without control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(str(told).split()))[:200]
