"""Reading and writing of artifacts: Parquet tables and npz arrays, atomic, checked, the same bytes each time."""

import contextlib
import functools
import io
import json
import os
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pointnetkl.workflow.errors import PointNetKLError

KEY = b"pointnetkl"  # of our metadata in a Parquet file
GROUP_ROWS = 1 << 16  # of a Parquet file's row groups


class ArtifactError(PointNetKLError):
    """An artifact is missing, damaged or not of the expected form."""


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, so that a reader never sees half of it.

    Raises:
        ArtifactError: the file cannot be written; a file that stood at the path before is left as it was.
    """
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")  # machines may share the folder
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with contextlib.suppress(OSError):  # most often it is not there any more
            partial.unlink()


def is_none(path: Path) -> bool:
    """Return whether a file stands for an input that does not exist, as data/none does: it begins with `none`."""
    with path.open("rb") as file:
        return file.read(4) == b"none"


def write_table(
    path: Path, frame: pd.DataFrame, schema: pa.Schema, metadata: Mapping[str, Any], crs: str | None = None
) -> None:
    """Write a table with exactly the schema's columns; its metadata are the parameters that made it.

    `crs` gets a metadata key of its own, because the reader of raw pings looks for it there in any program's files.

    Raises:
        ArtifactError: the frame lacks a column or has one of another type, or the file cannot be written.
    """
    keys = {KEY: json.dumps(metadata, sort_keys=True).encode()} | ({b"crs": crs.encode()} if crs else {})
    table = to_arrow(path, frame, schema)
    buffer = io.BytesIO()
    # fixed row groups: the bytes must not depend on the machine's memory, and few of them hold one submap;
    # checksums: a flipped bit is found
    pq.write_table(
        table.replace_schema_metadata(keys),
        buffer,
        row_group_size=GROUP_ROWS,
        compression="zstd",
        write_page_checksum=True,
    )
    write_bytes(path, buffer.getvalue())


def to_arrow(path: Path, frame: pd.DataFrame, schema: pa.Schema) -> pa.Table:
    """Return a frame as a table of exactly the schema's columns, without metadata.

    Raises:
        ArtifactError: the frame lacks a column or has one of another type; `path` is named in the error.
    """
    try:
        return pa.Table.from_pandas(frame, schema=schema, preserve_index=False).replace_schema_metadata()
    except (KeyError, pa.ArrowException) as error:
        raise ArtifactError(f"{path}: the table to write does not have its columns ({one_line(error)})") from error


def read_table(
    path: Path,
    schema: pa.Schema,
    only: Sequence[tuple[str, str, Any]] | None = None,
    also: pa.Schema | None = None,
) -> pd.DataFrame:
    """Read a table and check its columns; `only` filters rows, as [("ping", "<", 100)] does.

    The columns of `also` are optional as a group: a file that has one of them must have all, and they are read too.

    Raises:
        ArtifactError: the file is missing or damaged, or lacks a column of the schema or values in one.
    """
    rows = list(only) if only else None
    table = _guarded(path, lambda: pq.read_table(path, filters=rows, page_checksum_verification=True))
    further = also is not None and not set(also.names).isdisjoint(_guarded(path, lambda: table.column_names))
    return _checked(path, table, pa.schema([*schema, *also]) if also is not None and further else schema)


def read_groups(path: Path, schema: pa.Schema) -> Iterator[pd.DataFrame]:
    """Yield the rows of a table some thousands at a time, checked as by `read_table`; it need not fit in memory.

    Raises:
        ArtifactError: the file is missing or damaged, or lacks a column of the schema or values in one.
    """
    with _guarded(path, lambda: pq.ParquetFile(path, page_checksum_verification=True)) as file:
        for group in range(file.num_row_groups):
            yield _checked(path, _guarded(path, functools.partial(file.read_row_group, group)), schema)


def table_metadata(path: Path) -> dict[str, Any]:
    """Return the parameters stored with a table; an empty dictionary where another program wrote it.

    Raises:
        ArtifactError: the file is missing or damaged.
    """
    stored = (_guarded(path, lambda: pq.read_metadata(path)).metadata or {}).get(KEY, b"{}")
    return _object(path, stored)


def require_survey(survey: str, *paths: Path) -> None:
    """Refuse tables of another survey, which the numbers of their submaps would not show.

    Raises:
        ArtifactError: the parameters stored with one name another survey, or it is missing or damaged.
    """
    for path in paths:
        stored = table_metadata(path).get("survey", survey)
        if stored != survey:
            raise ArtifactError(f"{path}: is of survey {stored}, not of {survey}; give the files of one survey")


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """Write named arrays to one npz file, and the parameters that made them as its `metadata`.

    The bytes depend on the arrays and the parameters alone. np.savez leaves the headers to Python's zipfile, which
    changed them in 3.11.4, so each member's header is written out here.
    """
    buffer = io.BytesIO()
    members = {"metadata": np.array(json.dumps(metadata, sort_keys=True)), **arrays}
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:  # no compression: zlib's bytes differ by version
        for name, array in members.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o600 << 16  # whatever system writes it
            archive.writestr(entry, content.getvalue())
    write_bytes(path, buffer.getvalue())


def read_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read named arrays and the parameters that made them.

    Raises:
        ArtifactError: the file is missing or damaged.
    """
    try:
        # opened here, because np.load leaves a file open that is no archive
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return arrays, dict(json.loads(str(arrays.pop("metadata"))))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: is missing; run the stage that makes it (dvc repro)") from error
    except Exception as error:  # zipfile, numpy and json raise errors of many kinds on damaged bytes
        raise ArtifactError(f"{path}: is damaged ({one_line(error)}); delete it and run dvc repro") from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys.

    Raises:
        ArtifactError: a number is NaN or infinite, which JSON does not have, or the file cannot be written.
    """
    try:
        text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False)
    except ValueError as error:
        raise ArtifactError(f"{path}: a number to write is NaN or infinite, which JSON does not have") from error
    write_bytes(path, (text + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        ArtifactError: the file is missing or damaged, or holds something else.
    """
    return _object(path, _guarded(path, path.read_bytes))


