"""Map a function over submaps, in parallel, in order.

Threads, because the work is in kernels that release Python's lock; the answer never depends on their number.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from tqdm import tqdm

from pointnetkl.errors import PointNetKLError

Item = TypeVar("Item")
Result = TypeVar("Result")


class ComputeError(PointNetKLError):
    """The number of workers is not one."""


def workers() -> int:
    """Return how many workers to use: POINTNETKL_WORKERS, or one per core that this process may use."""
    asked = os.environ.get("POINTNETKL_WORKERS")
    if asked is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not asked.isdecimal() or int(asked) < 1:
        raise ComputeError(f"POINTNETKL_WORKERS is {asked!r}, must be a whole number of at least 1")
    return int(asked)


def over(function: Callable[[Item], Result], items: Sequence[Item], doing: str) -> list[Result]:
    """Return the function of every item, in order, with a progress bar that says what is being done."""
    with ThreadPoolExecutor(workers()) as pool:
        return list(progress(pool.map(function, items), doing, len(items)))


def progress(items: Iterable[Item], doing: str, total: int) -> Iterable[Item]:
    """Yield the items under a progress bar with rate and time left."""
    return tqdm(items, desc=doing, total=total, unit="submap", mininterval=0.5, dynamic_ncols=True)
