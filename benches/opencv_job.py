#!/usr/bin/env python3
"""The same job composed of OpenCV parts, for comparison: needs the package opencv-python-headless.

Usage: opencv_job.py VIDEO.y4m [THREADS]     (8-bit 4:2:0)

For each frame: luma reduced to 960 columns, pyramidal Lucas-Kanade on a 32 x 24 grid, a similarity
by RANSAC, a map whose angle and shift grow with the row, cubic remap of the three planes. Prints
the median time of a frame in milliseconds, reading left out.
"""

import statistics
import sys
import time

import cv2
import numpy as np


def frames(path):
    """Planes of each frame of an 8-bit 4:2:0 Y4M file."""
    with open(path, "rb") as file:
        header = file.readline().split()
        width = int(next(f for f in header if f.startswith(b"W"))[1:])
        height = int(next(f for f in header if f.startswith(b"H"))[1:])
        chroma = ((width + 1) // 2, (height + 1) // 2)
        while file.readline().startswith(b"FRAME"):
            yield [
                np.frombuffer(file.read(w * h), np.uint8).reshape(h, w)
                for w, h in ((width, height), chroma, chroma)
            ]


class RowMaps:
    """Where each output pixel of a plane is found; keeps its buffers."""

    def __init__(self, width, height):
        self.x = np.arange(width, dtype=np.float32)[None, :] - (width - 1) / 2
        self.y = (np.arange(height, dtype=np.float32) - (height - 1) / 2)[:, None]
        self.centre = ((width - 1) / 2, (height - 1) / 2)
        self.maps = np.empty((height, width), np.float32), np.empty((height, width), np.float32)

    def fill(self, turn, shift):
        """For a motion of `turn` radians and `shift` pixels of the plane a frame: a line a row."""
        share = self.y / len(self.y)
        cos, sin = np.cos(turn * share), np.sin(turn * share)
        starts = -sin * self.y + (shift[0] * share + self.centre[0]), cos * self.y + (shift[1] * share + self.centre[1])
        for target, slope, start in zip(self.maps, (cos, sin), starts):
            np.multiply(self.x, slope, out=target)
            target += start
        return self.maps


def rectify(planes, before, now, reduction, grid, maps):
    """The three planes, rectified by the similarity between two reduced lumas."""
    moved, status, _ = cv2.calcOpticalFlowPyrLK(before, now, grid, None, winSize=(15, 15), maxLevel=4)
    kept = status.ravel() == 1
    model, _ = cv2.estimateAffinePartial2D(grid[kept], moved[kept], method=cv2.RANSAC, ransacReprojThreshold=1.5)
    if model is None:
        return planes
    turn = float(np.arctan2(model[1, 0], model[0, 0]))
    centre = np.array([before.shape[1] / 2, before.shape[0] / 2, 1.0])
    shift = (model @ centre - centre[:2]) * reduction
    luma, chroma = maps[0].fill(turn, shift), maps[1].fill(turn, shift / 2)
    return [
        cv2.remap(plane, *found, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for plane, found in zip(planes, (luma, chroma, chroma))
    ]


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    cv2.setNumThreads(int(sys.argv[2]) if len(sys.argv) > 2 else 2)
    before, times, grid, maps = None, [], None, None
    for planes in frames(sys.argv[1]):
        started = time.perf_counter()
        height, width = planes[0].shape
        reduction = max(1.0, width / 960)
        size = (round(width / reduction), round(height / reduction))
        now = cv2.resize(planes[0], size, interpolation=cv2.INTER_AREA)
        if before is None:
            xs = (np.arange(32, dtype=np.float32) + 0.5) * size[0] / 32
            ys = (np.arange(24, dtype=np.float32) + 0.5) * size[1] / 24
            maps = [RowMaps(*plane.shape[::-1]) for plane in planes[:2]]
            grid = np.stack(np.meshgrid(xs, ys), -1).reshape(-1, 1, 2)
        else:
            rectify(planes, before, now, reduction, grid, maps)
            times.append((time.perf_counter() - started) * 1e3)
        before = now
    print(f"{statistics.median(times):.2f}")


if __name__ == "__main__":
    main()
