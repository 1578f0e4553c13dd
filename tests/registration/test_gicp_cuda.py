"""The engine cuda: on numba's simulator against the CPU, in a new process; its compiled code, where NVVM is."""

import contextlib
import importlib
import json
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest

import simulated_gpu
import terrains
from pointnetkl.registration import gicp
from pointnetkl.registration.gicp import matching, registration
from pointnetkl.registration.gicp.cuda import engine as cuda
from pointnetkl.registration.gicp.cuda import kernel
from pointnetkl.registration.gicp.cuda import matching as cuda_matching
from pointnetkl.surveys.se2 import SE2

pytestmark = pytest.mark.slow

SETTINGS = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)
KINDS = [*terrains.AMPLITUDES_M, "ridge"]
POINTS, RUNS = 150, 3
ROOT = Path(__file__).parents[2]
NO_GPU = pytest.mark.skipif(cuda.cuda.is_available(), reason="there is a GPU")
NOISE = gicp.Noise(sigma_m=0.2, key=0x123456789ABCDEF0, first=7)


def wall(points: int) -> np.ndarray:
    """Return a cliff, where no cell's table of candidates is enough."""
    rng = np.random.default_rng(2)
    return np.column_stack([rng.uniform(-2, 2, points), rng.uniform(-15, 15, points), rng.uniform(-150, 0, points)])


def simulate() -> dict[str, gicp.Registrations]:
    """Register copies of every kind of cloud on the simulator; the keys name the kind or the special case."""
    simulated_gpu.install()
    results = {kind: on_cuda(terrains.cloud(kind, POINTS)) for kind in KINDS} | {"wall": on_cuda(wall(POINTS))}
    rugged = terrains.cloud("rugged", POINTS)
    results["far"] = on_cuda(rugged, moved_m=500.0)
    results["halves"] = on_cuda(rugged[::2], rugged[1::2])
    results["last"] = on_cuda(rugged, noise=replace(NOISE, first=NOISE.first + RUNS - 1), only=slice(RUNS - 1, RUNS))
    cuda._own.lane = simulated_gpu.HostLane(1)
    results["alone"] = on_cuda(rugged)
    return results


def on_cuda(source: np.ndarray, target: np.ndarray | None = None, **options: Any) -> gicp.Registrations:
    return registered(source, target, engine="cuda", **options)


