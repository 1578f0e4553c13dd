"""PCD files, written by Open3D."""

from pathlib import Path

import numpy as np
import open3d

CLOUD = (np.random.default_rng(0).normal(size=(400, 3)).round(1) * [40, 40, 2] - [0, 0, 8]).astype(np.float32)
POSE = "11.5 -45.25 4.625 0.96 0.0 0.28 0.0"  # x y z, qw qx qy qz: nose down, which is to be levelled
FORMS = {"ascii": {"write_ascii": True}, "binary": {}, "compressed": {"compressed": True}}


def write(path: Path, form: str, pose: str = POSE) -> Path:
    """Write the cloud by Open3D, with a pose."""
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(CLOUD))
    open3d.io.write_point_cloud(str(path), cloud, **FORMS[form])
    path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0 0 0 1 0 0 0", f"VIEWPOINT {pose}".encode()))
    return path
