"""Labels kept as they are made, a file each, named by all that decides them: a killed run resumes where it was."""

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
_ABANDONED_S = 3600.0  # no file is written for an hour


class ShardError(PointNetKLError):
    """A label cannot be kept, or a worker would make another one than was asked for."""


@functools.cache
def kernel_version(engine: str) -> str:
    """Return a hash of the code that decides an engine's labels: nobody has to remember to raise a number.

    It is of the statements of the modules in SOURCES, in whichever file they stand, and of the libraries that draw,
    search and compile. What a module is called, what it imports from this project, comments and docstrings are left
    out: none of them changes a label.
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
        ours = isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pointnetkl"
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and (ours or docstring):
            first, last = node.lineno - 1, node.end_lineno or node.lineno
            lines[first:last] = [""] * (last - first)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start[0] - 1, token.start[1]
            lines[row] = lines[row][:column]
    spans = [(_first_line(node) - 1, node.end_lineno) for node in tree.body]
    kept = ("\n".join(line.rstrip() for line in lines[first:last] if line.strip()) for first, last in spans)
    return [text for text in kept if text]


@dataclass(frozen=True)
class Job:
    """What the labels of a survey are made of and where they are kept: all that a worker is told."""

    survey: str
    submaps: Path  # of submap.POINTS, where the workers see it too
    folder: Path  # of the shards, likewise
    runs: int
    settings: monte_carlo.Settings
    registration: gicp.Settings
    kernel: str  # of who hands out the work: kernel_version()

    def path(self, of: Submap) -> Path:
        """Return the file of a submap's label: its name changes with anything that the label depends on."""
        points = (of.points,) if self.settings.copy == "same" else (of.first, of.second)
        content = {
            "survey": of.survey,
            "submap": of.number,
            "points": [(p.dtype.str, p.shape, hashlib.sha256(p.tobytes()).hexdigest()) for p in points],
            "runs": self.runs,
            "settings": parameters.as_metadata(self.settings),
            "registration": parameters.as_metadata(self.registration),
            "kernel": self.kernel,
        }
        return self.folder / f"{_hash(content)}.npz"


def labels(job: Job) -> tuple[list[Label], int]:
    """Return the labels of a survey's submaps, by number, and how many of them were not there and had to be made.

    Raises:
        ShardError: a label could not be kept, or a worker has other code or other points.
        SubmapError: there are no submaps.
    """
    sweep(job.folder)
    paths = {one.number: job.path(one) for one in submap.read_each(job.survey, job.submaps)}
    if not paths:
        raise submap.SubmapError(f"{job.submaps}: has no submaps; did segment keep any of {job.survey}?")
    there = {number: found for number, path in paths.items() if (found := read(path))}
    missing = [(number, path.name) for number, path in paths.items() if number not in there]
    gpu = job.settings.engine == "cuda"
    compute.over(functools.partial(make, job), missing, f"label {job.survey}", processes=not gpu)
    return [there.get(number) or _made(path) for number, path in paths.items()], len(missing)


def make(job: Job, item: tuple[int, str]) -> None:
    """Label one submap, by its number, and keep the label under the given name, unless it is there.

    Raises:
        ShardError: the label cannot be kept, or would not be the one that was asked for.
    """
    number, name = item
    if kernel_version(job.settings.engine) != job.kernel:
        raise ShardError(
            f"{socket.gethostname()}: a worker there has another version of pointnetkl, NumPy, SciPy or Numba than the"
            " stage; install the same in both places and start the workers again"
        )
    one = submap.read(job.survey, job.submaps, number)
    if (path := job.path(one)).name != name:
        raise ShardError(f"{job.submaps}: submap {number} has changed since the stage began; run it again")
    if read(path):
        return
    try:
        label = monte_carlo.label(one, job.runs, job.settings, job.registration)
    except (GicpError, MonteCarloError) as error:
        raise ShardError(f"{job.submaps}: submap {number} of {job.survey}: {error}") from error
    write(path, label)


def write(path: Path, label: Label) -> None:
    """Keep a label, whole or not at all.

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
    """Return a label that was kept, its errors in float32; None where it is missing, damaged or not a whole label."""
    try:
        arrays, metadata = artifacts.read_arrays(path)
        label = Label(metadata["row"], arrays["errors"], arrays["held_out"])
        m = label.errors.shape[-1]
        known = metadata["name"] == path.name and set(label.row) == set(label_table.schema(m).names)
        whole = label.errors.shape == (label.row["runs"], m) and label.held_out.shape[1:] == (m,)
        return label if known and whole else None
    except (ArtifactError, IndexError, KeyError, TypeError):
        return None


def sweep(folder: Path) -> None:
    """Delete what killed writers left half written, long ago: others may be writing now."""
    for partial in folder.glob(".*.partial"):
        with contextlib.suppress(FileNotFoundError):
            if time.time() - partial.stat().st_mtime > _ABANDONED_S:
                partial.unlink()


def _made(path: Path) -> Label:
    if (label := read(path)) is None:
        raise ShardError(f"{path}: was made and is gone or damaged; is its folder seen by the workers? Run it again")
    return label


def _first_line(node: ast.stmt) -> int:
    # a definition begins with its decorators
    return min([node.lineno, *(each.lineno for each in getattr(node, "decorator_list", []))])


def _version(library: str) -> str | None:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return None


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
