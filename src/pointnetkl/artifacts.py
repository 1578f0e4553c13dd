"""Reading and writing of artifacts: Parquet tables and npz arrays, atomic, checked, the same bytes each time."""

import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pointnetkl.errors import PointNetKLError

_KEY = b"pointnetkl"


class ArtifactError(PointNetKLError):
    """An artifact is missing, damaged or not of the expected form."""


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: a reader never sees half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        partial.unlink(missing_ok=True)


def write_table(path: Path, frame: pd.DataFrame, schema: pa.Schema, metadata: Mapping[str, Any]) -> None:
    """Write a table with exactly the schema's columns, and the parameters that made it as metadata."""
    text = json.dumps(metadata, sort_keys=True).encode()
    table = pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
    buffer = io.BytesIO()
    # fixed row groups: the bytes must not depend on the machine's memory
    pq.write_table(table.replace_schema_metadata({_KEY: text}), buffer, row_group_size=1 << 20, compression="zstd")
    write_bytes(path, buffer.getvalue())


def read_table(path: Path, schema: pa.Schema) -> pd.DataFrame:
    """Read a table and check its columns.

    Raises:
        ArtifactError: the file is missing or damaged, or lacks a column of the schema.
    """
    table = _open_table(path)
    if missing := [name for name in schema.names if name not in table.column_names]:
        raise ArtifactError(f"{path}: lacks the column {missing[0]}; was it made by another stage?")
    try:
        return table.select(schema.names).cast(schema).to_pandas()
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise ArtifactError(f"{path}: a column has the wrong type ({_line(error)})") from error


def table_metadata(path: Path) -> dict[str, Any]:
    """Return the parameters stored with a table."""
    stored = (_open_table(path).schema.metadata or {}).get(_KEY, b"{}")
    return dict(json.loads(stored))


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """Write named arrays to one npz file, and the parameters that made them as its `metadata`."""
    buffer = io.BytesIO()
    np.savez(buffer, metadata=np.array(json.dumps(metadata, sort_keys=True)), **dict(arrays))  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())


def read_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read named arrays and the parameters that made them.

    Raises:
        ArtifactError: the file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return arrays, dict(json.loads(str(arrays.pop("metadata"))))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: is missing; run the stage that makes it (dvc repro)") from error
    except Exception as error:  # zipfile, numpy and json each fail in their own ways on damaged bytes
        raise ArtifactError(f"{path}: is damaged ({_line(error)}); delete it and run dvc repro") from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys; NaN is refused, because JSON has none."""
    write_bytes(path, (json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object."""
    try:
        return dict(json.loads(path.read_text()))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: is missing; run the stage that makes it (dvc repro)") from error
    except ValueError as error:
        raise ArtifactError(f"{path}: is damaged ({_line(error)}); delete it and run dvc repro") from error


def _open_table(path: Path) -> pa.Table:
    try:
        return pq.read_table(path)
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: is missing; run the stage that makes it (dvc repro)") from error
    except (pa.ArrowException, OSError) as error:
        raise ArtifactError(f"{path}: is not a readable Parquet file ({_line(error)})") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
