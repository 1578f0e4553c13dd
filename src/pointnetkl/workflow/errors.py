"""The root of this package's exceptions; each module derives its own from it."""


class PointNetKLError(Exception):
    """Bad input or an impossible request; the message is one sentence: what, where, and what to do."""


def printable(text: object) -> str:
    """Return the text of a file or of a library's error in one line of 200 letters at most, no control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(str(text).split()))[:200]
