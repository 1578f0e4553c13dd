"""The machine that a program runs on, for times that depend on it."""

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_CPUINFO = Path("/proc/cpuinfo")


def processor() -> str:
    """Return the name of the processor, as the system gives it."""
    lines = _CPUINFO.read_text().splitlines() if _CPUINFO.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def describe() -> dict[str, Any]:
    """Return the processor and the number of its cores."""
    return {"cpu": processor(), "cores": os.cpu_count() or 1}


def in_words(machine: Mapping[str, Any]) -> str:
    """Return in words what `describe` returned, here or on another machine."""
    return ", ".join([str(machine.get("cpu", "an unknown machine")), *_cores(machine)])


def _cores(machine: Mapping[str, Any]) -> list[str]:
    return [f"{machine['cores']} core{'' if machine['cores'] == 1 else 's'}"] if "cores" in machine else []
