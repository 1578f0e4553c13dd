"""Schemas and names of the tables that stage `stress` writes; without imports that are slow, for the report."""

import pyarrow as pa

PLAIN = "plain"  # no robust estimator
FIRST = "cauchy"  # the kernel that starts from corrupted poses; the others start where it ends
KERNELS = (PLAIN, "huber", FIRST, "dcs", "gnc")
# starts of a search: the solution of kernel FIRST, or the corrupted poses
SETTLED, CORRUPTED = FIRST, "corrupted"
# poses at which the loop gate was tried: the graph's own, navigation, or CORRUPTED
GRAPH, NAVIGATION = "graph", "navigation"
# A row per kernel, start, share, method and repetition. The measures of a failed run are null.
ROWS = pa.schema(
    [
        *((name, pa.string()) for name in ("survey", "kernel", "start", "method")),
        ("share", pa.float64()),  # of false loop closures among all
        ("draw", pa.int32()),  # of the true loop closures
        ("repetition", pa.int32()),  # of the yaw noise and the false ones
        ("true_closures", pa.int32()),
        ("false_closures", pa.int32()),
        *((name, pa.float64()) for name in ("rmse_xyz_m", "truth_rmse_xyz_m", "truth_relative_m")),
        *((name, pa.float64()) for name in ("accepted_true", "accepted_false")),  # weight above estimators.ACCEPTED
        ("failed", pa.bool_()),
    ]
)
# A row per gate that was tried; counts of pairs, which may be null.
GATE = pa.schema(
    [
        ("survey", pa.string()),
        ("at", pa.string()),  # GRAPH, NAVIGATION or CORRUPTED
        ("draw", pa.int32()),  # of the graph's loop closures, or repetition of the corruption
        ("joined", pa.int32()),
        ("covering", pa.float64()),  # the earlier covers enough of the later at the true poses; null without truth
        ("both", pa.float64()),
    ]
)
