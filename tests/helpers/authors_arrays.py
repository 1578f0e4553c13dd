"""Arrays as the paper's authors publish them, made here: simulated rows in the exact format."""

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np


def row(number: int, *, roughness: float = 0.2, points: int = 60, seed: int = 0) -> tuple[Any, ...]:
    """Return a submap as the authors' program made it: tuples of arrays, NumPy's scalar and two names."""
    rng = np.random.default_rng([seed, number])
    cloud = rng.uniform(-1, 1, (points, 3)) * [1, 1, roughness]
    cloud -= cloud.mean(axis=0)
    cloud /= np.linalg.norm(cloud, axis=1).max()
    a = rng.normal(size=(2, 2)) * np.exp(-4 * roughness)
    posterior = a @ a.T + 0.05 * np.eye(2)
    rho = np.float64(rng.uniform(80, 120))
    files = f"../data/made/submap_{number}.xyz", f"../data/made/submap_{number}.txt"
    return cloud, 9.0 * np.eye(2), posterior, rho, *files


def rows(count: int, seed: int = 0) -> list[tuple[Any, ...]]:
    """Return submaps from flat to rough, so that their labels can be learned."""
    return [row(i, roughness=i / count, points=50 + i, seed=seed) for i in range(count)]


def as_array(rows: list[tuple[Any, ...]]) -> np.ndarray:
    """Return rows as the (n, 6) array of objects that np.save makes of them."""
    array = np.empty((len(rows), len(rows[0])), object)
    for i, cells in enumerate(rows):
        for j, cell in enumerate(cells):
            array[i, j] = cell
    return array


def write(path: Path, rows: list[tuple[Any, ...]]) -> Path:
    """Write rows as np.save does; return the path."""
    np.save(path, as_array(rows), allow_pickle=True)
    return path


def npy(content: bytes, shape: object = (1, 6), version: int = 1, head: str = "") -> bytes:
    """Return a .npy file with this pickle and header."""
    header = (head or f"{{'descr': '|O', 'fortran_order': False, 'shape': {shape}, }}").encode() + b"\n"
    length = len(header).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + header + content


def pickled(array: np.ndarray, protocol: int = 4) -> bytes:
    """Return an array's pickle, in one of the protocols that versions of np.save have had."""
    buffer = io.BytesIO()
    pickle.dump(array, buffer, protocol)
    return buffer.getvalue()


def by_numpy_1(content: bytes) -> bytes:
    """Return a pickle of protocol 3 as NumPy 1 names its modules."""
    return content.replace(b"cnumpy._core.", b"cnumpy.core.")
