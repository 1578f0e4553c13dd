"""A file's bytes are those of the file, however they are asked for, and a mark is found wherever it stands."""

from pathlib import Path

import numpy as np
import pytest

from pointnetkl.readers.formats.window import Window


@pytest.fixture
def content(tmp_path: Path) -> tuple[Path, bytes]:
    """A file of some thousand bytes, longer than a stretch."""
    content = np.random.default_rng(0).bytes(5000)
    (tmp_path / "file").write_bytes(content)
    return tmp_path / "file", content


def test_any_stretch_of_a_file_is_what_stands_there(content: tuple[Path, bytes]):
    path, expected = content
    rng = np.random.default_rng(1)
    with Window(path, stretch=64) as window:
        assert window.size == 5000
        for offset, count in rng.integers(0, 5200, (300, 2)).tolist():
            assert bytes(window.read(offset, count)) == expected[offset : offset + count]


def test_more_than_the_file_has_is_not_made_room_for(content: tuple[Path, bytes]):
    with Window(content[0]) as window:
        assert len(window.read(4990, 1 << 60)) == 10
        assert len(window.read(1 << 60, 8)) == 0


def test_a_mark_is_found_across_the_edges_of_stretches(tmp_path: Path):
    for at in range(0, 200, 7):
        (tmp_path / "file").write_bytes(b"." * at + b"#MRZ" + b"." * 50)
        with Window(tmp_path / "file", stretch=16) as window:
            assert window.find(b"#MRZ", 0) == at
            assert window.find(b"#MRZ", at) == at
            assert window.find(b"#MRZ", at + 1) == -1
            assert window.find(b"#MRZ", 0, at + 4) == at
            assert window.find(b"#MRZ", 0, at + 3) == -1


def test_a_file_that_gets_shorter_is_told(tmp_path: Path):
    (tmp_path / "file").write_bytes(bytes(5000))
    with Window(tmp_path / "file", stretch=64) as window:
        (tmp_path / "file").write_bytes(bytes(100))
        with pytest.raises(OSError, match="cut off while it was read"):
            window.read(2000, 8)
