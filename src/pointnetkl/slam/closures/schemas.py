"""Schemas and names of the tables that stage `calibrate` writes; without imports that are slow, for the report."""

import pyarrow as pa

from pointnetkl.registration.covariance import table

BUILT, TO_GT, PLACED = KINDS = ("error", "gt_error", "placed_error")  # errors of a registration: see CLOSURES
DESCRIPTION = ("overlap", "patchiness", "outside", "given_m", "heading_m")  # columns about a submap, not about a draw
CLOSURES = pa.schema(
    [
        ("survey", pa.string()),
        ("draw", pa.int32()),
        ("submap", pa.int32()),  # the registered one
        ("targets", pa.int32()),  # number of submaps it was registered to
        ("converged", pa.bool_()),
        # share of its footprint that its targets have too, at the true poses (GT where the truth is not known)
        ("overlap", pa.float64()),
        ("patchiness", pa.float64()),  # see `terrain`
        ("outside", pa.float64()),  # share of its squared slopes on the ground that its targets do not have
        # in its frame: against the truth, against GT, and of the registration with all submaps at their true poses
        *((f"{kind}_{axis}_m", pa.float64()) for kind in KINDS for axis in "xy"),
        ("given_m", pa.float64()),  # error of its GT pose, as seen from its targets, before it was perturbed
        ("heading_m", pa.float64()),  # error if the ground in common lay exactly right and only GT's yaw was wrong
    ]
)
YAW = pa.schema([(f"{kind}_w_rad", pa.float64()) for kind in KINDS])  # where registrations find yaw too
# A row for each registration of CLOSURES and method of catalogue.OF_REGISTRATIONS: the placed error that the method
# judges, which is CLOSURES' own but for map's, and its covariance, both in the submap's frame.
ENDS = pa.schema(
    [
        ("survey", pa.string()),
        ("draw", pa.int32()),
        ("submap", pa.int32()),
        ("method", pa.string()),
        *((f"{PLACED}_{axis}_m", pa.float64()) for axis in "xy"),
        *((name, table.SCHEMA.field(name).type) for name in table.SCHEMA.names if name.startswith("q_")),
    ]
)
ENDS_YAW = pa.schema([(f"{PLACED}_w_rad", pa.float64()), *table.YAW])


def schema(dimensions: int) -> pa.Schema:
    """Return the schema of a table of loop closures' errors of M dimensions, 2 or 3."""
    return CLOSURES if dimensions == 2 else pa.schema([*CLOSURES, *YAW])


def ends_schema(dimensions: int) -> pa.Schema:
    """Return the schema of a table of ends of M dimensions, 2 or 3."""
    return ENDS if dimensions == 2 else pa.schema([*ENDS, *ENDS_YAW])
