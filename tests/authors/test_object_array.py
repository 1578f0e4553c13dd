"""Object arrays: arrays of np.save are read, and nothing in a file is executed."""

import os
import pickle
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import authors_arrays
from pointnetkl.authors import object_array

MEBIBYTE = 1 << 20


def read(folder: Path, content: bytes) -> list[tuple[Any, ...]]:
    (folder / "a.npy").write_bytes(content)
    return list(object_array.rows(folder / "a.npy", 6))


def refusal(folder: Path, content: bytes) -> str:
    """Return the one sentence that a file is refused with."""
    with pytest.raises(object_array.ObjectArrayError) as caught:
        read(folder, content)
    assert str(caught.value).startswith(f"{folder / 'a.npy'}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def agree(rows: list[tuple[Any, ...]], expected: list[tuple[Any, ...]]) -> bool:
    pairs = [pair for row, other in zip(rows, expected, strict=True) for pair in zip(row, other, strict=True)]
    return all(np.array_equal(a, b) and np.shape(a) == np.shape(b) for a, b in pairs)


class Calls:
    """Pickles as a call of any function."""

    def __init__(self, function: object, *arguments: object) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


def name(module: str, attribute: str) -> bytes:
    """Return opcodes that put what has this name on the stack."""
    return f"c{module}\n{attribute}\n".encode()


def holding(cell: object, column: int = 3) -> bytes:
    """Return a file of one row, one of whose cells is this."""
    cells: list[Any] = list(authors_arrays.row(0))
    cells[column] = cell
    return authors_arrays.npy(authors_arrays.pickled(authors_arrays.as_array([tuple(cells)])))


@pytest.mark.parametrize("protocol", [3, 4])
@pytest.mark.parametrize("version", [1, 2, 3])
def test_an_array_comes_back_from_every_version_of_the_format(tmp_path: Path, protocol: int, version: int):
    rows = authors_arrays.rows(4)
    content = authors_arrays.pickled(authors_arrays.as_array(rows), protocol)
    assert agree(read(tmp_path, authors_arrays.npy(content, (4, 6), version)), rows)


def test_what_np_save_writes_comes_back(tmp_path: Path):
    rows = authors_arrays.rows(5)
    assert agree(list(object_array.rows(authors_arrays.write(tmp_path / "a.npy", rows), 6)), rows)


def test_an_array_that_numpy_1_wrote_comes_back(tmp_path: Path):
    rows = authors_arrays.rows(3)
    content = authors_arrays.pickled(authors_arrays.as_array(rows), 3)
    old = authors_arrays.by_numpy_1(content)
    assert old != content
    assert agree(read(tmp_path, authors_arrays.npy(old, (3, 6))), rows)


@pytest.mark.parametrize("kind", [tuple, list])
def test_rows_may_be_tuples_or_lists(tmp_path: Path, kind: type):
    rows = authors_arrays.rows(3)
    array = np.empty(3, object)
    for i, cells in enumerate(rows):
        array[i] = kind(cells)
    assert agree(read(tmp_path, authors_arrays.npy(authors_arrays.pickled(array), (3,))), rows)


def test_arrays_keep_their_order_type_and_endianness(tmp_path: Path):
    array = np.arange(12.0).reshape(4, 3)
    for stored in (np.asfortranarray(array), array.astype(">f4"), array.astype("<i2"), array[::2, ::-1]):
        (row,) = read(tmp_path, holding(stored, 0))
        np.testing.assert_array_equal(row[0], stored)
        assert row[0].dtype == stored.dtype
    fortran = np.asfortranarray(authors_arrays.as_array(authors_arrays.rows(3)))
    content = authors_arrays.npy(authors_arrays.pickled(fortran), (3, 6))
    assert agree(read(tmp_path, content), authors_arrays.rows(3))


def test_a_pickle_that_runs_a_program_is_refused_and_it_does_not_run(tmp_path: Path):
    ran = tmp_path / "ran"
    for call in (
        Calls(os.system, f"touch {ran}"),
        Calls(eval, f"open({str(ran)!r}, 'w')"),
        Calls(exec, f"open({str(ran)!r}, 'w')"),
        Calls(open, str(ran), "w"),
        Calls(np.save, str(ran), np.zeros(2)),
        Calls(np.load, str(ran)),
        Calls(np.fromfile, str(ran)),
        Calls(np.memmap, str(ran), "uint8", "w+", 0, (8,)),
    ):
        assert "which no array needs" in refusal(tmp_path, holding(call))
        outside = authors_arrays.npy(pickle.dumps(call, 4))
        assert "which no array needs" in refusal(tmp_path, outside)
        nested = np.empty((1, 1), object)
        nested[0, 0] = call
        assert "which no array needs" in refusal(tmp_path, holding(nested))
        assert not ran.exists()
    (tmp_path / "a.npy").write_bytes(holding(Calls(os.system, f"touch {ran}")))
    np.load(tmp_path / "a.npy", allow_pickle=True)
    assert ran.exists(), "the files above do no harm to anyone"


@pytest.mark.parametrize(
    "named",
    [
        "builtins eval",
        "builtins getattr",
        "posix system",
        "subprocess Popen",
        "copyreg _reconstructor",
        "functools partial",
        "numpy load",
        "numpy fromfile",
        "numpy memmap",
        "numpy matrix",
        "numpy.testing._private.utils runstring",
        "numpy.ctypeslib load_library",
        "numpy.f2py.diagnose run_command",
        "numpy.core.multiarray fromfile",
        "numpy._core.multiarray fromfile",
        "numpy._core.multiarray _reconstruct.__globals__",
        "numpy._core.numeric _frombuffer",
        "numpy.random._pickle __generator_ctor",
        "pickle loads",
        "torch._utils _rebuild_tensor",
        "pointnetkl.authors.object_array _Unpickler",
        "__main__ anything",
    ],
)
def test_only_numpy_s_array_types_can_be_named(tmp_path: Path, named: str):
    module, function = named.split()
    content = b"\x80\x03" + name(module, function) + b"C\x01a\x85R."
    sentence = refusal(tmp_path, authors_arrays.npy(content))
    assert f"names '{module}.{function}', which no array needs" in sentence
    stacked = b"\x80\x04" + b"".join(b"\x8c" + bytes([len(w)]) + w.encode() for w in (module, function)) + b"\x93)R."
    assert f"names '{module}.{function}'" in refusal(tmp_path, authors_arrays.npy(stacked))


RECONSTRUCT = name("numpy.core.multiarray", "_reconstruct")
ARRAY, DTYPE = name("numpy", "ndarray"), name("numpy", "dtype")
ONE_CELL = RECONSTRUCT + ARRAY + b"K\x00\x85C\x01b\x87R"  # an array that waits for its state
FLOATS = DTYPE + b"X\x02\x00\x00\x00f8\x89\x88\x87R"
OBJECTS = DTYPE + b"X\x02\x00\x00\x00O8\x89\x88\x87R"


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (RECONSTRUCT + DTYPE + b"K\x00\x85C\x01b\x87R.", "of a kind of its own"),
        (RECONSTRUCT + name("numpy", "matrix") + b"K\x00\x85C\x01b\x87R.", "names 'numpy.matrix'"),
        (ARRAY + b"J\xff\xff\xff\x7f\x85R.", "damaged"),
        (DTYPE + b"X\x03\x00\x00\x00V99\x85R.", "neither of real numbers nor of objects"),
        (DTYPE + ARRAY + b"\x85R.", "neither of real numbers nor of objects"),
        (FLOATS + b"(K\x03X\x01\x00\x00\x00<NN(K\x01tK\xffK\xffK\x3ftb.", "structures"),
        (ONE_CELL + b"(K\x01K\x02\x85" + FLOATS + b"\x89C\x08AAAAAAAAtb.", "its content another"),
        (ONE_CELL + b"(K\x01K\x01K\x06\x86" + OBJECTS + b"\x89](NNNNetb.", "4 cells do not make"),
        (ONE_CELL + b"(K\x01K\x01K\x06\x86" + FLOATS + b"\x89C\x00tb.", "do not make an array of objects"),
        (ONE_CELL + b"(K\x01K\x01K\x06\x86" + OBJECTS + b"\x89C\x06AAAAAAtb(.", "damaged"),
        (b"\x8c\x03a\nb\x8c\x02\xc3\xa9\x93.", r"names 'a\nb.é'"),
        (b"}.", "EMPTY_DICT is not read"),
        (b"\x8f.", "EMPTY_SET is not read"),
        (b"(iposix\nsystem\n.", "INST is not read"),
        (b"Pid\n.", "PERSID is not read"),
        (b"\x82\x01.", "EXT1 is not read"),
        (b"N.", "its content another"),
        (b"N.N", "more after the array"),
        (b"R.", "damaged"),
        (b"\xff.", "damaged"),
        (b"", "damaged"),
    ],
)
def test_what_is_no_array_is_refused(tmp_path: Path, content: bytes, cause: str):
    assert cause in refusal(tmp_path, authors_arrays.npy(content))


