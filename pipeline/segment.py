"""Cut a survey into submaps of equal track length, thin them to an even spacing, and give each its frame."""

import argparse
from pathlib import Path

import numpy as np

from pointnetkl import artifacts, command, segmentation, settings, study, submap, survey


def main(arguments: argparse.Namespace) -> None:
    """Read the survey's pings and soundings; write its submaps and their poses."""
    how = settings.read(arguments.params, "segment", segmentation.Settings)
    line = study.survey(arguments.params, arguments.name)
    found = segmentation.segment(
        arguments.name,
        artifacts.read_table(arguments.survey / "pings.parquet", survey.PINGS),
        artifacts.read_table(arguments.survey / "soundings.parquet", survey.SOUNDINGS),
        line.submap_length_m,
        line.point_spacing_m,
        how,
    )
    metadata = {
        "survey": arguments.name,
        "params": {
            "segment": settings.as_metadata(how),
            "submap_length_m": line.submap_length_m,
            "point_spacing_m": line.point_spacing_m,
        },
        "dropped": found.dropped,
    }
    artifacts.write_table(arguments.submaps, submap.to_table(found.submaps), submap.POINTS, metadata)
    artifacts.write_table(arguments.poses, found.poses, submap.POSES, metadata)
    print(summary(arguments.name, found))


def summary(name: str, found: segmentation.Segmentation) -> str:
    """Return one line: how many submaps of how many points, and what was left out."""
    sizes = [len(one.points) for one in found.submaps]
    dropped = ", ".join(f"{count} {what}" for what, count in found.dropped.items() if count)
    return (
        f"{name}: {len(sizes)} submaps of {np.mean(sizes):.0f} +- {np.std(sizes):.0f} points;"
        f" left out: {dropped or 'nothing'}"
    )


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("name", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--survey", type=Path, required=True, help="folder of pings.parquet and soundings.parquet")
    parser.add_argument("--submaps", type=Path, required=True, help="points to write, Parquet")
    parser.add_argument("--poses", type=Path, required=True, help="poses to write, Parquet")
    command.run(main, parser)
