"""How the package's kernels are compiled: for a CPU here, and the same device functions for a GPU by cuda.py."""

from typing import Any

import numba
from numba.core import config

# Vectorise straight-line sums as well: the normals' nine sums become one addition, three times as fast.
config.SLP_VECTORIZE = 1

# The compiler may fuse a multiplication with an addition and take zero for minus zero, but not reorder sums: that
# would cost digits, and make the answer depend on the machine's vectors.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}

kernel = numba.njit(cache=True, nogil=True, **_OPTIONS)  # called from Python
device = numba.njit(inline="always", **_OPTIONS)  # called from kernels alone
