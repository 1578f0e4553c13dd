"""Lines of numbers in a text of any size, in blocks; a damaged line costs no other line."""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

_BLOCK = 1 << 22  # bytes
_LONGEST = 1 << 20  # bytes of a line
# bytes that are no text become question marks, which no parser takes for a number or fails on
_ASCII = bytes(byte if byte in b"\t\n\r" or 32 <= byte < 127 else ord("?") for byte in range(256))
_EMPTY = ("", "nan", "na", "n/a", "null")
_COMMENT = re.compile(rb"(?m)^[ \t]*(?:#|//|%|!).*$")


class NumberLines:
    """Iterates over some columns of a text's lines from a byte on: arrays (n, columns), float64, NaN where empty."""

    def __init__(
        self, path: Path, first: int, separator: str, width: int, columns: list[int], decimal: str = "."
    ) -> None:
        """Read lines of `width` words between separators; a blank means any run of blanks and tabs."""
        self._path, self._first = path, first
        self._separator, self._decimal = separator, decimal
        self._names = [f"c{index}" for index in range(width)]
        self._selected = [self._names[index] for index in columns]
        self.bad = 0  # lines that are not numbers
        self.first_bad: int | None = None  # byte where the block of the first of them begins
        self.read = 0  # lines of numbers

    def __iter__(self) -> Iterator[np.ndarray]:
        """Yield the numbers of each block."""
        with self._path.open("rb") as file:
            offset = file.seek(self._first)
            rest = b""
            while content := file.read(_BLOCK):
                lines, rest = self._cut(rest + content)
                yield self._numbers(lines, offset)
                offset = file.tell() - len(rest)
            yield self._numbers(rest, offset)

    def _cut(self, content: bytes) -> tuple[bytes, bytes]:
        end = max(content.rfind(b"\n"), content.rfind(b"\r")) + 1
        if len(content) - end > _LONGEST:  # too long for a line: it is dropped, to bound memory
            return content[:end] + b"?\n", b""
        return content[:end], content[end:]

    def _numbers(self, content: bytes, offset: int) -> np.ndarray:
        content = self._tidied(content)
        bad_before = self.bad
        try:
            table = self._table(content, pa.float64())
            numbers = np.column_stack([column.to_numpy() for column in table.columns])
        except pa.ArrowInvalid:
            self.bad = bad_before
            numbers = self._word_by_word(content)
        if self.bad > bad_before and self.first_bad is None:
            self.first_bad = offset
        self.read += len(numbers)
        return numbers

    def _tidied(self, content: bytes) -> bytes:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b'"', b"").translate(_ASCII)
        if any(mark in content for mark in (b"#", b"//", b"%", b"!")):
            content = _COMMENT.sub(b"", content)
        if self._separator == " ":
            content = content.replace(b"\t", b" ")
            while b"  " in content:
                content = content.replace(b"  ", b" ")
            content = content.replace(b" \n", b"\n").replace(b"\n ", b"\n").strip(b" ")
        return content

    def _table(self, content: bytes, kind: pa.DataType) -> pa.Table:
        from pyarrow import csv

        if not content.strip():
            return pa.table({name: pa.array([], kind) for name in self._selected})
        return csv.read_csv(
            io.BytesIO(content),
            read_options=csv.ReadOptions(column_names=self._names, use_threads=False, block_size=len(content) + 1),
            parse_options=csv.ParseOptions(
                delimiter=self._separator, quote_char=False, invalid_row_handler=self._invalid
            ),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(self._selected, kind),
                include_columns=self._selected,
                decimal_point=self._decimal,
            ),
        )

    def _invalid(self, _: Any) -> str:
        self.bad += 1
        return "skip"

    def _word_by_word(self, content: bytes) -> np.ndarray:
        """Return the numbers of a block in which some words are not numbers."""
        columns, wrong = [], np.zeros(0, bool)
        for column in self._table(content, pa.binary()).columns:
            words = pd.Series([(word or b"").decode("latin-1") for word in column.to_pylist()], dtype=object)
            if self._decimal == ",":
                words = words.str.replace(",", ".")
            numbers = pd.to_numeric(words, errors="coerce").to_numpy(np.float64)
            wrong = (wrong if len(wrong) else np.zeros(len(numbers), bool)) | (
                np.isnan(numbers) & ~words.str.strip().str.lower().isin(_EMPTY).to_numpy(bool)
            )
            columns.append(numbers)
        self.bad += int(wrong.sum())
        return np.column_stack(columns)[~wrong]
