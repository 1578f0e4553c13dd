"""What a correction starts from: raw files, an ingested survey or submaps, and what is known beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pointnetkl
from pointnetkl import readers
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.settings import Settings
from pointnetkl.readers import smrmsg
from pointnetkl.slam.closing import drift
from pointnetkl.surveys import survey
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.table_writer import TableWriter

_GRIDS = (".tif", ".tiff", ".bag")
_TABLES = ("pings.parquet", "soundings.parquet")


@dataclass(frozen=True)
class Inputs:
    """A survey to correct."""

    sources: Sequence[Path]  # raw files and folders of them, or one folder of an ingested survey
    submaps: tuple[Path, Path] | None = None  # points and poses that stage `segment` has cut
    held: Sequence[str] = ()  # names of raw files whose navigation is right
    fixes: Path | None = None  # CSV of absolute positions
    reference: Path | None = None  # GeoTIFF or BAG of a known seabed
    ties: Path | None = None  # list of ties, as mbnavadjust has them
    rates: Mapping[str, drift.Settings] = field(default_factory=dict)  # of drift, by further names

    @property
    def beside(self) -> list[Path]:
        """Return the files of what is known beside the survey."""
        return [path for path in (self.fixes, self.reference, self.ties) if path is not None]

    @property
    def ingested(self) -> Path | None:
        """Return the folder of an ingested survey, if that is the source."""
        folder = self.sources[0]
        return folder if len(self.sources) == 1 and all((folder / name).is_file() for name in _TABLES) else None

    def key(self, settings: Settings) -> dict[str, Any]:
        """Return what a result depends on: versions, settings, and the names, sizes and times of files."""
        paths = [*self.sources, *(self.submaps or ()), *self.beside]
        files = sorted(f for path in paths for f in files_of(path))
        stamps = [(str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in files]
        rates = {name: asdict(values) for name, values in self.rates.items()}
        return {
            "version": pointnetkl.__version__,
            "settings": asdict(settings),
            "files": stamps,
            "held": list(self.held),
            "rates": rates,
        }


def files_of(path: Path) -> list[Path]:
    """Return a file, or the files below a folder without those that are hidden, sorted."""
    if not path.is_dir():
        return [path]
    found = (file for file in path.rglob("*") if file.is_file())
    return sorted(file for file in found if not any(part.startswith(".") for part in file.relative_to(path).parts))


def check(inputs: Inputs, out: Path) -> None:
    """Refuse paths that are missing, and a result that would lie among them or replace them.

    Raises:
        CorrectionError: one of them is missing, or holds the result or lies in it.
    """
    if not inputs.sources:
        raise CorrectionError("there is no survey to correct; give raw files, or a folder of them")
    result = out.resolve()
    for path in [*inputs.sources, *inputs.beside, *(inputs.submaps or ())]:
        if not path.exists():
            raise CorrectionError(f"{path}: is missing; check the path")
        if (given := path.resolve()) == result or given in result.parents or result in given.parents:
            raise CorrectionError(f"{out}: would lie among what it is made from ({path}); choose a folder beside it")


def ingest(inputs: Inputs, name: str, settings: Settings, folder: Path) -> None:
    """Read raw files, and write pings.parquet and soundings.parquet to a folder, as stage `ingest` does.

    Raises:
        SurveyError: a file cannot be read, or nothing in them is usable.
    """
    with TableWriter(folder / _TABLES[1], survey.SOUNDINGS) as soundings:
        sources = [path for path in inputs.sources if path.is_dir() or not smrmsg.is_accuracy(path)]
        if grids := [path for path in sources if path.suffix.lower() in _GRIDS]:
            raise CorrectionError(f"{grids[0]}: is a grid and no survey; give it as --reference, beside raw files")
        raw = readers.read(sources, settings.reading, soundings.write, folder)
        if not raw.report["valid"]:
            raise CorrectionError(f"{name}: none of its {raw.report['soundings']} soundings is good; check their flags")
        soundings.metadata = {
            "survey": name,
            "kind": raw.kind,
            "crs": raw.crs,
            "origin": list(raw.origin),
            "report": raw.report,
        }
    artifacts.write_table(folder / _TABLES[0], raw.pings, survey.PINGS, soundings.metadata)
    print(f"{name}: {survey.summary(raw)}")


def metadata(tables: Path) -> dict[str, Any]:
    """Return what is stored with an ingested survey: kind, crs, origin and report.

    Raises:
        CorrectionError: it is not stored there.
    """
    stored = artifacts.table_metadata(tables / _TABLES[0])
    if missing := [key for key in ("kind", "crs", "origin") if key not in stored]:
        raise CorrectionError(f"{tables / _TABLES[0]}: does not say its {missing[0]}; make it by stage ingest")
    return stored
