"""How the package's kernels are compiled: for a CPU here, and the same device functions for a GPU by cuda.py."""

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

    With `reorder` its sums may be taken in another order, eight terms at a time; the order then is the compiler's, so
    only for a function that calls no other, which is compiled alike whenever it is.

    Numba's cache knows when the function's own file changes; its folder here changes with every file of the package,
    because a kernel holds what it calls from other files.
    """
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_CACHE)
    options = {**_OPTIONS, "fastmath": {"nsz", "reassoc"}} if reorder else _OPTIONS
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        config.CACHE_DIR = before
