"""`make fuzz`: every reader on 10,000 damaged files, and on as many that atheris makes to reach new code.

What breaks a reader is kept in fuzz-failures/. The same seed makes the same files.
"""

import argparse
import importlib.util
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

if sys.argv[1:3] == ["--one", "atheris"]:  # which follows what runs in the readers, if it sees them imported
    import atheris

    with atheris.instrument_imports(include=["pointnetkl"]):
        import damage
else:
    import damage
import seed_files

_SLOWEST_S, _MEMORY_BYTES = 20, 3 << 30  # of one input; of the address space of a process
_AVERAGE_S = 0.5  # of an input, with much to spare
_CONSTANT = 600  # times its size, and a floor, is what the memory of a file may be
_FLOOR_BYTES = 256 << 20


class HangError(BaseException):
    """A reader does not come back; no `except Exception` catches this."""


def main() -> int:
    """Run every reader, some at a time, and print what came of it; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000, help="damaged files for each reader")
    parser.add_argument("--atheris", type=int, default=10_000, help="inputs that atheris makes for each; 0: none")
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--only", nargs="*", default=sorted(seed_files.FORMATS), metavar="FORMAT")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="folder for what breaks a reader")
    parser.add_argument("--one", choices=("damage", "atheris"), help=argparse.SUPPRESS)
    arguments, rest = parser.parse_known_args()
    if arguments.one:
        return _run_reader(arguments, rest)
    if arguments.atheris and importlib.util.find_spec("atheris") is None:
        print("atheris is not installed (pip install -e '.[fuzz]'); its part is left out", file=sys.stderr)
        arguments.atheris = 0
    tasks = [
        (name, mutator) for mutator in ("damage", "atheris")[: 1 + bool(arguments.atheris)] for name in arguments.only
    ]
    print(
        f"{'reader':24} {'by':8} {'inputs':>7} {'refused':>8} {'reported':>8} {'read':>7} {'slowest':>8} {'memory':>8}"
    )
    with ThreadPoolExecutor(arguments.jobs) as pool:
        return max(pool.map(lambda task: _apart(*task, arguments), tasks))


def _apart(name: str, mutator: str, arguments: argparse.Namespace) -> int:
    """Run one reader in a process of its own: a library may bring that down."""
    command = [sys.executable, __file__, "--one", mutator, "--only", name, "--inputs", str(arguments.inputs)]
    command += ["--atheris", str(arguments.atheris), "--seed", str(arguments.seed), "--keep", str(arguments.keep)]
    limit_s = 600 + _AVERAGE_S * (arguments.inputs + arguments.atheris)  # what hangs in C hears no alarm
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=limit_s)
    except subprocess.TimeoutExpired:
        print(f"{name:24} {mutator:8} HANGS", flush=True)
        return 1
    line = next(
        (text[4:] for text in done.stdout.splitlines() if text.startswith("row ")), f"{name:24} {mutator:8} DIED"
    )
    print(line, flush=True)
    if done.returncode:
        print(done.stderr[-3000:], file=sys.stderr)
    return 1 if done.returncode else 0


class _Run:
    """One reader, input after input, under limits."""

    def __init__(self, name: str, keep: Path, folder: Path) -> None:
        self.name, self.keep, self.folder = name, keep, folder
        self.counts: Counter[str] = Counter()
        self.slowest_s, self.largest = 0.0, 0
        self.begun = _peak_bytes()
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
        signal.signal(signal.SIGALRM, _hang)

    def take(self, content: bytes) -> None:
        """Read one input; keep it, and fail, if it breaks the reader."""
        if not content:
            return
        path = self.folder / f"damaged{seed_files.FORMATS[self.name].suffix}"
        path.write_bytes(content)
        began = time.process_time()  # of this process: others may have the machine
        signal.alarm(_SLOWEST_S)
        try:
            self.counts[seed_files.FORMATS[self.name].outcome(path)] += 1
        except BaseException:
            self._kept(content)
            raise
        finally:
            signal.alarm(0)
        self.slowest_s = max(self.slowest_s, time.process_time() - began)
        if self.slowest_s > _SLOWEST_S:
            self._kept(content)
            raise HangError(f"{self.name}: {self.slowest_s:.0f} s")
        self.largest = max(self.largest, len(content))
        if _peak_bytes() - self.begun > _FLOOR_BYTES + _CONSTANT * self.largest:
            self._kept(content)
            raise MemoryError(f"{self.name}: {(_peak_bytes() - self.begun) >> 20} MiB for {len(content)} bytes")

    def row(self, mutator: str) -> str:
        """Return the line of the summary."""
        refused, reported, read = (self.counts[key] for key in (damage.REFUSED, damage.REPORTED, damage.READ))
        counts = f"{refused:>8} {reported:>8} {read:>7}"
        grown = (_peak_bytes() - self.begun) >> 20
        return (
            f"row {self.name:24} {mutator:8} {self.counts.total():>7} {counts} {self.slowest_s:>6.2f} s {grown:>4} MiB"
        )

    def _kept(self, content: bytes) -> None:
        self.keep.mkdir(parents=True, exist_ok=True)
        kept = self.keep / f"{self.name.replace('/', '_').replace(' ', '_')}-{self.counts.total()}"
        kept.with_suffix(seed_files.FORMATS[self.name].suffix).write_bytes(content)


def _run_reader(arguments: argparse.Namespace, rest: list[str]) -> int:
    (name,) = arguments.only
    with tempfile.TemporaryDirectory() as folder:
        run = _Run(name, arguments.keep, Path(folder))
        if arguments.one == "damage":
            _damage(run, arguments)
            print(run.row("damage"))
        else:
            _atheris(run, arguments, Path(folder))
    return 0


def _damage(run: _Run, arguments: argparse.Namespace) -> None:
    seeds = seed_files.FORMATS[run.name].contents()
    for content in seeds:
        run.take(content)
    rng = random.Random(arguments.seed)
    while run.counts.total() < arguments.inputs:
        content = damage.mutated(rng.choice(seeds), rng)
        if rng.random() < 0.5:  # else no checksum would let the deeper checks see anything
            content = seed_files.FORMATS[run.name].mended(content)
        run.take(content)


def _atheris(run: _Run, arguments: argparse.Namespace, folder: Path) -> None:
    corpus = folder / "corpus"
    corpus.mkdir()
    small = sorted(seed_files.FORMATS[run.name].contents(), key=len)[:4]
    for number, content in enumerate(small):
        (corpus / str(number)).write_bytes(content)

    def take(content: bytes) -> None:
        run.take(seed_files.FORMATS[run.name].mended(content))
        if run.counts.total() == arguments.atheris:  # libFuzzer ends the process without coming back here
            print(run.row("atheris"), flush=True)

    longest = max(map(len, small)) + 1000
    options = [f"-runs={2 * arguments.atheris}", f"-max_len={longest}", f"-seed={arguments.seed}", "-rss_limit_mb=0"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={folder}/", str(corpus)], take)
    atheris.Fuzz()


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _hang(signal_number: int, frame: object) -> None:
    raise HangError(f"no answer after {_SLOWEST_S} s")


if __name__ == "__main__":
    sys.exit(main())
