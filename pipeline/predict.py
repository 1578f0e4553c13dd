"""Covariances of one survey's submaps by the methods that learned from the labels of the training surveys."""

import argparse
from pathlib import Path

import pandas as pd

from pointnetkl import artifacts, command, gicp, settings, submap, voxel
from pointnetkl.covariance import learned, method, pointnetkl, table


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's covariance table."""
    registration = settings.read(arguments.params, "registration", gicp.Settings)
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))
    fitted = method.tabulate(learned.methods(learned.read(arguments.fits), registration), submaps)
    clouds = read_clouds(arguments.clouds, [s.number for s in submaps])
    network = pointnetkl.load(arguments.model)
    predicted = table.from_matrices(arguments.survey, network.name, clouds.submap.tolist(), network.predict(clouds))
    metadata = {"survey": arguments.survey, "params": {"registration": settings.as_metadata(registration)}}
    covariances = pd.concat([fitted, predicted], ignore_index=True)
    artifacts.write_table(arguments.covariances, covariances, table.SCHEMA, metadata)


def read_clouds(path: Path, numbers: list[int]) -> voxel.Clouds:
    """Read the clouds of just these submaps; other ones are an error that names both files' stage."""
    clouds = voxel.Clouds.from_arrays(artifacts.read_arrays(path)[0], str(path))
    if clouds.submap.tolist() != numbers:
        raise voxel.VoxelError(
            f"{path}: holds {len(clouds)} clouds, not those of the {len(numbers)} submaps; run dvc repro voxelise"
        )
    return clouds


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey")
    parser.add_argument("--submaps", type=Path, required=True)
    parser.add_argument("--clouds", type=Path, required=True, help="the same submaps as the network sees them")
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--fits", type=Path, required=True)
    parser.add_argument("--covariances", type=Path, required=True)
    command.run(main, parser)
