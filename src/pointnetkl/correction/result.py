"""What a correction gives: the track before and after, the loop closures, and a verdict; every product is of these."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.workflow.errors import PointNetKLError

# A row per ping (of another program's submaps: per submap), in order of ping: navigation, its correction, and
# covariances in the axes of the map. A place after is x_m + moved_x_m; so are y and yaw. z, roll and pitch stay.
TRACK = pa.schema(
    [("ping", pa.int32()), ("time_s", pa.float64()), ("file", pa.string())]
    + [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")]
    + [(name, pa.float64()) for name in ("moved_x_m", "moved_y_m", "moved_yaw_rad")]
    # of the pose after the correction, and of navigation before it; x and y are not correlated with yaw here
    + [(name, pa.float64()) for name in ("var_xx_m2", "var_xy_m2", "var_yy_m2", "var_yaw_rad2")]
    + [(f"before_{name}", pa.float64()) for name in ("var_xx_m2", "var_xy_m2", "var_yy_m2", "var_yaw_rad2")]
)
# A row per loop closure: a submap (source) that lies on others. What a refused one lacks is null.
CLOSURES = pa.schema(
    [
        ("source", pa.int32()),  # submap
        ("target", pa.int32()),  # the submap of which most of the overlap is; -1: a reference that is not of the survey
        ("targets", pa.string()),  # all of them, with a blank between
        ("time_s", pa.float64()),  # of the source's middle ping
        ("target_time_s", pa.float64()),
        ("x_m", pa.float64()),  # the overlap's middle in the map frame, after the correction
        ("y_m", pa.float64()),
        ("overlap_m2", pa.float64()),
        # from where navigation has the source on its targets to where it registers, in axes that turn with the targets
        ("shift_x_m", pa.float64()),
        ("shift_y_m", pa.float64()),
        ("v_xx_m2", pa.float64()),  # V of that shift: null in a closure that ground holds in less than two directions
        ("v_xy_m2", pa.float64()),
        ("v_yy_m2", pa.float64()),
        ("rank", pa.int32()),  # directions that the ground holds, 0 to 2
        ("residual_m", pa.float64()),  # rms of its matches along normals
        ("sigmas_before", pa.float64()),  # length of the whitened residual at navigation's poses, and at the corrected
        ("sigmas_after", pa.float64()),
        ("left_out_m", pa.float64()),  # length of its residual, in metres, at the poses that all others give
        ("weight", pa.float64()),  # 1 or 0
        ("state", pa.string()),  # accepted, or why not: slam.closing.schemas.State
    ]
)


class CorrectionError(PointNetKLError):
    """A survey cannot be corrected, or its products cannot be written."""


@dataclass(frozen=True)
class Submaps:
    """The pieces that the track was cut into, in its order."""

    number: np.ndarray  # (n,)
    time_s: np.ndarray  # (n,) of their middle pings
    line: np.ndarray  # (n,) of the survey's lines, from 0
    before: np.ndarray  # (n, 4, 4) T_map_submap by navigation
    after: np.ndarray  # (n, 4, 4) and corrected
    covariance: np.ndarray  # (n, 3, 3) of x, y (m^2, axes of the map) and yaw, after
    length_m: float  # along the track
    spacing_m: float  # of their points


@dataclass(frozen=True)
class Verdict:
    """Whether the correction was applied, and the numbers that decide; NaN where there is nothing to measure."""

    applied: bool
    sentence: str  # for people: what was done, and by which numbers
    closures: int  # submaps that return to mapped ground
    accepted: int
    left_out_before_m: float  # rms of closures, each left out of the solution in turn, at navigation's poses
    left_out_after_m: float  # and where the others predict it
    left_out_p: float  # that the latter is no smaller, by chance
    disagreement_before_m: float  # rms over cells of the depths that two passes give
    disagreement_after_m: float
    variance_factor: float  # of the closures at navigation's poses: 1 where drift and closures are as sure as they say
    drift: str  # what drift of navigation was assumed, in words


@dataclass(frozen=True)
class Corrected:
    """A survey corrected, or left as it was."""

    name: str
    kind: str  # surveys.survey.SWATHS, POINTS or SUBMAPS
    crs: str  # projected CRS of the map frame; "local" where the data have none
    origin: tuple[float, float]  # easting, northing of the map frame's origin in it, metres
    vertical: Sequence[str]  # levels that depths are below, as the files name them
    track: pd.DataFrame  # TRACK; no rows without pings
    submaps: Submaps | None  # None where there is no track to cut
    closures: pd.DataFrame  # CLOSURES
    verdict: Verdict

    @property
    def rms_moved_m(self) -> float:
        """Return the rms correction in the plane over all pings, metres; 0 without pings."""
        moved = self.track[["moved_x_m", "moved_y_m"]].to_numpy(np.float64)
        return float(np.sqrt((moved**2).sum(axis=1).mean())) if len(moved) else 0.0
