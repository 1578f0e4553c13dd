"""A window gives the bytes of its file, and candidates for records are found wherever they are."""

import re
from pathlib import Path

import numpy as np
import pytest

from pointnetkl.readers.formats import window as window_module
from pointnetkl.readers.formats.window import Mark, Window, candidates


@pytest.fixture
def content(tmp_path: Path) -> tuple[Path, bytes]:
    """A file of some thousand bytes, longer than a stretch."""
    content = np.random.default_rng(0).bytes(5000)
    (tmp_path / "file").write_bytes(content)
    return tmp_path / "file", content


def test_any_stretch_of_a_file_has_the_bytes_of_the_file(content: tuple[Path, bytes]):
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


def test_a_candidate_is_found_once_wherever_the_stretches_are_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(window_module, "_SEARCHED", 16)
    mark = Mark(re.compile(rb"#[A-Z]{3}"), lead=4, length=4, header=8)
    for begin in range(4, 200, 7):
        content = b"." * begin + b"#MRZ" + b"." * 9 + b"#SKM" + b"." * 50
        (tmp_path / "file").write_bytes(content)
        with Window(tmp_path / "file", stretch=16) as window:
            places = [(begin - 4, b"#MRZ"), (begin + 9, b"#SKM")]
            assert list(candidates(window, mark, 0, window.size)) == places
            assert list(candidates(window, mark, begin - 3, window.size)) == places[1:]
            assert list(candidates(window, mark, 0, begin)) == []


def test_a_file_that_gets_shorter_is_reported(tmp_path: Path):
    (tmp_path / "file").write_bytes(bytes(5000))
    with Window(tmp_path / "file", stretch=64) as window:
        (tmp_path / "file").write_bytes(bytes(100))
        with pytest.raises(OSError, match="cut off while it was read"):
            window.read(2000, 8)
