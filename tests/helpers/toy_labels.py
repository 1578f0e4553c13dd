"""A small survey to label, and the label stage on it by the command line."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml

import terrains
from pointnetkl.labels import shards
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts, parameters

ROOT = Path(__file__).parents[2]
SUBMAPS = 12
SETTINGS = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=5)
REGISTRATION = gicp.Settings(
    neighbours=10, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=20
)


def toy_submap(number: int, points: int = 100) -> Submap:
    """Return a submap; others have other points."""
    kind = list(terrains.AMPLITUDES_M)[number % len(terrains.AMPLITUDES_M)]
    return Submap("toy", number, *(terrains.cloud(kind, points, 3 * number + part) for part in range(3)))


def write(folder: Path, submaps: int = SUBMAPS, runs: int = 20, points: int = 100) -> Path:
    """Write the survey's points and parameters to a folder; return it."""
    artifacts.write_table(
        folder / "submaps.parquet", submap.to_table(toy_submap(i, points) for i in range(submaps)), submap.POINTS, {}
    )
    line = {
        "group": "test",
        "raw": "none",
        "truth": "none",
        "submap_length_m": 100,
        "point_spacing_m": 5,
        "label_runs": runs,
    }
    params = {
        "label": parameters.as_metadata(SETTINGS),
        "registration": parameters.as_metadata(REGISTRATION),
        "study": {"train": {}, "test": {"toy": line}, "surveys": {"toy": line}},
    }
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    return folder


def change(folder: Path, section: str, **values: object) -> None:
    """Change parameters of a written survey."""
    params = yaml.safe_load((folder / "params.yaml").read_text())
    params[section].update(values)
    (folder / "params.yaml").write_text(yaml.safe_dump(params))


def job(folder: Path, runs: int = 20, settings: monte_carlo.Settings = SETTINGS) -> shards.Job:
    """Return the job that the stage does on a written survey."""
    return shards.Job(
        "toy", folder / "submaps.parquet", folder / "shards", runs, settings, REGISTRATION, shards.kernel_version("cpu")
    )


def start(folder: Path, largest_file: int = resource.RLIM_INFINITY, **environment: str) -> subprocess.Popen[str]:
    """Start the stage, in a process group of its own; it may not write larger files than so many bytes."""
    command = [sys.executable, str(ROOT / "pipeline/label.py"), "toy", "--params", "params.yaml"]
    command += ["--submaps", "submaps.parquet", "--shards", "shards"]
    command += ["--labels", "out/labels.parquet", "--errors", "out/errors.npz"]
    inherited = {name: value for name, value in os.environ.items() if name != "DASK_SCHEDULER_ADDRESS"}
    return subprocess.Popen(
        command,
        cwd=folder,
        env=inherited | {"POINTNETKL_WORKERS": "2"} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file)),
    )


def run(folder: Path, **environment: str) -> str:
    """Run the stage to its end; return the line that says how many labels it made."""
    process = start(folder, **environment)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return next(line for line in output.splitlines() if line.startswith("toy: labelled"))


def fail(folder: Path, largest_file: int = resource.RLIM_INFINITY, **environment: str) -> str:
    """Run the stage, which must fail; return the sentence that it ends with, without the progress bar before it."""
    process = start(folder, largest_file, **environment)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1, errors
    assert "Traceback" not in errors
    assert errors.count("error: ") == 1
    sentence = errors[errors.index("error: ") :].strip()
    assert "\n" not in sentence
    return sentence


def kill(process: subprocess.Popen[str]) -> None:
    """Kill a started stage and all its workers, as `kill -9` of the group does."""
    with contextlib.suppress(ProcessLookupError):  # it has ended
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def outputs(folder: Path) -> dict[str, bytes]:
    """Return the bytes that the stage made, by name of the file."""
    return {path.name: path.read_bytes() for path in sorted((folder / "out").iterdir())}


def intact(folder: Path) -> set[str]:
    """Return the names of the shards that hold a label."""
    return {path.name for path in (folder / "shards").glob("*.npz") if shards.read(path)}


def until(condition, seconds: float = 120.0) -> None:
    """Wait until a condition is true."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def same_label(a: monte_carlo.Label, b: monte_carlo.Label) -> bool:
    """Whether two labels are the same in all that is kept."""
    return a.row == b.row and np.array_equal(a.errors, b.errors) and np.array_equal(a.held_out, b.held_out)
