"""Map a function over submaps, in order; the answer never depends on who does the work, or how many.

`over` is for hours of work: local processes, or a Dask cluster when DASK_SCHEDULER_ADDRESS names one. Function and
items travel to them, so they hold paths and not clouds. `in_threads` is for seconds of it, in kernels that release
Python's lock, on what is in memory already.
"""

import asyncio
import contextlib
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from typing import Any, TypeVar

from tqdm import tqdm

from pointnetkl.errors import PointNetKLError

Item = TypeVar("Item")
Result = TypeVar("Result")

_CONNECT_S = 15.0  # for a scheduler to answer: it is there or not, unlike a worker that waits in a batch queue
_WORKER_S = 300.0
_LOOK_S = 5.0  # between two looks at who is there
_WORKER_BYTES = 512 << 20  # for each thread of a Dask worker; labels at the paper's size take half of it
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class ComputeError(PointNetKLError):
    """A setting of the workers makes no sense, or they are not there, or did not survive."""


def workers() -> int:
    """Return how many workers to use: POINTNETKL_WORKERS, or one per core that this process may use.

    Raises:
        ComputeError: POINTNETKL_WORKERS is not a number of workers.
    """
    asked = os.environ.get("POINTNETKL_WORKERS")
    if asked is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not asked.isdecimal() or int(asked) < 1:
        raise ComputeError(f"POINTNETKL_WORKERS is {asked!r}, must be a whole number of at least 1")
    return int(asked)


def over(function: Callable[[Item], Result], items: Sequence[Item], doing: str, processes: bool = True) -> list[Result]:
    """Return the function of every item, in order, with a progress bar that says what is being done.

    It runs in local processes (in threads where processes would take turns, as at one GPU), or on the Dask cluster of
    DASK_SCHEDULER_ADDRESS; with POINTNETKL_WORKERS=1 in this process, whatever else is set. The function keeps its
    work itself where that is to survive a failure.

    Raises:
        ComputeError: a worker died, or there is none, or no cluster at the address.
    """
    if not items:
        return []
    count = min(workers(), len(items))
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address and os.environ.get("POINTNETKL_WORKERS") != "1":
        return _on_cluster(function, items, doing, address)
    if count > 1 and not processes:
        return in_threads(function, items, doing)
    if count > 1:
        return _in_processes(function, items, doing, count)
    return [function(item) for item in progress(items, doing, len(items))]


def in_threads(function: Callable[[Item], Result], items: Sequence[Item], doing: str) -> list[Result]:
    """Return the function of every item, in order, by threads of this process."""
    with ThreadPoolExecutor(workers()) as pool:
        return list(progress(pool.map(function, items), doing, len(items)))


def progress(items: Iterable[Item], doing: str, total: int) -> Iterable[Item]:
    """Yield the items under a progress bar with rate and time left."""
    return tqdm(items, desc=doing, total=total, unit="submap", mininterval=0.5, dynamic_ncols=True)


