"""An artifact is written whole or not at all, the same bytes each time, and never read wrong."""

import hashlib
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pointnetkl.workflow import artifacts
from pointnetkl.workflow.artifacts import ArtifactError
from pointnetkl.workflow.table_writer import TableWriter

SCHEMA = pa.schema([("submap", pa.int32()), ("name", pa.string()), ("x_m", pa.float32())])
FRAME = pd.DataFrame({"submap": [0, 1, 2], "name": ["a", "b", "c"], "x_m": [0.5, np.nan, -1.0]})
ARRAYS = {"points": np.arange(3000, dtype=np.float32).reshape(-1, 3), "submap": np.arange(4)}


def write(folder: Path) -> list[Path]:
    table, arrays, content = folder / "t.parquet", folder / "a.npz", folder / "c.json"
    artifacts.write_table(table, FRAME, SCHEMA, {"seed": 1, "a": "x"})
    artifacts.write_arrays(arrays, ARRAYS, {"seed": 2})
    artifacts.write_json(content, {"b": 1, "a": {"c": [1.5]}})
    return [table, arrays, content]


def test_what_is_written_is_read(tmp_path: Path):
    table, arrays, content = write(tmp_path / "new/folder")
    stored = artifacts.read_table(table, SCHEMA)
    pd.testing.assert_frame_equal(stored, FRAME.astype({"submap": np.int32, "x_m": np.float32}), check_dtype=False)
    assert stored["submap"].dtype == np.int32
    assert artifacts.table_metadata(table) == {"seed": 1, "a": "x"}
    stored, metadata = artifacts.read_arrays(arrays)
    assert metadata == {"seed": 2}
    assert all(
        np.array_equal(stored[name], value) and stored[name].dtype == value.dtype for name, value in ARRAYS.items()
    )
    assert artifacts.read_json(content) == {"b": 1, "a": {"c": [1.5]}}


def test_an_npz_has_these_bytes_with_every_python(tmp_path: Path):
    # the same from Python 3.11 to 3.14, and for a view that another layout holds
    path = tmp_path / "a.npz"
    artifacts.write_arrays(path, ARRAYS | {"fortran": np.asfortranarray(np.eye(3)[::-1])}, {"b": 1, "a": [0.5]})
    pinned = "288adfc40abaa55f91b1559bcf71363539c3522cac20caa86e66a21022ef8349"
    assert hashlib.sha256(path.read_bytes()).hexdigest() == pinned
    artifacts.write_arrays(path, ARRAYS | {"fortran": np.eye(3)[::-1]}, {"a": [0.5], "b": 1})
    assert hashlib.sha256(path.read_bytes()).hexdigest() == pinned


def test_only_the_rows_asked_for_are_read(tmp_path: Path):
    table, *_ = write(tmp_path)
    assert artifacts.read_table(table, SCHEMA, only=[("submap", ">", 0)])["name"].tolist() == ["b", "c"]


def test_a_table_read_piece_by_piece_is_the_whole_table(tmp_path: Path):
    long = pd.DataFrame({"submap": range(150_000), "name": "a", "x_m": 0.5})
    artifacts.write_table(tmp_path / "t.parquet", long, SCHEMA, {})
    pieces = list(artifacts.read_groups(tmp_path / "t.parquet", SCHEMA))
    assert len(pieces) > 1
    table = artifacts.read_table(tmp_path / "t.parquet", SCHEMA)
    pd.testing.assert_frame_equal(pd.concat(pieces, ignore_index=True), table)


def test_the_same_content_gives_the_same_bytes(tmp_path: Path):
    for first, other in zip(write(tmp_path / "one"), write(tmp_path / "other"), strict=True):
        assert first.read_bytes() == other.read_bytes()


def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    paths = write(tmp_path)
    before = [path.read_bytes() for path in paths]

    def full(self: Path, content: bytes) -> int:
        with self.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    for path in paths:
        with pytest.raises(ArtifactError, match="cannot be written \\(No space left on device\\)"):
            artifacts.write_bytes(path, b"new content")
    assert [path.read_bytes() for path in paths] == before
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path: Path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file/below.json", tmp_path / "folder", tmp_path / ("n" * 300)):
        with pytest.raises(ArtifactError, match="cannot be written"):
            artifacts.write_json(path, {})


def test_a_frame_that_does_not_fit_its_schema_is_not_written(tmp_path: Path):
    for frame in (FRAME.drop(columns="x_m"), FRAME.assign(submap="a"), FRAME.assign(submap=[0.5, 1.0, 2.0])):
        with pytest.raises(ArtifactError, match="does not have its columns"):
            artifacts.write_table(tmp_path / "t.parquet", frame, SCHEMA, {})
    assert not list(tmp_path.iterdir())


def test_json_refuses_what_it_cannot_say(tmp_path: Path):
    with pytest.raises(ArtifactError, match="NaN or infinite"):
        artifacts.write_json(tmp_path / "c.json", {"a": float("nan")})


def test_a_missing_artifact_says_what_to_run(tmp_path: Path):
    for reading in (
        lambda path: artifacts.read_table(path, SCHEMA),
        artifacts.table_metadata,
        artifacts.read_arrays,
        artifacts.read_json,
    ):
        with pytest.raises(ArtifactError, match=r"gone: is missing; run the stage that makes it \(dvc repro\)"):
            reading(tmp_path / "gone")


