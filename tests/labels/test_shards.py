"""A label is kept under a name made of all that decides it: never made twice, never taken for another one."""

import dataclasses
import errno
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from imports import SOURCE, closure
from pointnetkl.labels import shards
from pointnetkl.labels.shards import ShardError
from pointnetkl.registration import monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.surveys import submap
from toy_labels import SETTINGS, SUBMAPS, intact, job, same_label, toy_submap, write


@pytest.fixture(autouse=True)
def _serial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A survey's points, nothing labelled."""
    return write(tmp_path)


def test_a_label_read_is_the_label_kept_in_single_precision(survey: Path):
    task = job(survey)
    (first, *_), computed = shards.labels(task)
    label = monte_carlo.label(submap.read("toy", task.submaps, 0), task.runs, task.settings, task.registration)
    assert computed == SUBMAPS
    assert first.row == label.row
    assert np.array_equal(first.errors, label.errors.astype(np.float32))
    assert np.array_equal(first.held_out, label.held_out.astype(np.float32))


def test_what_is_kept_is_not_made_again(survey: Path):
    labels, _ = shards.labels(job(survey))
    reread, computed = shards.labels(job(survey))
    assert computed == 0
    assert all(map(same_label, labels, reread))


def test_ten_new_submaps_label_ten(survey: Path):
    shards.labels(job(survey))
    write(survey, SUBMAPS + 10)
    labels, computed = shards.labels(job(survey))
    assert (len(labels), computed) == (SUBMAPS + 10, 10)
    assert [label.row["submap"] for label in labels] == list(range(SUBMAPS + 10))


def test_a_changed_parameter_labels_all_and_the_old_one_none(survey: Path):
    shards.labels(job(survey))
    assert shards.labels(job(survey, settings=dataclasses.replace(SETTINGS, noise_sigma_m=0.3)))[1] == SUBMAPS
    assert shards.labels(job(survey))[1] == 0


def test_the_name_changes_with_all_that_the_label_depends_on(survey: Path):
    task, cloud = job(survey), toy_submap(0)
    split = dataclasses.replace(task, settings=dataclasses.replace(SETTINGS, copy="split"))
    paths = [
        dataclasses.replace(task, runs=21).path(cloud),
        dataclasses.replace(task, settings=dataclasses.replace(SETTINGS, seed=3)).path(cloud),
        dataclasses.replace(task, registration=dataclasses.replace(task.registration, neighbours=9)).path(cloud),
        dataclasses.replace(task, kernel="another").path(cloud),
        task.path(dataclasses.replace(cloud, survey="other")),
        task.path(dataclasses.replace(cloud, number=1)),
        task.path(dataclasses.replace(cloud, points=np.nextafter(cloud.points, np.inf))),
        task.path(dataclasses.replace(cloud, points=cloud.points.astype(np.float32))),
        task.path(dataclasses.replace(cloud, points=cloud.points.reshape(-1, 6))),
        split.path(cloud),
        split.path(dataclasses.replace(cloud, first=cloud.second, second=cloud.first)),
    ]
    assert len({task.path(cloud), *paths}) == len(paths) + 1


def test_the_name_changes_with_nothing_else(survey: Path):
    task, cloud = job(survey), toy_submap(0)
    elsewhere = dataclasses.replace(task, submaps=survey / "x.parquet", folder=survey / "y")
    assert elsewhere.path(cloud).name == task.path(cloud).name
    assert task.path(dataclasses.replace(cloud, first=cloud.second)) == task.path(
        cloud
    )  # `same` uses all the points only
    split = dataclasses.replace(task, settings=dataclasses.replace(SETTINGS, copy="split"))
    assert split.path(dataclasses.replace(cloud, points=cloud.first)) == split.path(cloud)


