"""What the races of readers share: a process for each, seconds of the processor, and sums that must agree."""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Beams = tuple[np.ndarray, ...]  # of a ping or a part: an array for each of a race's sums
Engine = Callable[[Path], Iterator[Beams]]


@dataclass(frozen=True)
class Race:
    """Readers of one format."""

    script: str  # that is run once more for each of them
    about: str
    source: Path  # the file that is repeated
    generate: Callable[[Path, Path, float], None]  # source, target, bytes
    engines: dict[str, Engine]  # "ours" among them
    sums: tuple[str, ...]  # what the arrays of Beams are
    compared: Sequence[str]  # of these, and "soundings"

    def main(self) -> None:
        """Race the readers, and print a line of JSON."""
        parser = argparse.ArgumentParser(description=self.about)
        parser.add_argument("--source", type=Path, default=self.source, help="the file that is repeated")
        parser.add_argument("--megabytes", type=float, default=200.0, help="of the repeated file")
        parser.add_argument("--repetitions", type=int, default=3)
        parser.add_argument("--engine", choices=list(self.engines), help="read --file with this one alone")
        parser.add_argument("--file", type=Path)
        given = parser.parse_args()
        if given.engine:
            print(json.dumps(self._measured(given.engine, given.file, given.repetitions)))
        else:
            print(json.dumps(self._run(given.source, 1e6 * given.megabytes, given.repetitions)))

    def _run(self, source: Path, size: float, repetitions: int) -> dict[str, object]:
        """Return the numbers of every engine that is installed, and the ratios of ours to theirs."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"big{source.suffix}"
            self.generate(source, path, size)
            found = {engine: self._apart(engine, path, repetitions) for engine in self.engines}
            bytes_read = path.stat().st_size
        installed = {engine: numbers for engine, numbers in found.items() if numbers is not None}
        ours = installed["ours"]
        for engine, numbers in installed.items():
            if not all(np.isclose(numbers[name], ours[name], rtol=1e-6) for name in ("soundings", *self.compared)):
                raise SystemExit(f"{source}: ours and {engine} do not agree: {ours} and {numbers}")
        ratios = {f"ratio_{name}": ours["mb_per_s"] / each["mb_per_s"] for name, each in installed.items()}
        return {"source": source.name, "bytes": bytes_read, **installed, **ratios}

    def _apart(self, engine: str, path: Path, repetitions: int) -> dict[str, float] | None:
        """Return what `_measured` does, of a process of its own; None where the engine is not installed."""
        words = ["--engine", engine, "--file", str(path), "--repetitions", str(repetitions)]
        result = subprocess.run([sys.executable, self.script, *words], capture_output=True, text=True)
        if "ModuleNotFoundError" in result.stderr:
            return None
        if result.returncode:
            raise SystemExit(f"{engine} failed: {result.stderr.strip().splitlines()[-1]}")
        found: dict[str, float] = json.loads(result.stdout.splitlines()[-1])
        return found

    def _measured(self, engine: str, path: Path, repetitions: int) -> dict[str, float]:
        """Read the file with one engine; return its rates, peak memory, and sums by which engines are compared."""
        seconds = []
        for _ in range(repetitions + 1):
            count, sums, begun = 0, np.zeros(len(self.sums)), time.process_time()
            for beams in self.engines[engine](path):
                count += len(beams[0])
                sums += [array.sum() for array in beams]
            seconds.append(time.process_time() - begun)
        rates = [path.stat().st_size / 1e6 / each for each in seconds[1:]]  # the first brings it into the page cache
        return {
            "mb_per_s": statistics.median(rates),
            "mb_per_s_least": min(rates),
            "soundings_per_s": count / statistics.median(seconds[1:]),
            "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            "soundings": count,
            **dict(zip(self.sums, sums.tolist(), strict=True)),
        }
