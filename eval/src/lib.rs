//! Renders rolling-shutter sequences with exact truth and judges the rectifier on them.
