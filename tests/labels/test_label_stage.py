"""The label stage makes the same bytes however it is run, killed, resumed, or spread over machines."""

import contextlib
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import toy_labels
from local_dask import LocalDask
from pointnetkl.registration.covariance import label_table
from pointnetkl.workflow import artifacts
from toy_labels import change, fail, intact, kill, outputs, run, start, until, write

pytestmark = pytest.mark.slow

SUBMAPS, RUNS = 40, 400  # some seconds of work
KILLS = 20


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The survey, labelled by one process in one go."""
    folder = write(tmp_path_factory.mktemp("undisturbed"), SUBMAPS, RUNS)
    assert run(folder, POINTNETKL_WORKERS="1") == f"toy: labelled {SUBMAPS}, 0 were there"
    return folder


@pytest.fixture
def survey(undisturbed: Path, tmp_path: Path) -> Path:
    """The same survey, not labelled."""
    for name in ("submaps.parquet", "params.yaml"):
        shutil.copy(undisturbed / name, tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalDask]:
    """A scheduler and two workers, by the README's very commands."""
    readme = (toy_labels.ROOT / "README.md").read_text()
    scheduler, worker = (
        re.search(rf"^((?:\w+=\S+ )*)(dask {name}[^#\n]*)", readme, re.MULTILINE) for name in ("scheduler", "worker")
    )
    assert scheduler is not None
    assert worker is not None
    cluster = LocalDask(tmp_path_factory.mktemp("dask"), scheduler[2])
    environment = dict(setting.split("=") for setting in worker[1].split())
    command = re.sub(r"tcp://\S+", "ADDRESS", re.sub(r"--nworkers \d+", "--nworkers 2", worker[2]))
    cluster.worker(command, **environment)
    yield cluster
    cluster.close()


@pytest.mark.parametrize("workers", ["2", "3"])
def test_any_number_of_workers_makes_the_same_bytes(undisturbed: Path, survey: Path, workers: str):
    assert run(survey, POINTNETKL_WORKERS=workers) == f"toy: labelled {SUBMAPS}, 0 were there"
    assert outputs(survey) == outputs(undisturbed)


def test_the_stage_killed_at_any_moment_resumes_to_the_same_bytes(undisturbed: Path, survey: Path):
    rng = np.random.default_rng(20)
    begun = time.monotonic()
    run(survey)
    duration, killed, begun = time.monotonic() - begun, 0, time.monotonic()
    shutil.rmtree(survey / "out")
    while killed < KILLS:
        spoil(survey / "shards", rng)
        before, moment = intact(survey), rng.uniform(0.1, 0.7) * duration
        process = start(survey, POINTNETKL_WORKERS=str(rng.integers(1, 3)))
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moment)
        killed += process.poll() is None
        kill(process)
        assert before <= intact(survey)
        assert time.monotonic() - begun < 60 + 3 * KILLS * duration
        age(survey / "shards")
    shutil.rmtree(survey / "out", ignore_errors=True)  # of attempts that ended first
    count = len(intact(survey))
    assert run(survey) == f"toy: labelled {SUBMAPS - count}, {count} were there"
    assert outputs(survey) == outputs(undisturbed)
    assert {path.name for path in (survey / "shards").iterdir()} == intact(survey)


def age(folder: Path) -> None:
    """Make what killed writers left half written two hours old: younger ones might be another stage's at work."""
    for path in folder.glob(".*.partial"):
        os.utime(path, (time.time() - 7200,) * 2)


