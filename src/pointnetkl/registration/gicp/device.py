"""Compilation of the package's kernels for a CPU; `gicp.cuda` compiles the same device functions for a GPU."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config

# Vectorise straight-line sums as well: the normals' nine sums become one addition, three times as fast.
config.SLP_VECTORIZE = 1

# The compiler may take zero for minus zero, but neither reorder sums nor fuse a product with a sum: how it fuses
# depends on what else it compiles at the time, and a process that finds the kernel in the cache would answer otherwise.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"nsz"}}

device = numba.njit(inline="always", **_OPTIONS)  # called from kernels alone


def _sources() -> str:
    folder = Path(__file__).parent
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))).hexdigest()[:16]


_CACHE = Path(config.CACHE_DIR or Path(__file__).parent / "__pycache__") / f"kernels-{_sources()}"


def kernel(function: Callable[..., Any], *, reorder: bool = False) -> Any:
    """Compile a function to be called from Python, and keep it on disk for the next process.

    With `reorder` the compiler may change the order of sums, to add eight terms at a time. Use it only for a function
    that calls no other: that one is compiled in the same way every time.

    Numba's cache notices a change of the function's own file only, but a kernel contains what it calls from other
    files. So the folder of the cache is named by a hash of all files of `gicp`.
    """
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_CACHE)
    options = {**_OPTIONS, "fastmath": {"nsz", "reassoc"}} if reorder else _OPTIONS
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        config.CACHE_DIR = before
