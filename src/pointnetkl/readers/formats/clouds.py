"""One cloud from one file of another program: PCD, PLY, NPZ or text, recognised by content and not by name."""

import io
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.readers.formats import lzf, text_lines
from pointnetkl.surveys import pose
from pointnetkl.workflow.errors import PointNetKLError

_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_PCD_HEADER = re.compile(rb"(?:.*\r?\n)*?DATA[ \t]+(\w+)[ \t]*\r?\n")
_PLY_HEADER = re.compile(rb"ply\r?\n(?:.*\r?\n)*?end_header[ \t]*\r?\n")
_AXES = ("x", "y", "z")


class CloudFileError(PointNetKLError):
    """A file is missing or damaged, or is no cloud in a known format."""


@dataclass(frozen=True)
class Layout:
    """The rows of a PCD or PLY file, by its header."""

    row: np.dtype  # a field for each name
    rows: int
    encoding: str  # ascii, binary or, of PCD, binary_compressed


def read(path: Path) -> np.ndarray:
    """Return the points (n, 3) of a file, float64, in the file's unit and frame.

    Formats are PCD (its VIEWPOINT is not applied) and PLY with any further fields; NPZ with an array `points`; and text
    with commas or blanks between its columns and `#` or `//` before comments. The first line of a text may name the
    columns x, y and z (or x_m, y_m, z_m); otherwise they are the first three.

    Raises:
        CloudFileError: the file is missing or damaged, or in another format.
    """
    return _guarded(path, _points)


