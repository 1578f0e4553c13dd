"""Pose graphs of random numbers, whose covariances are full and of axes of very different size."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pointnetkl.exchange.g2o import Graph
from pointnetkl.slam.graph.pose_graph import Edges


def poses(count: int, rng: np.random.Generator, size_m: float = 1e3) -> np.ndarray:
    """Return transforms (n, 4, 4), turned in every way."""
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    transforms[:, :3, 3] = rng.normal(size=(count, 3)) * size_m
    return transforms


def definite(count: int, rng: np.random.Generator, scales: float = 4.0) -> np.ndarray:
    """Return symmetric positive definite matrices (e, 6, 6), of axes from 10^-scales to 10^scales."""
    root = rng.normal(size=(count, 6, 6)) + 3 * np.eye(6)
    axes = 10 ** rng.uniform(-scales, scales, (count, 6))
    matrices = axes[:, :, None] * (root @ np.swapaxes(root, 1, 2)) * axes[:, None]
    return np.asarray((matrices + np.swapaxes(matrices, 1, 2)) / 2)


def graph(seed: int, vertices: int = 6, edges: int = 9, scales: float = 4.0) -> Graph:
    """Return a graph whose vertices have numbers in no order, two of them held."""
    rng = np.random.default_rng(seed)
    number = rng.permutation(40)[:vertices].astype(np.int64)
    ends = np.array([rng.permutation(vertices)[:2] for _ in range(edges)])
    measured = Edges(ends[:, 0], ends[:, 1], poses(edges, rng))
    return Graph(number, poses(vertices, rng), measured, definite(edges, rng, scales), np.array([1, 3]))


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a file as a bad disk or a careless editor leaves it."""
    damaged, place = bytearray(content), int(rng.integers(len(content)))
    kind = rng.integers(6)
    if kind == 0:
        damaged[place] = rng.integers(256)
    elif kind == 1:
        del damaged[place : place + int(rng.integers(1, 60))]
    elif kind == 2:
        damaged = damaged[:place]
    elif kind == 3:
        odd = [b"nan", b"-", b"1e999", b"\xff\xfe", b" ", b"\n", b"_", b"9" * 30, b"\0", b"e", b"."]
        damaged[place:place] = odd[int(rng.integers(len(odd)))]
    elif kind == 4:
        lines = content.splitlines(keepends=True)
        lines.insert(int(rng.integers(len(lines))), lines[int(rng.integers(len(lines)))])
        damaged = bytearray(b"".join(lines))
    else:
        lines = content.splitlines(keepends=True)
        del lines[int(rng.integers(len(lines)))]
        damaged = bytearray(b"".join(lines))
    return bytes(damaged)


def assert_one_sentence(sentence: str, path: Path) -> None:
    """See that an error names its file and is one line."""
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
