"""Pose graphs as g2o files, in two dialects that name alike what they do not mean alike.

Both have a line for each vertex (T_map_vertex) and edge (T_target_source, and the upper triangle of its information
in the source's frame, translation first). To g2o itself an orientation's error is the vector part of its quaternion,
half an angle: `g2o` so has the rotation's block of the information times 4, and the blocks between it and the
translation times 2, against `gtsam`, whose units are metres and radians throughout, as GTSAM reads and writes them. A
file does not say which it is: ours do, in the comment that they begin with.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.readers.formats import text_lines
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.surveys import pose
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError

DIALECTS = ("g2o", "gtsam")
_ORDER = np.array([3, 4, 5, 0, 1, 2])  # a file has the translation first, a tangent vector of ours the rotation
_UPPER = np.triu_indices(6)
_UNITS = {"g2o": np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]), "gtsam": np.ones(6)}  # radians in a unit of the file
_TITLE = "# pointnetkl pose graph, dialect"  # how a file of ours begins
_ERROR = {
    "g2o": "(x, y, z, qx, qy, qz), metres and quaternion",
    "gtsam": "(x, y, z, roll, pitch, yaw), metres, radians",
}
_VERTEX, _EDGE, _FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_NUMBERS = {_VERTEX: 7, _EDGE: 28}  # after the names of vertices
_SMALLEST = 1e-12  # eigenvalue of an information that is scaled to a unit diagonal; less is rounding


class G2oError(PointNetKLError):
    """A file is no pose graph, or not one of 3D poses."""


@dataclass(frozen=True)
class Graph:
    """Vertices in the order of their file, and what was measured between them; nodes count from 0."""

    number: np.ndarray  # (n,) the name of each vertex: the submap's number
    poses: np.ndarray  # (n, 4, 4) T_map_vertex
    edges: Edges
    information: np.ndarray  # (e, 6, 6) in m and rad, rotation first, in the source's frame
    fixed: np.ndarray  # (f,) nodes whose pose is given


@dataclass(frozen=True)
class Content:
    """What a file holds, and how it was understood."""

    graph: Graph
    dialect: str
    is_stated: bool  # by the file or the caller; else g2o is assumed


def write(path: Path, graph: Graph, dialect: str) -> None:
    """Write a graph with all digits of its numbers, whole or not at all.

    Raises:
        ArtifactError: the file cannot be written.
    """
    artifacts.write_bytes(path, to_text(graph, dialect).encode())


def to_text(graph: Graph, dialect: str) -> str:
    """Return a graph as the text of a file."""
    names, edges = graph.number.tolist(), graph.edges
    units = _UNITS[dialect]
    information = (units[:, None] * graph.information[:, _ORDER[:, None], _ORDER] * units)[:, *_UPPER]
    lines = [
        f"{_TITLE} {dialect}: poses T_map_vertex, edges T_first_second, x y z in metres and"
        f" qx qy qz qw; information of the error {_ERROR[dialect]}, in the second vertex's frame"
    ]
    lines += [f"{_VERTEX} {name} {_line(row)}" for name, row in zip(names, _rows(graph.poses), strict=True)]
    lines += [f"{_FIX} {names[node]}" for node in graph.fixed.tolist()]
    for k, i, T, row in zip(edges.target, edges.source, _rows(edges.measured), information, strict=True):
        lines.append(f"{_EDGE} {names[k]} {names[i]} {_line(T)} {_line(row)}")
    return "\n".join(lines) + "\n"


def read(path: Path, dialect: str | None = None) -> Content:
    """Return the graph in a file, taken in the dialect that it or the caller says, and in g2o's where neither does.

    Lines may be in any order; those of PARAMS_..., which only other kinds of edges use, are passed over.

    Raises:
        G2oError: the file is missing or damaged, has other lines than 3D poses and edges, a vertex twice or not at
            all, an information that is not positive definite, or says another dialect than the caller or there are.
    """
    lines = text_lines.read(path, G2oError)
    stated = _stated(path, lines)
    if dialect and stated and dialect != stated:
        raise G2oError(f"{path}: its first line says dialect {stated}, not {dialect}; leave the dialect out")
    chosen = dialect or stated or "g2o"
    return Content(_Reader(path).read(lines, _UNITS[chosen]), chosen, bool(dialect or stated))


class _Reader:
    """A file's lines on their way to a graph: what is wrong is told by its line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[str, list[list[float]]] = {_VERTEX: [], _EDGE: []}
        self._lines: dict[str, list[int]] = {_VERTEX: [], _EDGE: []}
        self._ends: list[tuple[int, list[int]]] = []  # of edges
        self._fixed: list[tuple[int, list[int]]] = []
        self._node: dict[int, int] = {}

    def read(self, lines: list[tuple[int, list[str]]], units: np.ndarray) -> Graph:
        for line, words in lines:
            if not words[0].startswith(("#", "PARAMS_")):
                self._take(line, words)
        if not self._node:
            raise G2oError(f"{self._path}: has no {_VERTEX}; it is no pose graph, or it is cut")
        poses, _ = self._transforms(_VERTEX)
        measured, rest = self._transforms(_EDGE)
        ends = np.array(self._nodes(self._ends), np.int64).reshape(-1, 2)
        fixed = np.unique(np.array([node for nodes in self._nodes(self._fixed) for node in nodes], np.int64))
        information = self._information(rest, units)
        return Graph(np.array(list(self._node)), poses, Edges(ends[:, 0], ends[:, 1], measured), information, fixed)

    def _take(self, line: int, words: list[str]) -> None:
        tag, names, values = self._parsed(line, words)
        if tag == _FIX:
            self._fixed.append((line, names))
            return
        self._rows[tag].append(values)
        self._lines[tag].append(line)
        if tag == _EDGE:
            self._add_edge(line, names)
        else:
            self._add_vertex(line, names[0])

    def _parsed(self, line: int, words: list[str]) -> tuple[str, list[int], list[float]]:
        """Return what a line begins with, the vertices that it names, and its numbers."""
        tag, *rest = words
        if tag not in (*_NUMBERS, _FIX):
            known = f"only {_VERTEX}, {_EDGE} and {_FIX} are read"
            raise self._error(line, f"it begins with {text_lines.shown(tag)}; {known}")
        named = {_VERTEX: 1, _EDGE: 2, _FIX: max(1, len(rest))}[tag]
        if len(rest) != (wanted := named + _NUMBERS.get(tag, 0)):
            raise self._error(line, f"it has {len(rest)} words after {tag}, must have {wanted}")
        try:
            return tag, [text_lines.whole(word) for word in rest[:named]], text_lines.numbers(rest[named:])
        except ValueError as error:
            raise self._error(line, str(error)) from error

    def _add_edge(self, line: int, names: list[int]) -> None:
        if names[0] == names[1]:
            raise self._error(line, f"an edge joins vertex {names[0]} to itself")
        self._ends.append((line, names))

    def _add_vertex(self, line: int, name: int) -> None:
        if name in self._node:
            raise self._error(line, f"vertex {name} stands there a second time")
        self._node[name] = len(self._node)

    def _nodes(self, named: list[tuple[int, list[int]]]) -> list[list[int]]:
        for line, names in named:
            if missing := [name for name in names if name not in self._node]:
                raise self._error(line, f"there is no vertex {missing[0]} in the file")
        return [[self._node[name] for name in names] for _, names in named]

    def _transforms(self, tag: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses of the lines of a kind, and the numbers after them."""
        rows = np.array(self._rows[tag], np.float64).reshape(-1, _NUMBERS[tag])
        wrong = ~pose.are_unit(rows[:, 3:7])
        if wrong.any():
            line = self._lines[tag][int(wrong.argmax())]
            raise self._error(line, "its quaternion has not length 1; the order is x y z qx qy qz qw")
        return pose.from_quaternions(rows[:, :3], rows[:, 3:7]), rows[:, 7:]

    def _information(self, upper: np.ndarray, units: np.ndarray) -> np.ndarray:
        matrices = np.zeros((len(upper), 6, 6))
        matrices[:, *_UPPER] = upper
        matrices += np.swapaxes(np.triu(matrices, 1), 1, 2)
        found = (matrices / units[:, None] / units)[:, _ORDER[:, None], _ORDER]
        wrong = ~is_definite(found)
        if wrong.any():
            raise self._error(self._lines[_EDGE][int(wrong.argmax())], "its information is not positive definite")
        return np.asarray(found)

    def _error(self, line: int, cause: str) -> G2oError:
        return G2oError(f"{self._path}: line {line}: {cause}")


def is_definite(matrices: np.ndarray) -> np.ndarray:
    """Return which (e,) of the symmetric matrices (e, k, k) are positive definite, whatever the units of their axes."""
    scale = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 0))
    good = (scale > 0).all(axis=1)
    scaled = np.tile(np.eye(matrices.shape[-1]), (len(matrices), 1, 1))
    with np.errstate(over="ignore"):
        scaled[good] = matrices[good] / scale[good, :, None] / scale[good, None]
    good &= (np.abs(scaled) <= 2).all(axis=(1, 2))  # no correlation is above 1; and eigvalsh takes no infinity
    scaled[~good] = np.eye(matrices.shape[-1])
    return np.asarray(good & (np.linalg.eigvalsh(scaled)[:, 0] > _SMALLEST))


def _stated(path: Path, lines: list[tuple[int, list[str]]]) -> str | None:
    """Return the dialect that a comment before all else says."""
    first = " ".join(lines[0][1]) if lines else ""
    if not first.startswith(_TITLE):
        return None
    said = first.removeprefix(_TITLE).split(":")[0].strip()
    if said not in DIALECTS:
        known = " and ".join(DIALECTS)
        raise G2oError(f"{path}: its first line says dialect {text_lines.shown(said)}; there are {known}")
    return said


def _rows(poses: np.ndarray) -> np.ndarray:
    return np.column_stack([poses[:, :3, 3], pose.quaternions(poses)]) if len(poses) else np.empty((0, 7))


def _line(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))
