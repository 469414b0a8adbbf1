#!/usr/bin/python3
# SPDX-License-Identifier: MIT OR Apache-2.0
"""Puts clips one after the other on a timeline of GStreamer Editing Services, each with the effect
rsrectify, and renders them to a file; the project can be saved for an editor.

  edit_timeline.py OUT.mp4 CLIP... [--seconds 2] [--save PROJECT.xges]
"""

import argparse
import pathlib
import sys

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstPbutils", "1.0")
gi.require_version("GES", "1.0")
from gi.repository import GES, GLib, Gst, GstPbutils


def uri(path):
    return pathlib.Path(path).resolve().as_uri()


def timeline_of(paths, seconds):
    """A timeline with the first seconds of each clip, in the size and at the rate of the first one."""
    timeline = GES.Timeline.new()
    track = GES.VideoTrack.new()
    timeline.add_track(track)
    layer = timeline.append_layer()
    start = 0
    for path in paths:
        asset = GES.UriClipAsset.request_sync(uri(path))
        if start == 0:
            # Effects come after the change to the project's size and rate: those of the clips keep the frames
            # as the camera took them.
            video = asset.get_info().get_video_streams()[0]
            size = f"width={video.get_width()},height={video.get_height()}"
            rate = f"{video.get_framerate_num()}/{video.get_framerate_denom()}"
            track.set_restriction_caps(Gst.Caps.from_string(f"video/x-raw,{size},framerate={rate}"))
        length = asset.get_duration()
        if seconds:
            length = min(length, int(seconds * Gst.SECOND))
        clip = layer.add_asset(asset, start, 0, length, GES.TrackType.VIDEO)
        # Each clip has an effect of its own, which finds its camera's readout. Options follow the name, as in
        # gst-launch-1.0; for all clips of a camera whose readout is known:
        # "rsrectify readout-time=20000000 readout-direction=top-to-bottom".
        effect = GES.Effect.new("rsrectify")
        # A top effect sees the clip's frames before they are placed in the picture.
        clip.add_top_effect(effect, -1)
        start += length
    return timeline


def mp4_profile():
    """H.264 in MP4."""
    container = GstPbutils.EncodingContainerProfile.new(
        "mp4", None, Gst.Caps.from_string("video/quicktime,variant=iso"), None
    )
    video = GstPbutils.EncodingVideoProfile.new(Gst.Caps.from_string("video/x-h264"), None, None, 0)
    container.add_profile(video)
    return container


def render(timeline, path):
    pipeline = GES.Pipeline.new()
    pipeline.set_timeline(timeline)
    pipeline.set_render_settings(uri(path), mp4_profile())
    pipeline.set_mode(GES.PipelineFlags.RENDER)
    try:
        started = pipeline.set_state(Gst.State.PLAYING) != Gst.StateChangeReturn.FAILURE
        ends = Gst.MessageType.EOS | Gst.MessageType.ERROR
        # What does not start has posted its error already.
        message = pipeline.get_bus().timed_pop_filtered(Gst.CLOCK_TIME_NONE if started else 0, ends)
        if message is None:
            sys.exit("The rendering does not start.")
        if message.type == Gst.MessageType.ERROR:
            raise message.parse_error()[0]
    finally:
        pipeline.set_state(Gst.State.NULL)


def main():
    parser = argparse.ArgumentParser(description="Renders clips one after the other, each rectified.")
    parser.add_argument("output", help="an MP4 file")
    parser.add_argument("clips", nargs="+", metavar="CLIP")
    parser.add_argument("--seconds", type=float, help="of each clip; all of it unless given")
    parser.add_argument("--save", metavar="PROJECT.xges", help="save the project, too")
    Gst.init(None)
    GES.init()
    arguments = parser.parse_args()
    if not Gst.ElementFactory.find("rsrectify"):
        sys.exit("GST_PLUGIN_PATH must name the folder of libgstrsrectify.so.")
    try:
        timeline = timeline_of(arguments.clips, arguments.seconds)
        if arguments.save:
            timeline.save_to_uri(uri(arguments.save), None, True)
        render(timeline, arguments.output)
    except GLib.Error as error:
        sys.exit(error.message)


if __name__ == "__main__":
    main()
