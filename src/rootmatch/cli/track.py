"""The command ``rootmatch track``: frames in order, each predicted from those before, written as they come."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Any

import typer

from rootmatch.cli import match_options as option
from rootmatch.cli.error_messages import option_names_in_errors
from rootmatch.cli.exit_codes import NOT_TRUSTED
from rootmatch.cli.frames import FrameOutputs
from rootmatch.cli.problem_options import angle, build_problem, flag
from rootmatch.errors import InputError, quoted

Frames = Annotated[
    Path,
    typer.Argument(metavar="FRAMES.csv|-", help="Detections frame,x,y[,camera] in order; - reads them."),
]
Rate = Annotated[
    float, typer.Option(metavar="HZ", help="Frames a second; missing numbers are time.", rich_help_panel=option.INPUT)
]
Poses = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="Write a row for each frame: status and pose with its covariance.",
        show_default="standard output",
        rich_help_panel=option.OUTPUT,
    ),
]
Matches = Annotated[
    Path | None,
    typer.Option(metavar="CSV", help="Write frame,source,target,weight,motion.", rich_help_panel=option.OUTPUT),
]


def track(
    model: option.Model,
    frames: Frames,
    problem: option.Problem,
    camera: option.Camera = None,
    rate: Rate = 60.0,
    noise: option.Noise = "1",
    vertical_camera: option.VerticalCamera = None,
    vertical_world: option.VerticalWorld = None,
    vertical_noise: option.VerticalNoise = None,
    normals: option.Normals = True,
    view_angle: option.ViewAngle = None,
    detection_rate: option.DetectionRate = None,
    max_seconds: option.MaxSeconds = None,
    seed: option.Seed = 0,
    poses: Poses = None,
    output: Matches = None,
) -> None:
    """Follow a body, or several, through the frames of a camera.

    Each frame is predicted from those before. Every row is written as soon as its frame is complete, which is when the
    next one begins.

    Exit code 0: something was matched; 1: nothing in any frame; 2: bad input; 130: interrupted, what was written stays.
    """
    given: dict[str, str | float | int | None] = {
        "camera": camera,
        "vertical_camera": vertical_camera,
        "vertical_world": vertical_world,
        "vertical_noise": vertical_noise,
    }
    if not rate > 0.0 or rate == float("inf"):
        raise InputError(f"--rate: {rate:g} given; give frames a second, above 0")
    FrameOutputs(output, poses, as_json=False, resume=False).check([model, frames])
    try:
        sigma = float(noise)
    except ValueError:
        raise InputError(f"--noise: {quoted(noise)} given; give a number of pixels") from None
    posed = build_problem(str(problem), given)
    from rootmatch import io
    from rootmatch.cameras.rig import rig_of
    from rootmatch.cli.frame_outputs import COVARIANCES, MATCH_COLUMNS, POSE_COLUMNS, Appended, match_rows, pose_rows
    from rootmatch.io.frame_files import read_frames
    from rootmatch.tracking.tracker import Tracker

    source = io.read_points(model, posed.source_dimension or io.point_dimension(model), posed.order)
    posed = posed.for_points(source.points)
    options: dict[str, Any] = {
        "normals": source.normals if normals else None,
        "view_angle": None if view_angle is None else angle("view_angle", view_angle, 180.0),
        "detection_rate": detection_rate,
        "max_seconds": max_seconds,
        "bodies": source.bodies,
        "seed": seed,
    }
    options = {name: value for name, value in options.items() if value is not None}
    subjects = {name: flag(name) for name in (*options, "noise")}
    header = (*POSE_COLUMNS, *COVARIANCES)
    count: Counter[str] = Counter()
    with (
        option_names_in_errors({"source": str(model), **subjects, "bodies": str(model), "normals": str(model)}),
        ExitStack() as files,
    ):
        tracker = Tracker(source.points, posed, noise=sigma, **options)
        matches = files.enter_context(closing(Appended(output, MATCH_COLUMNS, False))) if output else None
        table = files.enter_context(closing(Appended(poses, header, False))) if poses else None
        printed = csv.writer(sys.stdout, lineterminator="\n")
        if table is None:
            printed.writerow(header)
        for frame in read_frames(frames, posed.target_dimension, of_rig=rig_of(posed) is not None):
            found = tracker.update(frame.points, time=frame.number / rate)
            rows = pose_rows(frame.number, found)
            if table is not None:
                table.write(rows)
            else:
                printed.writerows(rows)
                sys.stdout.flush()
            if matches is not None:
                matches.write(match_rows(frame.number, found, source))
            count.update(row[2] for row in rows)
    text = ", ".join(f"{count[status]} {status}" for status in ("matched", "ambiguous", "untrusted"))
    print(f"rootmatch: {text}", file=sys.stderr)
    if not count["matched"]:
        raise typer.Exit(NOT_TRUSTED)
