# SPDX-License-Identifier: MIT OR Apache-2.0

"""The program `rsrectify`, which needs the system's GStreamer."""

import ctypes
import os
import sys
from pathlib import Path

PROGRAM = Path(__file__).parent / "rsrectify"
# What the program is linked to, of GStreamer.
LIBRARIES = ["libgstreamer-1.0.so.0", "libgstbase-1.0.so.0", "libgstvideo-1.0.so.0", "libgstapp-1.0.so.0"]
# One line, which rsrectify-batch passes on.
ADVICE = (
    "error: {library} is missing: rsrectify needs GStreamer 1.22 or later with its plugins. Debian, Ubuntu: "
    "sudo apt-get install gstreamer1.0-libav gstreamer1.0-plugins-{{base,good,bad,ugly}}; Fedora: "
    "sudo dnf install gstreamer1-plugin-libav gstreamer1-plugins-{{base,good,bad-free,ugly-free}}; Arch: "
    "sudo pacman -S gst-libav gst-plugins-{{base,good,bad,ugly}}"
)


def main() -> int:
    """Becomes the program; 2 where it cannot run."""
    for library in LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            print(ADVICE.format(library=library), file=sys.stderr)
            return 2
    os.execv(PROGRAM, ["rsrectify", *sys.argv[1:]])
