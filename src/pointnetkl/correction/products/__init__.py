"""What is written of a corrected survey beside its maps and soundings: text, navigation, lines, graph and ties."""

from collections.abc import Sequence
from pathlib import Path

from pointnetkl.correction.products import graph, lines, mbsystem, navigation_files, tables, ties, trajectories
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise


def write(folder: Path, corrected: Corrected, edge_noise: Sequence[DeadReckoningNoise] | None = None) -> list[str]:
    """Write all products of these kinds into an existing folder; return what is left out and why, in sentences.

    `edge_noise` is that of dead reckoning between consecutive submaps, for the graph.

    Raises:
        CorrectionError: the survey cannot be placed on the earth, or the noises are not of its submaps.
        ArtifactError: a file cannot be written.
    """
    tables.write_closures(folder / "closures.csv", corrected)
    left_out = _of_pings(folder, corrected) if len(corrected.track) else ["no track: the survey has no pings"]
    left_out += ties.write(folder / "ties.txt", corrected)
    if corrected.submaps is None:
        return [*left_out, "no covariances.txt and no graph.g2o: the survey has no submaps along a track"]
    trajectories.write_covariances(folder / "covariances.txt", corrected, corrected.submaps)
    if edge_noise is None:
        return [*left_out, "no graph.g2o: the noise of dead reckoning is not known"]
    return left_out + graph.write(folder / "graph.g2o", corrected, corrected.submaps, edge_noise)


def _of_pings(folder: Path, corrected: Corrected) -> list[str]:
    track = Placed(corrected)
    tables.write_track(folder / "track.csv", track)
    trajectories.write_tum(folder / "trajectory.tum", track)
    lines.write(folder / "lines.gpkg", corrected, track)
    left_out = navigation_files.write(folder / "navigation.sbet", folder / "navigation.smrmsg", track)
    return left_out + mbsystem.write(folder / "na0", folder / "navigation.fnv", track)