def spoil(folder: Path, rng: np.random.Generator) -> None:
    """Take half of the shards away, as though no run had come so far, and cut one short, as a power failure does."""
    paths = rng.permutation(np.array(sorted(folder.glob("*.npz")), dtype=object))
    for path in paths[: len(paths) // 2]:
        path.unlink()
    for path in paths[-1:]:
        path.write_bytes(path.read_bytes()[:-100])


def test_ten_new_submaps_label_ten_and_a_changed_parameter_labels_all(tmp_path: Path):
    run(write(tmp_path, 12))
    assert run(write(tmp_path, 22)) == "toy: labelled 10, 12 were there"
    change(tmp_path, "label", noise_sigma_m=0.3)
    assert run(tmp_path) == "toy: labelled 22, 0 were there"
    change(tmp_path, "label", noise_sigma_m=0.2)
    assert run(tmp_path) == "toy: labelled 0, 22 were there"


def test_submaps_that_stop_early_have_fewer_errors_and_then_nan(tmp_path: Path):
    change(write(tmp_path, 8, 2000), "label", target_relative_error=0.1)
    run(tmp_path)
    runs = artifacts.table_metadata(tmp_path / "out/labels.parquet")["label"]["target_relative_error"]
    errors = artifacts.read_arrays(tmp_path / "out/errors.npz")[0]["errors"]
    finite = np.isfinite(errors).all(axis=2)
    assert runs == 0.1
    assert errors.shape[1] == finite.sum(axis=1).max()
    assert len(set(finite.sum(axis=1))) > 1
    assert all(not np.diff(row.astype(int)).max() > 0 for row in finite)  # numbers first, then NaN to the end
    assert artifacts.read_arrays(tmp_path / "out/errors.npz")[0]["held_out"].shape == (8, 5, 2)


def test_a_training_survey_has_the_same_labels_and_no_held_out_errors(tmp_path: Path):
    for group in ("test", "train"):
        (tmp_path / group).mkdir()
    test, train = (write(tmp_path / group, 4) for group in ("test", "train"))
    params = yaml.safe_load((train / "params.yaml").read_text())
    line = params["study"]["test"].pop("toy") | {"group": "train"}
    params["study"].update(train={"toy": line}, surveys={"toy": line})
    (train / "params.yaml").write_text(yaml.safe_dump(params))
    run(test)
    run(train)
    labels = [artifacts.read_table(folder / "out/labels.parquet", label_table.schema(2)) for folder in (test, train)]
    pd.testing.assert_frame_equal(*labels)
    arrays = [artifacts.read_arrays(folder / "out/errors.npz")[0] for folder in (test, train)]
    np.testing.assert_array_equal(arrays[0]["errors"], arrays[1]["errors"])
    assert [a["held_out"].shape for a in arrays] == [(4, 5, 2), (4, 0, 2)]


def cluster(dask: LocalDask) -> dict[str, str]:
    return {"DASK_SCHEDULER_ADDRESS": dask.address, "POINTNETKL_WORKER_TIMEOUT_S": "60"}


def test_a_dask_cluster_makes_the_same_bytes(undisturbed: Path, survey: Path, dask: LocalDask):
    assert run(survey, **cluster(dask)) == f"toy: labelled {SUBMAPS}, 0 were there"
    assert outputs(survey) == outputs(undisturbed)


@pytest.mark.parametrize("lost", ["worker", "machine"])
def test_what_a_lost_dask_worker_had_is_done_by_others(undisturbed: Path, survey: Path, dask: LocalDask, lost: str):
    from distributed import Client

    with Client(dask.address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        old = set(client.run(os.getpid).values())
        machine = dask.worker("dask worker ADDRESS --nworkers 1 --nthreads 1")
        client.wait_for_workers(3, timeout=60)
        (victim,) = set(client.run(os.getpid).values()) - old
    process = start(survey, **cluster(dask))
    until(lambda: len(intact(survey)) > 3)
    if lost == "machine":  # with the nanny, which would start it again
        dask.lose(machine)
    else:
        os.kill(victim, 9)
    assert len(intact(survey)) < SUBMAPS
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert f"toy: labelled {SUBMAPS}, 0 were there" in output
    assert outputs(survey) == outputs(undisturbed)
    dask.lose(machine)


def test_a_cluster_with_another_version_is_refused(survey: Path, dask: LocalDask, tmp_path_factory):
    # the stage runs from a copy of this package that has another statement in what decides a label
    other = tmp_path_factory.mktemp("other")
    shutil.copytree(toy_labels.ROOT / "src/pointnetkl", other / "pointnetkl")
    with (other / "pointnetkl/registration/monte_carlo.py").open("a") as file:
        file.write("CHANGED = 1\n")
    assert "another version of pointnetkl" in fail(survey, PYTHONPATH=str(other), **cluster(dask))
    assert not intact(survey)


def test_a_scheduler_that_is_not_there_is_told_in_a_sentence(survey: Path):
    said = fail(survey, DASK_SCHEDULER_ADDRESS="tcp://nowhere", POINTNETKL_WORKERS="2")
    assert said.startswith("error: tcp://nowhere: no Dask scheduler answers")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own, of 64 KiB, on the folder of the shards."""
    folder = tmp_path / "shards"
    folder.mkdir()
    mounting = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], capture_output=True)
    if mounting.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounting.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_full_disk_ends_in_a_sentence_and_room_resumes(
    undisturbed: Path, survey: Path, small_disk: Path, workers: str
):
    said = fail(survey, POINTNETKL_WORKERS=workers)
    assert re.search(r"cannot be written \(No space left on device\); the labels finished before are kept", said)
    count = len(intact(survey))
    assert 0 < count < SUBMAPS
    subprocess.run(["mount", "-o", "remount,size=1m", str(small_disk)], check=True)
    assert run(survey, POINTNETKL_WORKERS=workers) == f"toy: labelled {SUBMAPS - count}, {count} were there"
    assert outputs(survey) == outputs(undisturbed)


@pytest.mark.parametrize(("largest", "kept"), [(2000, 0), (16000, SUBMAPS)])
def test_a_limit_on_files_ends_in_a_sentence(survey: Path, undisturbed: Path, largest: int, kept: int):
    # where no disk can be mounted this stands for a full one: first for shards, then for the results only
    said = fail(survey, largest, POINTNETKL_WORKERS="1")
    assert "cannot be written (File too large)" in said
    assert len(intact(survey)) == kept
    assert not (survey / "out/errors.npz").exists()
    assert run(survey) == f"toy: labelled {SUBMAPS - kept}, {kept} were there"
    assert outputs(survey) == outputs(undisturbed)
