#!/usr/bin/python3
# SPDX-License-Identifier: MIT OR Apache-2.0
"""Rectifies raw frames of an application by GStreamer: appsrc → rsrectify → appsink.

  rectify_frames.py IN.raw OUT.raw FORMAT WIDTH HEIGHT FRAMES_PER_SECOND

IN.raw holds frames without padding, one after the other; FORMAT is GStreamer's name of their pixel
format, such as I420 or GRAY8. What was found in each frame is printed.
"""

import argparse
import sys

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstApp", "1.0")
gi.require_version("GstVideo", "1.0")
# GstApp is what gives appsrc and appsink their methods.
from gi.repository import GLib, Gst, GstApp, GstVideo  # noqa: F401

PIPELINE = "appsrc name=in format=time ! rsrectify attach-meta=true ! appsink name=out sync=false max-buffers=4"
# How long to wait for a frame before the bus is asked for an error.
PATIENCE = Gst.SECOND


class Input:
    """The frames that go into the pipeline."""

    def __init__(self, file, size, rate):
        self.file, self.size, self.rate, self.count = file, size, rate, 0

    def push(self, source, _length):
        """Called by appsrc, in its own thread, whenever it wants a frame: frames are read no faster than
        they are worked on."""
        try:
            pixels = self.file.read(self.size)
        except OSError as error:
            # An exception goes nowhere from here; the main thread waits for frames and looks at the bus.
            failure = GLib.Error.new_literal(Gst.ResourceError.quark(), str(error), Gst.ResourceError.READ)
            source.post_message(Gst.Message.new_error(source, failure, ""))
            pixels = b""
        if len(pixels) < self.size:
            source.end_of_stream()
            return
        buffer = Gst.Buffer.new_wrapped(pixels)
        # Each frame needs the time at which it was taken: the readout is found in time, not in rows.
        buffer.pts = Gst.util_uint64_scale(self.count, Gst.SECOND, self.rate)
        buffer.duration = Gst.SECOND // self.rate
        self.count += 1
        source.push_buffer(buffer)


def description(buffer):
    """What the element says of a frame."""
    meta = buffer.get_custom_meta("RsRectifyMeta")
    if meta is None:
        # Frames that are passed through, interlaced ones for example, have none.
        return "no motion"
    found = meta.get_structure()
    readout, confidence = found.get_value("readout-time"), found.get_value("confidence")
    direction = found.get_value("readout-direction").value_nick
    text = f"readout {readout / Gst.MSECOND:.1f} ms {direction}, confidence {confidence:.2f}"
    # Absent where it cannot be told.
    if found.has_field("expected-error"):
        text += f", expected error {found.get_value('expected-error'):.2f} px"
    return text


def raise_error(bus):
    """Raises the error that is on the bus, if one is."""
    message = bus.pop_filtered(Gst.MessageType.ERROR)
    if message:
        raise message.parse_error()[0]


def take_frames(sink, bus, out):
    """Takes frames out of the pipeline until there are no more."""
    number = 0
    while True:
        sample = sink.try_pull_sample(PATIENCE)
        if sample is None:
            raise_error(bus)
            if sink.is_eos():
                return
            continue
        buffer = sample.get_buffer()
        print(f"frame {number}: {buffer.pts / Gst.SECOND:.3f} s, {description(buffer)}")
        # All of it: without GstVideoMeta, for which appsink does not ask, rows have no padding.
        out.write(buffer.extract_dup(0, buffer.get_size()))
        number += 1


def run(arguments, source_file, out):
    info = GstVideo.VideoInfo()
    if not info.set_format(arguments.format, arguments.width, arguments.height):
        sys.exit("Frames cannot have this size.")
    info.fps_n, info.fps_d = arguments.rate, 1
    pipeline = Gst.parse_launch(PIPELINE)
    source, sink = pipeline.get_by_name("in"), pipeline.get_by_name("out")
    source.set_caps(info.to_caps())
    source.connect("need-data", Input(source_file, info.size, arguments.rate).push)
    bus = pipeline.get_bus()
    try:
        if pipeline.set_state(Gst.State.PLAYING) == Gst.StateChangeReturn.FAILURE:
            raise_error(bus)
        take_frames(sink, bus, out)
    finally:
        # Ends the thread that reads the file.
        pipeline.set_state(Gst.State.NULL)


def positive(text):
    number = int(text)
    if number <= 0:
        raise argparse.ArgumentTypeError("must be above 0")
    return number


def video_format(name):
    found = GstVideo.VideoFormat.from_string(name)
    if found == GstVideo.VideoFormat.UNKNOWN:
        raise argparse.ArgumentTypeError(f"no pixel format is called {name}")
    return found


def main():
    parser = argparse.ArgumentParser(description="Rectifies raw frames by appsrc, rsrectify and appsink.")
    parser.add_argument("input", type=argparse.FileType("rb"), help="frames without padding")
    parser.add_argument("output", type=argparse.FileType("wb"), help="where the rectified frames go")
    parser.add_argument("format", type=video_format, help="pixel format, such as I420 or GRAY8")
    for name in ["width", "height", "rate"]:
        parser.add_argument(name, type=positive)
    Gst.init(None)
    arguments = parser.parse_args()
    try:
        # Closed here, so that what the disk cannot take any more is noticed.
        with arguments.input, arguments.output:
            run(arguments, arguments.input, arguments.output)
    except GLib.Error as error:
        sys.exit(error.message)
    except OSError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
