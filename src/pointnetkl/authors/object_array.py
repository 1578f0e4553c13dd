"""Object arrays in .npy files, which are pickles: read without executing anything in the file.

The results are numbers, texts, None, lists, tuples and arrays of plain numbers. Stand-ins replace the NumPy functions
that a pickle names: the real ones trust the pickle, so that an invented dtype or shape makes them allocate or write
where they must not.
"""

import ast
import math
import mmap
import pickle
import pickletools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError

_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 1024  # bytes; that of an object array has 118

# All that any version of np.save needs for such arrays. Sets and dicts are excluded, because hashing a deep tuple
# overflows the stack.
_OPCODES = re.compile(
    "PROTO|FRAME|STOP|MARK|POP|POP_MARK|(STACK_)?GLOBAL|REDUCE|BUILD|(LONG_)?BIN(PUT|GET)|MEMOIZE"
    "|NONE|NEW(TRUE|FALSE)|BININT[12]?|LONG1|BINFLOAT|EMPTY_(LIST|TUPLE)|APPENDS?|TUPLE[123]?"
    "|(SHORT_)?BIN(BYTES|UNICODE)|BIN(BYTES|UNICODE)8"
)
_NUMBERS = frozenset(kind + size for kind in "fiu" for size in "1248") - {"f1"}
_OBJECTS = frozenset({"O", "O8"})


class ObjectArrayError(PointNetKLError):
    """A file is no object array, is damaged, or contains something that is not read."""


class _RefusedError(Exception):
    """A file asks for something that is refused; becomes an ObjectArrayError."""


def rows(path: Path, columns: int) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of an object array of shape (n, columns), or (n,) with a tuple or a list as a row.

    Cells that are arrays are views of the bytes read, with the stored shape and type; NumPy's scalars become numbers.

    Raises:
        ObjectArrayError: the file is missing or damaged, is another array, or names anything but NumPy's array types.
    """
    try:
        # mapped, because read(n) with an absurd n then allocates nothing
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            yield from _rows(path, content, columns)
    except OSError as error:
        raise ObjectArrayError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise ObjectArrayError(f"{path}: is empty; copy it again") from error


def _rows(path: Path, content: mmap.mmap, columns: int) -> Iterator[tuple[Any, ...]]:
    try:
        declared = _header(content)
        _check_opcodes(content)
        array = _Unpickler(content).load()
        if not isinstance(array, _Array) or array.shape != declared:
            raise _RefusedError(f"its header says shape {declared}, its content another")
        yield from _cut(array, columns)
    except _RefusedError as error:
        raise ObjectArrayError(f"{path}: {error}; copy it again from where it was published") from error
    except Exception as error:  # ast, pickle, pickletools and NumPy raise many errors on damaged bytes
        reason = " ".join(str(error).split())[:120]
        raise ObjectArrayError(f"{path}: is damaged near byte {content.tell()} ({reason}); copy it again") from error


def _header(content: mmap.mmap) -> tuple[int, ...]:
    """Return the shape in the file's header; the file's position is then at the pickle."""
    head = content.read(8)
    if head[:6] != _MAGIC or head[6:] not in (b"\1\0", b"\2\0", b"\3\0"):
        raise _RefusedError(f"is no .npy file of version 1 to 3, it begins with {head!r}")
    length = int.from_bytes(content.read(2 if head[6] == 1 else 4), "little")
    if length > _LONGEST_HEADER:
        raise _RefusedError(f"its header claims {length} bytes, must have at most {_LONGEST_HEADER}")
    fields = ast.literal_eval(content.read(length).decode())
    if fields["descr"] not in ("|O", "O"):
        raise _RefusedError(f"holds {str(fields['descr'])[:20]!r}, not objects")
    return _shape(fields["shape"])


def _check_opcodes(content: mmap.mmap) -> None:
    """Refuse opcodes that no array needs or that allocate more than the file's size, before anything is built."""
    begin, size = content.tell(), len(content)
    for opcode, argument, place in pickletools.genops(cast(IO[bytes], content)):
        if not _OPCODES.fullmatch(opcode.name):
            raise _RefusedError(f"byte {place}: pickle's {opcode.name} is not read")
        # a memo is a table as long as its largest index, and a frame is read in one piece
        if opcode.name in ("LONG_BINPUT", "FRAME") and (argument or 0) > size:
            raise _RefusedError(f"byte {place}: {opcode.name} of {argument} is more than the file holds")
    if content.tell() != size:
        raise _RefusedError(f"byte {content.tell()}: there is more after the array")
    content.seek(begin)


