# SPDX-License-Identifier: MIT OR Apache-2.0

from typing import Any

import numpy as np
import pytest
from rsrectify_batch import readout
from rsrectify_batch.readout import MODEL_ERROR, Readout

# Of 30 frames/s: the prior's deviation is half a period.
PERIOD = 1000 / 30
PRIOR = {"deviation_ms": PERIOD / 2, "rows": 0.9, "columns": 0.1}


def combine(measurements: list[dict[str, Any]]) -> Readout:
    """The readout of measurements that have one."""
    found = readout.combine(measurements)
    assert found is not None
    return found


def measured(*hypotheses: tuple[str, float, float, float], frames: int = 100) -> dict[str, Any]:
    """A measurement whose posterior is this mixture of direction, milliseconds, deviation, weight."""
    names = ("direction", "signed_readout_ms", "deviation_ms", "weight")
    listed = [dict(zip(names, one)) for one in hypotheses]
    timing = {"stabilised": "undecided", "shows_leans": False, "timeline": "as stated"}
    return {"hypotheses": listed, "prior": PRIOR, "frames_with_motion": frames, **timing}


def told(milliseconds: float, deviation: float, direction: str = "top-to-bottom") -> dict[str, Any]:
    return measured((direction, milliseconds, deviation, 1.0))


NOTHING = measured(("top-to-bottom", 0.0, PERIOD / 2, 0.9), ("left-to-right", 0.0, PERIOD / 2, 0.1))


def test_evidence_of_normal_posteriors_adds_up_as_information() -> None:
    # Each posterior's information less the prior's, and the prior's once: in closed form, with the model's error in each.
    means, deviations = np.array([24.0, 25.0, 24.4]), np.array([1.0, 1.5, 0.6])
    model = (MODEL_ERROR * PERIOD) ** 2
    prior = (PERIOD / 2) ** 2
    posteriors = deviations**2 + model
    likelihoods = 1 / posteriors - 1 / (prior + model)
    information = likelihoods.sum() + 1 / prior
    found = combine([told(*one) for one in zip(means, deviations)])
    assert found.milliseconds == pytest.approx((means / posteriors).sum() / information, abs=0.02)
    assert found.deviation_ms == pytest.approx(information**-0.5, rel=0.1)
    assert (found.direction, found.doubt) == ("top-to-bottom", None)


@pytest.mark.parametrize("share", [0.03, 0.06, 0.09, 0.099, 0.101, 0.2])
def test_alone_a_part_is_relied_on_where_measure_relies_on_it(share: float) -> None:
    # `rsrectify measure`: up to a tenth of the frame duration.
    found = combine([told(20.0, share * PERIOD), NOTHING])
    assert (found.doubt is None) == (share < 0.1), found
    if share < 0.1:
        assert found.milliseconds == pytest.approx(20.0, abs=0.2)
        assert found.deviation_ms == pytest.approx(share * PERIOD, rel=0.02)


def test_alone_a_far_possibility_counts_as_measure_counts_it() -> None:
    # Its deviation is that of a gradient: of one part in a hundred 52 ms away, 5.2 ms; along the other axis, sqrt(28² + 10²) ms.
    for other in [("bottom-to-top", -24.0, 1.0, 0.01), ("left-to-right", 10.0, 1.0, 0.02)]:
        found = combine([measured(("top-to-bottom", 28.0, 1.0, 1 - other[3]), other)])
        distance = 52.0 if other[0] == "bottom-to-top" else np.hypot(28.0, 10.0)
        expected = np.sqrt(1 + other[3] * distance**2)
        assert found.deviation_ms == pytest.approx(expected, rel=0.05) and "deviation" in str(found.doubt)


def test_a_part_that_tells_nothing_changes_nothing() -> None:
    alone, beside = combine([told(20.0, 1.0)]), combine([told(20.0, 1.0), NOTHING, NOTHING])
    assert beside.milliseconds == pytest.approx(alone.milliseconds, abs=1e-6)
    assert beside.deviation_ms == pytest.approx(alone.deviation_ms, rel=1e-6)