def registered(
    source: np.ndarray,
    target: np.ndarray | None = None,
    engine: str = "cpu",
    moved_m: float = 0.0,
    noise: gicp.Noise = NOISE,
    only: slice = slice(None),
) -> gicp.Registrations:
    """Register moved, noisy copies of a cloud onto itself or another."""
    moves = moved_m + 2 * np.random.default_rng(3).standard_normal((RUNS, 2))
    clouds = [gicp.prepare(points, SETTINGS) for points in (source, source if target is None else target)]
    return gicp.register_noisy(*clouds, moves[only], noise, SETTINGS, engine=engine)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder into which the simulating process has written its results."""
    folder = tmp_path_factory.mktemp("simulated")
    result = simulated_gpu.run(__file__, str(folder), cwd=ROOT, timeout=600)
    assert result.returncode == 0, result.stderr
    return folder


@pytest.fixture(scope="module")
def simulated(folder: Path) -> dict[str, gicp.Registrations]:
    """Return what `simulate` returned in that process."""
    with np.load(folder / "results.npz") as arrays:
        return {
            name: gicp.Registrations(
                SE2.from_vector(arrays[f"{name} T"]), arrays[f"{name} converged"], arrays[f"{name} iterations"]
            )
            for name in {key.split()[0] for key in arrays}
        }


@pytest.mark.parametrize("kind", [*KINDS, "wall"])
def test_the_gpus_kernel_answers_as_the_cpus_does(simulated: dict[str, gicp.Registrations], kind: str) -> None:
    on_gpu, on_cpu = simulated[kind], registered(wall(POINTS) if kind == "wall" else terrains.cloud(kind, POINTS))
    assert np.allclose(on_gpu.T_target_copy.translation, on_cpu.T_target_copy.translation, atol=1e-4)
    assert np.array_equal(on_gpu.iterations, on_cpu.iterations)
    assert np.array_equal(on_gpu.converged, on_cpu.converged)


def test_one_half_registers_onto_the_other_as_on_the_cpu(simulated: dict[str, gicp.Registrations]) -> None:
    rugged = terrains.cloud("rugged", POINTS)
    assert np.allclose(
        simulated["halves"].T_target_copy.translation,
        registered(rugged[::2], rugged[1::2]).T_target_copy.translation,
        atol=1e-4,
    )


def test_a_copy_out_of_reach_stays_where_it_is(simulated: dict[str, gicp.Registrations]) -> None:
    assert np.array_equal(simulated["far"].T_target_copy.translation, np.zeros((RUNS, 2)))
    assert not simulated["far"].converged.any()


def test_a_run_has_the_same_answer_in_every_launch(simulated: dict[str, gicp.Registrations]) -> None:
    rugged = simulated["rugged"].T_target_copy.translation
    assert np.array_equal(simulated["alone"].T_target_copy.translation, rugged)
    assert np.array_equal(simulated["last"].T_target_copy.translation, rugged[-1:])


@NO_GPU
def test_without_a_gpu_the_error_says_what_is_missing() -> None:
    with pytest.raises(gicp.GicpError, match="needs an NVIDIA GPU"):
        on_cuda(terrains.cloud("mild", 50))


def test_the_engine_refuses_yaw() -> None:
    cloud = gicp.prepare(terrains.cloud("mild", 50), SETTINGS)
    with pytest.raises(gicp.GicpError, match="x and y alone"):
        gicp.register_noisy(cloud, cloud, np.zeros((1, 2)), NOISE, replace(SETTINGS, dof="xyyaw"), engine="cuda")


def test_a_cloud_that_does_not_fit_is_refused_before_anything_is_copied() -> None:
    with pytest.raises(gicp.GicpError, match="20000000 points is too large"):
        cuda._room(simulated_gpu.HostLane(), 20_000_000, 1)


def test_registration_on_a_cpu_imports_nothing_for_gpus() -> None:
    room = "pointnetkl.registration.gicp"
    code = f"import sys; import {room}; sys.exit('{room}.cuda' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_interleaved_candidates_are_those_of_the_table_and_a_far_one_for_each_that_is_missing() -> None:
    target = gicp.prepare(terrains.cloud("mild", 50), SETTINGS).as_target
    interleaved = cuda_matching.interleaved(target)
    cells, n = len(target.reach), len(target.points) // 3
    numbers = (
        interleaved.numbers.reshape(-1, matching.CANDIDATES, 32).transpose(0, 2, 1).reshape(-1, matching.CANDIDATES)
    )
    expected = np.sort(target.numbers.reshape(cells, -1), axis=1)
    for candidates, in_table in zip(numbers[:cells], expected, strict=True):
        assert sorted(candidates[candidates < n]) == list(in_table[in_table >= 0])
    assert (interleaved.candidates.reshape(3, -1)[:, n] > 1e10).all()


def test_the_benchmark_of_the_gpu_ends_in_its_numbers(folder: Path) -> None:
    numbers = json.loads((folder / "benchmark").read_text().splitlines()[-1])
    assert numbers["share_within_1mm"] == 1
    assert numbers["kl_largest_floor0"] < 1e-3
    assert numbers["paper_kernel_s"] == pytest.approx(9080 * 3000 / numbers["kernel_per_s"], rel=1e-3)
    assert numbers["paper_all_s"] == pytest.approx(9080 * 3000 / numbers["all_per_s"], rel=1e-3)


@NO_GPU
def test_without_a_gpu_the_benchmark_ends_in_a_sentence() -> None:
    result = subprocess.run([sys.executable, "benchmarks/gpu.py"], cwd=ROOT, capture_output=True)
    assert result.returncode == 1
    assert result.stderr.startswith(
        b"error: the engine cuda (experimental: it has run on a simulator only) needs an NVIDIA GPU"
    )
    assert result.stderr.count(b"\n") == 1


@pytest.fixture(scope="module")
def ptx() -> str:
    """The kernel as NVVM compiles it for compute capability 9.0, a GPU or not."""
    compiler = pytest.importorskip("numba_cuda", reason="numba-cuda, whose NVVM compiles the kernel, is not installed")
    dispatcher = importlib.import_module("numba.cuda.dispatcher")
    with pytest.MonkeyPatch.context() as patch:
        # nothing but the GPU's capability is asked of it
        patch.setattr(dispatcher, "get_current_device", lambda: SimpleNamespace(compute_capability=(9, 0)))
        try:
            options = {"device": False, "cc": (9, 0), "output": "ptx", "abi": "numba", "fastmath": True}
            return str(cuda.cuda.compile(kernel.register_noisy.py_func, signature(), **options)[0])
        except Exception as error:
            if "NVVM" not in str(error) and "nvvm" not in str(error):
                raise
            pytest.skip(f"numba-cuda {compiler.__version__} finds no NVVM: {str(error).splitlines()[0]}")


def signature() -> tuple[Any, ...]:
    """Return the types of a launch's arguments."""
    cloud, limits = gicp.prepare(terrains.cloud("mild", 50), SETTINGS), registration.limits(SETTINGS)
    arguments = cuda.arguments(simulated_gpu.HostLane(), cloud, cloud, np.zeros((2, 2)), NOISE, limits)
    return tuple(numba.typeof(argument) for argument in arguments)


