# SPDX-License-Identifier: MIT OR Apache-2.0

"""What several parts of a clip, or several clips of one camera, say of its readout together.

Each part states its posterior of the signed readout time: a mixture of normal densities, along the rows or the columns,
and the prior that all parts have in common. Posterior ÷ prior is proportional to the likelihood of the part, and the
logarithms of independent likelihoods add up (Bayes). Where the camera is known that made them, they add up with what is
known of its readout.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Densities, by time or by axis and time.
Array = NDArray[np.float64]

# Readout ratios that were found without a word about the camera end within this of the truth where they are right: the
# error of the model, which more frames of the same part do not make smaller.
MODEL_ERROR = 0.02
# The share of runs that are sure of a wrong readout, 19 of 306 (docs/accuracy.md): of several parts none alone can rule a
# value out.
WRONG = 0.06
# A readout is relied on, as by `rsrectify measure`, up to this standard deviation, as a share of the frame period, and from so
# many frames on whose motion was followed.
SURE = 0.1
FOLLOWED = 15
# The share of a normal density within twice its deviation. Of several parts the readout is relied on where so much of the
# posterior lies within twice the deviation above: what is left of one wrong part does not count by its distance, too.
PROBABLE = 0.954
# A part tells something where a readout is so much likelier than before it was seen.
TELLING = 2.0
# The probability that a clip is of another camera, or in another mode, than the one whose readout is expected: `OTHER_CAMERA_ODDS`
# of the rectifier.
OTHER_CAMERA = float(np.exp(-3.0))
# The prior's standard deviation, as a share of the frame period.
PRIOR_SHARE = 0.5
# A likelihood whose logarithm is still finite.
TINY = 1e-300

# What `rsrectify fix` is told where it is to look for the readout by itself, from what is known of the camera on.
OPEN = ["--readout-time", "0"]

# Frames that `rsrectify fix` looks ahead where its first pass finds that frames were moved, or exposed at other times than
# stated: with so many it knows that from the first frame on.
LOOKAHEAD = "18"

# Axis of each direction (0: along the rows' order, 1: the columns').
AXES = {"top-to-bottom": 0, "bottom-to-top": 0, "left-to-right": 1, "right-to-left": 1}
DIRECTIONS = (("top-to-bottom", "bottom-to-top"), ("left-to-right", "right-to-left"))


@dataclass(frozen=True)
class Readout:
    """What is believed of a readout: milliseconds, the edge that is read first, and why it is not certain, if so."""

    milliseconds: float
    direction: str
    deviation_ms: float
    doubt: str | None
    # What was known of the camera before, as `rsrectify measure --json` prints it.
    expected: dict[str, Any] | None = None
    # Whether all parts that tell it were moved after their readout and leans are seen, by which they can be rectified; whether any part was
    # moved, or was exposed at other times than stated.
    is_stabilised: bool = False
    is_retimed: bool = False

    def options(self, given: Sequence[str] = ()) -> list[str]:
        """What `rsrectify fix` is told beside the options that are given."""
        # 0 would leave it to the rectifier.
        time = max(self.milliseconds, 1e-6)
        known = ["--readout-time", f"{time:.6f}", "--readout-direction", self.direction]
        options = list(OPEN if self.doubt else known)
        timing = {"--lookahead": LOOKAHEAD} if self.is_retimed else {}
        timing |= {"--stabilised": "yes"} if self.is_stabilised else {}
        names = {option.split("=")[0] for option in given}
        for name, value in timing.items():
            options += [] if name in names else [name, value]
        return options

    def __str__(self) -> str:
        known = self.expected
        camera = f"; {known['camera']} {known['mode']}: {known['signed_readout_ms']:.1f} ms expected" if known else ""
        if self.doubt:
            return f"not certain: {self.doubt}{camera}"
        return f"{self.milliseconds:.1f} ms, {self.direction}, give or take {self.deviation_ms:.1f} ms{camera}"


def combine(measurements: list[dict[str, Any]]) -> Readout | None:
    """The readout that all measurements have in common, as `rsrectify measure --json` prints each; None without any."""
    measurements = [one for one in measurements if one.get("hypotheses")]
    if not measurements:
        return None
    # Half a frame period; where parts of a clip differ in it, their likelihoods do not.
    prior_deviation = float(np.median([one["prior"]["deviation_ms"] for one in measurements]))
    period = prior_deviation / PRIOR_SHARE
    # No readout is longer than the frame period.
    times = np.linspace(-period, period, 8001)
    # Alone, a part counts as `rsrectify measure` counts it; errors of a part show beside others.
    likelihoods = [_likelihood(one, times, 0.0) for one in measurements]
    wrong = 0.0
    is_several = sum(one.max() > TELLING for one in likelihoods) > 1
    if is_several:
        likelihoods = [_likelihood(one, times, MODEL_ERROR * period) for one in measurements]
        wrong = WRONG
    logs = sum(np.log(np.maximum(wrong + (1 - wrong) * one, TINY)) for one in likelihoods)
    expected = _expected(measurements)
    logs = logs + np.log(_belief(measurements[0]["prior"], expected, times))
    posterior = np.exp(logs - logs.max())
    posterior /= posterior.sum()

    axis, mode = np.unravel_index(posterior.argmax(), posterior.shape)
    near = np.abs(times - times[mode]) <= SURE * period
    weights = posterior[axis][near]
    mean = float((weights * times[near]).sum() / weights.sum())
    # Of a gradient along rows and columns: a readout along the other axis is as wrong as it is long.
    variance = (posterior[axis] * (times - mean) ** 2).sum()
    variance += (posterior[1 - axis] * (times**2 + mean**2)).sum()
    deviation = float(np.sqrt(variance))
    place = int(abs(times - mean).argmin())
    tell = [one[axis, place] for one in likelihoods if one.max() > TELLING]
    near = np.abs(times - mean) <= 2 * SURE * period
    is_sure = posterior[axis][near].sum() >= PROBABLE if is_several else deviation <= SURE * period
    doubt = _doubt(measurements, None if is_sure else deviation / period, tell)
    said = {one["stabilised"] for one in measurements} - {"undecided"}
    is_retimed = "yes" in said or any(one["timeline"] != "as stated" for one in measurements)
    direction = DIRECTIONS[axis][int(mean < 0)]
    is_stabilised = said == {"yes"} and any(one.get("shows_leans") for one in measurements)
    return Readout(abs(mean), direction, deviation, doubt, expected, is_stabilised, is_retimed)


def _likelihood(measurement: dict[str, Any], times: Array, blur: float) -> Array:
    """Posterior ÷ prior of the signed readout time, by axis and time; `blur` is the deviation of the model's error."""
    posterior = np.zeros((2, len(times)))
    for one in measurement["hypotheses"]:
        deviation = np.hypot(one["deviation_ms"], blur)
        density = _normal(times, one["signed_readout_ms"], deviation)
        posterior[AXES[one["direction"]]] += one["weight"] * density
    return posterior / _prior(measurement["prior"], times, blur)