def test_what_one_part_leaves_open_another_decides() -> None:
    # The reversed direction fits a vibration as well; a pan elsewhere in the film tells.
    open_edge = measured(("top-to-bottom", 28.0, 1.0, 0.4), ("bottom-to-top", -24.0, 1.0, 0.6))
    assert combine([open_edge]).doubt is not None
    found = combine([open_edge, told(27.0, 3.0)])
    assert found.doubt is None and found.direction == "top-to-bottom"
    assert found.milliseconds == pytest.approx(28.0, abs=0.3)


def test_one_sure_and_wrong_part_does_not_outvote_two() -> None:
    wrong = told(-20.0, 0.2, "right-to-left")
    found = combine([told(24.0, 1.0), wrong, told(24.5, 1.0)])
    assert (found.direction, found.doubt) == ("top-to-bottom", None)
    assert found.milliseconds == pytest.approx(24.2, abs=0.3)


def test_parts_of_several_cameras_leave_it_open() -> None:
    assert combine([told(10.0, 0.3), told(25.0, 0.3)]).doubt is not None
    many = [told(time, 0.3) for time in (5.0, 10.0, 15.0, 20.0, 25.0)]
    assert combine([*many, told(25.0, 0.3)]).doubt is not None


def test_directions_have_their_axis_and_sign() -> None:
    for direction, time in [("bottom-to-top", -12.0), ("left-to-right", 12.0), ("right-to-left", -12.0)]:
        found = combine([told(time, 0.5, direction)])
        assert found.direction == direction and found.doubt is None
        assert found.milliseconds == pytest.approx(12.0, abs=0.1)
        assert found.options()[-1] == direction


def test_what_is_known_of_the_camera_counts_where_the_film_leaves_it_open() -> None:
    known: dict[str, Any] = {"camera": "GoPro HERO5 Session", "mode": "1280x720@29.97", "direction": "top-to-bottom"}
    known |= {"signed_readout_ms": 25.7, "deviation_ms": 2.6}

    def of_camera(one: dict[str, Any]) -> dict[str, Any]:
        return {**one, "expected": known}

    open_edge = measured(("top-to-bottom", 28.0, 1.0, 0.4), ("bottom-to-top", -24.0, 1.0, 0.6))
    found = combine([of_camera(open_edge)] * 2)
    assert found.doubt is None and found.direction == "top-to-bottom" and "25.7 ms expected" in str(found)
    # Between the two, by their information; how far from the expected one the film is alone is a matter of its own.
    assert 25.7 < found.milliseconds < combine([open_edge, told(28.0, 1.0)]).milliseconds
    # A film that shows another readout is of another camera, or of another mode of it.
    clear = told(12.0, 0.3)
    found = combine([of_camera(clear)] * 3)
    assert found.doubt is None and found.milliseconds == pytest.approx(12.0, abs=0.2)
    # What was not seen to move is not decided by what is known, but looked for from there on.
    assert combine([of_camera({**NOTHING, "frames_with_motion": 3})]).options() == ["--readout-time", "0"]
    # Clips of several cameras have no expectation in common.
    other = {**open_edge, "expected": {**known, "signed_readout_ms": 10.0}}
    assert combine([of_camera(open_edge), other]).expected is None


def test_without_motion_it_is_not_certain() -> None:
    assert readout.combine([]) is None
    assert combine([NOTHING]).doubt is not None
    still = {**told(20.0, 0.5), "frames_with_motion": 3}
    assert "motion" in str(combine([still]).doubt)
    assert combine([still]).options() == ["--readout-time", "0"]


def test_where_time_or_place_of_frames_is_not_what_the_file_says_more_frames_are_looked_ahead() -> None:
    usual = {**told(20.0, 0.5), "stabilised": "no"}
    assert "--lookahead" not in combine([usual, usual]).options()
    dropped = {**usual, "timeline": "one frame of 5 is missing"}
    assert combine([usual, dropped]).options()[-2:] == ["--lookahead", "18"]
    assert "18" not in combine([usual, dropped]).options(["--lookahead=8"])
    stabilised = {**usual, "stabilised": "yes", "shows_leans": True}
    assert combine([stabilised, NOTHING]).options()[-4:] == ["--lookahead", "18", "--stabilised", "yes"]
    assert "yes" not in combine([stabilised, usual]).options(), "shots of several cameras"
    deformed = {**stabilised, "shows_leans": False}
    assert combine([deformed, NOTHING]).options()[-2:] == ["--lookahead", "18"], "nothing to rectify it by"
