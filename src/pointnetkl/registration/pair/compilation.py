"""Compilation of this package's kernels, which contain those of `gicp`."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config

from pointnetkl.registration.gicp.device import device

__all__ = ["device", "kernel"]

_FOLDERS = (Path(__file__).parent, Path(__file__).parents[1] / "gicp")


def _sources() -> str:
    files = sorted(path for folder in _FOLDERS for path in folder.rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


_CACHE = Path(config.CACHE_DIR or Path(__file__).parent / "__pycache__") / f"kernels-{_sources()}"


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function to be called from Python as `gicp.device.kernel` does, and keep it on disk.

    The folder of the cache is named by a hash of all files of both packages, because a kernel contains what it calls
    from other files, and numba's cache notices a change of the function's own file only.

    Sums keep their order. In another, H and X of the process that compiles differed in their last digits from those of
    one that finds the kernels on disk, and so did the bytes of a stage's table.
    """
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_CACHE)
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz"})(function)
    finally:
        config.CACHE_DIR = before
