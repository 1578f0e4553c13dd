"""Pose graphs as g2o files, in two dialects whose lines look the same and mean different things.

Both have a line for each vertex (T_map_vertex) and for each edge (T_target_source, and the upper triangle of its
information in the source's frame, translation first). They differ in the error of an orientation. Dialect `gtsam` has
it in radians, as GTSAM reads and writes files. Dialect `g2o`, that of g2o itself, has the vector part of a quaternion,
which is half an angle: the information's block of the rotation is 4 times that in radians, and its blocks between
rotation and translation 2 times. Files usually do not state their dialect; ours do, in their first line, a comment.
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
_ORDER = np.array([3, 4, 5, 0, 1, 2])  # files have the translation first, our tangent vectors the rotation
_UPPER = np.triu_indices(6)
_UNITS = {"g2o": np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]), "gtsam": np.ones(6)}  # per radian (and metre)
_TITLE = "# pointnetkl pose graph, dialect"  # first line of our files
_ERROR = {
    "g2o": "(x, y, z, qx, qy, qz), metres and quaternion",
    "gtsam": "(x, y, z, roll, pitch, yaw), metres, radians",
}
_VERTEX, _EDGE, _FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_NUMBERS = {_VERTEX: 7, _EDGE: 28}  # after the names of vertices
_SMALLEST = 1e-12  # eigenvalue of an information scaled to a unit diagonal; less is rounding


class G2oError(PointNetKLError):
    """A file is not a pose graph of 3D poses."""


@dataclass(frozen=True)
class Graph:
    """Vertices in the order of their file, and the edges between them; nodes count from 0."""

    number: np.ndarray  # (n,) the name of each vertex: the submap's number
    poses: np.ndarray  # (n, 4, 4) T_map_vertex
    edges: Edges
    information: np.ndarray  # (e, 6, 6) in m and rad, rotation first, in the source's frame
    fixed: np.ndarray  # (f,) nodes that an optimiser holds


@dataclass(frozen=True)
class Content:
    """The graph of a file, and the dialect in which it was read."""

    graph: Graph
    dialect: str
    is_stated: bool  # by the file or the caller; if not, g2o is assumed


def write(path: Path, graph: Graph, dialect: str) -> None:
    """Write a graph with all digits of its numbers; the file is replaced as a whole.

    Raises:
        ArtifactError: the file cannot be written.
    """
    artifacts.write_bytes(path, to_text(graph, dialect).encode())


def to_text(graph: Graph, dialect: str) -> str:
    """Return the text of a file for a graph."""
    names, edges = graph.number.tolist(), graph.edges
    units = _UNITS[dialect]
    information = (units[:, None] * graph.information[:, _ORDER[:, None], _ORDER] * units)[:, *_UPPER]
    lines = [
        f"{_TITLE} {dialect}: poses T_map_vertex, edges T_first_second, x y z in metres and"
        f" qx qy qz qw; information of the error {_ERROR[dialect]}, in the second vertex's frame"
    ]
    lines += [f"{_VERTEX} {name} {_line(row)}" for name, row in zip(names, _rows(graph.poses), strict=True)]
    lines += [f"{_FIX} {names[node]}" for node in graph.fixed.tolist()]
    for k, i, T, row in zip(edges.target, edges.source, _rows(edges.T_target_source), information, strict=True):
        lines.append(f"{_EDGE} {names[k]} {names[i]} {_line(T)} {_line(row)}")
    return "\n".join(lines) + "\n"


def read(path: Path, dialect: str | None = None) -> Content:
    """Return the graph in a file, in the dialect that it or the caller states, else in dialect g2o.

    Lines may be in any order. Those of PARAMS_..., which only other kinds of edges use, are ignored.

    Raises:
        G2oError: the file is missing or damaged; it has lines other than 3D poses and edges, a vertex twice, an edge
            to no vertex, or an information that is not positive definite; or its dialect is unknown or not the
            caller's.
    """
    lines = text_lines.read(path, G2oError)
    stated = _stated(path, lines)
    if dialect and stated and dialect != stated:
        raise G2oError(f"{path}: its first line says dialect {stated}, not {dialect}; leave the dialect out")
    read_as = dialect or stated or DIALECTS[0]
    return Content(_Reader(path).read(lines, _UNITS[read_as]), read_as, bool(dialect or stated))


class _Reader:
    """Builds a graph from the lines of a file; errors name the line."""

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
                self._add(line, words)
        if not self._node:
            raise G2oError(f"{self._path}: has no {_VERTEX}; it is not a pose graph, or it is cut off")
        poses, _ = self._transforms(_VERTEX)
        measured, rest = self._transforms(_EDGE)
        ends = np.array(self._nodes(self._ends), np.int64).reshape(-1, 2)
        fixed = np.unique(np.array([node for nodes in self._nodes(self._fixed) for node in nodes], np.int64))
        information = self._information(rest, units)
        return Graph(np.array(list(self._node)), poses, Edges(ends[:, 0], ends[:, 1], measured), information, fixed)

    def _add(self, line: int, words: list[str]) -> None:
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
        """Return the tag that a line begins with, the vertices that it names, and its numbers."""
        tag, *rest = words
        if tag not in (*_NUMBERS, _FIX):
            cause = f"it begins with {text_lines.shown(tag)}; only {_VERTEX}, {_EDGE} and {_FIX} are read"
            raise self._error(line, cause)
        named = {_VERTEX: 1, _EDGE: 2, _FIX: max(1, len(rest))}[tag]
        if len(rest) != (expected := named + _NUMBERS.get(tag, 0)):
            raise self._error(line, f"it has {len(rest)} words after {tag}, must have {expected}")
        try:
            return tag, [text_lines.whole_number(word) for word in rest[:named]], text_lines.numbers(rest[named:])
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
        """Return the poses of all lines with a tag, and the numbers after them."""
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
        information = (matrices / units[:, None] / units)[:, _ORDER[:, None], _ORDER]
        wrong = ~is_definite(information)
        if wrong.any():
            raise self._error(self._lines[_EDGE][int(wrong.argmax())], "its information is not positive definite")
        return np.asarray(information)

    def _error(self, line: int, cause: str) -> G2oError:
        return G2oError(f"{self._path}: line {line}: {cause}")


def is_definite(matrices: np.ndarray) -> np.ndarray:
    """Return which (e,) of the symmetric matrices (e, k, k) are positive definite, in any units of their axes."""
    scale = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 0))
    good = (scale > 0).all(axis=1)
    scaled = np.tile(np.eye(matrices.shape[-1]), (len(matrices), 1, 1))
    with np.errstate(over="ignore"):
        scaled[good] = matrices[good] / scale[good, :, None] / scale[good, None]
    good &= (np.abs(scaled) <= 2).all(axis=(1, 2))  # no correlation is above 1, and eigvalsh refuses infinity
    scaled[~good] = np.eye(matrices.shape[-1])
    return np.asarray(good & (np.linalg.eigvalsh(scaled)[:, 0] > _SMALLEST))


def _stated(path: Path, lines: list[tuple[int, list[str]]]) -> str | None:
    """Return the dialect that the first line states, or None."""
    first = " ".join(lines[0][1]) if lines else ""
    if not first.startswith(_TITLE):
        return None
    stated = first.removeprefix(_TITLE).split(":")[0].strip()
    if stated not in DIALECTS:
        known_dialects = " and ".join(DIALECTS)
        raise G2oError(f"{path}: its first line says dialect {text_lines.shown(stated)}; there are {known_dialects}")
    return stated


def _rows(poses: np.ndarray) -> np.ndarray:
    return np.column_stack([poses[:, :3, 3], pose.quaternions(poses)]) if len(poses) else np.empty((0, 7))


def _line(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))
