"""Is what a label needs in the clouds that PointNetKL sees? Four numbers over slopes, from points and from voxels.

`structure_tensor` is fitted to the labels of each test survey itself, once from the submaps' points and once from the
voxelised clouds, taken back to metres: the least mean KL (nats) that this form can reach there. Where both are alike,
voxelisation has hidden nothing that this form needs.
"""

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting, structure_tensor
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table, table
from pointnetkl.reporting import text_table
from pointnetkl.surveys import submap, voxel
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Fit, and print a table."""
    surveys = arguments.surveys or list(study.read(arguments.params).test)
    rows = [row(arguments, name) for name in surveys]
    print(text_table.markdown([text_table.block(str(__doc__).splitlines()[0], rows, list(rows[0]))]))


def row(arguments: argparse.Namespace, name: str) -> dict[str, Any]:
    """Return the sizes of a survey's clouds, and the mean KL of both fits."""
    params, folder = arguments.params, arguments.data / "test" / name
    settings = parameters.read(params, "fit", fitting.Settings)
    label = parameters.read(params, "label", monte_carlo.Settings)
    registration = parameters.read(params, "registration", gicp.Settings)
    columns = label_table.schema(registration.dimensions)
    labels = table.to_matrices(artifacts.read_table(folder / "labels.parquet", columns).sort_values("submap"))
    submaps = list(submap.stream(name, folder / "submaps.parquet"))
    seen, setup = list(voxelised(submaps, folder / "clouds.npz")), SelfRegistration(settings.seed, label, registration)
    both = [structure_tensor.fit(fitting.Training(each, labels, setup), settings) for each in (submaps, seen)]
    return {
        "survey": name,
        "submaps": len(submaps),
        "points": sum(len(s.points) for s in submaps) / len(submaps),
        "voxelised": sum(len(s.points) for s in seen) / len(seen),
        "kl_points": both[0].mean_kl,
        "kl_voxelised": both[1].mean_kl,
    }


def voxelised(submaps: list[submap.Submap], path: Path) -> Iterator[submap.Submap]:
    """Yield the submaps with the points that a network sees, in metres."""
    clouds = voxel.Clouds.from_arrays(artifacts.read_arrays(path)[0], str(path))
    for i, whole in enumerate(submaps):
        cloud = clouds.cloud(i)
        yield dataclasses.replace(whole, points=cloud.points.astype(float) * cloud.radius)


if __name__ == "__main__":
    parser = command.parser(__doc__ or "")
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--surveys", nargs="+", help="test surveys (default: all)")
    command.run(main, parser)