def test_the_kernel_compiles_to_one_function_without_arrays_in_local_memory(ptx: str) -> None:
    assert len(re.findall(r"^\.visible \.entry|\.entry", ptx)) == 1
    assert "call" not in re.sub(r"//.*", "", ptx)
    assert ".local" not in ptx


def test_no_sum_is_taken_in_an_order_that_timing_decides(ptx: str) -> None:
    atomics = re.findall(r"\b(?:atom|red)\.[\w.:]+", ptx)
    assert set(atomics) == {"atom.global.add.u32"}  # the count of runs begun


def test_the_kernel_fits_the_registers_of_six_blocks_a_multiprocessor(ptx: str, tmp_path: Path) -> None:
    if not (assembler := shutil.which("ptxas")):
        pytest.skip("ptxas, which assigns the registers, is not on the path")
    (tmp_path / "kernel.ptx").write_text(ptx)
    command = [assembler, "-v", "-arch=sm_90", "-maxrregcount=80", "kernel.ptx", "-o", "kernel.cubin"]
    report = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    if "unsupported" in report.stderr.lower():
        pytest.skip(f"ptxas is older than NVVM: {report.stderr.strip().splitlines()[0]}")
    assert report.returncode == 0, report.stderr
    spilled = re.search(r"(\d+) bytes spill stores", report.stderr)
    assert spilled
    assert int(spilled[1]) <= 64


def benchmark() -> None:
    """Run benchmarks/gpu.py on little."""
    small = "--points 60 --terrain rugged --checked 3 --launched 2 --repetitions 1 --runs 2 --labels 2"
    sys.argv = ["benchmarks/gpu.py", *small.split(), "--threads", "1"]  # the simulator runs one kernel at a time
    sys.path.insert(0, str(ROOT / "benchmarks"))
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    written = Path(sys.argv[1])
    arrays = {}
    for name, outcome in simulate().items():
        arrays[f"{name} T"] = outcome.T_target_copy.to_vector()
        arrays[f"{name} converged"], arrays[f"{name} iterations"] = outcome.converged, outcome.iterations
    np.savez(written / "results.npz", **arrays)
    with (written / "benchmark").open("w") as printed, contextlib.redirect_stdout(printed):
        benchmark()
