"""TUM trajectories: what is written comes back, and what is damaged is refused by its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphs
from pointnetkl.exchange import tum
from pointnetkl.exchange.tum import TumError


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 20))
@settings(max_examples=40, deadline=None)
def test_a_trajectory_comes_back(tmp_path_factory: pytest.TempPathFactory, seed: int, count: int):
    rng, path = np.random.default_rng(seed), tmp_path_factory.mktemp("tum") / "a.tum"
    times, poses = 1e9 + np.cumsum(rng.uniform(0.01, 100, count)), graphs.poses(count, rng, 1e6)
    tum.write(path, times, poses, "seconds")
    assert path.read_text().startswith("# seconds; ")
    times_again, again = tum.read(path)
    np.testing.assert_array_equal(times_again, times)
    np.testing.assert_array_equal(again[:, :3, 3], poses[:, :3, 3])
    np.testing.assert_allclose(again, poses, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("# nothing\n", "has no pose"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2: it has 7 words, must have 8"),
        ("1 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n", "line 3: its time is not later"),
        ("1 0 0 inf 0 0 0 1\n", "line 1: 'inf' is not a finite number"),
        ("1 0 0 0 1 1 0 1\n", "line 1: its quaternion has not length 1"),
        ("time x y z qx qy qz qw\n", "line 1: 'time' is not a finite number"),
        (b"\xff\x00", "line 1: it is no text"),
    ],
)
def test_what_is_no_trajectory_is_refused_by_its_line(tmp_path: Path, content: str | bytes, sentence: str):
    (tmp_path / "a.tum").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(TumError, match=sentence) as refused:
        tum.read(tmp_path / "a.tum")
    assert str(refused.value).startswith(str(tmp_path / "a.tum"))


def test_a_damaged_file_is_a_trajectory_or_an_error_of_ours(tmp_path: Path):
    rng, path, refused = np.random.default_rng(0), tmp_path / "a.tum", 0
    tum.write(path, np.arange(6.0), graphs.poses(6, rng), "numbers")
    whole = path.read_bytes()
    for _ in range(300):
        path.write_bytes(graphs.mutated(whole, rng))
        try:
            times, poses = tum.read(path)
        except TumError as error:
            sentence, refused = str(error), refused + 1
            graphs.assert_one_sentence(sentence, path)
        else:
            assert np.isfinite(times).all()
            assert np.isfinite(poses).all()
    assert 100 < refused < 300