def _prior(prior: dict[str, Any], times: Array, blur: float = 0.0) -> Array:
    density = _normal(times, 0.0, np.hypot(prior["deviation_ms"], blur))
    return np.array([prior["rows"] * density, prior["columns"] * density])


def _expected(measurements: list[dict[str, Any]]) -> dict[str, Any] | None:
    """What is known of the camera that made all of this; None where that is nothing, or not one readout."""
    known = [one["expected"] for one in measurements if one.get("expected")]
    return known[0] if known and all(one == known[0] for one in known) else None


def _belief(prior: dict[str, Any], expected: dict[str, Any] | None, times: Array) -> Array:
    """What is believed before anything is seen, by axis and time."""
    belief = _prior(prior, times)
    if expected:
        belief = OTHER_CAMERA * belief
        density = _normal(times, expected["signed_readout_ms"], expected["deviation_ms"])
        belief[AXES[expected["direction"]]] += (1 - OTHER_CAMERA) * density
    return belief


def _normal(values: Array, mean: float, deviation: float) -> Array:
    density: Array = np.exp(-0.5 * ((values - mean) / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi))
    return density


def _doubt(measurements: list[dict[str, Any]], deviation: float | None, tell: list[float]) -> str | None:
    """Why the readout is not to be relied on: its deviation as a share of the frame period, where that is too large, and its
    likelihoods by the measurements that tell something."""
    if sum(one["frames_with_motion"] for one in measurements) < FOLLOWED:
        return "hardly a frame has a motion that most of the picture follows"
    if deviation is not None:
        return f"the deviation is {100 * deviation:.0f} % of the frame duration"
    agree = sum((1 - WRONG) * likelihood > WRONG for likelihood in tell)
    if tell and 2 * agree <= len(tell):
        return f"of {len(tell)} parts that tell it, {len(tell) - agree} tell another one"
    return None
