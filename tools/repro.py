"""Run `dvc repro`; print the scale before it, and the seconds of each stage after it."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Run the pipeline; return DVC's exit status."""
    os.chdir(ROOT)
    bin_folder = Path(sys.executable).parent
    environment = os.environ | {
        "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONUNBUFFERED": "1",  # otherwise a stage's lines come after those of DVC
        "DVC_NO_ANALYTICS": "1",
    }
    dvc = str(bin_folder / "dvc")
    if not (ROOT / ".git").exists():
        # an unpacked archive has no .git, and DVC then needs this setting
        subprocess.run([dvc, "config", "--local", "core.no_scm", "true"], env=environment, check=True)
    announce()
    begun = time.monotonic()
    status, seconds = follow([dvc, "repro", *sys.argv[1:]], environment)
    summarise(seconds, time.monotonic() - begun)
    return status


def announce() -> None:
    """Print the scale that params.yaml holds."""
    try:
        study = yaml.safe_load((ROOT / "params.yaml").read_text())["study"]
        counts = len(study["train"]), len(study["test"])
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return  # DVC says what is wrong with the file
    print(f"scale: {study['scale']}, {counts[0]} training and {counts[1]} test surveys")


def follow(command: list[str], environment: dict[str, str]) -> tuple[int, dict[str, float]]:
    """Run a command and print its lines; return its exit status, and the seconds of every stage that it announces."""
    seconds: dict[str, float] = {}
    running, since = "", time.monotonic()
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            announced = re.match(r"(?:Running stage|Stage) '([^']+)'", line)
            if announced:
                if running:
                    seconds[running] = time.monotonic() - since
                running = announced[1] if line.startswith("Running") else ""
                since = time.monotonic()
    if running:
        seconds[running] = time.monotonic() - since
    return process.returncode, seconds


def summarise(seconds: dict[str, float], total: float) -> None:
    """Print the runs and the seconds of each stage, added up over its surveys."""
    stages: dict[str, list[float]] = {}
    for name, spent in seconds.items():
        stages.setdefault(name.split("@")[0], []).append(spent)
    if stages:
        print("\nstage       runs  seconds")
        for stage, spent in stages.items():
            print(f"{stage:<10}{len(spent):>6}{sum(spent):>9.1f}")
    print(f"{'all':<10}{len(seconds):>6}{total:>9.1f}")


if __name__ == "__main__":
    sys.exit(main())
