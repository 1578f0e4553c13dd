"""A simulated GPU for tests: numba's simulator, in a new process."""

import os
import subprocess
import sys
from typing import Any

import numpy as np

from pointnetkl.registration.gicp.cuda import engine as cuda

THREADS = 8  # of a block: each is a thread of Python


class HostLane(cuda.Lane):
    """A lane whose arrays are NumPy's, as the simulator takes them; new ones are filled with numbers, as on a GPU."""

    def __init__(self, blocks: int = 2):
        self.gpu, self.blocks, self.stream = "simulator", blocks, 0

    def empty(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """Return an array of memory that was used before."""
        return np.full(shape, 77, dtype)

    def put(self, name: str, array: np.ndarray) -> np.ndarray:
        """Return a copy on the device."""
        return np.array(array)

    def get(self, array: np.ndarray) -> np.ndarray:
        """Return an array of the device on the host."""
        return array


def install() -> None:
    """Let the engine run here, in a process that `run` has started."""
    cuda.Lane, cuda._THREADS = HostLane, THREADS  # type: ignore[misc]


def run(*command: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a script of Python in a process that simulates: numba asks for it when it is imported."""
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, **options)