def test_a_damaged_label_is_made_again(survey: Path):
    expected, _ = shards.labels(job(survey))
    paths = sorted((survey / "shards").iterdir())
    rng = np.random.default_rng(0)
    for path, place in zip(paths[:6], rng.uniform(size=6), strict=True):
        content = path.read_bytes()
        cut = int(place * len(content))
        path.write_bytes(content[:cut])  # cut short
    for path in paths[6:9]:
        content = path.read_bytes()
        cut = content.index(b"errors.npy") + 150  # in the numbers
        path.write_bytes(content[:cut] + bytes([content[cut] ^ 1]) + content[cut + 1 :])
    shutil.copy(paths[10], paths[9])  # another submap's label
    reread, computed = shards.labels(job(survey))
    assert computed == 10
    assert all(map(same_label, expected, reread))


def test_what_a_writer_left_half_written_long_ago_is_removed_and_what_another_writes_now_is_not(survey: Path):
    (survey / "shards").mkdir()
    old, new = (survey / "shards" / f".0123.npz.{name}.partial" for name in ("old", "new"))
    for half in (old, new):
        half.write_bytes(b"PK")
    os.utime(old, (0, time.time() - 2 * 3600))
    shards.labels(job(survey))
    assert not old.exists()
    assert new.exists()
    assert len(intact(survey)) == SUBMAPS


