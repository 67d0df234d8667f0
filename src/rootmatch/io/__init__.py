"""Files of points, matches, ground truth and cameras: outputs are written whole or not at all.

What cannot be read or written raises `InputError`, whose text names the file, the row or entry, and the remedy.
"""

from __future__ import annotations

from rootmatch.io.camera_files import Calibration, parse_camera, path_of_camera_text, read_camera, write_camera
from rootmatch.io.csv_tables import write_table
from rootmatch.io.known_files import prior_of_frame, read_known
from rootmatch.io.outputs import (
    check_output,
    check_output_folder,
    is_standard_output,
    write_atomically,
    write_folder_atomically,
)
from rootmatch.io.point_files import (
    PointSet,
    point_dimension,
    read_candidates,
    read_points,
    read_truth,
    write_matches,
    write_points,
)
from rootmatch.io.pose_files import pose_format, read_prior, write_poses

__all__ = [
    "Calibration",
    "PointSet",
    "check_output",
    "check_output_folder",
    "is_standard_output",
    "parse_camera",
    "path_of_camera_text",
    "point_dimension",
    "pose_format",
    "prior_of_frame",
    "read_camera",
    "read_candidates",
    "read_known",
    "read_points",
    "read_prior",
    "read_truth",
    "write_atomically",
    "write_camera",
    "write_folder_atomically",
    "write_matches",
    "write_points",
    "write_poses",
    "write_table",
]
