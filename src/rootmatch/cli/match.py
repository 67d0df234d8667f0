"""The command ``rootmatch match``: two files of points in, their matches out."""

from __future__ import annotations

import sys
from typing import Any

import typer

from rootmatch.cli import match_options as option
from rootmatch.cli.error_messages import rename_to_options
from rootmatch.cli.exit_codes import NOT_TRUSTED
from rootmatch.cli.frames import FrameOutputs, Job, diagnose_frame, match_frames
from rootmatch.cli.match_outputs import Outputs, print_match
from rootmatch.cli.noise import Noise, noise_option
from rootmatch.cli.problem_options import build_problem, flag
from rootmatch.cli.progress import progress_bar
from rootmatch.errors import InputError, quote_value

OF_ONE_IMAGE = ("candidates", "plot", "photo", "truth", "pose_format", "prior", "report")
"""Options that do not apply to many images."""


def match(
    model: option.Model,
    image: option.Image,
    problem: option.Problem,
    camera: option.Camera = None,
    noise: option.Noise = None,
    source_noise: option.SourceNoise = None,
    vertical_camera: option.VerticalCamera = None,
    vertical_world: option.VerticalWorld = None,
    vertical_noise: option.VerticalNoise = None,
    camera2: option.Camera2 = None,
    axis: option.Axis = None,
    axis2: option.Axis2 = None,
    axis_noise: option.AxisNoise = None,
    centre: option.Centre = None,
    dimension: option.Dimension = None,
    normals: option.Normals = True,
    view_angle: option.ViewAngle = None,
    detection_rate: option.DetectionRate = None,
    resolution: option.Resolution = None,
    min_probability: option.MinProbability = None,
    prior: option.Prior = None,
    known: option.Known = None,
    candidates: option.Candidates = None,
    motions: option.Motions = "1",
    preset: option.Preset = None,
    sampler: option.Sampler = None,
    samples: option.Samples = None,
    residual: option.Residual = None,
    rho: option.Rho = None,
    solver: option.Solver = None,
    max_evaluations: option.MaxEvaluations = None,
    max_hyperedges: option.MaxHyperedges = None,
    max_seconds: option.MaxSeconds = None,
    backend: option.Backend = None,
    scheduler: option.Scheduler = None,
    jobs: option.Jobs = None,
    seed: option.Seed = 0,
    output: option.Output = None,
    poses: option.Poses = None,
    pose_format: option.PoseFormat = None,
    plot: option.Plot = None,
    report: option.Report = None,
    photo: option.Photo = None,
    as_json: option.AsJson = False,
    diagnose: option.Diagnose = False,
    truth: option.Truth = None,
    resume: option.Resume = False,
    progress: option.Progress = None,
) -> None:
    """Match points to image detections by geometry alone.

    If the image file has a column frame, each frame is matched on its own and written as soon as it is done.

    Image x points right and y down; points are raw pixels if the camera file has a lens. The camera looks along +z.

    Exit code 0: matched; 1: untrusted or ambiguous (the best match is still printed); 2: bad input; 130: interrupted.
    """
    given = locals()
    from rootmatch import io
    from rootmatch.io.frame_files import has_frames

    of_many = has_frames(image)
    if of_many:
        refused = [name for name in OF_ONE_IMAGE if given[name] not in (None, False)]
        if refused:
            raise InputError(
                f"{flag(refused[0])}: it applies to one image, but {image} has a column frame or time; leave it out"
            )
        if str(image) == "-":
            raise InputError("-: standard input is read by `rootmatch track`; give a file")
    elif jobs is not None or resume:
        raise InputError(
            f"{'--resume' if jobs is None else '--jobs'}: it applies to many frames, but {image} has no column "
            "frame; leave it out"
        )
    outputs = Outputs(output=output, poses=poses, pose_format=pose_format, plot=plot, report=report, photo=photo)
    frame_outputs = FrameOutputs(output, poses, as_json, resume)
    cameras = [io.path_of_camera_text(text) for text in (camera, camera2) if text is not None]
    inputs = [path for path in (model, image, *cameras, truth, candidates, photo, prior, known) if path is not None]
    if of_many:
        frame_outputs.check(inputs)
    else:
        outputs.check(problem, inputs, as_json)
    posed = build_problem(problem, given)
    of_rig = posed.rig is not None
    if of_rig:
        for name, path in (("plot", plot), ("report", report)):
            if path is not None:
                raise InputError(f"{flag(name)}: it cannot show the several images of a rig; use --json or --output")
    # 0 where the points say it
    source = io.read_points(model, posed.source_dimension or io.point_dimension(model), posed.order)
    posed = posed.for_points(source.points)
    if source.bodies is not None and motions != "1":
        raise InputError(
            f"--motions: {model} has a column body, which says which points move together; leave --motions out"
        )
    if prior is not None and known is not None:
        raise InputError("--known: --prior already gives the whole pose; leave one of them out")
    told = None if known is None else io.read_known(known, source.bodies)
    given_noise = Noise(noise_option(noise), source.sigma, model, image, problem=posed, given_source=source_noise)
    options = option.given_options(source, given_noise, given)
    settings = {"seed": seed, "motions": _motions(motions), "normals": source.normals if normals else None}
    if of_many:
        settings["noise"] = given_noise.of(None)
        subjects = {name: flag(name) for name in (*options, *settings)} | {"source": str(model), "bodies": str(model)}
        with rename_to_options(subjects):
            job = Job(source, posed, options | settings, given_noise, told)
            unmatched = match_frames(job, image, frame_outputs, 1 if jobs is None else jobs, scheduler)
            if diagnose and unmatched is not None:
                print(diagnose_frame(job, image, unmatched), file=sys.stderr)
            if unmatched is not None:
                raise typer.Exit(NOT_TRUSTED)
        return
    target = io.read_points(image, posed.target_dimension, posed.order, of_rig=of_rig, of_image=True)
    if prior is not None and target.known is not None:
        raise InputError(f"--prior: {image} has columns of what is known of the pose; leave one of them out")
    true = io.read_truth(truth, source, target) if truth else None
    predicted = (
        io.prior_of_frame(told, here=target.known) if prior is None else io.read_prior(prior, source.bodies is not None)
    )
    of_image = {
        "scheduler": scheduler,
        "candidates": io.read_candidates(candidates, source, target) if candidates else None,
        "prior": predicted,
    }
    options |= {name: value for name, value in of_image.items() if value is not None}
    subjects = {name: flag(name) for name in (*options, "noise", "motions", "seed")}
    subjects["source_noise"] = given_noise.source_subject
    with (
        rename_to_options({"source": str(model), "target": str(image), **subjects, "bodies": str(model)}),
        progress_bar("hyper-edges", progress) as show,
    ):
        from rootmatch.api import match as find

        noise_of_image = given_noise.of(target.sigma)
        with given_noise.naming(target.sigma):
            found = find(
                source.points, target.points, posed, noise=noise_of_image, progress=show, **settings, **options
            )
    outputs.write(found, source, target, true)
    print_match(
        found=found,
        source=source,
        target=target,
        true=true,
        as_json=as_json,
        estimated=noise == "auto",
        file=sys.stderr if outputs.printed else sys.stdout,
        diagnosis=found.diagnose() if diagnose and not found else None,
    )
    if found.status.name != "MATCHED":
        raise typer.Exit(NOT_TRUSTED)


def _motions(text: str) -> Any:
    """A number, or "auto"."""
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise InputError(f"--motions: {quote_value(text)} given; give a whole number of at least 1, or auto") from None
