# SPDX-License-Identifier: MIT OR Apache-2.0

"""What the tests share: the program, a film, and runs of the package as its user starts them."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PROGRAM = os.environ.get("RSRECTIFY", "rsrectify")
# A shaken film of two shots, rendered by scripts/check-batch.
FILM = Path(os.environ.get("RSRECTIFY_FILM", "film.mp4")).resolve()
FRAMES = 80
# Its readout is 0.8 frame periods. One that is measured differs from it by a little more than nothing, and by another little on
# another processor: 3 % of a frame period are allowed, where a wrong one is off by 10 % and more.
READOUT_MS = 0.8 * 1000 / 30
READOUT_ERROR_MS = 0.03 * 1000 / 30
# Frames of a part in the tests.
PART = 20

# What a shell runs in the background ignores interruptions, and so would the runs that the tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


class Output:
    """A folder that runs write to."""

    def __init__(self, folder: Path):
        self.folder = folder

    @property
    def manifest(self) -> dict[str, Any]:
        state: dict[str, Any] = json.loads((self.folder / "rsrectify-batch.json").read_text())
        return state

    @property
    def files(self) -> list[str]:
        """All files and folders but the manifest."""
        found = (path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*"))
        return sorted(name for name in found if name != "rsrectify-batch.json")

    def start(self, *clips: Path, options: tuple[object, ...] = ()) -> subprocess.Popen[str]:
        arguments = ["rectify", *clips, "--output", self.folder, "--program", PROGRAM, "--part", PART, *options]
        command = [sys.executable, "-m", "rsrectify_batch", *map(str, arguments)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def run(self, *clips: Path, options: tuple[object, ...] = (), code: int = 0) -> str:
        """What a run says that ends with this exit code."""
        process = self.start(*clips, options=options)
        said, _ = process.communicate(timeout=500)
        assert process.returncode == code, said
        return said


def readout_said(said: str, begin: str) -> float:
    """The readout in milliseconds that a run says after these words."""
    found = re.search(re.escape(begin) + r" ([0-9.]+) ms, top-to-bottom, give or take [0-9.]+ ms", said)
    assert found, said
    return float(found[1])


@pytest.fixture
def output(tmp_path: Path) -> Output:
    return Output(tmp_path / "out")


def sha256_of_frames(file: Path) -> str:
    """The SHA-256 of the frames of a file as they are encoded."""
    return str(index(file)["sha256"])


def index(file: Path) -> dict[str, Any]:
    listed: dict[str, Any] = json.loads(subprocess.run([PROGRAM, "index", file], check=True, capture_output=True).stdout)
    return listed


def pixels(file: Path) -> bytes:
    """All decoded frames of a Matroska file of FFV1."""
    raw = file.with_suffix(".raw")
    elements = ["filesrc", f"location={file}", "!", "matroskademux", "!", "avdec_ffv1", "!", "filesink", f"location={raw}"]
    subprocess.run(["gst-launch-1.0", "-q", *elements], check=True)
    found = raw.read_bytes()
    raw.unlink()
    return found


def fix(clip: Path, output: Path, *options: str | Path) -> None:
    """Rectifies a clip by the program itself."""
    subprocess.run([PROGRAM, "fix", clip, "--output", output, *options], check=True, capture_output=True)