def _checked(path: Path, table: pa.Table, schema: pa.Schema) -> pd.DataFrame:
    stored = _guarded(path, lambda: table.column_names)  # a damaged name raises only here
    if missing := [name for name in schema.names if name not in stored]:
        raise ArtifactError(f"{path}: lacks the column {missing[0]}; was it made by another stage?")
    try:
        table = table.select(schema.names).cast(schema)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise ArtifactError(f"{path}: a column has the wrong type ({one_line(error)})") from error
    # pandas would turn integers with a gap among them into floats; a gap among floats is NaN
    if gaps := [f.name for f in schema if pa.types.is_integer(f.type) and table[f.name].null_count]:
        raise ArtifactError(f"{path}: the column {gaps[0]} has an empty value; was it made by another stage?")
    return table.to_pandas()


def _object(path: Path, text: bytes) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except ValueError as error:
        raise ArtifactError(f"{path}: is damaged ({one_line(error)}); delete it and run dvc repro") from error
    if not isinstance(content, dict):
        raise ArtifactError(f"{path}: holds a {type(content).__name__}, not a JSON object; delete it and run dvc repro")
    return content


def _guarded(path: Path, reading: Callable[[], Any]) -> Any:
    try:
        return reading()
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: is missing; run the stage that makes it (dvc repro)") from error
    except (pa.ArrowException, OSError, ValueError) as error:  # ValueError: a name that is no UTF-8
        raise ArtifactError(f"{path}: cannot be read ({one_line(error)}); delete it and run dvc repro") from error


def one_line(error: Exception) -> str:
    """Return an error's text in one line of 200 letters at most."""
    return " ".join(str(error).split())[:200]
