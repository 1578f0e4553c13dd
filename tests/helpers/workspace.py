"""A copy of the project in a folder of its own, where tests run DVC without touching this one."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
COPIED = (
    "pipeline",
    "src",
    "scales",
    "dvc.yaml",
    "params.yaml",
    "pyproject.toml",
    ".dvc/config",
    ".dvcignore",
    ".gitignore",
)


def smoke(*dropped: str) -> list[str]:
    """Return the changes that make the smoke scale, but for those of surveys that are dropped from the study."""
    changes = (ROOT / "scales/smoke").read_text().replace("-S ", "").split()
    return [f"-S{change}" for change in changes if not any(f"surveys.{name}." in change for name in dropped)]


class Workspace:
    """A project folder under git and DVC."""

    def __init__(self, folder: Path):
        self.folder = folder
        for name in COPIED:
            source, target = ROOT / name, folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
            else:
                shutil.copy(source, target)
        (folder / "data").mkdir(exist_ok=True)
        shutil.copy(ROOT / "data/none", folder / "data/none")
        self.run("git", "init", "-q")
        self.commit("begin")

    def run(self, *command: str, check: bool = True, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command in the folder, with this Python's programs first in the path."""
        paths = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        names = {
            "GIT_AUTHOR_NAME": "t",
            "GIT_AUTHOR_EMAIL": "t@t",
            "GIT_COMMITTER_NAME": "t",
            "GIT_COMMITTER_EMAIL": "t@t",
        }
        result = subprocess.run(
            command,
            cwd=self.folder,
            env=os.environ | names | {"PATH": paths, "DVC_NO_ANALYTICS": "1"} | environment,
            capture_output=True,
            text=True,
        )
        if check and result.returncode:
            raise AssertionError(
                f"{' '.join(command)} ended with {result.returncode}:\n{result.stdout}\n{result.stderr}"
            )
        return result

    def commit(self, message: str) -> None:
        """Commit all that git does not ignore."""
        self.run("git", "add", "-A")
        self.run("git", "commit", "-q", "-m", message)

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace a piece of text that stands in a file once."""
        path = self.folder / file
        text = path.read_text()
        assert text.count(old) == 1, f"{file} has {text.count(old)} times {old!r}"
        path.write_text(text.replace(old, new))

    def drop_surveys(self, *names: str) -> None:
        """Take surveys out of the study, as a user does: by deleting their lines."""
        path = self.folder / "params.yaml"
        text = path.read_text()
        study, rest = text.split("\nsimulate:", 1)
        for name in names:
            study = re.sub(rf"\n    {name}: .*", "", study)
        path.write_text(f"{study}\nsimulate:{rest}")

    def ran(self, output: str) -> list[str]:
        """Return the stages that a `dvc repro` ran, from what it printed."""
        return re.findall(r"Running stage '([^']+)'", output)
