# SPDX-License-Identifier: MIT OR Apache-2.0

"""The command line."""

import argparse
import asyncio
import os
import sys
from pathlib import Path
from typing import Any

from . import __version__, manifest, report
from .executors import ClusterError, Local, Ray
from .manifest import Manifest, ManifestError
from .program import Program, ProgramError
from .progress import Progress
from .run import WORK, Job, Run, Settings

EXIT_CODES = """Exit codes: 0 all was done, 1 a clip failed and the others were done, 2 the command line cannot be carried out,
130 interrupted; the same command goes on from there."""

# Frames before a part of a film that is steadied: after four seconds at 60 frames a second, the virtual camera is where it
# would be in the whole film.
STEADIED_HALO = 240
# Options of `rsrectify fix` by which it finds the motion, and with it the steadied path and its crop.
ANALYSIS = {f"--{name}" for name in ("readout-time", "inter-frame-delay", "readout-direction", "camera", "stabilised", "effort",
                                    "estimator", "model", "focal-length", "lookahead", "grid-columns", "grid-rows", "stabilize", "crop")}


def main(arguments: list[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    try:
        code: int = options.action(options)
        return code
    except (ManifestError, ProgramError, ClusterError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted: the same command goes on from here", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rsrectify-batch", description=__doc__)
    parser.description = "Rectifies many clips, or one long film, by many processes of the program rsrectify."
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    rectify = commands.add_parser(
        "rectify", help="rectify clips, or go on where a run has stopped", epilog=EXIT_CODES
    )
    rectify.set_defaults(action=_rectify)
    rectify.add_argument("clips", nargs="+", metavar="CLIP", help="clips, or folders with all that is below them")
    rectify.add_argument("--output", "-o", required=True, type=Path, metavar="FOLDER", help="the folder for all")
    rectify.add_argument("--afresh", action="store_true", help="forget what an earlier run has done there")
    rectify.add_argument("--overwrite", action="store_true", help="replace files that are there already")
    rectify.add_argument("--program", default="rsrectify", metavar="PATH", help="the program, on all machines")

    where = rectify.add_argument_group("workers")
    where.add_argument("--workers", type=_positive, default=os.cpu_count(), metavar="N",
                       help="processes at a time on this machine (one for each processor)")
    where.add_argument("--address", metavar="ADDRESS",
                       help="a Ray cluster instead of this machine: its address, or auto")
    where.add_argument("--processors", type=_positive, default=1, metavar="N",
                       help="processors of each worker (1): with 4K, 2 to 4 take less memory")
    where.add_argument("--retries", type=int, default=2, metavar="N",
                       help="how often a step that was broken off is tried again (2)")

    split = rectify.add_argument_group("parts of long clips")
    split.add_argument("--part", type=_positive, default=600, metavar="FRAMES",
                       help="frames of a part, about: it ends at a cut where one is near (600)")
    split.add_argument("--halo", type=int, default=60, metavar="FRAMES",
                       help="frames before a part that are analysed too (60)")

    camera = rectify.add_argument_group("camera")
    camera.add_argument("--same-camera", action="store_true",
                        help="all clips were made by one camera in one mode: one readout for all")
    camera.add_argument("--readout-time", type=float, metavar="MS", help="known already: nothing is measured")
    camera.add_argument("--readout-direction", metavar="DIRECTION", help="the edge that is read first, as for rsrectify fix")
    camera.add_argument("--camera", metavar="NAME",
                        help="the camera whose readout is expected, as for rsrectify fix (the one that a clip names)")
    camera.add_argument("--focal-length", type=float, metavar="WIDTHS", help="in frame widths, where it is known")

    written = rectify.add_argument_group("files that are written")
    for name in ("codec", "container", "quality", "bitrate", "audio"):
        written.add_argument(f"--{name}", help="as for rsrectify fix")
    written.add_argument("--stabilize", type=float, metavar="SECONDS",
                         help="steady the picture, as for rsrectify fix; 10 per cent are cut away, or what --fix --crop says")
    written.add_argument("--motion", action="store_true",
                         help="beside each result a motion file of the clip, for filters in editors: CLIP.motion; "
                              "the least crop of each clip is then found")
    written.add_argument("--fix", nargs=argparse.REMAINDER, default=[], metavar="OPTION",
                         help="further options of rsrectify fix, up to the end of the line")

    status = commands.add_parser("status", help="say how far a run has come")
    status.set_defaults(action=_status)
    status.add_argument("output", type=Path, metavar="FOLDER", help="the folder that it writes to")

    page = commands.add_parser("report", help=f"write a page over all clips of a run, {report.NAME}, into its folder")
    page.set_defaults(action=_report)
    page.add_argument("output", type=Path, metavar="FOLDER", help="the folder that it writes to")
    return parser


def _positive(text: str) -> int:
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def _given(options: argparse.Namespace, *names: str) -> list[str]:
    """The options that were given, as arguments of the program."""
    values = [(name, getattr(options, name.replace("-", "_"))) for name in names]
    return [f"--{name}={value}" for name, value in values if value is not None]


def _analysis_first(options: list[str]) -> tuple[list[str], list[str]]:
    """Options of `rsrectify fix`, those of the analysis, which `rsrectify track` has, too, and the rest."""
    analysis: list[str] = []
    rest: list[str] = []
    chosen = rest
    for option in options:
        # A value follows its option, or is one with it.
        if option.startswith("--"):
            chosen = analysis if option.split("=")[0] in ANALYSIS else rest
        chosen.append(option)
    return analysis, rest


def _rectify(options: argparse.Namespace) -> int:
    is_given = options.readout_time is not None
    direction, focal_length = _given(options, "readout-direction"), _given(options, "focal-length")
    camera = _given(options, "camera")
    # Parts of a film must be cropped alike, which a motion file sees to; and a steadied path depends on more frames before it.
    is_steadied = bool(options.stabilize)
    is_crop_open = is_steadied and not options.motion and not any(one.startswith("--crop") for one in options.fix)
    crop = ["--crop=10"] if is_crop_open else []
    fix_options = [*_given(options, "codec", "quality", "bitrate", "stabilize"), *crop, *focal_length, *camera, *options.fix]
    track_options: list[str] = []
    if options.motion:
        track_options, fix_options = _analysis_first(fix_options)
    settings = Settings(
        program=options.program,
        part=options.part,
        halo=max(options.halo, STEADIED_HALO) if is_steadied else options.halo,
        same_camera=options.same_camera,
        readout=[*_given(options, "readout-time"), *direction] if is_given else [],
        measure_options=[] if is_given else [*direction, *focal_length, *camera],
        fix_options=fix_options,
        join_options=_given(options, "audio"),
        motion=options.motion,
        track_options=track_options,
        processors=options.processors,
        retries=options.retries,
    )
    program = Program(options.program)
    jobs = _jobs(program, options.clips, options.output.resolve(), settings, _given(options, "container"))
    options.output.mkdir(parents=True, exist_ok=True)
    # What changes the result; not who works on it.
    decisive = ("part", "halo", "same_camera", "readout", "measure_options", "fix_options", "join_options", "motion",
                "track_options")
    result = {"program_version": program.run("--version").strip()}
    result |= {name: getattr(settings, name) for name in decisive}
    state = Manifest(options.output, result, options.afresh)
    try:
        return _run(jobs, settings, options, state)
    finally:
        state.close()


def _run(jobs: list[Job], settings: Settings, options: argparse.Namespace, state: Manifest) -> int:
    executor = Ray(options.address, options.processors) if options.address else Local(options.workers)
    progress = Progress(passes=1 + (not settings.readout) + settings.motion)
    try:
        run = Run(jobs, settings, executor, state, progress)
        for clip in run.clips:
            if (file := clip.in_the_way) and not options.overwrite:
                raise ManifestError(f"{file} is there already; --overwrite replaces it")
        failed = asyncio.run(run.all())
    finally:
        executor.close()
        progress.close()
    print(f"{len(jobs) - len(failed)} of {len(jobs)} clips rectified")
    for clip in failed:
        print(f"failed: {clip.job.clip}: {clip.known['error']}")
    work = options.output / WORK
    if not failed and work.exists():
        work.rmdir()
    return 1 if failed else 0


def _jobs(program: Program, clips: list[str], output: Path, settings: Settings, container: list[str]) -> list[Job]:
    """The clips that are named, and the files that they become, as `rsrectify fix` says, which refuses options that it cannot
    carry out."""
    arguments = [Path(clip).resolve() for clip in clips]
    # Files that are there are looked at later: they may be this run's own.
    given = [*settings.readout, *settings.all_fix_options, *settings.track_options, *settings.join_options, *container]
    found = program.json("fix", "--dry-run", "--json", "--recursive", "--output", f"{output}/", *given, *arguments)
    return [Job(one["clip"], one["output"], one["codec"]) for one in found]


def _status(options: argparse.Namespace) -> int:
    clips = manifest.read(options.output)["clips"]
    for clip, known in clips.items():
        share = report.numbers(known).get("corrected")
        corrected = "" if share is None else f", {share:.0%} of the frames corrected"
        print(f"{known['state']:10} {_done(known)} {clip}{corrected}" + (f": {known['error']}" if "error" in known else ""))
    done = sum(known["state"] == "done" for known in clips.values())
    print(f"{done} of {len(clips)} clips rectified")
    return 0


def _report(options: argparse.Namespace) -> int:
    print(report.write(options.output))
    return 0


def _done(known: dict[str, Any]) -> str:
    """How far a clip has come, in parts."""
    if known["state"] == "done":
        # A clip of one part is rectified at one go, with no result for the part.
        count = len(known["parts"])
        return f"{count:4} of {count} parts rectified"
    if "parts" in known:
        parts, verb, result = known["parts"], "rectified", "result"
    else:
        parts, verb, result = known.get("measured", []), "measured", "found"
    return f"{sum(result in part for part in parts):4} of {len(parts)} parts {verb}"