def _in_processes(function: Callable[[Item], Result], items: Sequence[Item], doing: str, count: int) -> list[Result]:
    # A server that has imported the function's module forks the workers: a fork of this process would inherit its
    # libraries' threads, and a fresh interpreter for each would import everything again.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context: Any = multiprocessing.get_context(method)
    context.set_forkserver_preload([getattr(function, "func", function).__module__])
    pool = ProcessPoolExecutor(count, context, _begin_worker)
    try:
        with _one_thread_each():
            return list(progress(pool.map(function, items), doing, len(items)))
    except BrokenProcessPool as error:
        raise ComputeError(
            f"{doing}: a worker process was killed, most often because memory ran out; what was finished is kept:"
            f" run it again, with POINTNETKL_WORKERS below {count} if memory is short"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    # libraries read these once, as a worker imports them
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _begin_worker() -> None:
    # Ctrl-C is the parent's to answer; and when the parent dies, however it does, nobody else would end this process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def _on_cluster(function: Callable[[Item], Result], items: Sequence[Item], doing: str, address: str) -> list[Result]:
    from distributed import KilledWorker  # a second to import, and only here

    patience = _patience()
    try:
        with _quiet(), _client(address) as client:
            _refuse_small(_await_workers(client, address, patience))
            futures = client.map(function, items, pure=False)
            found = dict(progress(_finished(client, futures, address, patience), doing, len(items)))
            return [found[future] for future in futures]
    except KilledWorker as error:
        raise ComputeError(
            f"{doing}: {error.allowed_failures + 1} workers of {address} died over the same submap, most often because"
            " memory ran out; what was finished is kept: give workers more (--memory-limit) and run it again"
        ) from error
    except CancelledError as error:
        raise ComputeError(
            f"{doing}: the scheduler at {address} went away; what was finished is kept: start it and run again"
        ) from error
    except (ModuleNotFoundError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "deserialization" not in str(error):
            raise
        raise ComputeError(
            f"{doing}: the scheduler at {address} or a worker there cannot load what is to be done"
            f" ({error.__cause__ or error}); install the same pointnetkl there as here and start them again"
        ) from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # Dask tells at length, and in pieces, what one sentence tells here
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _patience() -> float:
    asked = os.environ.get("POINTNETKL_WORKER_TIMEOUT_S", str(_WORKER_S))
    try:
        seconds = float(asked)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < float("inf"):
        raise ComputeError(f"POINTNETKL_WORKER_TIMEOUT_S is {asked!r}, must be a number of seconds")
    return seconds


def _client(address: str) -> Any:
    from distributed import Client

    try:
        # asked first by a call that can fail: a client of a wrong address takes half a minute to give up
        if "workers" not in asyncio.run(asyncio.wait_for(_identity(address), _CONNECT_S)):
            raise ValueError("what answers is no scheduler")
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except Exception as error:  # every kind of wrong address fails in a way of its own
        cause = " ".join(str(error).split())[:200] or f"nothing in {_CONNECT_S:g} s"
        raise ComputeError(
            f"{address}: no Dask scheduler answers ({cause}); start one (dask scheduler), or unset"
            " DASK_SCHEDULER_ADDRESS to work with local processes"
        ) from error


async def _identity(address: str) -> dict[str, Any]:
    from distributed import Security, rpc

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=_CONNECT_S, connection_args=arguments) as scheduler:
        return dict(await scheduler.identity())


def _await_workers(client: Any, address: str, patience: float) -> dict[str, Any]:
    deadline = time.monotonic() + patience
    while not (known := _running(client)):
        if time.monotonic() > deadline:
            raise ComputeError(
                f"{address}: no Dask worker for {patience:g} s; start one (dask worker {address}), or wait longer by"
                " POINTNETKL_WORKER_TIMEOUT_S; what was finished is kept"
            )
        time.sleep(0.2)
    return known


def _running(client: Any) -> dict[str, Any]:
    known = client.scheduler_info(n_workers=-1)["workers"]
    return {name: worker for name, worker in known.items() if worker["status"] == "running"}


def _refuse_small(known: dict[str, Any]) -> None:
    # Dask pauses a worker at 80 % of its memory, and kills it at 95 %, again and again
    for name, worker in known.items():
        share = worker["memory_limit"] / worker["nthreads"]
        if 0 < share < _WORKER_BYTES:  # 0: no limit
            raise ComputeError(
                f"{name}: this Dask worker has {share / 2**20:.0f} MiB for each thread, a submap takes up to"
                f" {_WORKER_BYTES >> 20} MiB; start it with --nthreads 1 --memory-limit 2GiB"
            )


def _finished(client: Any, futures: list[Any], address: str, patience: float) -> Iterator[tuple[Any, Any]]:
    # yields futures and their results, in any order, for as long as there is a worker
    from distributed import as_completed

    done, left, since = as_completed(futures, loop=client.loop, with_results=True), len(futures), time.monotonic()
    while left:
        batch = done.next_batch(block=False)
        for future, result in batch:
            if future.status == "error":
                raise result[1]
            if future.cancelled():
                raise CancelledError
            yield future, result
        left -= len(batch)
        if not batch and time.monotonic() - since > _LOOK_S:
            _await_workers(client, address, patience)
            since = time.monotonic()
        time.sleep(0.1)
