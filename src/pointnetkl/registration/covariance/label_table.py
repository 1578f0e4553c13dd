"""Tables of labels, as the stages label and vary write them: light, so that the report can import it."""

import pyarrow as pa

from pointnetkl.registration.covariance import table

LABELS = pa.schema(
    [
        ("submap", pa.int32()),
        # of the errors of a registration, as `monte_carlo.errors` defines them
        *((name, pa.float64()) for name in ("q_xx_m2", "q_xy_m2", "q_yy_m2")),
        ("mean_x_m", pa.float64()),  # of the errors: the registration's bias, part of Q
        ("mean_y_m", pa.float64()),
        ("runs", pa.int32()),
        ("converged_share", pa.float64()),
        ("main_basin_share", pa.float64()),
        ("iterations_mean", pa.float64()),
        # standard errors of q_xx, q_xy, q_yy, from the errors' fourth moments
        *((name, pa.float64()) for name in ("se_xx_m2", "se_xy_m2", "se_yy_m2")),
        ("relative_error", pa.float64()),  # the largest standard error of a variance u^T Q u, as a share of it
        ("spacing_m", pa.float64()),  # median distance to the nearest neighbour, in the target
        ("self_matching", pa.bool_()),
    ]
)
# What labels of x, y and yaw have too; w is yaw.
_ALSO = ("mean_w_rad", "se_xw_m_rad", "se_yw_m_rad", "se_ww_rad2")
YAW = pa.schema([*table.YAW, *((name, pa.float64()) for name in _ALSO)])

RUNS, CONDITIONS = "runs", "conditions"  # studies: parts of many runs; labels under other spacings and noises
VARIATIONS = pa.schema(
    [
        ("survey", pa.string()),
        ("submap", pa.int32()),
        ("study", pa.string()),
        ("copy", pa.string()),
        ("noise_sigma_m", pa.float64()),
        ("cell_m", pa.float64()),  # edge of the cells that one point each was drawn from
        ("spacing_m", pa.float64()),  # median distance to the nearest neighbour, in the target
        ("points", pa.int32()),  # of the target
        ("repeat", pa.int32()),  # place among the parts of `runs` runs, of study `runs`; no run is in two of them
        ("runs", pa.int32()),
        *[(name, pa.float64()) for name in ("q_xx_m2", "q_xy_m2", "q_yy_m2", "relative_error")],
        *[(name, pa.float64()) for name in ("mean_x_m", "mean_y_m")],
        *[(name, pa.float64()) for name in ("converged_share", "main_basin_share", "iterations_mean")],
    ]
)


def schema(dimensions: int) -> pa.Schema:
    """Return the schema of a table of labels of M dimensions, 2 or 3."""
    return LABELS if dimensions == 2 else pa.schema([*LABELS, *YAW])


def variations_schema(dimensions: int) -> pa.Schema:
    """Return the schema of a table of varied labels of M dimensions, 2 or 3."""
    return VARIATIONS if dimensions == 2 else pa.schema([*VARIATIONS, *table.YAW])