def test_an_array_of_objects_within_another_is_refused(tmp_path: Path):
    assert "objects within another" in refusal(tmp_path, holding(np.array([None, "a"], object), 0))


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04" + bytes(60), "is no .npy file"),
        (b"\x93NUMPY\x09\x00" + bytes(60), "is no .npy file of version 1 to 3"),
        (authors_arrays.npy(b"N.", head="{'descr': '<f8', 'fortran_order': False, 'shape': (1, 6)}"), "not objects"),
        (authors_arrays.npy(b"N.", head="{'shape': (1, 6)}"), "damaged"),
        (authors_arrays.npy(b"N.", head="__import__('os').system('true')"), "damaged"),
        (authors_arrays.npy(b"N.", (-1, 6)), "shape is not one"),
        (authors_arrays.npy(b"N.", (1, 2, 3)), "at most two dimensions"),
    ],
)
def test_what_is_no_file_of_objects_is_refused(tmp_path: Path, content: bytes, cause: str):
    assert cause in refusal(tmp_path, content)


def test_a_missing_file_is_reported(tmp_path: Path):
    with pytest.raises(object_array.ObjectArrayError, match=r"absent\.npy: cannot be read \(No such file"):
        list(object_array.rows(tmp_path / "absent.npy", 6))


def test_a_row_of_other_width_is_refused_by_its_number(tmp_path: Path):
    array = np.empty(2, object)
    array[0], array[1] = authors_arrays.row(0), authors_arrays.row(1)[:5]
    assert "row 1: must have 6 cells" in refusal(tmp_path, authors_arrays.npy(authors_arrays.pickled(array), (2,)))


