# SPDX-License-Identifier: MIT OR Apache-2.0

from itertools import pairwise

import pytest
from rsrectify_batch.plan import Part, parts


@pytest.mark.parametrize("frames", [1, 7, 100, 149, 150, 151, 1000, 12345])
@pytest.mark.parametrize("cuts", [[], [50], [3, 99, 101, 149, 151, 640], list(range(1, 12345, 7))])
def test_parts_are_all_of_a_clip_and_of_similar_length(frames: int, cuts: list[int]) -> None:
    found = parts(frames, 100, cuts)
    assert (found[0].first, found[-1].end) == (0, frames)
    assert all(one.end == other.first for one, other in pairwise(found))
    assert all(part.frames <= 150 for part in found)
    assert len(found) == 1 or all(part.frames >= 50 for part in found)


def test_parts_end_at_the_nearest_cut() -> None:
    assert parts(400, 100, [80, 130, 210]) == [Part(0, 80), Part(80, 210), Part(210, 310), Part(310, 400)]
    # None is within half a part of its end.
    assert parts(300, 100, [20, 40]) == [Part(0, 100), Part(100, 200), Part(200, 300)]


def test_a_short_clip_is_one_part() -> None:
    assert parts(150, 100, [75]) == [Part(0, 150)]
