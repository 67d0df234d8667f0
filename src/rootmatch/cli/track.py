"""The command ``rootmatch track``: frames in order, each predicted from those before, written as they come."""

from __future__ import annotations

import gc
import math
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rootmatch.cli import match_options as option
from rootmatch.cli.error_messages import rename_to_options
from rootmatch.cli.exit_codes import NOT_TRUSTED
from rootmatch.cli.frames import FrameOutputs, warn_of_unused
from rootmatch.cli.noise import Noise, noise_option
from rootmatch.cli.problem_options import build_problem, flag
from rootmatch.cli.surroundings import note_remainder
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.tracking.tracker import TrackingOptions

motion = option.option_factory("Motion")

Velocity = Annotated[
    float | None,
    motion("Speed of the body on each axis, in its radii per second; 0.3 for a map.", metavar="R/S", default="15"),
]
Acceleration = Annotated[
    float | None, motion("Acceleration on each axis, in radii/s²; 1 for a map.", metavar="R/S2", default="100")
]
AngularVelocity = Annotated[
    float | None, motion("Angular speed about each axis, in degrees/s.", metavar="DEG/S", default="229")
]
AngularAcceleration = Annotated[
    float | None, motion("Angular acceleration about each axis, in degrees/s².", metavar="DEG/S2", default="1719")
]
SearchBudget = Annotated[
    int | None,
    motion(
        "Evaluations of a frame's search at 60 frames/s; more for a body of many points.", metavar="N", default="60000"
    ),
]
TURNING = "angular_velocity", "angular_acceleration"

RATE = 60.0
"""Frames a second where neither --rate nor a column time says it."""


def tracking_options(given: Mapping[str, Any]) -> TrackingOptions:
    """The options of `rootmatch.Tracker` that are given."""
    from rootmatch.tracking.motion_filter import MotionOptions
    from rootmatch.tracking.tracker import TrackingOptions

    moves = {name: given[name] for name in ("velocity", "acceleration", *TURNING) if given[name] is not None}
    for name, value in moves.items():
        if not 0.0 < value < math.inf:
            raise InputError(f"{flag(name)}: {value:g} given; give a number above 0")
    moves |= {name: math.radians(moves[name]) for name in TURNING if name in moves}
    budget = {} if given["search_budget"] is None else {"search_budget": given["search_budget"]}
    return TrackingOptions(motion=MotionOptions(**moves), **budget)


Model = Annotated[Path, typer.Argument(metavar="MODEL.csv", help="Points x,y,z in space, of one or several bodies.")]
Problem = Annotated[
    Literal["p3p", "up2p", "rigid", "similarity"],
    option.points("What is known: p3p, up2p, rigid or similarity.", metavar="PROBLEM"),
]
Camera = Annotated[
    str | None,
    option.points(
        "p3p, up2p: FX,FY,CX,CY in pixels, or a calibration file (OpenCV, COLMAP, Kalibr, ROS, our JSON).",
        metavar="CAMERA",
    ),
]
StatedNoise = Annotated[
    str | None,
    option.points(
        "Standard deviation of a coordinate, in pixels; rigid, similarity: in the points' unit, SOURCE,TARGET if the "
        "model is noisy.",
        metavar="SIGMA",
        default="1, or the columns sigma or sxx,sxy,syy",
    ),
]
Prior = Annotated[
    Path | None,
    option.points(
        "Predicted pose of the first frame, as for rootmatch match; with several bodies, by label.", metavar="JSON"
    ),
]
Frames = Annotated[
    Path,
    typer.Argument(
        metavar="FRAMES.csv|-",
        help="Detections frame|time,x,y[,z,camera,sigma|sxx,sxy,syy] in order; - reads standard input.",
    ),
]
Rate = Annotated[
    float | None,
    option.points(
        "Frames per second; missing frame numbers count as elapsed time.",
        metavar="HZ",
        default="60, or the column time",
    ),
]
Poses = Annotated[
    Path | None,
    option.output(
        "Write one row per frame: status, and pose with its covariance; .tum: a trajectory.",
        metavar="FILE",
        default="standard output",
    ),
]
PoseFormat = Annotated[
    Literal["csv", "tum"] | None,
    option.output(
        "Format of the poses; tum: for each matched frame, its time and the camera in the frame of the points.",
        default="by the suffix",
    ),
]
AsJson = Annotated[bool, option.output("--json", "Print one JSON object for each frame, one per line.")]
Diagnose = Annotated[bool, typer.Option("--diagnose", hidden=True)]
SkipBadFrames = Annotated[
    bool,
    typer.Option(
        "--skip-bad-frames",
        help="Leave out frames that are faulty or out of order, with a warning; by default they end the run.",
    ),
]
Matches = Annotated[Path | None, option.output("Write frame,source,target,weight,motion.", metavar="CSV")]


