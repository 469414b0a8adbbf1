# SPDX-License-Identifier: MIT OR Apache-2.0

"""Rectifies many clips, or one long film, by many processes of the program `rsrectify`."""

__version__ = "0.1.0"
