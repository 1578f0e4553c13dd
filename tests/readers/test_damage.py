"""On any bytes a reader ends in one sentence, or in soundings that agree with its report.

Some hundred inputs a reader; `make fuzz` does the same with ten thousand and more.
"""

import functools
import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import damage
import seed_files

pytestmark = pytest.mark.slow

READERS = sorted(seed_files.FORMATS)
QUICK = settings(
    max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@functools.cache
def contents(name: str) -> list[bytes]:
    """Return the sound files of a reader: no fixture, whose bytes pytest would print."""
    return seed_files.FORMATS[name].contents()


@pytest.mark.parametrize("name", READERS)
def test_sound_files_are_read_to_the_end(tmp_path: Path, name: str):
    path = tmp_path / f"sound{seed_files.FORMATS[name].suffix}"
    for content in seed_files.FORMATS[name].builders():
        path.write_bytes(content)
        assert seed_files.FORMATS[name].outcome(path) != damage.REFUSED
        path.write_bytes(seed_files.FORMATS[name].mended(content))
        assert seed_files.FORMATS[name].outcome(path) != damage.REFUSED


@pytest.mark.parametrize("name", READERS)
@given(rng=st.randoms(use_true_random=False))
@QUICK
def test_a_damaged_file_says_so_or_gives_what_it_declares(tmp_path: Path, name: str, rng: random.Random):
    path = tmp_path / f"damaged{seed_files.FORMATS[name].suffix}"
    content = damage.mutated(rng.choice(contents(name)), rng)
    for changed in (content, seed_files.FORMATS[name].mended(content)):
        if changed:
            path.write_bytes(changed)
            seed_files.FORMATS[name].outcome(path)


@pytest.mark.parametrize("name", READERS)
@given(content=st.binary(min_size=1, max_size=400), kept=st.integers(0, 200))
@QUICK
def test_any_bytes_behind_any_beginning_end_in_a_sentence(tmp_path: Path, name: str, content: bytes, kept: int):
    path = tmp_path / f"any{seed_files.FORMATS[name].suffix}"
    path.write_bytes(contents(name)[0][:kept] + content)
    seed_files.FORMATS[name].outcome(path)
