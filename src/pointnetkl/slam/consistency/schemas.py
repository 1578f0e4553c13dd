"""Schema of the table of map-to-map errors by thinning; without imports that are slow, for the report."""

import pyarrow as pa

THINNINGS = (1, 2, 4, 8)
THINNING = pa.schema(
    [
        ("survey", pa.string()),
        ("thinning", pa.int32()),  # every so many-th point
        ("cells", pa.int64()),  # that two or more submaps share
        ("map_to_map_m", pa.float64()),  # thinned points are compared with all points: the benchmark's measure
        ("both_thinned_m", pa.float64()),  # thinned points are compared with thinned points
    ]
)
