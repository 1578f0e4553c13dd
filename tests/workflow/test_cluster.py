"""A Dask cluster gives what one process does; and one that cannot work says so soon."""

import functools
import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from local_dask import LocalDask
from pointnetkl.workflow import cluster, compute
from pointnetkl.workflow.cluster import ClusterError


def double(number: int) -> int:
    return 2 * number


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalDask]:
    """A scheduler that gives a task up when a worker dies over it."""
    cluster = LocalDask(tmp_path_factory.mktemp("dask"), DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    yield cluster
    cluster.close()


def ask_cluster(monkeypatch: pytest.MonkeyPatch, address: str, wait_s: str = "1") -> None:
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", address)
    monkeypatch.setenv("POINTNETKL_WORKER_TIMEOUT_S", wait_s)


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "tcp://nowhere.invalid:8786", "nonsense", "http://x:1", "tls://127.0.0.1:1"]
)
def test_an_address_without_a_scheduler_is_named(monkeypatch: pytest.MonkeyPatch, address: str):
    monkeypatch.setattr(cluster, "_CONNECT_S", 1.0)
    ask_cluster(monkeypatch, address)
    with pytest.raises(ClusterError, match=f"^{address}: no Dask scheduler answers .*start one"):
        compute.over(math.sqrt, [4.0], "root")


@pytest.mark.parametrize("wrong", ["soon", "-1", "nan", "inf", ""])
def test_a_time_to_wait_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, wrong: str):
    ask_cluster(monkeypatch, "tcp://127.0.0.1:1", wrong)
    with pytest.raises(ClusterError, match=r"POINTNETKL_WORKER_TIMEOUT_S is .*must be a number of seconds"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_cluster_without_workers_is_told_soon(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    ask_cluster(monkeypatch, dask.address)
    with pytest.raises(ClusterError, match=r"no Dask worker for 1 s; start one \(dask worker tcp://"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_worker_with_too_little_memory_is_refused(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    small = dask.worker("dask worker ADDRESS --nworkers 1 --nthreads 2 --memory-limit 900MiB")
    ask_cluster(monkeypatch, dask.address, "60")
    with pytest.raises(ClusterError, match="has 450 MiB for each thread, a submap takes up to 512 MiB; start it with"):
        compute.over(math.sqrt, [4.0], "root")
    dask.lose(small)


def test_a_worker_with_too_little_memory_that_comes_later_is_refused(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    monkeypatch.setattr(cluster, "_LOOK_S", 0.2)
    ask_cluster(monkeypatch, dask.address, "60")
    large = dask.worker()
    compute.over(math.sqrt, [4.0], "root")
    small = dask.worker("dask worker ADDRESS --nworkers 1 --nthreads 1 --memory-limit 300MiB")
    with pytest.raises(ClusterError, match="has 300 MiB for each thread"):
        compute.over(time.sleep, [0.5] * 120, "sleep")
    dask.lose(small)
    dask.lose(large)


def test_workers_that_are_paused_are_told_from_none(monkeypatch: pytest.MonkeyPatch, dask: LocalDask):
    from distributed import Client

    def pause(dask_worker):
        dask_worker.status = type(dask_worker.status).paused

    worker = dask.worker("dask worker ADDRESS --nworkers 1 --nthreads 1 --memory-limit 0")  # nothing wakes it again
    with Client(dask.address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        client.run(pause)
    ask_cluster(monkeypatch, dask.address)
    with pytest.raises(
        ClusterError, match=r"none that runs \(1 are paused, most often for memory\) for 1 s; start one"
    ):
        compute.over(math.sqrt, [4.0], "root")
    dask.lose(worker)


def test_a_cluster_gives_the_answers_in_order_and_tells_how_its_workers_failed(
    monkeypatch: pytest.MonkeyPatch, dask: LocalDask
):
    worker = dask.worker()
    ask_cluster(monkeypatch, dask.address, "60")
    assert compute.over(math.sqrt, [float(n * n) for n in range(50)], "root") == list(range(50))
    with pytest.raises(
        ClusterError, match=r"cannot load .*No module named 'test_cluster'.*install the same pointnetkl"
    ):
        compute.over(double, [0], "double")
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        compute.over(math.sqrt, [1.0, -1.0], "root")
    with pytest.raises(ClusterError, match=r"1 workers of tcp.* died over the same submap.*--memory-limit"):
        compute.over(os._exit, [1], "exit")
    ask_cluster(monkeypatch, dask.address, "1")
    dask.lose(worker)
    with pytest.raises(ClusterError, match="no Dask worker for 1 s"):
        compute.over(math.sqrt, [4.0], "root")


def test_a_scheduler_that_goes_away_ends_the_work_in_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    dask = LocalDask(tmp_path)
    dask.worker()
    ask_cluster(monkeypatch, dask.address, "60")
    monkeypatch.setattr(cluster, "_CONNECT_S", 5.0)
    try:
        with pytest.raises(ClusterError, match=r"the scheduler at tcp.* went away; stage label keeps what it finished"):
            compute.over(functools.partial(os.kill, dask.scheduler.pid), [signal.SIGKILL] + [0] * 100, "kill")
    finally:
        dask.close()