HUGE = 10**12
HUGE_INT = b"\x8a\x06" + HUGE.to_bytes(6, "little")
DEEP = 200_000


@pytest.mark.parametrize(
    "content",
    [
        authors_arrays.npy(b"N.", (HUGE, 6)),
        b"\x93NUMPY\x02\x00" + b"\xff" * 4 + b" " * 64,
        authors_arrays.npy(b"N.", head="[" * 900),
        authors_arrays.npy(b"Nr" + b"\xff\xff\xff\x7f" + b"."),  # a memo of 2^31 places
        authors_arrays.npy(b"\x8e" + struct.pack("<Q", 1 << 40) + b"a."),
        authors_arrays.npy(b"B" + struct.pack("<I", (1 << 32) - 1) + b"a."),
        authors_arrays.npy(b"\x8d" + struct.pack("<Q", 1 << 62) + b"a."),
        authors_arrays.npy(b"\x95" + struct.pack("<Q", 1 << 40) + b"N."),
        authors_arrays.npy(ONE_CELL + b"(K\x01" + HUGE_INT + b"K\x06\x86" + OBJECTS + b"\x89]tb.", (HUGE, 6)),
        authors_arrays.npy(RECONSTRUCT + ARRAY + HUGE_INT + b"\x85C\x01b\x87R."),
        authors_arrays.npy(DTYPE + b")" + b"\x85" * DEEP + b"\x85R."),  # to hash it would overflow the stack
        authors_arrays.npy(b"]q\x00" + b"h\x00a" * 1000 + b"."),  # a list of itself
    ],
)
def test_a_small_file_never_takes_much_memory(tmp_path: Path, content: bytes):
    tracemalloc.start()
    refusal(tmp_path, content)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * MEBIBYTE


@pytest.mark.filterwarnings("ignore:invalid escape sequence:DeprecationWarning")  # pickletools, on a text in the file
def test_a_damaged_file_is_read_or_refused_and_nothing_else(tmp_path: Path):
    good = np.frombuffer(authors_arrays.write(tmp_path / "good.npy", authors_arrays.rows(2)).read_bytes(), np.uint8)
    rng = np.random.default_rng(0)
    cut, spoilt_ones = [], []
    for number in range(900):
        spoilt = good.copy()
        if number % 3 == 0:
            spoilt = spoilt[: rng.integers(len(good))]
        else:  # one bit, or five
            places = rng.integers(len(good), size=1 + 4 * (number % 2))
            spoilt[places] ^= (1 << rng.integers(8, size=len(places))).astype(np.uint8)
        try:
            read(tmp_path, spoilt.tobytes())
        except object_array.ObjectArrayError as error:
            (spoilt_ones if number % 3 else cut).append(str(error))
    assert len(cut) == 300
    assert len(spoilt_ones) > 100
    assert not any("\n" in sentence for sentence in cut + spoilt_ones)