def test_a_full_disk_keeps_what_was_finished_and_says_so(survey: Path, monkeypatch: pytest.MonkeyPatch):
    expected, _ = shards.labels(dataclasses.replace(job(survey), folder=survey / "other"))
    write_bytes, written = Path.write_bytes, list[Path]()

    def full(self: Path, content: bytes) -> int:
        written.append(self)
        if len(written) > 5:
            write_bytes(self, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_bytes(self, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ShardError, match=r"No space left on device.*finished before are kept.*run it again"):
        shards.labels(job(survey))
    monkeypatch.undo()
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    assert len(list((survey / "shards").iterdir())) == len(intact(survey)) == 5
    labels, computed = shards.labels(job(survey))
    assert computed == SUBMAPS - 5
    assert all(map(same_label, expected, labels))


def test_a_worker_with_other_code_is_refused(survey: Path):
    with pytest.raises(ShardError, match="a worker there has another version of pointnetkl, NumPy, SciPy or Numba"):
        shards.labels(dataclasses.replace(job(survey), kernel="another"))
    assert not intact(survey)


def test_a_worker_that_sees_other_points_is_refused(survey: Path):
    task = job(survey)
    name = task.path(toy_submap(1)).name
    with pytest.raises(ShardError, match="submap 0 has changed since the stage began"):
        shards.make(task, (0, name))
    assert not intact(survey)


def test_a_label_that_is_there_is_not_made_by_a_retry(survey: Path, monkeypatch: pytest.MonkeyPatch):
    task = job(survey)
    shards.labels(task)
    monkeypatch.setattr(monte_carlo, "label", lambda *_: pytest.fail("made again"))
    shards.make(task, (0, task.path(submap.read("toy", task.submaps, 0)).name))


def test_labels_that_workers_keep_elsewhere_are_missed(survey: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shards, "make", lambda *_: None)
    with pytest.raises(ShardError, match="was made and is gone or damaged; is its folder seen by the workers"):
        shards.labels(job(survey))


def test_a_survey_without_submaps_is_refused(tmp_path: Path):
    with pytest.raises(submap.SubmapError, match="has no submaps; did segment keep any of toy"):
        shards.labels(job(write(tmp_path, 0)))


def test_numbers_that_are_not_finite_are_kept(tmp_path: Path):
    row = dict.fromkeys(label_table.LABELS.names, 0.5) | {"relative_error": np.float64(np.inf), "runs": np.int32(3)}
    label = monte_carlo.Label(row, np.full((3, 2), np.nan), np.zeros((0, 2)))
    shards.write(tmp_path / "x.npz", label)
    stored = shards.read(tmp_path / "x.npz")
    assert stored is not None
    assert stored.row == row
    assert np.isnan(stored.errors).all()
    assert stored.held_out.shape == (0, 2)


@pytest.mark.parametrize(
    "spoiled", [{"row": {}}, {"errors": np.zeros((1, 2))}, {"errors": np.zeros(())}, {"held_out": np.zeros(4)}]
)
def test_a_file_of_the_right_name_that_holds_no_whole_label_is_not_believed(survey: Path, spoiled: dict[str, object]):
    expected, _ = shards.labels(job(survey))
    path = survey / "shards" / min(intact(survey))
    label = shards.read(path)
    assert label is not None
    shards.write(path, dataclasses.replace(label, **spoiled))
    reread, computed = shards.labels(job(survey))
    assert computed == 1
    assert all(map(same_label, expected, reread))


def version_of(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(shards, "__file__", str(folder / "labels/shards.py"))
    return shards.kernel_version.__wrapped__("cpu")


def test_the_kernel_version_changes_with_the_code_and_not_with_line_ends_or_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    version = shards.kernel_version("cpu")
    copy = tmp_path / "elsewhere"
    shutil.copytree(SOURCE / "pointnetkl", copy, ignore=shutil.ignore_patterns("__pycache__"))
    assert version_of(copy, monkeypatch) == version
    for path in copy.rglob("*.py"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert version_of(copy, monkeypatch) == version
    (copy / "plots.py").write_text("")
    assert version_of(copy, monkeypatch) == version
    for name in ("registration/gicp/kernel.py", "registration/monte_carlo.py"):
        with (copy / name).open("a") as file:
            file.write("CHANGED = 1\n")
        assert version_of(copy, monkeypatch) != version
        shutil.copy(SOURCE / "pointnetkl" / name, copy / name)
    monkeypatch.setattr(shards, "_version", lambda library: "0.0")
    assert version_of(copy, monkeypatch) != version


def test_the_kernel_version_is_of_statements_wherever_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    version = shards.kernel_version("cpu")
    copy = tmp_path / "elsewhere"
    shutil.copytree(SOURCE / "pointnetkl", copy, ignore=shutil.ignore_patterns("__pycache__"))
    # a function moves to another file of the same room, the file gets another name, and its importer says so
    kernel, weights = copy / "registration/gicp/kernel.py", copy / "registration/gicp/weights.py"
    last = kernel.read_text().rindex("\n\n\n@kernel\n")
    (copy / "registration/gicp/weighing.py").write_text(
        f'"""Other words."""\n{weights.read_text()}{kernel.read_text()[last:]}'
    )
    kernel.write_text(
        kernel.read_text()[:last].replace("from pointnetkl.registration.gicp import", "from pointnetkl.rooms import")
    )
    weights.unlink()
    assert version_of(copy, monkeypatch) == version


def test_statements_leave_out_what_decides_no_label():
    source = '''"""A module."""

import math

from pointnetkl import pose  # ours


@cached
def turned(x: float) -> float:
    """Return it turned."""
    # because
    return math.sin(x)  # of x

"text"
'''
    expected = ["import math", "@cached\ndef turned(x: float) -> float:\n    return math.sin(x)"]
    assert shards.statements(source) == expected
    assert shards.statements("x = 1\n") != shards.statements("x = 2\n")


def test_every_module_that_a_label_is_made_by_is_in_the_kernel_version():
    package = SOURCE / "pointnetkl"
    counted = {path for pattern in shards.SOURCES for path in package.glob(pattern)}
    # these carry numbers in, where their hash is counted, or check them
    names = (
        "workflow/artifacts.py",
        "registration/covariance/gaussian.py",
        "workflow/errors.py",
        "workflow/parameters.py",
        "workflow/study.py",
        "surveys/pose.py",
        "surveys/submap.py",
    )
    assert closure(package / "registration/monte_carlo.py") - counted <= {package / name for name in names}
    assert all(list(package.glob(pattern)) for pattern in shards.SOURCES)
