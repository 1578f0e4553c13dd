"""The device of a training: a GPU in mixed precision, or the CPU in full precision, the same to the bit each time."""

import os

import torch
from numba import set_num_threads
from numba.core import config

from pointnetkl.workflow.errors import PointNetKLError


class DeviceError(PointNetKLError):
    """This machine lacks the device that is asked for."""


def choose(name: str) -> torch.device:
    """Return the device for `auto` (a GPU where there is one), `cpu` or `cuda`.

    Raises:
        DeviceError: cuda is asked for where there is none.
    """
    present = torch.cuda.is_available()
    if name == "cuda" and not present:
        raise DeviceError("device is cuda, but torch finds no NVIDIA GPU here; write auto or cpu in params.yaml")
    return torch.device("cuda" if present and name != "cpu" else "cpu")


def prepare(seed: int, threads: int, device: torch.device) -> None:
    """Make torch give the same bits every time on a CPU: set its generator, its threads and its algorithms."""
    torch.manual_seed(seed)
    torch.set_num_threads(threads)
    if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
        # TBB last, which Numba would try first: an older one on the system makes it warn
        config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]
    set_num_threads(min(threads, config.NUMBA_NUM_THREADS))
    # as use_deterministic_algorithms does, which also imports a compiler, for seconds
    torch.set_deterministic_debug_mode("error" if device.type == "cpu" else "default")
    # else torch fills every new tensor with NaN first, a fifth of the time; nothing here reads what it has not written
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]


def low_precision(device: torch.device) -> torch.dtype | None:
    """Return the type in which matrices are multiplied in training; None: all in float32, as on every CPU.

    bfloat16 has the range of float32; float16, for GPUs that lack it, has not, and its loss must be scaled.
    """
    if device.type != "cuda":
        return None
    return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float16


def rng_states(device: torch.device) -> list[torch.Tensor]:
    """Return the states of torch's generators: the CPU's, and the GPU's where that is the device."""
    return [torch.get_rng_state(), *([torch.cuda.get_rng_state()] if device.type == "cuda" else [])]


def set_rng_states(device: torch.device, states: list[torch.Tensor]) -> None:
    """Give torch's generators the states that `rng_states` returned."""
    torch.set_rng_state(states[0])
    if device.type == "cuda":
        torch.cuda.set_rng_state(states[1])
