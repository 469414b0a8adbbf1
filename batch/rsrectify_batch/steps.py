# SPDX-License-Identifier: MIT OR Apache-2.0

"""What workers do: each step is a call of the program that writes at most one file, and checks it.

A step writes under a name of its own and renames the file when it is whole, so that a step that was lost with its
machine leaves nothing that looks done, and two of the same step do not disturb each other.
"""

import json
import os
import platform
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .plan import Part
from .program import USAGE, Program, ProgramError

# The coarsest clock of the containers, Matroska's, by default.
CLOCK_NS = 1_000_000
# Of a motion file.
HEADER_BYTES = 1024


def index(program: str, clip: str, file: str) -> dict[str, Any]:
    """Lists the frames of a clip in a file: how many there are, and the SHA-256 of all as they are encoded."""
    with _replaced(file) as attempt:
        Program(program).run("index", clip, "--output", attempt)
        found = json.loads(Path(attempt).read_text())
    return {"frames": found["frames"], "sha256": found["sha256"]}


def measure(program: str, clip: str, index_file: str, part: Part, options: list[str]) -> dict[str, Any]:
    """Measures the readout of frames, as `rsrectify measure --json` prints it."""
    # One frame more, so that it is seen whether a shot begins with the first.
    part_options = ["--frames", part, "--halo", 1, "--index", index_file]
    found = Program(program).json("measure", "--json", clip, *part_options, *options)
    measured: dict[str, Any] = found["clips"][0]
    return measured


def track(program: str, clip: str, frames: int, output: str, options: list[str]) -> dict[str, Any]:
    """Writes the motion of a clip's frames, found at one go, to a file."""
    with _replaced(output) as attempt:
        Program(program).run("track", clip, "--motion", attempt, *options)
        # The file begins with lines of text.
        with open(attempt, "rb") as file:
            header = file.read(HEADER_BYTES).decode().splitlines()
        if f"frames: {frames}" not in header:
            raise ProgramError(f"the motion file does not have the clip's {frames} frames", 1)
        return {"bytes": os.path.getsize(attempt)}


def fix(program: str, clip: str, index_file: str, part: Part, halo: int, output: str, options: list[str]) -> dict[str, Any]:
    """Rectifies frames of a clip, without audio, which comes from the clip when the parts are joined."""
    part_options = ["--frames", str(part), "--halo", str(halo), "--index", index_file, "--audio", "none"]
    return _write(program, clip, index_file, part, output, [*part_options, *options])


def fix_all(program: str, clip: str, index_file: str, frames: int, output: str, options: list[str]) -> dict[str, Any]:
    """Rectifies a clip at one go."""
    return _write(program, clip, index_file, Part(0, frames), output, options)


def join(program: str, clip: str, index_file: str, parts: list[str], output: str, options: list[str]) -> dict[str, Any]:
    """Joins the parts of a clip; what was joined, as `rsrectify join --json` prints it, and the file."""
    with _replaced(output) as attempt:
        arguments = [clip, *parts, "--output", attempt, "--index", index_file]
        joined = Program(program).json("join", "--json", *arguments, *options)
        result = _check(program, index_file, Part(0, joined["frames"]), attempt)
        if result["sha256"] != joined["sha256"]:
            raise ProgramError("the joined file does not hold what its parts do", 1)
    return {**result, "parts": [part["sha256"] for part in joined["parts"]]}


def _write(program: str, clip: str, index_file: str, part: Part, output: str, options: list[str]) -> dict[str, Any]:
    started = time.monotonic()
    with _replaced(output) as attempt:
        done = Program(program).json("fix", clip, "--output", attempt, "--json", *options)
        result = _check(program, index_file, part, attempt)
    # The file has another name by now.
    summary = {name: value for name, value in done.items() if name not in ("clip", "output", "error")}
    return {**result, "summary": summary, "seconds": round(time.monotonic() - started, 3), "machine": platform.node()}


def _check(program: str, index_file: str, part: Part, output: str) -> dict[str, Any]:
    """Reads a file that was written: whether it has the part's frames, at their times."""
    expected = json.loads(Path(index_file).read_text())["times_ns"][part.first : part.end]
    found = Program(program).json("index", output)
    if found["frames"] != len(expected):
        raise ProgramError(f"{found['frames']} frames were written where there should be {len(expected)}", 1)
    times = found["times_ns"]
    late = [
        number
        for number, (time_ns, wanted) in enumerate(zip(times, expected))
        if abs((time_ns - times[0]) - (wanted - expected[0])) > CLOCK_NS
    ]
    if late:
        raise ProgramError(f"frame {part.first + late[0]} is shown at another time than in the clip", 1)
    return {"frames": found["frames"], "sha256": found["sha256"], "bytes": os.path.getsize(output)}


@contextmanager
def _replaced(output: str) -> Iterator[str]:
    """A file to write under a name that nobody else uses, with the extension, which tells the program the container; it
    becomes the output if all goes well."""
    path = Path(output)
    attempt = path.with_name(f"{path.stem}.{uuid.uuid4().hex}{path.suffix}")
    try:
        yield str(attempt)
        os.replace(attempt, output)
    finally:
        attempt.unlink(missing_ok=True)


STEPS: dict[str, Callable[..., dict[str, Any]]] = {step.__name__: step for step in (index, measure, track, fix, fix_all, join)}


def carry_out(step: str, arguments: tuple[Any, ...]) -> dict[str, Any]:
    """Carries out the step of a name."""
    if step not in STEPS:
        raise ProgramError(f"{step}: no such step", USAGE)
    return STEPS[step](*arguments)
