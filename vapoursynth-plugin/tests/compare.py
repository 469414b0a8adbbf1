# SPDX-License-Identifier: MIT OR Apache-2.0

"""Compares what the filter makes of raw frames with what `rsrectify fix` has made of them; run by scripts/check-vapoursynth.

    compare.py PLUGIN MOTION CLIP FIXED WIDTH HEIGHT    CLIP and FIXED: frames of 8-bit 4:2:0, one after another
"""

import ctypes
import sys
from pathlib import Path

import vapoursynth as vs

plugin, motion, clip_file, fixed_file, width, height = sys.argv[1:]
width, height = int(width), int(height)
FRAME = width * height * 3 // 2
core = vs.core
core.std.LoadPlugin(plugin)


def planes(frame):
    """Address, bytes from row to row, bytes of a row, and rows of each plane."""
    for index in range(frame.format.num_planes):
        share = 2 if index else 1
        address = (frame.get_read_ptr if frame.readonly else frame.get_write_ptr)(index)
        yield address.value, frame.get_stride(index), width // share, height // share


def filled(number, frame, data):
    """A copy of a frame with the bytes of frame `number` of a file."""
    copy = frame.copy()
    at = number * FRAME
    for address, stride, row, rows in planes(copy):
        for line in range(rows):
            ctypes.memmove(address + line * stride, data[at : at + row], row)
            at += row
    return copy


def packed(frame):
    """The bytes of a frame."""
    lines = (
        ctypes.string_at(address + line * stride, row)
        for address, stride, row, rows in planes(frame)
        for line in range(rows)
    )
    return b"".join(lines)


def refusal(*arguments, **options):
    try:
        core.rsrectify.Apply(*arguments, **options).get_frame(0)
    except vs.Error as error:
        return str(error)
    return "nothing was refused"


data, fixed = Path(clip_file).read_bytes(), Path(fixed_file).read_bytes()
count = len(data) // FRAME
assert len(fixed) == len(data) == count * FRAME, "the files differ in length"
blank = core.std.BlankClip(width=width, height=height, format=vs.YUV420P8, length=count, fpsnum=25, fpsden=1)
# In the centre, where GStreamer takes it to be in frames of this size that do not state it.
blank = core.std.SetFrameProps(blank, _ChromaLocation=1)
clip = core.std.ModifyFrame(blank, blank, lambda n, f: filled(n, f, data))

# In any order.
order = sorted(range(count), key=lambda number: number * 7 % count)
rectified = core.rsrectify.Apply(clip, motion=motion)
for number in order:
    with rectified.get_frame(number) as frame:
        assert packed(frame) == fixed[number * FRAME :][:FRAME], f"frame {number} is not that of fix"
assert data != fixed, "nothing was rectified"

# By the time that a source filter has stated, whatever the number: trimmed, and later by a second.
timed = core.std.FrameEval(clip, lambda n: core.std.SetFrameProps(clip, _AbsoluteTime=n / 25 + 1.0))
trimmed = core.rsrectify.Apply(timed[10:], motion=motion, start=-1.0)
with trimmed.get_frame(3) as frame:
    assert packed(frame) == fixed[13 * FRAME :][:FRAME], "a trimmed clip is not rectified by its times"

still = core.rsrectify.Apply(clip, motion=motion, strength=0.0)
with still.get_frame(5) as frame:
    assert packed(frame) == data[5 * FRAME :][:FRAME], "strength 0 changes a frame"
for options, reason in [
    ({"motion": "none.motion"}, "No such file"),
    ({"motion": motion, "border": "round"}, "border must be"),
    ({"motion": motion, "strength": 2.0}, "strength must be"),
]:
    assert reason in refusal(clip, **options), refusal(clip, **options)
other = core.std.BlankClip(width=640, height=360, format=vs.YUV420P8)
assert "another shape" in refusal(other, motion=motion)
assert "integer samples" in refusal(core.std.BlankClip(format=vs.RGBS), motion=motion)
print(f"VapourSynth: {count} frames are those of fix")
