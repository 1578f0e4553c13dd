"""Writing of Parquet tables that need not fit in memory."""

import contextlib
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pointnetkl.workflow import artifacts


class TableWriter:
    """A context that writes a table part by part, so that it need not fit in memory.

    The file is whole in the end, or not there at all. `metadata` is as write_table takes it; it may be set until the
    context ends.

    Raises:
        ArtifactError: a part lacks a column or has one of another type, or the file cannot be written; a file that
            stood at the path before is left as it was.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        """Begin a table in a temporary file beside its path."""
        self.metadata: Mapping[str, Any] = {}
        self._path, self._schema = path, schema
        self._partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
        self._waiting = schema.empty_table()
        self._file: Any = None

    def __enter__(self) -> Self:
        """Return the writer; no file is opened before there are rows."""
        return self

    def write(self, frame: pd.DataFrame) -> None:
        """Add rows."""
        part = artifacts.to_arrow(self._path, frame, self._schema)
        self._waiting = pa.concat_tables([self._waiting, part])
        # groups of one size, whatever the parts: the bytes must not depend on them
        while len(self._waiting) >= artifacts.GROUP_ROWS:
            self._write_group()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Move the file to its path, unless there was an error."""
        try:
            if kind is None:
                self._write_group()
                self._finish()
            elif self._file is not None:
                self._file.close()
        finally:
            with contextlib.suppress(OSError):
                self._partial.unlink()

    def _write_group(self) -> None:
        group, self._waiting = self._waiting[: artifacts.GROUP_ROWS], self._waiting[artifacts.GROUP_ROWS :]
        with self._one_sentence():
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = pq.ParquetWriter(self._partial, self._schema, compression="zstd", write_page_checksum=True)
            self._file.write_table(group.combine_chunks(), row_group_size=artifacts.GROUP_ROWS)

    def _finish(self) -> None:
        with self._one_sentence():
            self._file.add_key_value_metadata({artifacts.KEY: json.dumps(self.metadata, sort_keys=True).encode()})
            self._file.close()
            os.replace(self._partial, self._path)

    @contextlib.contextmanager
    def _one_sentence(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise artifacts.ArtifactError(
                f"{self._path}: cannot be written ({error.strerror or artifacts.one_line(error)})"
            ) from error
