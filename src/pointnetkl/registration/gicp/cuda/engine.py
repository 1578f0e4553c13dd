"""The experimental engine for an NVIDIA GPU: it copies clouds there, and registers noisy copies by the thousand."""

import math
import threading
from typing import Any

import numpy as np
from numba import cuda
from numba.core import config

from pointnetkl.registration.gicp import kernel, matching, weights
from pointnetkl.registration.gicp.cloud import Cloud, GicpError
from pointnetkl.registration.gicp.cuda import kernel as cuda_kernel
from pointnetkl.registration.gicp.cuda import matching as cuda_matching
from pointnetkl.registration.gicp.noise import Noise

_THREADS = 128  # of a block, a power of two
_BLOCKS = 6  # of a multiprocessor: what its registers hold
_ROOM_BYTES = 1 << 29  # for what the blocks of one call keep


def register_noisy(
    source: Cloud, target: Cloud, translations: np.ndarray, noise: Noise, limits: kernel.Limits
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Register copies of the source onto the target as `gicp.register_noisy` does, up to the rounding of float32.

    Returns translations (b, 2) in metres, iterations (b,) and whether each converged (b,). Calls of several threads
    overlap on the GPU, where each keeps up to a GiB for the thread's next call.

    Raises:
        GicpError: there is no GPU or no numba-cuda, yaw is asked for, or the source is too large.
    """
    if limits.with_yaw:
        raise GicpError(
            "the experimental engine cuda finds x and y alone; set label.engine to cpu, which finds yaw too, or"
            " registration.dof to xy"
        )
    require_gpu()
    if len(translations) == 0:
        return np.zeros((0, 2)), np.zeros(0, np.int32), np.zeros(0, np.bool_)
    if not hasattr(_own, "lane"):
        _own.lane = Lane()
    return launch(_own.lane, arguments(_own.lane, source, target, translations, noise, limits))


def require_gpu() -> None:
    """Check that the engine can run here.

    Raises:
        GicpError: there is no GPU or no numba-cuda.
    """
    if not cuda.is_available() or (cuda.implementation == "Built-in" and not config.ENABLE_CUDASIM):
        raise GicpError(
            "the engine cuda (experimental: it has run on a simulator only) needs an NVIDIA GPU with its driver, and"
            " numba-cuda (pip install -e '.[cuda]', or '.[cuda12]'); at least one is missing here: install it, or set"
            " label.engine to cpu"
        )


class Lane:
    """A thread's stream and its arrays on the GPU, which are kept between calls: freeing one halts all streams."""

    def __init__(self) -> None:
        """Open a stream on the current GPU."""
        gpu = cuda.get_current_device()
        self.gpu = gpu.name.decode() if isinstance(gpu.name, bytes) else str(gpu.name)
        self.blocks = _BLOCKS * gpu.MULTIPROCESSOR_COUNT
        self.stream: Any = cuda.stream()
        self._arrays: dict[str, Any] = {}

    def empty(self, name: str, shape: tuple[int, ...], dtype: type) -> Any:
        """Return an array on the GPU with undefined contents."""
        size = math.prod(shape)
        if name not in self._arrays or self._arrays[name].size < size:
            self._arrays[name] = cuda.device_array(size + size // 4, dtype, stream=self.stream)
        return self._arrays[name][:size].reshape(shape)

    def put(self, name: str, array: np.ndarray) -> Any:
        """Return a copy on the GPU."""
        on_gpu = self.empty(name, array.shape, array.dtype.type)
        on_gpu.copy_to_device(np.ascontiguousarray(array), stream=self.stream)
        return on_gpu

    def get(self, array: Any) -> np.ndarray:
        """Return a copy from the GPU, after all earlier work of the stream."""
        on_host = array.copy_to_host(stream=self.stream)
        self.stream.synchronize()
        return np.asarray(on_host)


_own = threading.local()


def launch(lane: Lane, arguments: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the kernel once with what `arguments` returned; fetch translations, iterations and who converged."""
    *_, room, outcomes = arguments
    shared = cuda_kernel.shared_bytes(_THREADS)
    cuda_kernel.register_noisy[len(room.matches), _THREADS, lane.stream, shared](*arguments)
    translations, iterations, converged, _ = (lane.get(array) for array in outcomes)
    return translations, iterations, converged


def arguments(
    lane: Lane, source: Cloud, target: Cloud, translations: np.ndarray, noise: Noise, limits: kernel.Limits
) -> tuple[Any, ...]:
    """Copy what one launch reads to the GPU, and make room there for what it writes; see cuda_kernel.register_noisy.

    Raises:
        GicpError: the source is too large.
    """
    runs, n = len(translations), len(source.points)
    points, lists = source.as_source(target, np.zeros(3)).points, np.sort(source.lists, axis=1).T.reshape(-1)
    return (
        cuda_kernel.Source(lane.put("source", points), lane.put("lists", lists)),
        _put_target(lane, cuda_matching.interleaved(target.as_target)),
        lane.put("moves", np.asarray(translations, np.float32)),
        noise.as_arguments(),
        limits,
        _room(lane, n, runs),
        cuda_kernel.Outcomes(
            lane.empty("translations", (runs, 2), np.float64),
            lane.empty("iterations", (runs,), np.int32),
            lane.empty("converged", (runs,), np.bool_),
            lane.put("started", np.zeros(1, np.int32)),
        ),
    )


def _room(lane: Lane, n: int, runs: int) -> cuda_kernel.Room:
    whole = -(-n // _THREADS) * _THREADS
    shapes: dict[str, tuple[int, ...]] = {
        "points": (3, n),
        "normals": (3, n),
        "terms": (weights.TERMS, n),
        "matches": (n,),
        "deadlines": (whole,),
        "stale": (2, n),
    }
    fitting = _ROOM_BYTES // sum(4 * math.prod(shape) for shape in shapes.values())
    if fitting < 1:
        raise GicpError(
            f"a cloud of {n} points is too large for the engine cuda, which has {_ROOM_BYTES >> 20} MiB for it;"
            " thin it, or set label.engine to cpu"
        )
    blocks = min(runs, lane.blocks, fitting)
    whole_numbers = {"matches", "stale"}
    return cuda_kernel.Room(
        **{
            name: lane.empty(name, (blocks, *shape), np.int32 if name in whole_numbers else np.float32)
            for name, shape in shapes.items()
        }
    )


def _put_target(lane: Lane, target: matching.Target) -> matching.Target:
    arrays = {name: value for name, value in target._asdict().items() if isinstance(value, np.ndarray)}
    return target._replace(**{name: lane.put(f"target {name}", value) for name, value in arrays.items()})
