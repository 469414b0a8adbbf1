# SPDX-License-Identifier: MIT OR Apache-2.0

"""What a run says while it goes on."""

import sys
from typing import Any

from tqdm import tqdm


class Progress:
    """Frames of all clips that are known, in each of so many passes, as a bar where there is a terminal; and lines."""

    def __init__(self, passes: int):
        self._passes = passes
        self._known: set[str] = set()
        self._bar = tqdm(total=0, unit=" frames", disable=None, smoothing=0.05, dynamic_ncols=True)

    def knows(self, clip: Any) -> None:
        """Adds a clip's frames, once it is known how many it has."""
        index = clip.known.get("index")
        if index is None or clip.is_done or clip.job.clip in self._known:
            return
        self._known.add(clip.job.clip)
        frames = index["frames"]
        done = sum(one["end"] - one["first"] for one in clip.known.get("measured", []) if "found" in one)
        self._bar.total += frames * self._passes
        self._bar.update(done)

    def done(self, frames: int) -> None:
        """Adds frames of a pass."""
        self._bar.update(frames)

    def say(self, line: str) -> None:
        self._bar.write(line, file=sys.stderr)

    def close(self) -> None:
        self._bar.close()
