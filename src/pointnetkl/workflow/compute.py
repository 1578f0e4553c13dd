"""Map a function over submaps. Results are in the order of the items, whatever the number and kind of workers.

`over` is for hours of work, in local processes or, if DASK_SCHEDULER_ADDRESS is set, on a Dask cluster. Function and
items are sent to the workers, so they should hold paths and not clouds. `in_threads` is for seconds of work in kernels
that release Python's lock, on data in memory.
"""

import collections
import contextlib
import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from typing import Any, TypeVar

from tqdm import tqdm

from pointnetkl.workflow import cluster
from pointnetkl.workflow.errors import PointNetKLError

Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD = 16  # items a worker that threads are given before the first is done
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class ComputeError(PointNetKLError):
    """The number of workers is not a number, or a worker died."""


def workers() -> int:
    """Return the number of workers: POINTNETKL_WORKERS, or one for each core that this process may use.

    Raises:
        ComputeError: POINTNETKL_WORKERS is not a whole number of at least 1.
    """
    value = os.environ.get("POINTNETKL_WORKERS")
    if value is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not value.isdecimal() or int(value) < 1:
        raise ComputeError(f"POINTNETKL_WORKERS is {value!r}, must be a whole number of at least 1")
    return int(value)


def over(
    function: Callable[[Item], Result], items: Sequence[Item], doing: str, processes: bool = True, unit: str = "submap"
) -> list[Result]:
    """Return the results of a function on items, in their order, with a progress bar named `doing`.

    It runs on the Dask cluster of DASK_SCHEDULER_ADDRESS if that is set, else in local processes; without `processes`
    in threads, for work that would wait for one GPU. POINTNETKL_WORKERS=1 runs it in this process in any case. The
    results are lost if a worker dies: a function whose work should survive writes it to disk.

    Raises:
        ComputeError: POINTNETKL_WORKERS is not a whole number of at least 1, or a local worker died.
        ClusterError: no scheduler answers at the address, it has no workers, or one died.
    """
    if not items:
        return []
    count = min(workers(), len(items))
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address and os.environ.get("POINTNETKL_WORKERS") != "1":
        return cluster.over(function, items, doing, address, functools.partial(progress, unit=unit))
    if count > 1 and not processes:
        return in_threads(function, items, doing, unit)
    if count > 1:
        return _in_processes(function, items, doing, count, unit)
    return [function(item) for item in progress(items, doing, len(items), unit)]


def in_threads(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    doing: str,
    unit: str = "submap",
    total: int | None = None,
) -> list[Result]:
    """Return the results of a function on items, in their order, computed by threads of this process.

    Items that are read from a file one by one (then `total` is their number) are held a few at a time.
    """
    count = len(items) if isinstance(items, Sequence) else total
    with ThreadPoolExecutor(workers()) as pool:
        return list(progress(_mapped(pool, function, iter(items)), doing, count, unit))


def _mapped(pool: ThreadPoolExecutor, function: Callable[[Item], Result], items: Iterator[Item]) -> Iterator[Result]:
    waiting: collections.deque[Future[Result]] = collections.deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > _AHEAD * workers():
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:  # after an error, nothing that has not begun begins
        for future in waiting:
            future.cancel()


def progress(items: Iterable[Item], doing: str, total: int | None, unit: str = "submap") -> Iterable[Item]:
    """Yield the items under a progress bar with rate and time left."""
    return tqdm(items, desc=doing, total=total, unit=unit, mininterval=0.5, dynamic_ncols=True)


def _in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], doing: str, count: int, unit: str
) -> list[Result]:
    # A server that has imported the function's module forks the workers. A fork of this process would inherit the
    # threads of its libraries, and fresh interpreters would each import everything again.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context: Any = multiprocessing.get_context(method)
    context.set_forkserver_preload([getattr(function, "func", function).__module__])
    pool = ProcessPoolExecutor(count, context, _begin_worker)
    try:
        with _one_thread_each():
            return list(progress(pool.map(function, items), doing, len(items), unit))
    except BrokenProcessPool as error:
        raise ComputeError(
            f"{doing}: a worker process was killed, most often because memory ran out; stage label keeps what it"
            f" finished: run it again, with POINTNETKL_WORKERS below {count} if memory is short"
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
    # the parent handles Ctrl-C; and nothing else ends this process when the parent dies
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)
