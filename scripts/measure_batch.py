# SPDX-License-Identifier: MIT OR Apache-2.0

"""Called by scripts/measure-batch: films in parts against one run, and the time of workers.

    measure_batch.py FOLDER-WITH-FILMS DOCUMENT
"""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

FILMS = {"hand_g08": "a hand that shakes", "trans_rot1_B40": "a camera that moves and turns before near things"}
SIZE = (480, 640)
PART = 100
HALOS = (0, 10, 30, 60, 120)
WORKERS = (1, 2, 4)
MARKS = ("<!-- scripts/measure-batch writes from here -->", "<!-- to here -->")


def run(*command: object) -> bytes:
    return subprocess.run([*map(str, command)], check=True, stdout=subprocess.PIPE).stdout


def batch(film: Path, output: Path, *options: object) -> float:
    """Rectifies a film in parts; the seconds that it took."""
    shutil.rmtree(output, ignore_errors=True)
    started = time.monotonic()
    run(sys.executable, "-m", "rsrectify_batch", "rectify", film, "--output", output, "--part", PART, *options)
    return time.monotonic() - started


def luma(file: Path) -> np.ndarray:
    pipeline = f"filesrc location={file} ! decodebin ! videoconvert ! video/x-raw,format=GRAY8 ! fdsink".split()
    frames = run("gst-launch-1.0", "-q", *pipeline)
    return np.frombuffer(frames, np.uint8).reshape(-1, *SIZE).astype(np.float32)


def psnr(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Of each frame in dB, 99 at most."""
    squares = ((one - other) ** 2).mean(axis=(1, 2))
    decibels: np.ndarray = np.minimum(10 * np.log10(255**2 / np.maximum(squares, 1e-9)), 99)
    return decibels


def seams(folder: Path) -> list[str]:
    lines = [
        f"| film (640×480, 800 frames, parts of {PART}) | `--halo` | first frame of a part, median (least) | all frames, median (least) |",
        "|---|---|---|---|",
    ]
    for name, what in FILMS.items():
        film, output = folder / f"{name}.mp4", folder / "measured"
        readout = json.loads(run("rsrectify", "measure", "--json", film))["clips"][0]
        time_ms, direction = abs(readout["signed_readout_ms"]), readout["readout_direction"]
        given = ("--readout-time", time_ms, "--readout-direction", direction, "--codec", "ffv1")
        whole = folder / "whole.mkv"
        run("rsrectify", "fix", film, "--output", whole, "--overwrite", *given)
        expected, recorded = luma(whole), luma(film)
        for halo in HALOS:
            batch(film, output, "--halo", halo, *given)
            found = psnr(luma(output / f"{name}-rectified.mkv"), expected)
            parts = json.loads((output / "rsrectify-batch.json").read_text())["clips"][str(film)]["parts"]
            first = found[[part["first"] for part in parts[1:]]]
            lines.append(
                f"| {what} | {halo} | {np.median(first):.0f} ({first.min():.0f}) dB | {np.median(found):.0f} ({found.min():.0f}) dB |"
            )
        before = psnr(recorded, expected)
        lines.append(f"| {what}, not rectified | | | {np.median(before):.0f} ({before.min():.0f}) dB |")
        shutil.rmtree(output)
        whole.unlink()
    return lines


def workers(folder: Path) -> list[str]:
    processors = len(os.sched_getaffinity(0))
    film = folder / "hand_g08.mp4"
    started = time.monotonic()
    run("rsrectify", "fix", film, "--output", folder / "whole.mp4", "--overwrite")
    alone = time.monotonic() - started
    lines = [
        f"| workers, on {processors} processors | time, s | frames/s | against one worker | ideal |",
        "|---|---|---|---|---|",
        f"| `rsrectify fix` alone, all processors, no halo | {alone:.1f} | {800 / alone:.0f} | | |",
    ]
    first = None
    for number in WORKERS:
        seconds = min(batch(film, folder / "measured", "--workers", number) for _ in range(2))
        first = first or seconds
        ideal = min(number, processors)
        lines.append(f"| {number} | {seconds:.1f} | {800 / seconds:.0f} | {first / seconds:.2f} × | {ideal} × |")
    shutil.rmtree(folder / "measured")
    (folder / "whole.mp4").unlink()
    return lines


def main() -> None:
    folder, document = map(Path, sys.argv[1:])
    tables = "\n".join([
        "PSNR of the luma against one run with the same readout, and, for scale, of the clip as it was recorded:", "",
        *seams(folder), "",
        "One film from its index to the checked file, the shorter of two runs. With the halo of 60 frames, three of eight frames that are",
        "analysed are analysed twice; with parts of 600, one of eleven:", "",
        *workers(folder),
    ])
    text = document.read_text()
    before, rest = text.split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    document.write_text(f"{before}{MARKS[0]}\n\n{tables}\n\n{MARKS[1]}{after}")


main()
