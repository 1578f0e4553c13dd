"""Text files with one record a line, such as g2o and TUM: numbered lines, and strict parsing of numbers."""

import math
from collections.abc import Sequence
from pathlib import Path

from pointnetkl.workflow.errors import PointNetKLError


def read(path: Path, error: type[PointNetKLError]) -> list[tuple[int, list[str]]]:
    """Return the number, from 1, and the words of each line that is not blank; comments (#) are included.

    Raises:
        PointNetKLError: of the class `error`; the file cannot be read, or is not a text.
    """
    try:
        text = path.read_bytes().decode("ascii", "surrogateescape")
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror})") from cause
    lines = [(number, line.split()) for number, line in enumerate(text.split("\n"), 1)]
    if not_text := [number for number, words in lines if words and not "".join(words).isascii() and words[0][0] != "#"]:
        raise error(f"{path}: line {not_text[0]}: it is no text of numbers; the file is damaged or of another form")
    return [(number, words) for number, words in lines if words]


def numbers(words: Sequence[str]) -> list[float]:
    """Return words as numbers.

    Raises:
        ValueError: a word is not a finite number.
    """
    for word in words:
        if "_" in word or not _is_finite(word):  # Python takes 1_0 for 10; no other program writes that
            raise ValueError(f"{shown(word)} is not a finite number")
    return [float(word) for word in words]


def whole_number(word: str) -> int:
    """Return a word as a whole number from 0, of at most 63 bits.

    Raises:
        ValueError: the word is not such a number.
    """
    if not (word.isdecimal() and len(word) < 19):
        raise ValueError(f"{shown(word)} is not a whole number from 0")
    return int(word)


def shown(word: str) -> str:
    """Return the beginning of a word for an error message, with odd characters escaped."""
    return ascii(word[:30])


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
