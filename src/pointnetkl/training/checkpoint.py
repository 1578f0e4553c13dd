"""The state of a training, kept in a file, so that a killed training, or a longer one, goes on from there."""

import hashlib
import importlib.metadata
import inspect
import io
import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pointnetkl.models.samples import Samples
from pointnetkl.workflow import artifacts


class Checkpoint:
    """A file whose name is a hash of all that decides a training; it is written whole or not at all."""

    def __init__(self, folder: Path, name: str, every_s: float) -> None:
        """Keep the training of that name in the folder, every `every_s` seconds."""
        self.path = folder / f"{name}.pt"
        self.every_s = every_s
        self.kept_at = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """Return the kept state; None where there is none that can be read."""
        try:
            content = torch.load(io.BytesIO(self.path.read_bytes()), map_location="cpu", weights_only=True)
            return dict(content)
        except Exception:  # zip, pickle and torch each fail in their own ways; starting anew gives the same model
            return None

    def offer(self, state: Callable[[], dict[str, Any]]) -> None:
        """Keep the state if it is time to.

        Raises:
            ArtifactError: it cannot be written.
        """
        if time.monotonic() - self.kept_at >= self.every_s:
            self.keep(state())

    def keep(self, state: dict[str, Any]) -> None:
        """Keep the state.

        Raises:
            ArtifactError: it cannot be written.
        """
        buffer = io.BytesIO()
        torch.save(state, buffer)
        artifacts.write_bytes(self.path, buffer.getvalue())
        self.kept_at = time.monotonic()

    def discard_others(self) -> None:
        """Delete every other state in the folder: the model is trained, and its abandoned trainings are out of date."""
        for path in (*self.path.parent.glob("*.pt"), *self.path.parent.glob(".*.partial")):
            if path != self.path:
                path.unlink(missing_ok=True)

    def discard(self) -> None:
        """Delete every state in the folder."""
        self.discard_others()
        self.path.unlink(missing_ok=True)


def name(settings: Mapping[str, Any], samples: tuple[Samples, ...]) -> str:
    """Return a hash of the settings, the data, this package's loaded code, and the versions of libraries."""
    modules = {key: module for key, module in sys.modules.items() if key.startswith("pointnetkl.")}
    content = {
        "settings": settings,
        "samples": [_digest(each) for each in samples],
        "sources": {key: inspect.getsource(module) for key, module in sorted(modules.items()) if _has_code(module)},
        "libraries": [importlib.metadata.version(library) for library in ("numpy", "torch", "numba", "llvmlite")],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _digest(samples: Samples) -> str:
    digest = hashlib.sha256()
    described = () if samples.described is None else (samples.described,)
    for array in (samples.submap, samples.radius, samples.label, *described, *samples.clouds):
        digest.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _has_code(module: Any) -> bool:
    return bool(getattr(module, "__file__", None)) and Path(module.__file__).stat().st_size > 0
