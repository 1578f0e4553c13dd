"""`make setup` installs into a folder of the project, never into one that a link names."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(not shutil.which("make"), reason="make is not installed")
def test_a_venv_that_is_a_link_is_refused_and_its_target_stays_as_it_was(tmp_path: Path):
    project, other = tmp_path / "project", tmp_path / "environment of another project"
    other.mkdir()
    (other / "pyvenv.cfg").write_text("home = elsewhere\n")
    (project / "tools").mkdir(parents=True)
    for name in ("Makefile", "tools/setup.sh", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, project / name)
    (project / ".venv").symlink_to(other)
    result = subprocess.run(["make", "setup"], cwd=project, capture_output=True, text=True, check=False)
    assert result.returncode
    assert f"{project}/.venv is a link to {other}" in result.stderr
    assert "rm .venv" in result.stderr
    assert (project / ".venv").is_symlink()
    assert [path.name for path in other.iterdir()] == ["pyvenv.cfg"]
    assert (other / "pyvenv.cfg").read_text() == "home = elsewhere\n"
