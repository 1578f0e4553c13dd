"""Compute every submap's canonical cloud, the network's input: zero-mean, in the unit sphere, one point a voxel."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

from pointnetkl.surveys import submap, voxel
from pointnetkl.workflow import artifacts, command, compute, parameters


def main(arguments: argparse.Namespace) -> None:
    """Read a survey's submaps; write their clouds."""
    settings = parameters.read(arguments.params, "voxelise", voxel.Settings)
    artifacts.require_survey(arguments.name, arguments.submaps)

    def canonical(cloud: submap.Submap) -> tuple[int, voxel.Canonical]:
        origin = f"{cloud.survey}, submap {cloud.number}"
        return cloud.number, voxel.canonical(cloud.points, settings.voxel, origin)

    submaps = submap.stream(arguments.name, arguments.submaps)  # a large survey's do not fit in memory
    numbered = compute.in_threads(canonical, submaps, "voxelise")
    clouds = voxel.Clouds.join([number for number, _ in numbered], [cloud for _, cloud in numbered])
    metadata = {"survey": arguments.name, "params": {"voxelise": parameters.as_metadata(settings)}}
    artifacts.write_arrays(arguments.clouds, clouds.to_arrays(), metadata)
    print(f"{arguments.name}: {len(clouds)} clouds, {len(clouds.points)} points, sigma_z {voxel.sigma_z(clouds):.4g}")


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("name", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--submaps", type=Path, required=True, help="points of the submaps, Parquet")
    parser.add_argument("--clouds", type=Path, required=True, help="clouds to write, npz")
    command.run(main, parser)