def track(
    model: Model,
    frames: Frames,
    problem: Problem,
    camera: Camera = None,
    rate: Rate = None,
    noise: StatedNoise = None,
    source_noise: option.SourceNoise = None,
    vertical_camera: option.VerticalCamera = None,
    vertical_world: option.VerticalWorld = None,
    vertical_noise: option.VerticalNoise = None,
    prior: Prior = None,
    known: option.Known = None,
    normals: option.Normals = True,
    view_angle: option.ViewAngle = None,
    detection_rate: option.DetectionRate = None,
    resolution: option.Resolution = None,
    min_probability: option.MinProbability = None,
    max_seconds: option.MaxSeconds = None,
    velocity: Velocity = None,
    acceleration: Acceleration = None,
    angular_velocity: AngularVelocity = None,
    angular_acceleration: AngularAcceleration = None,
    search_budget: SearchBudget = None,
    seed: option.Seed = 0,
    poses: Poses = None,
    pose_format: PoseFormat = None,
    output: Matches = None,
    as_json: AsJson = False,
    skip_bad_frames: SkipBadFrames = False,
    diagnose: Diagnose = False,
) -> None:
    """Follow one or several bodies through the frames of a camera or an optical tracker.

    Each frame is predicted from the previous ones. A row is written as soon as
    its frame is complete: at an empty line, or when the next frame begins.

    Exit code 0: something was matched; 1: nothing in any frame; 2: bad input;
    130: interrupted, and rows written so far are kept.
    """
    given = locals()
    from rootmatch import io
    from rootmatch.io.frame_files import STANDARD_INPUT, read_frames

    if diagnose:
        raise InputError(
            "--diagnose: `rootmatch match --diagnose` with the same files diagnoses the first frame that is not matched"
        )
    if rate is not None and not 0.0 < rate < float("inf"):
        raise InputError(f"--rate: {rate:g} given; give a number of frames per second above 0")
    given_files = model, frames, prior, known, None if camera is None else io.path_of_camera_text(camera)
    inputs = [path for path in given_files if path is not None and path != STANDARD_INPUT]
    outputs = _outputs(output, poses, pose_format, as_json=as_json)
    outputs.check(inputs)
    given_noise = noise_option(noise)
    if given_noise == "auto":
        raise InputError(
            "--noise: auto given; a tracker needs a number; `rootmatch match` can estimate it from a single frame"
        )
    tracking = tracking_options(given)
    posed = build_problem(problem, given)
    from rootmatch.cli.frame_outputs import FrameWriter
    from rootmatch.cli.track_summary import Queue, TrackSummary
    from rootmatch.precompile.ahead_of_time import load_tracker
    from rootmatch.tracking.tracker import Tracker

    source = io.read_points(model, posed.source_dimension or io.point_dimension(model), posed.order)
    posed = posed.for_points(source.points)
    first = None if prior is None else io.read_prior(prior, source.bodies is not None)
    told = None if known is None else io.read_known(known, source.bodies)
    noises = Noise(given_noise, source.sigma, model, frames, problem=posed, given_source=source_noise)
    options = option.given_options(source, noises, given) | {"seed": seed}
    if normals and source.normals is not None:
        options["normals"] = source.normals
    subjects = {name: flag(name) for name in (*options, "noise")} | {"source_noise": noises.source_subject}
    if outputs.trajectory and source.bodies is not None:
        raise InputError(f"--pose-format: tum is a trajectory of one body, but {model} has a column body; give csv")
    summary, queue = TrackSummary(rate or RATE), Queue()
    with (
        rename_to_options({"source": str(model), **subjects, "bodies": str(model), "normals": str(model)}),
        warnings.catch_warnings(),
    ):
        note_remainder("what was written is kept")
        warnings.filterwarnings("ignore", message="time: the frames are")  # the summary says it, of more frames
        of_rig = posed.rig is not None
        with FrameWriter(outputs, source, posed) as writer:  # before kernels are loaded, as it may refuse
            tracker = Tracker(source.points, posed, noise=noises.of(None), tracking=tracking, **options)
            load_tracker(posed, source.points, **{name: one for name, one in options.items() if name != "max_seconds"})
            gc.freeze()  # a garbage collection of all that was imported would hold up a frame by 0.05 to 0.2 s
            for frame in read_frames(frames, posed.target_dimension, of_rig=of_rig, skipping=skip_bad_frames):
                if frame.time is not None and rate is not None:
                    raise InputError(f"--rate: {frames} has a column time; leave one of them out")
                when = frame.number / (rate or RATE) if frame.time is None else frame.time
                weights = None if frame.sigma is None else noises.of(frame.sigma)
                known_here = io.prior_of_frame(told, frame.number, when, frame.known)
                predicted: Any = known_here if first is None else first
                try:
                    if frame.fault is not None:
                        raise InputError(frame.fault)
                    with noises.naming(frame.sigma):
                        found = tracker.update(frame.points, time=when, noise=weights, prior=predicted)
                except InputError as error:
                    if not skip_bad_frames:
                        raise InputError(f"{error} (frame {frame.number})") from None
                    print(f"rootmatch: warning: frame {frame.number} is left out: {error}", file=sys.stderr)
                    summary.skipped += 1
                    continue
                statuses = writer.write(frame.number, when, found, tracker)
                summary.take(found, statuses, when, timed=frame.time is not None, known=predicted is not None)
                first = None
                if frames == STANDARD_INPUT and (late := queue.take(when, found.seconds)):
                    print(f"rootmatch: {late}", file=sys.stderr)
    warn_of_unused(told)
    for line in summary.lines():
        print(f"rootmatch: {line}", file=sys.stderr)
    if not summary.statuses["matched"]:
        raise typer.Exit(NOT_TRUSTED)


def _outputs(output: Path | None, poses: Path | None, form: str | None, *, as_json: bool) -> FrameOutputs:
    """Where the results go; refuses options that ask for two things in one place."""
    from rootmatch.io import is_standard_output

    if form is not None and poses is None and as_json:
        raise InputError("--pose-format: --json prints the poses in its own format; give --poses FILE")
    if not as_json and poses is None and output is not None and is_standard_output(output):
        raise InputError("--output: without --poses FILE the poses go to standard output; give one of them a file")
    is_tum = form == "tum" or (form is None and poses is not None and poses.suffix == ".tum")
    return FrameOutputs(output, poses, as_json=as_json, resume=False, trajectory=is_tum)