def test_half_a_file_is_refused(tmp_path: Path):
    table, arrays, content = write(tmp_path)
    for path in (table, arrays, content):
        raw = path.read_bytes()
        for size in (0, 3, len(raw) // 2, len(raw) - 5):
            path.write_bytes(raw[:size])
            with pytest.raises(ArtifactError):
                {table: artifacts.table_metadata, arrays: artifacts.read_arrays, content: artifacts.read_json}[path](
                    path
                )


def outcome(reading: Callable[[], object]) -> str:
    """Return what was read as text, or the error's sentence."""
    try:
        return str(reading())
    except ArtifactError as error:
        return f"refused: {error}"


def test_a_flipped_bit_in_the_data_is_found_or_harmless(tmp_path: Path):
    table, arrays, _ = write(tmp_path)
    data = table.stat().st_size - pq.read_metadata(table).serialized_size - 8
    for path, size, reading in (
        (table, data, lambda: artifacts.read_table(table, SCHEMA)),
        (table, data, lambda: list(artifacts.read_groups(table, SCHEMA))),
        (arrays, arrays.stat().st_size, lambda: artifacts.read_arrays(arrays)),
    ):
        raw, expected = path.read_bytes(), outcome(reading)
        for place in np.random.default_rng(0).integers(4, size, 60):
            path.write_bytes(raw[:place] + bytes([raw[place] ^ 0x10]) + raw[place + 1 :])
            result = outcome(reading)
            assert result == expected or (result.startswith("refused: ") and "\n" not in result)
        path.write_bytes(raw)


def test_the_columns_of_another_stage_are_refused(tmp_path: Path):
    path = tmp_path / "t.parquet"
    for columns, message in [
        ({"submap": [1], "name": ["a"]}, "lacks the column x_m"),
        ({"submap": ["one"], "name": ["a"], "x_m": [1.0]}, "a column has the wrong type"),
        ({"submap": [1.5], "name": ["a"], "x_m": [1.0]}, "a column has the wrong type"),
        ({"submap": [1, None], "name": ["a", "b"], "x_m": [1.0, 2.0]}, "the column submap has an empty value"),
    ]:
        pq.write_table(pa.table(columns), path)
        with pytest.raises(ArtifactError, match=message):
            artifacts.read_table(path, SCHEMA)
        with pytest.raises(ArtifactError, match=message):
            list(artifacts.read_groups(path, SCHEMA))


def test_arrays_that_would_run_code_are_refused(tmp_path: Path):
    buffer = io.BytesIO()
    np.savez(buffer, metadata=np.array("{}"), points=np.array([{"a": 1}], dtype=object))
    (tmp_path / "a.npz").write_bytes(buffer.getvalue())
    with pytest.raises(ArtifactError, match="is damaged"):
        artifacts.read_arrays(tmp_path / "a.npz")


def test_json_that_is_no_object_is_refused(tmp_path: Path):
    for text in ("[]", "[[1, 2]]", "3", "null", "\xff"):
        (tmp_path / "c.json").write_text(text, encoding="latin-1")
        with pytest.raises(ArtifactError):
            artifacts.read_json(tmp_path / "c.json")


def test_a_table_of_another_survey_is_refused_and_one_that_does_not_say_is_not(tmp_path: Path):
    paths = [tmp_path / f"{name}.parquet" for name in ("none", "borno", "baltic")]
    for path, metadata in zip(paths, ({}, {"survey": "borno"}, {"survey": "baltic"}), strict=True):
        artifacts.write_table(path, FRAME, SCHEMA, metadata)
    artifacts.require_survey("borno", *paths[:2])
    with pytest.raises(ArtifactError, match=r"baltic\.parquet: is of survey baltic, not of borno"):
        artifacts.require_survey("borno", *paths)


ROWS = pa.schema([("a", pa.int32()), ("b", pa.float64())])


def rows(count: int) -> pd.DataFrame:
    return pd.DataFrame({"a": np.arange(count, dtype=np.int32), "b": np.linspace(0, 1, count)})


def test_a_table_written_in_parts_is_the_same_whatever_the_parts(tmp_path: Path):
    table = rows(200_000)
    for size in (1000, 65_536, 200_000):
        with TableWriter(tmp_path / f"{size}.parquet", ROWS) as writer:
            for begin in range(0, len(table), size):
                writer.write(table[begin : begin + size])
            writer.metadata = {"known": "last"}
    assert artifacts.read_table(tmp_path / "1000.parquet", ROWS).equals(table)
    assert artifacts.table_metadata(tmp_path / "1000.parquet") == {"known": "last"}
    contents = {path.read_bytes() for path in tmp_path.iterdir()}
    assert len(contents) == 1


def test_a_table_without_parts_is_empty(tmp_path: Path):
    with TableWriter(tmp_path / "t.parquet", ROWS):
        pass
    assert artifacts.read_table(tmp_path / "t.parquet", ROWS).empty


def test_a_table_that_is_not_finished_leaves_what_stood_there(tmp_path: Path):
    path = tmp_path / "t.parquet"
    path.write_text("before")
    with pytest.raises(KeyError), TableWriter(path, ROWS) as writer:  # noqa: PT012
        writer.write(rows(100_000))
        raise KeyError
    with (
        pytest.raises(artifacts.ArtifactError, match="does not have its columns"),
        TableWriter(path, ROWS) as writer,
    ):
        writer.write(rows(3).drop(columns="b"))
    assert [file.name for file in tmp_path.iterdir()] == ["t.parquet"]
    assert path.read_text() == "before"
