"""Shards: a file for each label, written as soon as it is computed, so that a killed run can resume.

A file's name is a hash of everything that decides the label.
"""

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import io
import json
import socket
import time
import tokenize
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.registration.gicp import GicpError
from pointnetkl.registration.monte_carlo import Label, MonteCarloError
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts, compute, parameters
from pointnetkl.workflow.artifacts import ArtifactError
from pointnetkl.workflow.errors import PointNetKLError

# the modules whose code decides a label
SOURCES = (
    "registration/gicp/**/*.py",
    "registration/covariance/table.py",
    "registration/error_statistics.py",
    "registration/monte_carlo.py",
    "registration/streams.py",
    "surveys/se2.py",
)
LIBRARIES = {"cpu": ("numpy", "scipy", "numba", "llvmlite"), "cuda": ("numpy", "scipy", "numba", "numba-cuda")}
_ABANDONED_S = 3600.0  # age of a temporary file that no process writes any more


class ShardError(PointNetKLError):
    """A label cannot be written, or a worker would compute another one than the stage asked for."""


@functools.cache
def kernel_version(engine: str) -> str:
    """Return a hash of the code that decides an engine's labels, so that no version has to be raised by hand.

    It is of the statements of the modules in SOURCES, whatever file they are in, and of the versions of the libraries
    that draw, search and compile. Names of modules, imports from this project, comments and docstrings do not count,
    because they change no label.
    """
    folder = Path(__file__).parents[1]
    files = {file for pattern in SOURCES for file in folder.glob(pattern)}
    code = sorted(text for file in files for text in statements(file.read_text("utf-8")))
    return _hash({"code": code, "libraries": [_version(name) for name in LIBRARIES[engine]]})


def statements(source: str) -> list[str]:
    """Return the top-level statements of a module as text, without comments, docstrings and imports of this project."""
    lines = source.splitlines()
    tree = ast.parse(source)
    for node in ast.walk(tree):
        own_import = isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pointnetkl"
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and (own_import or docstring):
            first, last = node.lineno - 1, node.end_lineno or node.lineno
            lines[first:last] = [""] * (last - first)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start[0] - 1, token.start[1]
            lines[row] = lines[row][:column]
    spans = [(_first_line(node) - 1, node.end_lineno) for node in tree.body]
    texts = ("\n".join(line.rstrip() for line in lines[first:last] if line.strip()) for first, last in spans)
    return [text for text in texts if text]


@dataclass(frozen=True)
class Job:
    """The labels of a survey to compute: all that a worker needs to know."""

    survey: str
    submaps: Path  # file of submap.POINTS, at a path that is valid on the workers too
    folder: Path  # of the shards, at such a path
    runs: int
    settings: monte_carlo.Settings
    registration: gicp.Settings
    kernel: str  # kernel_version() of the stage, which the workers must have too

    def path(self, cloud: Submap) -> Path:
        """Return the file of a submap's label, whose name is a hash of all that decides the label."""
        points = (cloud.points,) if self.settings.copy == "same" else (cloud.first, cloud.second)
        content = {
            "survey": cloud.survey,
            "submap": cloud.number,
            "points": [(p.dtype.str, p.shape, hashlib.sha256(p.tobytes()).hexdigest()) for p in points],
            "runs": self.runs,
            "settings": parameters.as_metadata(self.settings),
            "registration": parameters.as_metadata(self.registration),
            "kernel": self.kernel,
        }
        return self.folder / f"{_hash(content)}.npz"


def labels(job: Job) -> tuple[list[Label], int]:
    """Return the labels of a survey's submaps, by number, and the number of labels that had no shard yet.

    Raises:
        ShardError: a label could not be written, or a worker has other code or other points.
        SubmapError: there are no submaps.
    """
    sweep(job.folder)
    paths = {cloud.number: job.path(cloud) for cloud in submap.stream(job.survey, job.submaps)}
    if not paths:
        raise submap.SubmapError(f"{job.submaps}: has no submaps; did segment keep any of {job.survey}?")
    stored = {number: label for number, path in paths.items() if (label := read(path))}
    missing = [(number, path.name) for number, path in paths.items() if number not in stored]
    gpu = job.settings.engine == "cuda"
    compute.over(functools.partial(make, job), missing, f"label {job.survey}", processes=not gpu)
    return [stored.get(number) or _read_new(path) for number, path in paths.items()], len(missing)


def make(job: Job, item: tuple[int, str]) -> None:
    """Label the submap of a number and write the shard of this name, unless it exists.

    Raises:
        ShardError: the label cannot be computed or written, or would not be the one that the stage asked for.
    """
    number, name = item
    if kernel_version(job.settings.engine) != job.kernel:
        raise ShardError(
            f"{socket.gethostname()}: a worker there has another version of pointnetkl, NumPy, SciPy or Numba than the"
            " stage; install the same in both places and start the workers again"
        )
    cloud = submap.read(job.survey, job.submaps, number)
    if (path := job.path(cloud)).name != name:
        raise ShardError(f"{job.submaps}: submap {number} has changed since the stage began; run it again")
    if read(path):
        return
    try:
        label = monte_carlo.label(cloud, job.runs, job.settings, job.registration)
    except (GicpError, MonteCarloError) as error:
        raise ShardError(f"{job.submaps}: submap {number} of {job.survey}: {error}") from error
    write(path, label)


def write(path: Path, label: Label) -> None:
    """Write a label's shard, whole or not at all.

    Raises:
        ShardError: it cannot be written.
    """
    row = {name: value.item() if isinstance(value, np.generic) else value for name, value in label.row.items()}
    arrays = {"errors": label.errors.astype(np.float32), "held_out": label.held_out.astype(np.float32)}
    try:
        artifacts.write_arrays(path, arrays, {"name": path.name, "row": row})
    except ArtifactError as error:
        raise ShardError(f"{error}; the labels finished before are kept: mend that and run it again") from error


def read(path: Path) -> Label | None:
    """Return a shard's label, its errors in float32; None where the file is missing, damaged or no whole label."""
    try:
        arrays, metadata = artifacts.read_arrays(path)
        label = Label(metadata["row"], arrays["errors"], arrays["held_out"])
        m = label.errors.shape[-1]
        fits = metadata["name"] == path.name and set(label.row) == set(label_table.schema(m).names)
        complete = label.errors.shape == (label.row["runs"], m) and label.held_out.shape[1:] == (m,)
        return label if fits and complete else None
    except (ArtifactError, IndexError, KeyError, TypeError):
        return None


def sweep(folder: Path) -> None:
    """Delete old temporary files of killed writers; young ones may belong to writers at work."""
    for partial in folder.glob(".*.partial"):
        with contextlib.suppress(FileNotFoundError):
            if time.time() - partial.stat().st_mtime > _ABANDONED_S:
                partial.unlink()


def _read_new(path: Path) -> Label:
    if (label := read(path)) is None:
        raise ShardError(f"{path}: was made and is gone or damaged; is its folder seen by the workers? Run it again")
    return label


def _first_line(node: ast.stmt) -> int:
    # a definition begins with its decorators
    return min([node.lineno, *(decorator.lineno for decorator in getattr(node, "decorator_list", []))])


def _version(library: str) -> str | None:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return None


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
