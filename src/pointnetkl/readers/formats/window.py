"""A file's bytes by place, of which only a stretch is in memory: no map of the file, which would count as memory."""

import os
from pathlib import Path
from types import TracebackType
from typing import Self

_STRETCH = 1 << 23  # bytes


class Window:
    """A file opened for reading, whose bytes are asked for by offset; what lies near the last ones costs nothing.

    Raises:
        OSError: the file cannot be opened or read, or gets shorter meanwhile.
    """

    def __init__(self, path: Path, stretch: int = _STRETCH) -> None:
        """Open the file; `stretch` is how many bytes are held at least."""
        self._file = path.open("rb")
        self._stretch = stretch
        self._begin, self._held = 0, b""
        self.size = os.fstat(self._file.fileno()).st_size

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Close the file."""
        self._file.close()

    def read(self, offset: int, count: int) -> memoryview:
        """Return `count` bytes from `offset`, fewer where the file ends; memory is bounded by the file's size."""
        if offset >= self.size:
            return memoryview(b"")
        begin = offset - self._begin
        if begin < 0 or begin + count > len(self._held):
            self._file.seek(offset)
            wanted = min(max(count, self._stretch), self.size - offset)
            self._begin, self._held, begin = offset, self._file.read(wanted), 0
            if len(self._held) < wanted:
                raise OSError("it was cut off while it was read")
        return memoryview(self._held)[begin : begin + count]

    def find(self, mark: bytes, offset: int, before: int | None = None) -> int:
        """Return where `mark` begins next, at `offset` or after it and wholly before `before`; -1 where nowhere."""
        end = self.size if before is None else min(before, self.size)
        while offset + len(mark) <= end:
            stretch = min(self._stretch, end - offset)
            if (found := bytes(self.read(offset, stretch)).find(mark)) >= 0:
                return offset + found
            offset += stretch - len(mark) + 1
        return -1
