"""Schemas of the tables that stage `close` writes, and states; without imports that are slow, for the report."""

from enum import StrEnum

import pyarrow as pa

ERRORS = ("as_it_is_m", "se2_m", "joined_m")  # in the plane: as it is, after the best shift and turn, of joined pairs
# A row per run, believed drift and method; `navigation` is the survey before any closure.
ROWS = pa.schema(
    [
        ("survey", pa.string()),
        ("method", pa.string()),
        ("run", pa.int32()),  # 0: navigation as recorded; others: drifts drawn about the truth
        ("believed", pa.float64()),  # factor of the drift's sigmas
        *((name, pa.float64()) for name in ERRORS),  # rms against the truth; null where it is not known
        # of x and y, 1 is right, and the share of joined pairs whose error lies in the 95 % ellipse that the poses'
        # covariance gives it; null where the truth is not known
        ("pose_nees", pa.float64()),
        ("joined_95", pa.float64()),
        # of closures whose matches fit, at navigation's poses: 1 where drift and closures are as sure as they say
        ("variance_factor", pa.float64()),
        # submaps that return to mapped ground; of them accepted, and flat (ground says nothing); null of navigation
        *((name, pa.float64()) for name in ("closures", "accepted", "flat")),
    ]
)
# A row per submap: the recorded navigation, closed by method map, and one standard deviation of its place.
POSES = pa.schema(
    [("survey", pa.string()), ("submap", pa.int32()), ("time_s", pa.float64())]
    + [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "yaw_rad", "sigma_x_m", "sigma_y_m", "sigma_yaw_rad")]
)
# A row per closure of the recorded navigation by method map, and one per submap that it is registered on.
CLOSURES = pa.schema(
    [
        ("survey", pa.string()),
        ("source", pa.int32()),  # submap
        ("target", pa.int32()),
        ("share", pa.float64()),  # of the registered points that lie over this target; null without a match
        ("state", pa.string()),  # accepted, or why not
        ("rank", pa.int32()),  # directions that the ground holds; 0 without a match, and the next columns null
        ("residual_m", pa.float64()),  # rms of its matches
        ("moved_m", pa.float64()),  # offset at which the search ended, length
        ("sigmas", pa.float64()),  # length of its whitened residual at the solved poses
    ]
)


class State(StrEnum):
    """What became of a closure."""

    ACCEPTED = "accepted"
    UNMATCHED = "unmatched"  # too few points of the source lie over the targets, or the method has no covariance
    FLAT = "flat"  # no direction is held by the ground: nothing to tell the graph
    RESIDUALS = "residuals"  # its matches fit worse than the survey's others
    PREDICTION = "prediction"  # contradicts navigation and the other closures, were drift drift_factor times as large
    OUTVOTED = "outvoted"  # by graduated non-convexity
