//! GStreamer element `rsrectify`: takes rolling-shutter distortion out of video.
