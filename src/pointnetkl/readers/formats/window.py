"""Bytes of a file by offset, of which only a stretch is in memory, and the search for records in damaged bytes.

A file is not mapped into memory, because mapped pages count as memory of the process.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

_STRETCH = 1 << 23  # bytes
_SEARCHED = 1 << 16  # bytes that are searched at once


class Window:
    """A file opened for reading by offset; bytes near those read last are in memory.

    Raises:
        OSError: the file cannot be opened or read, or gets shorter meanwhile.
    """

    def __init__(self, path: Path, stretch: int = _STRETCH) -> None:
        """Open the file; `stretch` is how many bytes are read at once."""
        self._file = path.open("rb")
        self._stretch = stretch
        self._begin, self._bytes = 0, b""
        self.size = os.fstat(self._file.fileno()).st_size

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self._file.close()

    def read(self, offset: int, count: int) -> memoryview:
        """Return `count` bytes from `offset`, fewer at the end of the file, which also bounds the memory."""
        if offset >= self.size:
            return memoryview(b"")
        begin = offset - self._begin
        if begin < 0 or begin + count > len(self._bytes):
            self._file.seek(offset)
            wanted = min(max(count, self._stretch), self.size - offset)
            self._begin, self._bytes, begin = offset, self._file.read(wanted), 0
            if len(self._bytes) < wanted:
                raise OSError("it was cut off while it was read")
        return memoryview(self._bytes)[begin : begin + count]


class Mark(NamedTuple):
    """Bytes by which the beginning of a record is recognised."""

    pattern: re.Pattern[bytes]
    lead: int  # bytes of a record before the pattern
    length: int  # bytes that the pattern looks at
    header: int  # bytes of a record's header; fewer are not searched


def candidates(window: Window, mark: Mark, begin: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield each offset in [begin, end) at which a record may begin, and the bytes that the pattern matched there.

    Readers resume here after damage: they take the first candidate that is a whole record.
    """
    while begin + mark.header < end:
        stretch = window.read(begin, min(_SEARCHED, end - begin))
        for match in mark.pattern.finditer(stretch, mark.lead):
            yield begin + match.start() - mark.lead, match[0]
        begin += max(1, len(stretch) - (mark.lead + mark.length - 1))  # a record may be cut in two by the stretch
