"""Cut a survey into submaps of equal track length (tiles, where nobody sailed), thin them, and give each its frame."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pointnetkl import segmentation
from pointnetkl.segmentation import tiles
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts, command, parameters, study
from pointnetkl.workflow.study import StudySurvey


def main(arguments: argparse.Namespace) -> None:
    """Read the survey's pings and soundings; write its submaps and their poses."""
    how = parameters.read(arguments.params, "segment", segmentation.Settings)
    line = study.survey(arguments.params, arguments.name)
    sizes: list[int] = []
    with artifacts.TableWriter(arguments.submaps, submap.POINTS) as points:

        def take(one: submap.Submap) -> None:
            sizes.append(len(one.points))
            points.write(submap.to_table([one]))

        found = segmented(arguments, line, how, take)
        points.metadata = {
            "survey": arguments.name,
            "params": {
                "segment": parameters.as_metadata(how),
                "submap_length_m": line.submap_length_m,
                "point_spacing_m": line.point_spacing_m,
            },
            "dropped": found.dropped,
        }
    artifacts.write_table(arguments.poses, found.poses, submap.POSES, points.metadata)
    print(summary(arguments.name, sizes, found.dropped))


def segmented(
    arguments: argparse.Namespace, line: StudySurvey, how: segmentation.Settings, take: segmentation.Take
) -> segmentation.Segmentation:
    """Cut the survey as its kind demands: a track in lengths, points in tiles, another program's submaps not at all."""
    pings = arguments.survey / "pings.parquet"
    parts = artifacts.read_groups(arguments.survey / "soundings.parquet", survey.SOUNDINGS)
    match artifacts.table_metadata(pings).get("kind", survey.SWATHS):
        case survey.SWATHS:
            lengths = (line.submap_length_m, line.point_spacing_m)
            track = artifacts.read_table(pings, survey.PINGS)
            return segmentation.segment(arguments.name, track, parts, *lengths, how, take)
        case survey.SUBMAPS:
            each = artifacts.read_table(pings, survey.PINGS)
            return segmentation.keep(arguments.name, each, parts, line.point_spacing_m, how, take)
        case survey.POINTS:
            lengths, scratch = (line.submap_length_m, line.point_spacing_m), arguments.submaps.parent
            return tiles.segment(arguments.name, parts, *lengths, how.seed, take, scratch)
        case kind:
            raise segmentation.SegmentationError(
                f"{pings}: is of kind {kind!r}, must be {survey.SWATHS}, {survey.POINTS} or {survey.SUBMAPS}; run dvc"
                f" repro ingest@{arguments.name}"
            )


def summary(name: str, sizes: Sequence[int], dropped: Mapping[str, int]) -> str:
    """Return one line: how many submaps of how many points, and what was left out."""
    counts = ", ".join(f"{count} {what}" for what, count in dropped.items() if count)
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
