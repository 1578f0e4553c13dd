"""The chunks of a LAZ file, each decompressed alone, so that damage to one costs no other.

LASzip has no checksum. But the decompression of a whole chunk uses all its bytes, and that of a damaged one hardly ever
does. Some damaged counts make the library end the process, so that counts are checked before.
"""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pointnetkl.readers.formats.las.header import Header, LasError
from pointnetkl.readers.formats.recording import Problems
from pointnetkl.readers.formats.window import Window

_USER, _NUMBER = "laszip encoded", 22204
_VLR = struct.Struct("<HHBBHIIqqH")  # compressor, coder, version, options, points in a chunk, ..., number of items
_CHUNKED, _LAYERED = 2, 3  # compressors; files from before about 2011 have 1
_ANY = 0xFFFF_FFFF  # points in a chunk: the table has the number for each chunk
_MOST_POINTS = 1 << 20  # in a chunk; the usual is 50,000
_WITHOUT_LAYERS = frozenset({0, 6, 7, 8, 9})  # items of points up to format 5
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1, 14: 0}  # number, by item of format 6 and up; extra bytes, 14, have one a byte
_SLACK = 4  # bytes at the end of a chunk in which encoders differ
_BLOCK = 1 << 16  # points decompressed at once, so that a wrong count allocates little
_PANIC = "PanicException"  # of Rust: it is no Exception, and its class cannot be imported
_STEP = 64  # last bytes of a chunk, which are handed out one by one to count those that are used

_Outcome = TypeVar("_Outcome")


