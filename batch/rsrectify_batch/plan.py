# SPDX-License-Identifier: MIT OR Apache-2.0

"""A film → the parts that are measured or rectified each by itself."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Part:
    """Frames of a clip, from `first` to before `end`."""

    first: int
    end: int

    @classmethod
    def of(cls, entry: dict[str, Any]) -> "Part":
        """That of a manifest's entry."""
        return cls(entry["first"], entry["end"])

    @property
    def entry(self) -> dict[str, Any]:
        return {"first": self.first, "end": self.end}

    @property
    def frames(self) -> int:
        return self.end - self.first

    def __str__(self) -> str:
        return f"{self.first}:{self.end}"


def parts(frames: int, length: int, cuts: list[int] | None = None) -> list[Part]:
    """The parts of a clip: each about `length` frames, between half and one and a half of it where the clip is as long.

    A part ends at the frame nearest to that length at which another shot begins; where there is none, right there. They
    depend on the clip and the length only, not on who works on them: so does the result.
    """
    cuts = sorted(cuts or [])
    found, first = [], 0
    while first < frames:
        end = frames
        if 2 * (frames - first) > 3 * length:
            end = _nearest(cuts, first + length, (length + 1) // 2, frames)
        found.append(Part(first, end))
        first = end
    return found


def _nearest(cuts: list[int], wanted: int, reach: int, frames: int) -> int:
    """The cut nearest to a frame within reach of it, and not closer than that to the last one; else the frame itself."""
    latest = min(wanted + reach, frames - reach)
    near = cuts[bisect_left(cuts, wanted - reach) : bisect_right(cuts, latest)]
    return min(near, key=lambda cut: abs(cut - wanted), default=wanted)
