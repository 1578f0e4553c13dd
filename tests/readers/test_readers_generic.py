"""Generic pings in parts: the same pings and soundings, bit for bit, however a file is cut into blocks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from generic_files import rows
from pointnetkl.readers.formats import generic
from pointnetkl.readers.formats.generic import GenericError
from pointnetkl.readers.formats.recording import Recording

RAW = rows(pings=60, beams=7).assign(down_m=np.random.default_rng(0).normal(30, 1, 420).astype(np.float32))


def joined(parts: Sequence[Recording]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the pings and soundings of all parts, numbered through."""
    first = np.cumsum([0, *(len(part.pings) for part in parts)])
    soundings = [
        p.soundings.assign(ping=p.soundings["ping"] + first_ping) for p, first_ping in zip(parts, first, strict=False)
    ]
    return pd.concat([p.pings for p in parts], ignore_index=True), pd.concat(soundings, ignore_index=True)


def written(path: Path, table: pd.DataFrame, **options: int) -> Path:
    """Write pings as Parquet or CSV, by the name."""
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        pq.write_table(pa.Table.from_pandas(table, preserve_index=False), path, **options)
    return path


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read few rows at once."""
    monkeypatch.setattr(generic, "PART", 50)
    monkeypatch.setattr(generic, "_BLOCK", 2000)
    monkeypatch.setattr(generic, "_LARGE", 0)


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_a_file_in_blocks_has_the_pings_of_the_file_at_once(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
):
    path = written(tmp_path / name, RAW, row_group_size=33)
    (expected_part,) = generic.read(path)
    request.getfixturevalue("small_blocks")
    parts = list(generic.read(path))
    assert len(parts) > 4
    for table, expected in zip(joined(parts), (expected_part.pings, expected_part.soundings), strict=True):
        pd.testing.assert_frame_equal(table, expected, check_exact=True)


@pytest.mark.usefixtures("small_blocks")
def test_rows_that_go_back_in_time_are_counted_over_all_blocks(tmp_path: Path):
    mixed = RAW.sample(frac=1.0, random_state=np.random.RandomState(3))
    parts = list(generic.read(written(tmp_path / "a.parquet", mixed)))
    assert sum(len(part.soundings) for part in parts) == 420
    early = int((np.diff(mixed["time_s"]) < 0).sum())
    problems = [problem for part in parts for problem in part.problems]
    assert problems == [f"a.parquet: its rows went back in time {early} times, and were sorted"]


@pytest.mark.usefixtures("small_blocks")
def test_a_crs_that_changes_within_a_file_is_refused(tmp_path: Path):
    two = RAW.assign(crs=np.where(RAW.index < 210, "EPSG:32632", "EPSG:32633"))
    with pytest.raises(GenericError, match="column crs must name one coordinate system"):
        list(generic.read(written(tmp_path / "a.csv", two)))


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_a_table_without_rows_is_a_part_without_pings(tmp_path: Path, name: str):
    (part,) = generic.read(written(tmp_path / name, RAW.head(0).astype(float)))
    assert len(part.pings) == len(part.soundings) == 0


def test_columns_of_garbage_are_named_in_letters_that_can_be_printed(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_bytes(bytes(range(256)).replace(b"\n", b"") * 3)
    with pytest.raises(GenericError, match="column time_s is missing; it has") as caught:
        list(generic.read(path))
    assert str(caught.value).isprintable()
