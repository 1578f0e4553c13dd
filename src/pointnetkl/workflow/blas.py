"""Ask OpenBLAS for the same kernels on every x86-64 processor: the same seed then gives the same bytes on each.

OpenBLAS comes with NumPy and SciPy. It picks its kernels by the processor, and they round differently: labels made on
two generations of one processor differed in their last digits. The Haswell kernels run wherever there is AVX2.
OpenBLAS reads the variable once, as NumPy loads it, so a stage's script imports this module before all others.
"""

import os
import platform
from pathlib import Path

_CPUINFO = Path("/proc/cpuinfo")


def has_avx2() -> bool:
    """Whether this is an x86-64 processor that runs the Haswell kernels, as far as Linux tells."""
    return platform.machine() == "x86_64" and _CPUINFO.exists() and " avx2 " in _CPUINFO.read_text()


if has_avx2():
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")  # somebody's own choice stands
