"""The answer does not depend on how many work on it, or where; and who cannot work says so soon."""

import functools
import math
import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from local_dask import LocalDask
from pointnetkl import compute
from pointnetkl.compute import ComputeError


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


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalDask]:
    """A scheduler that gives a task up when a worker dies over it."""
    cluster = LocalDask(tmp_path_factory.mktemp("dask"), DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    yield cluster
    cluster.close()


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
    code = "import sys; from pointnetkl import compute; assert not {'dask', 'distributed', 'tornado'} & {*sys.modules}"
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
    with pytest.raises(ComputeError, match=r"label x: a worker process was killed.*finished is kept.*WORKERS below 2"):
        compute.over(die, range(10), "label x")


def test_workers_end_when_their_parent_is_killed():
    code = "import time; from pointnetkl import compute; compute.over(time.sleep, [600.0] * 2, 'sleep')"
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


def ask_cluster(monkeypatch: pytest.MonkeyPatch, address: str, wait_s: str = "1") -> None:
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", address)
    monkeypatch.setenv("POINTNETKL_WORKER_TIMEOUT_S", wait_s)


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "tcp://nowhere.invalid:8786", "nonsense", "http://x:1", "tls://127.0.0.1:1"]
)
def test_an_address_without_a_scheduler_is_told_soon(monkeypatch: pytest.MonkeyPatch, address: str):
    monkeypatch.setattr(compute, "_CONNECT_S", 1.0)
    ask_cluster(monkeypatch, address)
    begun = time.monotonic()
    with pytest.raises(ComputeError, match=f"^{address}: no Dask scheduler answers .*start one"):
        compute.over(math.sqrt, [4.0], "root")
    assert time.monotonic() - begun < 20


@pytest.mark.parametrize("wrong", ["soon", "-1", "nan", "inf", ""])
def test_a_time_to_wait_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, wrong: str):
    ask_cluster(monkeypatch, "tcp://127.0.0.1:1", wrong)
    with pytest.raises(ComputeError, match=r"POINTNETKL_WORKER_TIMEOUT_S is .*must be a number of seconds"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_cluster_without_workers_is_told_soon(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    ask_cluster(monkeypatch, dask.address)
    with pytest.raises(ComputeError, match=r"no Dask worker for 1 s; start one \(dask worker tcp://"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_worker_with_too_little_memory_is_refused(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    small = dask.worker("dask worker ADDRESS --nworkers 1 --nthreads 2 --memory-limit 900MiB")
    ask_cluster(monkeypatch, dask.address, "60")
    with pytest.raises(ComputeError, match="has 450 MiB for each thread, a submap takes up to 512 MiB; start it with"):
        compute.over(math.sqrt, [4.0], "root")
    dask.lose(small)


def test_a_cluster_gives_the_answers_in_order_and_tells_how_its_workers_failed(
    monkeypatch: pytest.MonkeyPatch, dask: LocalDask
):
    worker = dask.worker()
    ask_cluster(monkeypatch, dask.address, "60")
    assert compute.over(math.sqrt, [float(n * n) for n in range(50)], "root") == list(range(50))
    with pytest.raises(
        ComputeError, match=r"cannot load .*No module named 'test_compute'.*install the same pointnetkl"
    ):
        compute.over(draw, [0], "draw")
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        compute.over(math.sqrt, [1.0, -1.0], "root")
    with pytest.raises(ComputeError, match=r"1 workers of tcp.* died over the same submap.*--memory-limit"):
        compute.over(os._exit, [1], "exit")
    ask_cluster(monkeypatch, dask.address, "1")
    dask.lose(worker)
    with pytest.raises(ComputeError, match="no Dask worker for 1 s"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_scheduler_that_goes_away_ends_the_work_in_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    dask = LocalDask(tmp_path)
    dask.worker()
    ask_cluster(monkeypatch, dask.address, "60")
    monkeypatch.setattr(compute, "_CONNECT_S", 5.0)
    try:
        with pytest.raises(ComputeError, match=r"the scheduler at tcp.* went away; what was finished is kept"):
            compute.over(functools.partial(os.kill, dask.scheduler.pid), [signal.SIGKILL] + [0] * 100, "kill")
    finally:
        dask.close()
