"""Files of points, matches, ground truth and cameras: outputs are written whole or not at all.

What cannot be read or written raises `InputError`, whose text names the file, the row or entry, and the remedy.
"""

from __future__ import annotations

from rootmatch.io.calibrations.native import DIRECTIONS
from rootmatch.io.camera_files import (
    Calibration,
    parse_camera,
    parse_direction,
    parse_numbers,
    path_of_camera_text,
    read_camera,
    write_camera,
)
from rootmatch.io.csv_tables import write_table
from rootmatch.io.inputs import read_bytes
from rootmatch.io.known_files import prior_of_frame, read_known
from rootmatch.io.outputs import (
    check_output,
    check_output_folder,
    is_standard_output,
    is_written_through,
    write_atomically,
    write_folder_atomically,
    write_text_atomically,
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
from rootmatch.io.pose_files import finite_or_none, pose_format, pose_record, read_prior, write_poses

__all__ = [
    "DIRECTIONS",
    "Calibration",
    "PointSet",
    "path_of_camera_text",
    "check_output",
    "check_output_folder",
    "finite_or_none",
    "write_folder_atomically",
    "is_standard_output",
    "parse_camera",
    "parse_direction",
    "parse_numbers",
    "point_dimension",
    "pose_format",
    "pose_record",
    "prior_of_frame",
    "read_bytes",
    "read_camera",
    "read_candidates",
    "read_known",
    "read_points",
    "read_prior",
    "read_truth",
    "is_written_through",
    "write_camera",
    "write_matches",
    "write_points",
    "write_poses",
    "write_table",
    "write_text_atomically",
    "write_atomically",
]
