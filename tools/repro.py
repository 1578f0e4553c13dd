"""Run `dvc repro`, and say before which scale runs and after how long each stage took.

A simulated survey whose grid is not here is left out: grids are other people's, and do not come with the project.
"""

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
        "PYTHONUNBUFFERED": "1",  # or the stages' lines would come after DVC's
        "DVC_NO_ANALYTICS": "1",
    }
    dvc = str(bin_folder / "dvc")
    if not (ROOT / ".git").exists():
        # an unpacked archive: DVC works without git when told so
        subprocess.run([dvc, "config", "--local", "core.no_scm", "true"], env=environment, check=True)
    leave_out_gridless(ROOT / "params.yaml")
    announce()
    begun = time.monotonic()
    status, seconds = follow([dvc, "repro", *sys.argv[1:]], environment)
    summarise(seconds, time.monotonic() - begun)
    return status


def leave_out_gridless(path: Path) -> None:
    """Make comments of the lines of test surveys whose grid is missing, and say so."""
    params = yaml.safe_load(path.read_text())
    for name in sorted(params["study"]["test"].keys() & params["simulate"].keys()):
        grid = params["simulate"][name]["grid"]
        # one that DVC knows of may be somewhere else; one that it does not know of is a mistake, which it will name
        if not Path(grid).exists() and Path(f"{grid}.dvc").exists():
            path.write_text(without(path.read_text(), name))
            print(
                f"{grid} is not here, so the survey {name} is left out: its lines in params.yaml are comments now."
                f"\ndata/grids/README.md says where the grid is from; put it there, and take the # away again"
            )


def without(text: str, survey: str) -> str:
    """Return parameters with a survey's line below study.test and its entry below simulate as comments."""
    lines, section, inside, listed = [], "", False, False
    for line in text.splitlines():
        if re.match(r"\w", line):
            section = line.split(":")[0]
        if re.match(r" {0,2}\w", line):
            inside = section == "simulate" and line.split("#")[0].strip() == f"{survey}:"
        if not line.startswith("     "):  # DVC folds long lines: what is indented deeper goes on with the one before
            listed = section == "study" and line.startswith(f"    {survey}:")
        lines.append(f"# {line}" if inside or listed else line)
    return "\n".join(lines) + "\n"


def announce() -> None:
    """Print the scale that params.yaml holds."""
    study = yaml.safe_load((ROOT / "params.yaml").read_text())["study"]
    print(f"scale: {study['scale']}, {len(study['train'])} training and {len(study['test'])} test surveys")


def follow(command: list[str], environment: dict[str, str]) -> tuple[int, dict[str, float]]:
    """Run a command, pass its lines on, and time the stages that they announce, in seconds."""
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
    """Print seconds per stage, its surveys added up."""
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
