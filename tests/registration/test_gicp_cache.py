"""Compiled kernels on disk: another process returns the same bytes, and a changed file is compiled again."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
REGISTER = """
import numpy as np
import terrains
from pointnetkl.registration import gicp
settings = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)
cloud = gicp.prepare(terrains.cloud("mild", 400), settings)
registrations = gicp.register_noisy(cloud, cloud, np.ones((5, 2)), gicp.Noise(0.2, 3), settings)
print(registrations.T_target_copy.translation.tobytes().hex())
"""


def registered(source: Path, cache: Path) -> str:
    """Return what a new process, with kernels kept in `cache`, prints."""
    path = os.pathsep.join([str(source), str(ROOT / "tests/helpers")])
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run(
        [sys.executable, "-c", REGISTER], env=environment, capture_output=True, text=True, check=True
    ).stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package, to be changed."""
    folder = tmp_path_factory.mktemp("source")
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "src/pointnetkl", folder / "pointnetkl", ignore=without)
    return folder


def test_a_process_that_compiles_and_one_that_finds_the_kernel_compiled_answer_alike(
    source: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cache = tmp_path_factory.mktemp("cache")
    compiled = registered(source, cache)
    assert list(cache.rglob("*.nbc"))
    assert registered(source, cache) == compiled
    # what a kernel calls stands in other files than its own
    noise = source / "pointnetkl/registration/gicp/noise.py"
    noise.write_text(noise.read_text().replace("_f32(2.0**-24)\n    bits", "_f32(2.0**-25)\n    bits"))
    assert registered(source, cache) != compiled