def read_posed(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (n, 3) of a PCD file, in its sensor's frame, and T_map_sensor (4, 4), its VIEWPOINT.

    Raises:
        CloudFileError: the file is missing or damaged, or has no pose.
    """
    return _guarded(path, _points), _guarded(path, viewpoint)


def _guarded(path: Path, reading: Callable[[Path, bytes], np.ndarray]) -> np.ndarray:
    try:
        return np.asarray(reading(path, path.read_bytes()), np.float64)
    except OSError as error:
        raise CloudFileError(f"{path}: cannot be read ({error.strerror})") from error
    except CloudFileError:
        raise
    except Exception as error:  # numpy, zipfile and UTF-8 raise many errors on damaged bytes
        reason = " ".join(str(error).split())[:120]
        raise CloudFileError(f"{path}: is damaged, or no PCD, PLY, NPZ or text of x y z ({reason})") from error


def viewpoint(path: Path, content: bytes) -> np.ndarray:
    """Return the VIEWPOINT in the header of a PCD file as a pose (4, 4).

    Raises:
        CloudFileError: there is no VIEWPOINT, or it is not a pose.
    """
    header = _PCD_HEADER.match(content)
    match = re.search(rb"^VIEWPOINT[ \t]+(.*?)[ \t\r]*$", header[0], re.MULTILINE) if header else None
    if not match:
        raise CloudFileError(f"{path}: holds no pose; write the submap as PCD with its pose as VIEWPOINT")
    words = match[1].decode("latin-1").split()
    if len(words) != 7:
        raise CloudFileError(f"{path}: VIEWPOINT has {len(words)} numbers, must have 7: x y z qw qx qy qz")
    try:
        x, y, z, qw, qx, qy, qz = text_lines.numbers(words)
    except ValueError as error:
        raise CloudFileError(f"{path}: VIEWPOINT is no pose: {error}") from error
    orientation = np.array([[qx, qy, qz, qw]])
    if not pose.are_unit(orientation)[0]:
        raise CloudFileError(
            f"{path}: the quaternion of its VIEWPOINT has not length 1; the order is x y z qw qx qy qz"
        )
    return pose.from_quaternions(np.array([[x, y, z]]), orientation)[0]


def _points(path: Path, content: bytes) -> np.ndarray:
    if content.startswith(b"PK\x03\x04"):
        return _from_npz(path, content)
    if content.startswith(b"\x93NUMPY"):
        raise CloudFileError(f"{path}: is an .npy file; write an .npz with an array `points`")
    if content.startswith(b"ply"):
        return _from_ply(path, content)
    if re.match(rb"(?:#.*\r?\n|\s)*(?:VERSION|FIELDS)\s", content):
        return _from_pcd(path, content)
    return _from_text(path, content)


def _from_npz(path: Path, content: bytes) -> np.ndarray:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        if "points" not in stored.files:
            raise CloudFileError(f"{path}: has no array `points`, but {', '.join(stored.files) or 'nothing'}")
        return np.asarray(stored["points"])


def _from_text(path: Path, content: bytes) -> np.ndarray:
    lines = [re.split("#|//", line)[0].strip() for line in content.decode("utf-8-sig").splitlines()]
    lines = [line for line in lines if line]
    named = _named_columns(path, lines[0]) if lines else None
    lines = lines[1:] if named else lines
    if not lines:
        raise CloudFileError(f"{path}: holds no points")
    return np.loadtxt(lines, delimiter="," if "," in lines[0] else None, usecols=named or (0, 1, 2), ndmin=2)


def _named_columns(path: Path, line: str) -> list[int] | None:
    """Return the columns that a text's first line names x, y and z; None if it has numbers."""
    bare = re.sub(r"\s*(\[.*?\]|\(.*?\))", "", line)  # without units, which may follow a blank
    names = [name.strip().strip('"') for name in (bare.split(",") if "," in bare else bare.split())]
    lower = [name.lower().removesuffix("_m") for name in names]
    if set(_AXES) <= set(lower):
        return [lower.index(axis) for axis in _AXES]
    if any(re.match(r"[-+.]*\d|[-+]?(nan|inf)\b", name) for name in lower):
        return None
    raise CloudFileError(f"{path}: its columns are {', '.join(names)}; name those of the points x, y and z")


def pcd_layout(path: Path, content: bytes) -> tuple[Layout, int]:
    """Return the layout in the header of a PCD file, and the byte where its rows begin.

    Raises:
        CloudFileError: the header is cut or damaged.
    """
    header = _PCD_HEADER.match(content)
    if not header:
        raise CloudFileError(f"{path}: is a PCD file without a line DATA; it may be cut")
    try:
        lines = header[0].decode("latin-1").splitlines()
        words = dict(line.split(None, 1) for line in lines if len(line.split()) > 1)
        names = words["FIELDS"].split()
        counts = words.get("COUNT", "1 " * len(names)).split()
        kinds = [kind.lower() + size for kind, size in zip(words["TYPE"].split(), words["SIZE"].split(), strict=True)]
        fields = [
            (f"{name}{index}" if name not in _AXES else name, f"<{kind}", int(count))
            for index, (name, kind, count) in enumerate(zip(names, kinds, counts, strict=True))
        ]
        layout = Layout(np.dtype(fields), int(words["POINTS"]), header[1].decode("latin-1").lower())
    except Exception as error:  # numpy raises many errors on a wrong type
        reason = " ".join(str(error).split())[:80]
        raise CloudFileError(f"{path}: the header of its PCD is damaged ({reason})") from error
    if layout.row.hasobject or any(np.prod(layout.row[name].shape) != 1 for name in _AXES if name in names):
        raise CloudFileError(f"{path}: the header of its PCD is damaged: x, y and z must be one number each")
    return layout, header.end()


def uncompressed(path: Path, body: bytes, layout: Layout) -> np.ndarray:
    """Return x, y, z (n, 3) of a PCD file with compressed binary data, which is stored column by column.

    Raises:
        CloudFileError: the data are cut or damaged.
    """
    if len(body) < 8:
        raise CloudFileError(f"{path}: is cut; it has 0 of {layout.rows} points")
    packed, size = struct.unpack_from("<II", body)
    if size != layout.rows * layout.row.itemsize or packed > len(body) - 8 or layout.rows < 0:
        raise CloudFileError(
            f"{path}: is cut or damaged; {layout.rows} points of {layout.row.itemsize} bytes do not fit {size} bytes"
            f" compressed to {packed}, of which {len(body) - 8} are there"
        )
    try:
        content = lzf.decompress(body[8 : 8 + packed], size)
    except ValueError as error:
        raise CloudFileError(f"{path}: {error}") from error
    begins = {axis: _offset(layout.row, axis) * layout.rows for axis in axes_of(path, layout)}
    axes = [np.frombuffer(content, layout.row[axis], layout.rows, begin).reshape(-1) for axis, begin in begins.items()]
    return np.column_stack(axes)


def _offset(row: np.dtype, name: str) -> int:
    names = row.names or ()
    return sum(row[other].itemsize for other in names[: names.index(name)])


def _from_pcd(path: Path, content: bytes) -> np.ndarray:
    layout, begin = pcd_layout(path, content)
    body = content[begin:]
    return uncompressed(path, body, layout) if layout.encoding == "binary_compressed" else _rows(path, body, layout)


def _from_ply(path: Path, content: bytes) -> np.ndarray:
    header = _PLY_HEADER.match(content)
    if not header:
        raise CloudFileError(f"{path}: is a PLY file without a line end_header; it may be cut")
    words = [line.split() for line in header[0].decode("latin-1").splitlines()]
    encoding = next(line_words[1] for line_words in words if line_words[0] == "format")
    order = ">" if encoding == "binary_big_endian" else "<"
    elements = [line_words for line_words in words if line_words[:1] == ["element"]]
    if not elements or elements[0][1] != "vertex":
        raise CloudFileError(f"{path}: is a PLY file whose first element is not `vertex`; write its points alone")
    first = words.index(elements[0]) + 1
    last = words.index(elements[1]) if len(elements) > 1 else len(words)
    properties = [line_words for line_words in words[first:last] if line_words[0] == "property"]
    row = np.dtype([(line_words[-1], order + _PLY_TYPES[line_words[1]]) for line_words in properties])
    body = content[header.end() :]
    return _rows(path, body, Layout(row, int(elements[0][2]), "ascii" if encoding == "ascii" else "binary"))


def _rows(path: Path, body: bytes, layout: Layout) -> np.ndarray:
    """Return x, y, z of the rows; a library would pad a cut file with zeros."""
    axes_of(path, layout)
    if layout.rows < 0:
        raise CloudFileError(f"{path}: is damaged; its header says that it has {layout.rows} points")
    lines = body.splitlines()[: layout.rows] if layout.encoding == "ascii" else []
    available = len(lines) if layout.encoding == "ascii" else len(body) // layout.row.itemsize
    if available < layout.rows:
        raise CloudFileError(f"{path}: is cut; it has {available} of {layout.rows} points")
    if layout.encoding == "ascii":
        return np.loadtxt(lines, usecols=columns_of(layout.row), ndmin=2, comments=None)
    rows = np.frombuffer(body, layout.row, layout.rows)
    return np.column_stack([rows[axis].reshape(layout.rows) for axis in _AXES])


def axes_of(path: Path, layout: Layout) -> tuple[str, ...]:
    """Return the names of the coordinates.

    Raises:
        CloudFileError: one of them is missing.
    """
    if missing := [axis for axis in _AXES if axis not in (layout.row.names or ())]:
        raise CloudFileError(f"{path}: its points have no {missing[0]}")
    return _AXES


def columns_of(row: np.dtype) -> list[int]:
    """Return the indices of x, y and z among the words of a line of text; a field may have several words."""
    names = row.names or ()
    widths = [int(np.prod(row[name].shape)) for name in names]
    return [sum(widths[: names.index(axis)]) for axis in _AXES]
