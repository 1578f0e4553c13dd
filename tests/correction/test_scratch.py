"""What a correction has finished is kept, whole, until its folder appears; other settings begin anew."""

import errno
import os
import re
from pathlib import Path

import pytest

from pointnetkl.correction import scratch
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.scratch import Scratch

KEY = {"version": "1", "settings": {"cell_m": 0.5}, "files": [("a", 1, 2)]}


def a_folder(path: Path) -> Path:
    """Return a folder with a file in it."""
    path.mkdir()
    a_file(path)
    return path


def a_file(folder: Path) -> None:
    (folder / "a").write_text("made")


def never(folder: Path) -> None:
    raise AssertionError("the step is there and is made again")


def test_a_step_is_made_once_and_kept_for_the_next_run(tmp_path: Path):
    first = Scratch(tmp_path / "out", KEY).step("cut", a_file)
    again = Scratch(tmp_path / "out", KEY).step("cut", never)
    assert first == again == tmp_path / ".out.partial" / "cut"
    assert (again / "a").read_text() == "made"


def test_a_step_that_was_killed_is_made_again_from_nothing(tmp_path: Path):
    def killed(folder: Path) -> None:
        (folder / "half").write_text("")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Scratch(tmp_path / "out", KEY).step("cut", killed)
    step = Scratch(tmp_path / "out", KEY).step("cut", a_file)
    assert [file.name for file in step.iterdir()] == ["a"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("other", [KEY | {"version": "2"}, KEY | {"settings": {"cell_m": 0.6}}, KEY | {"files": []}])
def test_another_key_begins_anew(tmp_path: Path, other: dict):
    Scratch(tmp_path / "out", KEY).step("cut", a_file)
    assert not (Scratch(tmp_path / "out", other).folder / "cut").exists()


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00"])
def test_a_damaged_key_begins_anew(tmp_path: Path, content: bytes):
    before = Scratch(tmp_path / "out", KEY)
    before.step("cut", a_file)
    (before.folder / "key.json").write_bytes(content)
    del before  # which unlocks
    assert not (Scratch(tmp_path / "out", KEY).folder / "cut").exists()


def test_two_runs_at_once_into_one_folder_are_refused(tmp_path: Path):
    first = Scratch(tmp_path / "out", KEY)
    with pytest.raises(CorrectionError, match="another run works in it"):
        Scratch(tmp_path / "out", KEY)
    del first
    Scratch(tmp_path / "out", KEY)


def test_a_result_that_was_about_to_be_replaced_is_put_back(tmp_path: Path):
    out = a_folder(tmp_path / "out")
    first = Scratch(out, KEY)
    os.replace(out, first.folder / "replaced")  # as a run that is killed now leaves it
    del first
    Scratch(out, {"other": 1})
    assert (out / "a").is_file()


def test_the_order_of_a_key_does_not_matter(tmp_path: Path):
    Scratch(tmp_path / "out", KEY).step("cut", a_file)
    Scratch(tmp_path / "out", dict(reversed(KEY.items()))).step("cut", never)


def test_two_results_in_one_folder_have_scratch_of_their_own(tmp_path: Path):
    Scratch(tmp_path / "one", KEY).step("cut", a_file)
    assert not (Scratch(tmp_path / "two", KEY).folder / "cut").exists()
    Scratch(tmp_path / "one", KEY).step("cut", never)


@pytest.mark.parametrize("there", ["nothing", "empty folder", "full folder", "file"])
def test_the_result_takes_its_place_and_nothing_else_is_left(tmp_path: Path, there: str):
    out = tmp_path / "new" / "out"
    if there != "nothing":
        (out if "folder" in there else out.parent).mkdir(parents=True)
    if there in ("full folder", "file"):
        (out / "old" if there == "full folder" else out).write_text("old")
    kept = Scratch(out, KEY)
    kept.step("cut", a_file)
    kept.step("products", a_file)
    kept.deliver("products", out)
    assert [file.relative_to(tmp_path) for file in tmp_path.rglob("*") if file.is_file()] == [Path("new/out/a")]
    assert os.listdir(out.parent) == ["out"]


def test_a_full_disk_is_one_sentence_and_what_is_finished_is_kept(tmp_path: Path):
    def full(folder: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    kept = Scratch(tmp_path / "out", KEY)
    kept.step("cut", a_file)
    with pytest.raises(CorrectionError, match=re.escape("(No space left on device); make room")) as ended:
        kept.step("products", full)
    assert "\n" not in str(ended.value)
    assert not (tmp_path / "out").exists()
    del ended, kept
    Scratch(tmp_path / "out", KEY).step("cut", never)


def test_an_error_without_words_of_the_system_has_words(tmp_path: Path):
    def short(folder: Path) -> None:
        raise OSError("100 requested and 7 written")  # as NumPy says it on a full disk

    with pytest.raises(CorrectionError, match="100 requested and 7 written"):
        Scratch(tmp_path / "out", KEY).step("cut", short)


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CorrectionError, match="cannot be written"):
        Scratch(tmp_path / "file" / "out", KEY)


def test_a_result_that_cannot_be_moved_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    kept = Scratch(tmp_path / "out", KEY)
    kept.step("products", a_file)

    def denied(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(scratch.os, "replace", denied)
    with pytest.raises(CorrectionError, match="Permission denied"):
        kept.deliver("products", tmp_path / "out")
