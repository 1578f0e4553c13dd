"""Schemas and names of the tables that stage `slam` writes; without imports that are slow, for the report."""

import pyarrow as pa

TABLE, AUTHORS = "table", "authors"  # variants: the paper's protocol, and the authors' program with its slips
RMSES = ("rmse_xyz_m", "rmse_se2_m", "rmse_4dof_m")  # as it is, and after alignment in SE(2) and in 4 DoF
# A row per variant, method, draw and repetition; `navigation` has one row, as no repetition changes it.
ROWS = pa.schema(
    [
        ("survey", pa.string()),
        ("variant", pa.string()),  # table; shared or all, the other way to count edges; authors
        ("method", pa.string()),
        ("draw", pa.int32()),  # of the loop closures; 0 is the paper's graph
        ("repetition", pa.int32()),
        *((name, pa.float64()) for name in RMSES),  # against GT
        *((f"truth_{name}", pa.float64()) for name in RMSES),  # against the truth; null where it is not known
        ("truth_relative_m", pa.float64()),  # of pairs that a loop closure joins
        ("map_to_map_m", pa.float64()),  # null in the repetitions that do not measure it
        ("map_to_map_auvlib_m", pa.float64()),
        ("pose_nees", pa.float64()),  # in one repetition
    ]
)
# Of draw 0, repetition 0, for figures; `which` is truth, navigation, gt, corrupted or a method.
TRAJECTORIES = pa.schema(
    [("survey", pa.string()), ("which", pa.string()), ("submap", pa.int32())]
    + [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "yaw_rad")]
)
