"""Files of points, matches, ground truth and cameras: errors name the row, outputs are written whole or not at all."""

from __future__ import annotations

from rootmatch.io.calibration import (
    DIRECTIONS,
    Calibration,
    parse_camera,
    parse_direction,
    parse_numbers,
    read_camera,
    write_camera,
)
from rootmatch.io.outputs import check_output, check_output_folder, folder_written_whole, written_whole
from rootmatch.io.points import PointSet, read_candidates, read_points, read_truth, write_matches, write_points
from rootmatch.io.tables import write_table

__all__ = [
    "DIRECTIONS",
    "Calibration",
    "PointSet",
    "check_output",
    "check_output_folder",
    "folder_written_whole",
    "parse_camera",
    "parse_direction",
    "parse_numbers",
    "read_camera",
    "read_candidates",
    "read_points",
    "read_truth",
    "write_camera",
    "write_matches",
    "write_points",
    "write_table",
    "written_whole",
]
