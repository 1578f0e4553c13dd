"""Where real raw files may be found: tests that need them are skipped where this folder is absent."""

from pathlib import Path

REALDATA = Path(__file__).parents[3] / "shared/realdata"
