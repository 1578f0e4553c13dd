"""A Dask cluster on this machine, started by the command line as a user does, on free ports."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

SCHEDULER = "--host 127.0.0.1 --port 0 --dashboard-address :0"


class LocalDask:
    """A scheduler, and the workers that were started; `close` ends all of them."""

    def __init__(self, folder: Path, command: str = "dask scheduler", **environment: str):
        self.folder, self.started = folder, list[subprocess.Popen[bytes]]()
        where = folder / "scheduler.json"
        self.scheduler = self._start(f"{command} {SCHEDULER} --scheduler-file {where}", environment)
        deadline = time.monotonic() + 60
        while not where.exists() or not where.read_text():
            assert time.monotonic() < deadline, (folder / "dask.log").read_text()
            time.sleep(0.05)
        self.address: str = json.loads(where.read_text())["address"]

    def worker(
        self, command: str = "dask worker ADDRESS --nworkers 1 --nthreads 1", **environment: str
    ) -> "subprocess.Popen[bytes]":
        """Start workers by a command in which ADDRESS stands for the scheduler's."""
        return self._start(command.replace("ADDRESS", self.address), environment)

    def close(self) -> None:
        """End the scheduler and all the workers."""
        for process in self.started:
            self.lose(process)

    def lose(self, process: "subprocess.Popen[bytes]") -> None:
        """Kill a process and its children at once, as when a machine is lost."""
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def _start(self, command: str, environment: dict[str, str]) -> "subprocess.Popen[bytes]":
        program, *arguments = shlex.split(command)
        with (self.folder / "dask.log").open("ab") as log:
            process = subprocess.Popen(
                [str(Path(sys.executable).with_name(program)), *arguments],
                cwd=self.folder,
                env=os.environ | {"DASK_TEMPORARY_DIRECTORY": str(self.folder)} | environment,  # not in the system's
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.started.append(process)
        return process