@dataclass
class Chunks:
    """Iterates over the points of the whole chunks, as bytes; counts the rest."""

    path: Path
    window: Window
    header: Header
    problems: Problems
    decompressed: int = 0  # points
    lost: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be decompressed.

        Raises:
            LasError: the LASzip record is missing, damaged, or does not fit the points of the header.
        """
        self._vlr = self.header.records.get((_USER, _NUMBER), b"")
        if len(self._vlr) < _VLR.size:
            raise LasError(f"{self.path}: is compressed, but its LASzip record is missing or cut; copy it again")
        self._kind, _, _, _, _, _, self._per_chunk, _, _, count = _VLR.unpack_from(self._vlr)
        items = self._vlr[_VLR.size : _VLR.size + 6 * count]
        self._items = list(struct.iter_unpack("<HHH", items)) if len(items) == 6 * count else []
        readable = {_CHUNKED: _WITHOUT_LAYERS, _LAYERED: frozenset(_LAYERS)}.get(self._kind, frozenset())
        fits = all(item[0] in readable for item in self._items)
        if not fits or sum(item[1] for item in self._items) != self.header.record_bytes:
            raise LasError(
                f"{self.path}: its LASzip record (compressor {self._kind}, {count} items) does not fit points of"
                f" {self.header.record_bytes} bytes; it is damaged, or of LASzip before 2.0: write it again"
            )
        if not 0 < self._per_chunk <= _MOST_POINTS and self._per_chunk != _ANY:
            raise LasError(f"{self.path}: its LASzip record says {self._per_chunk} points in a chunk; it is damaged")

    def __iter__(self) -> Iterator[bytes]:
        """Yield the records of a chunk."""
        table = self._table()
        if table is None:
            yield from self._untabled()
            return
        offset, remaining = self.header.first + 8, self.header.declared
        for number, (points, size) in enumerate(table):
            if self._per_chunk == _ANY and not points:  # some writers end with an empty chunk
                offset += size
                continue
            last = number == len(table) - 1
            expected = points or min(self._per_chunk, remaining if last else self._per_chunk)
            yield from self._chunk(offset, size, expected)
            offset, remaining = offset + size, max(0, remaining - expected)

    def _table(self) -> list[tuple[int, int]] | None:
        """Return the points (0: unknown) and bytes of each chunk; None if no table fits the file."""
        start = self._table_start()
        head = self.window.read(start, 8)
        count = struct.unpack_from("<I", head, 4)[0] if start and len(head) == 8 else 0
        space = start - self.header.first - 8
        if not count or count > space // self.header.record_bytes:  # each begins with a point as it is
            self.problems.add(
                f"its table of chunks is missing or damaged, at byte {start}" if start else "it is cut off"
            )
            return None
        chunks = _guarded(lambda lazrs: self._listed(lazrs, start, count))
        if not chunks or sum(size for _, size in chunks) != space or max(n for n, _ in chunks) > _MOST_POINTS:
            self.problems.add(f"its table of chunks at byte {start} is damaged")
            return None
        if self._per_chunk != _ANY:
            chunks = [(0, size) for _, size in chunks]
            least = (count - 1) * self._per_chunk
            if not least < self.header.declared <= least + self._per_chunk:
                self.problems.add(
                    f"its header has {self.header.declared} points, and {count} chunks of {self._per_chunk}"
                )
        return chunks

    def _table_start(self) -> int:
        for offset in (self.header.first, self.window.size - 8):  # at the end, where a writer could not go back
            (start,) = struct.unpack("<q", self.window.read(offset, 8)) if offset + 8 <= self.window.size else (0,)
            if self.header.first + 8 < start < self.window.size - 8:
                return int(start)
        return 0

    def _listed(self, lazrs: Any, start: int, count: int) -> list[tuple[int, int]]:
        # an entry takes ten bytes at most
        table = bytes(self.window.read(start, 64 + 10 * count))
        return list(lazrs.read_chunk_table_only(io.BytesIO(table + bytes(64)), lazrs.LazVlr(self._vlr)))

    def _chunk(self, offset: int, size: int, points: int) -> Iterator[bytes]:
        content = bytes(self.window.read(offset, size))
        stated, length = self._layers(content) if self._kind == _LAYERED else (points, size)
        sound = length == size and (stated == points or self._per_chunk != _ANY)
        rows, used = self._rows(content, stated, size - _STEP) if sound else (b"", 0)
        if rows and abs(used - size) <= _SLACK:
            self.decompressed += stated
            yield rows
        else:
            self.lost += points
            self.problems.add(f"{size} bytes from byte {offset} on are a damaged chunk of {points or 'unknown'} points")

    def _untabled(self) -> Iterator[bytes]:
        """Yield chunks one after another without a table, until one is damaged."""
        offset, end = self.header.first + 8, self.header.end
        most = 2 * self._per_chunk * self.header.record_bytes + 1024
        while offset < end and self.decompressed < self.header.declared:
            points = min(self._per_chunk, self.header.declared - self.decompressed) if self._per_chunk != _ANY else 0
            if self._kind == _LAYERED:
                stated, most = self._layers(bytes(self.window.read(offset, self._layers_end)))
                points = stated if most <= end - offset else 0  # the library allocates a layer of any size
            content = bytes(self.window.read(offset, min(most, end - offset))) if points else b""
            rows, used = self._rows(content, points, 0)
            if not rows or used > len(content):
                self.lost += points
                self.problems.add(f"{end - offset} bytes from byte {offset} on are damaged or cut off")
                return
            self.decompressed += points
            offset += used
            yield rows

    @property
    def _layers_end(self) -> int:
        """Return the bytes of a layered chunk up to its layers."""
        layers = sum(_LAYERS[kind] or size for kind, size, _ in self._items)
        return self.header.record_bytes + 4 + 4 * layers

    def _layers(self, content: bytes) -> tuple[int, int]:
        """Return the points of a layered chunk, 0 if too many, and its bytes, by the header before its layers."""
        if len(content) < self._layers_end:
            return 0, 0
        begin = self.header.record_bytes
        points, *sizes = struct.unpack_from(f"<{(self._layers_end - begin) // 4}I", content, begin)
        return points if points <= _MOST_POINTS else 0, self._layers_end + sum(sizes)

    def _rows(self, content: bytes, points: int, slow: int) -> tuple[bytes, int]:
        """Return a decompressed chunk, empty if that fails, and how many of its bytes were used."""
        if not 0 < points <= _MOST_POINTS or len(content) < self.header.record_bytes:
            return b"", 0
        # one chunk of so many points, and a table of none
        vlr = self._vlr[:12] + struct.pack("<I", points) + self._vlr[16:]
        source = _Source(struct.pack("<q", 8 + len(content)) + content + bytes(8), max(8, 8 + slow))
        rows = _guarded(lambda lazrs: self._decompressed(lazrs.LasZipDecompressor(source, vlr), points))
        return rows or b"", source.tell() - 8

    def _decompressed(self, opened: Any, points: int) -> bytes:
        blocks = []
        for begin in range(0, points, _BLOCK):
            blocks.append(bytearray(min(_BLOCK, points - begin) * self.header.record_bytes))
            opened.decompress_many(blocks[-1])
        return b"".join(blocks)


class _Source(io.BytesIO):
    """Bytes that are handed out one by one from `slow` on, so that those read are those used."""

    def __init__(self, content: bytes, slow: int) -> None:
        super().__init__(content)
        self._slow = slow

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer, or a part of it, and return how many bytes that is."""
        content = self.read(min(len(buffer), max(1, self._slow - self.tell())))
        buffer[: len(content)] = content
        return len(content)


def _guarded(work: Callable[[Any], _Outcome]) -> _Outcome | None:
    """Return the result of a call into the library, None where damage makes it fail."""
    import lazrs

    try:
        return work(lazrs)
    except lazrs.LazrsError:
        return None
    except BaseException as error:
        if type(error).__name__ != _PANIC:
            raise
        return None