class _Dtype:
    """Stands in for numpy.dtype: numbers of a fixed size, or objects."""

    def __init__(self, code: str, *_: object) -> None:
        # the type is checked first: to hash or print a hostile value can take all stack or memory
        if type(code) is not str or code not in _NUMBERS | _OBJECTS:
            raise _RefusedError("has an array that is neither of real numbers nor of objects")
        self.code, self.order = code, "="

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, order, subtype, names, fields = state[:5]
        if order not in ("<", ">", "|", "=") or (subtype, names, fields) != (None, None, None):
            raise _RefusedError("has an array of structures, must be real numbers or objects")
        self.order = order

    def numbers(self) -> np.dtype[Any]:
        """Return the type, which must be one of numbers."""
        if self.code in _OBJECTS:
            raise _RefusedError("has an array of objects within another")
        return np.dtype(self.order + self.code)


class _Array:
    """Stands in for numpy.ndarray: its content is checked when it is read as a cell."""

    shape: tuple[int, ...]

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, self.dtype, self.fortran, self.content = state
        self.shape = _shape(shape)

    def numbers(self) -> np.ndarray:
        """Return the array, a view of the bytes that were read."""
        flat = np.frombuffer(self.content, self.dtype.numbers())
        return flat.reshape(self.shape[::-1]).T if self.fortran else flat.reshape(self.shape)

    def objects(self) -> np.ndarray:
        """Return the array of objects, with its cells as they were read."""
        if self.dtype.code not in _OBJECTS or len(self.content) != math.prod(self.shape):
            raise _RefusedError(f"its {len(self.content)} cells do not make an array of objects of shape {self.shape}")
        flat = np.empty(len(self.content), object)
        for i, cell in enumerate(self.content):  # one by one, because NumPy would unpack cells that are sequences
            flat[i] = cell
        return flat.reshape(self.shape)  # also in Fortran order, because NumPy lists objects row by row


def _reconstruct(kind: object, *_: object) -> _Array:
    """Stand in for NumPy's function of this name; its shape argument is never that of the array."""
    if kind is not _Array:
        raise _RefusedError("has an array of a kind of its own, must be numpy.ndarray")
    return _Array()


def _scalar(dtype: _Dtype, content: bytes) -> float:
    """Stand in for NumPy's function of this name."""
    return np.frombuffer(content, dtype.numbers()).item()


_STAND_INS = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Dtype,
    # NumPy 1 and NumPy 2
    ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy._core.multiarray", "scalar"): _scalar,
}


class _Unpickler(pickle.Unpickler):
    """Finds the stand-ins and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _STAND_INS:
            named = f"{module[:40]}.{name[:40]}"
            raise _RefusedError(f"names {named!r}, which no array needs: do not open it otherwise")
        return _STAND_INS[module, name]


def _cut(array: _Array, columns: int) -> Iterator[tuple[Any, ...]]:
    cells = array.objects()
    if cells.ndim not in (1, 2):
        raise _RefusedError(f"has shape {array.shape}, must be (rows, {columns})")
    for number, row in enumerate(cells):
        if not isinstance(row, np.ndarray | tuple | list) or len(row) != columns:
            raise _RefusedError(f"row {number}: must have {columns} cells")
        yield tuple(cell.numbers() if isinstance(cell, _Array) else cell for cell in row)


def _shape(shape: Any) -> tuple[int, ...]:
    if type(shape) is not tuple or len(shape) > 2 or any(type(n) is not int or n < 0 for n in shape):
        raise _RefusedError("has an array whose shape is not one of at most two dimensions")
    return shape
