"""Map a function over items on a Dask cluster; every failure of the cluster becomes an error of one sentence."""

import asyncio
import contextlib
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import Any, TypeVar

from pointnetkl.workflow.errors import PointNetKLError

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[Iterable[Any], str, int], Iterable[Any]]  # takes the items, the name of the work, their number

_CONNECT_S = 15.0  # for a scheduler to answer; workers get longer, because they may wait in a batch queue
_WORKER_S = 300.0
_LOOK_S = 5.0  # between two checks of the workers
_WORKER_BYTES = 512 << 20  # for each thread of a Dask worker; labels at the paper's size take half of it


class ClusterError(PointNetKLError):
    """The scheduler or its workers are missing, are too small for the work, or died."""


def over(
    function: Callable[[Item], Result], items: Sequence[Item], doing: str, address: str, progress: Progress
) -> list[Result]:
    """Return the results of a function on items, in their order, computed by the workers of a scheduler.

    Raises:
        ClusterError: no scheduler answers at the address, no worker is large enough, or workers died.
    """
    from distributed import KilledWorker  # imported here, because it takes a second

    patience = _patience()
    try:
        with _quiet(), _client(address) as client:
            _refuse_small(_await_workers(client, address, patience))
            futures = client.map(function, items, pure=False)
            results = dict(progress(_finished(client, futures, address, patience), doing, len(items)))
            return [results[future] for future in futures]
    except KilledWorker as error:
        raise ClusterError(
            f"{doing}: {error.allowed_failures + 1} workers of {address} died over the same submap, most often because"
            " memory ran out; stage label keeps what it finished: give workers more (--memory-limit) and run it again"
        ) from error
    except CancelledError as error:
        raise ClusterError(
            f"{doing}: the scheduler at {address} went away; stage label keeps what it finished: start it and run again"
        ) from error
    except (ModuleNotFoundError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "deserialization" not in str(error):
            raise
        raise ClusterError(
            f"{doing}: the scheduler at {address} or a worker there cannot load what is to be done"
            f" ({error.__cause__ or error}); install the same pointnetkl there as here and start them again"
        ) from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # Dask logs each failure in many lines; our error says it in one sentence
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _patience() -> float:
    value = os.environ.get("POINTNETKL_WORKER_TIMEOUT_S", str(_WORKER_S))
    try:
        seconds = float(value)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < float("inf"):
        raise ClusterError(f"POINTNETKL_WORKER_TIMEOUT_S is {value!r}, must be a number of seconds")
    return seconds


def _client(address: str) -> Any:
    from distributed import Client

    try:
        # a call that fails fast comes first: a client of a wrong address takes half a minute to give up
        if "workers" not in asyncio.run(asyncio.wait_for(_identity(address), _CONNECT_S)):
            raise ValueError("what answers is no scheduler")
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except Exception as error:  # wrong addresses raise errors of many kinds
        cause = " ".join(str(error).split())[:200] or f"nothing in {_CONNECT_S:g} s"
        raise ClusterError(
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
    while not (running := _with_status(client, "running")):
        if time.monotonic() > deadline:
            paused = len(_with_status(client, "paused"))
            none = f"none that runs ({paused} are paused, most often for memory)" if paused else "no Dask worker"
            raise ClusterError(
                f"{address}: {none} for {patience:g} s; start one (dask worker {address}), or wait longer by"
                " POINTNETKL_WORKER_TIMEOUT_S; stage label keeps what it finished"
            )
        time.sleep(0.2)
    return running


def _with_status(client: Any, status: str) -> dict[str, Any]:
    workers = client.scheduler_info(n_workers=-1)["workers"]
    return {name: worker for name, worker in workers.items() if worker["status"] == status}


def _refuse_small(workers: dict[str, Any]) -> None:
    # Dask pauses a worker at 80 % of its memory, and kills it at 95 %, again and again
    for name, worker in workers.items():
        share = worker["memory_limit"] / worker["nthreads"]
        if 0 < share < _WORKER_BYTES:  # 0: no limit
            raise ClusterError(
                f"{name}: this Dask worker has {share / 2**20:.0f} MiB for each thread, a submap takes up to"
                f" {_WORKER_BYTES >> 20} MiB; start it with --nthreads 1 --memory-limit 2GiB"
            )


def _finished(client: Any, futures: list[Any], address: str, patience: float) -> Iterator[tuple[Any, Any]]:
    # yields futures and their results as they come, in any order
    from distributed import as_completed

    done = as_completed(futures, loop=client.loop, with_results=True)
    remaining, since = len(futures), time.monotonic()
    while remaining:
        batch = done.next_batch(block=False)
        for future, result in batch:
            if future.status == "error":
                raise result[1]
            if future.cancelled():
                raise CancelledError
            yield future, result
        remaining -= len(batch)
        if not batch and time.monotonic() - since > _LOOK_S:
            _refuse_small(_await_workers(client, address, patience))  # new workers may have come
            since = time.monotonic()
        time.sleep(0.1)
