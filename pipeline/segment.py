"""Cut a survey into submaps of equal track length (into tiles, where there is no track), thin them, write their poses.

Submaps that another program has cut are kept as they are. What later stages need to know of the survey, its kind and
its point spacing, stands in the metadata of both tables.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from pointnetkl import segmentation
from pointnetkl.segmentation import spacing, tiles
from pointnetkl.surveys import submap, survey
from pointnetkl.surveys.submap import Sampling, Submap
from pointnetkl.workflow import artifacts, command, parameters, study
from pointnetkl.workflow.study import StudySurvey
from pointnetkl.workflow.table_writer import TableWriter


def main(arguments: argparse.Namespace) -> None:
    """Read the survey's pings and soundings; write its submaps and their poses."""
    settings = parameters.read(arguments.params, "segment", segmentation.Settings)
    line = study.survey(arguments.params, arguments.name)
    kind = artifacts.table_metadata(arguments.survey / "pings.parquet").get("kind", survey.SWATHS)
    sizes: list[int] = []
    spacings_m: list[float] = []
    with TableWriter(arguments.submaps, submap.POINTS) as points:

        def take(cut: Submap) -> None:
            rows = submap.to_table([cut])
            points.write(rows)
            sizes.append(len(cut.points))
            stored = cut.points.astype(np.float32)  # as later stages read them
            spacings_m.append(spacing.between_neighbours(stored.astype(np.float64)))

        segments = segment(arguments, kind, line, settings, take)
        points.metadata = {
            "survey": arguments.name,
            "params": {
                "segment": parameters.as_metadata(settings),
                "submap_length_m": line.submap_length_m,
                "point_spacing_m": line.point_spacing_m,
            },
            "dropped": segments.dropped,
            **asdict(Sampling(kind, float(np.median(spacings_m)))),
        }
    artifacts.write_table(arguments.poses, segments.poses, submap.POSES, points.metadata)
    print(summary(arguments.name, sizes, segments.dropped))


def segment(
    arguments: argparse.Namespace,
    kind: str,
    line: StudySurvey,
    settings: segmentation.Settings,
    take: segmentation.Take,
) -> segmentation.Segmentation:
    """Cut the survey as its kind demands: a track in lengths, points in tiles, another program's submaps not at all."""
    name, pings = arguments.name, arguments.survey / "pings.parquet"
    soundings = artifacts.read_groups(arguments.survey / "soundings.parquet", survey.SOUNDINGS)
    length_m, spacing_m = line.submap_length_m, line.point_spacing_m
    match kind:
        case survey.SWATHS:
            track = artifacts.read_table(pings, survey.PINGS)
            return segmentation.segment(name, track, soundings, length_m, spacing_m, settings, take)
        case survey.SUBMAPS:
            poses = artifacts.read_table(pings, survey.PINGS)
            return segmentation.keep(name, poses, soundings, spacing_m, settings, take)
        case survey.POINTS:
            scratch = arguments.submaps.parent
            return tiles.segment(name, soundings, length_m, spacing_m, settings.seed, take, scratch)
    raise segmentation.SegmentationError(
        f"{pings}: is of kind {kind!r}, must be {survey.SWATHS}, {survey.POINTS} or {survey.SUBMAPS}; run dvc"
        f" repro ingest@{name}"
    )


def summary(name: str, sizes: Sequence[int], dropped: Mapping[str, int]) -> str:
    """Return one line: the number of submaps, their points, and what was left out."""
    counts = ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count)
    return (
        f"{name}: {len(sizes)} submaps of {np.mean(sizes):.0f} +- {np.std(sizes):.0f} points;"
        f" left out: {counts or 'nothing'}"
    )


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("name", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--survey", type=Path, required=True, help="folder of pings.parquet and soundings.parquet")
    parser.add_argument("--submaps", type=Path, required=True, help="points to write, Parquet")
    parser.add_argument("--poses", type=Path, required=True, help="poses to write, Parquet")
    command.run(main, parser)
