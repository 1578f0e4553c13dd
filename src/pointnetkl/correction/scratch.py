"""The folder beside the result where a correction keeps what it has finished, so that a killed run goes on."""

import fcntl
import json
import os
import shutil
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pointnetkl.correction.result import CorrectionError
from pointnetkl.workflow import artifacts

_LOCK, _REPLACED = ".lock", "replaced"


class Scratch:
    """Steps of a correction, each a folder that is there whole or not at all.

    They are those of one input and one set of settings: the key. With another key all begins anew. The folder is held
    by a lock as long as this object lives.

    Raises:
        CorrectionError: the folder cannot be made, or another run works in it.
    """

    def __init__(self, out: Path, key: Mapping[str, Any]) -> None:
        """Keep what an earlier run with this key has finished; remove that of others."""
        self.folder, self._out = out.parent / f".{out.name}.partial", out
        stored, wanted = self.folder / "key.json", json.dumps(key, sort_keys=True, default=str)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(self.folder / _LOCK, os.O_CREAT | os.O_RDWR)
            self._unlock = weakref.finalize(self, os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._restore()
            if not stored.is_file() or stored.read_bytes() != wanted.encode():
                self._clear()
                artifacts.write_bytes(stored, wanted.encode())
        except BlockingIOError as error:
            raise CorrectionError(
                f"{self.folder}: another run works in it; wait for it, or choose another OUT"
            ) from error
        except OSError as error:
            raise _failed(self.folder, error) from error

    def _restore(self) -> None:
        """Put back a result that a run was about to replace when it was killed."""
        if (self.folder / _REPLACED).is_dir() and not self._out.exists():
            os.replace(self.folder / _REPLACED, self._out)

    def _clear(self) -> None:
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != _LOCK:
                path.unlink()

    def step(self, name: str, make: Callable[[Path], None]) -> Path:
        """Return the folder of a step, which `make` fills where it is not there.

        Raises:
            CorrectionError: the disk is full, or the folder cannot be written.
        """
        done, begun = self.folder / name, self.folder / f".{name}"
        if done.is_dir():
            print(f"{name}: finished by an earlier run")
            return done
        try:
            shutil.rmtree(begun, ignore_errors=True)
            begun.mkdir()
            make(begun)
            os.replace(begun, done)
        except OSError as error:
            raise _failed(begun, error) from error
        return done

    def leave(self) -> None:
        """Let go of the folder; remove it where no step is finished: there is nothing to go on with."""
        if self.folder.is_dir() and not any(
            path.is_dir() and not path.name.startswith(".") for path in self.folder.iterdir()
        ):
            shutil.rmtree(self.folder, ignore_errors=True)
        self._unlock()

    def deliver(self, name: str, out: Path) -> None:
        """Move a step's folder to where the result belongs, in place of an earlier result, and remove the rest.

        Raises:
            CorrectionError: it cannot be moved.
        """
        try:
            if out.exists():
                os.replace(out, self.folder / _REPLACED)
            os.replace(self.folder / name, out)
        except OSError as error:
            self._restore()
            raise _failed(out, error) from error
        shutil.rmtree(self.folder, ignore_errors=True)


def _failed(path: Path, error: OSError) -> CorrectionError:
    return CorrectionError(
        f"{path}: cannot be written ({error.strerror or error}); make room or choose another folder, and run the same"
        " command again: what is finished is kept"
    )
