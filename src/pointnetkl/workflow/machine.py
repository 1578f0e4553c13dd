"""The machine that a program runs on, for times that depend on it."""

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_CPUINFO = Path("/proc/cpuinfo")


def processor() -> str:
    """Return the name of the processor, as the system gives it, with family and model: a cloud may mask the name."""
    lines = _CPUINFO.read_text().splitlines() if _CPUINFO.exists() else []
    pairs = (line.partition(":") for line in reversed(lines) if ":" in line)  # the first processor's come last
    entries = {key.strip(): value.strip() for key, _, value in pairs}
    if "model name" not in entries:
        return platform.processor() or platform.machine()
    numbers = [f"{key.removeprefix('cpu ')} {entries[key]}" for key in ("cpu family", "model") if key in entries]
    return entries["model name"] + (f" ({', '.join(numbers)})" if numbers else "")


def describe() -> dict[str, Any]:
    """Return the processor and the number of its cores."""
    return {"cpu": processor(), "cores": os.cpu_count() or 1}


def in_words(machine: Mapping[str, Any]) -> str:
    """Return in words what `describe` returned, here or on another machine."""
    return ", ".join([str(machine.get("cpu", "an unknown machine")), *_cores(machine)])


def _cores(machine: Mapping[str, Any]) -> list[str]:
    return [f"{machine['cores']} core{'' if machine['cores'] == 1 else 's'}"] if "cores" in machine else []
