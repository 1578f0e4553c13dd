"""The answer does not depend on how many work on it; and who cannot work says so soon."""

import functools
import operator
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from pointnetkl.workflow import compute
from pointnetkl.workflow.compute import ComputeError


def draw(number: int) -> float:
    time.sleep(0.002 * (number % 3))  # the later ones may be done first
    return float(np.random.default_rng([5, number]).standard_normal())


def fail(folder: Path, number: int) -> None:
    (folder / str(number)).touch()
    time.sleep(0.01)
    raise ComputeError("no")


def die(number: int) -> None:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)


def environment(name: str) -> str | None:
    return os.environ.get(name)


@pytest.fixture(autouse=True)
def _no_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)


def test_the_answer_does_not_depend_on_the_number_of_workers(monkeypatch: pytest.MonkeyPatch):
    expected = [draw(number) for number in range(20)]
    for workers in ("1", "2", "3"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        assert compute.over(draw, range(20), "draw") == expected
        assert compute.in_threads(draw, range(20), "draw") == expected


def test_nothing_to_do_gives_nothing():
    assert compute.over(draw, [], "draw") == []
    assert compute.in_threads(draw, [], "draw") == []


@pytest.mark.parametrize("wrong", ["", "0", "-1", "two", "1.5", "²"])
def test_a_number_of_workers_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, wrong: str):
    monkeypatch.setenv("POINTNETKL_WORKERS", wrong)
    with pytest.raises(ComputeError, match=r"POINTNETKL_WORKERS is .*, must be a whole number of at least 1"):
        compute.over(draw, range(3), "draw")


def test_without_a_wish_there_is_at_least_one_worker(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("POINTNETKL_WORKERS", raising=False)
    assert compute.workers() >= 1


@pytest.mark.parametrize("workers", ["1", "2"])
def test_the_first_failure_ends_the_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, workers: str):
    monkeypatch.setenv("POINTNETKL_WORKERS", workers)
    with pytest.raises(ComputeError, match="no"):
        compute.over(functools.partial(fail, tmp_path), range(1000), "fail")
    assert len(list(tmp_path.iterdir())) < 100


def test_one_worker_is_this_process_and_more_are_others(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", "tcp://nowhere.invalid:1")  # one worker wins: it is for debugging
    assert set(compute.over(operator.methodcaller("__call__"), [os.getpid] * 3, "ask")) == {os.getpid()}
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS")
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    assert os.getpid() not in compute.over(operator.methodcaller("__call__"), [os.getpid] * 3, "ask")


def test_dask_is_imported_for_a_cluster_only():
    imported = "{'dask', 'distributed', 'tornado'} & {*sys.modules}"
    code = f"import sys; from pointnetkl.workflow import compute; assert not {imported}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_workers_use_one_thread_each_and_leave_this_process_its_own(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert compute.over(environment, ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"], "ask") == ["1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


def test_a_worker_that_is_killed_ends_the_work_in_a_sentence(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    with pytest.raises(
        ComputeError, match=r"label x: a worker process was killed.*keeps what it finished.*WORKERS below 2"
    ):
        compute.over(die, range(10), "label x")


def test_workers_end_when_their_parent_is_killed():
    code = "import time; from pointnetkl.workflow import compute; compute.over(time.sleep, [600.0] * 2, 'sleep')"
    parent = subprocess.Popen(
        [sys.executable, "-c", code], env=os.environ | {"POINTNETKL_WORKERS": "2"}, stderr=subprocess.DEVNULL
    )
    deadline, children = time.monotonic() + 60, list[psutil.Process]()
    while len(children) < 4 and time.monotonic() < deadline:  # two workers, their server, its tracker of resources
        time.sleep(0.1)
        children = psutil.Process(parent.pid).children(recursive=True)
    parent.kill()
    parent.wait()
    assert len(children) >= 3
    assert psutil.wait_procs(children, timeout=20)[1] == []


def test_after_an_error_no_thread_begins_another_item(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    begun = []

    def work(item: int) -> None:
        begun.append(item)
        if item == 0:
            raise ValueError("the first is broken")
        time.sleep(0.02)

    with pytest.raises(ValueError, match="the first is broken"):
        compute.in_threads(work, range(200), "work")
    assert len(begun) < 10
