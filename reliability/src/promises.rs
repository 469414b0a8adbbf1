// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the element promises to a pipeline, and the tests that show it.

/// A promise and where it is shown: `file::test`, or `attack name`; nothing where it is not.
pub struct Promise {
    /// In one sentence.
    pub text: &'static str,
    /// The tests.
    pub shown_by: &'static [&'static str],
}

const fn promise(text: &'static str, shown_by: &'static [&'static str]) -> Promise {
    Promise { text, shown_by }
}

/// All promises, in groups.
pub const PROMISES: &[(&str, &[Promise])] = &[
    (
        "Latency",
        &[
            promise(
                "A latency query goes upstream first; least and most latency grow by the element's own, and without an answer from upstream there is none.",
                &[
                    "latency::latency_adds_to_that_of_upstream",
                    "latency::without_upstream_there_is_no_latency_to_tell",
                    "promises::the_most_latency_grows_by_as_much_as_the_least",
                    "hostile::an_upstream_of_any_latency",
                    "attack fuzz",
                ],
            ),
            promise(
                "Its own is the lookahead times the frame duration, rounded up, plus the time reserved for the work; where caps tell no rate or a false one, it is learnt from the timestamps.",
                &[
                    "latency::latency_is_the_lookahead_rounded_up",
                    "latency::the_latency_grows_to_that_of_the_frames_that_come",
                    "latency::a_processing_deadline_is_latency",
                    "interval::a_rate_that_is_not_kept_is_corrected_once",
                ],
            ),
            promise(
                "A change is announced once, with no lock held.",
                &[
                    "latency::a_change_of_latency_is_announced_once",
                    "promises::callbacks_of_the_application_may_call_the_element",
                ],
            ),
            promise(
                "What passes through has no latency and is not held.",
                &["buffers::what_is_not_one_exposure_a_frame_passes_with_one_warning"],
            ),
            promise(
                "A live sink drops nothing for want of latency.",
                &[
                    "live::a_true_frame_rate",
                    "live::no_frame_rate",
                    "live::half_the_frame_rate",
                    "live::vp8_over_rtp",
                    "attack live",
                ],
            ),
            promise(
                "A live frame goes out when its time is up, with what is known by then.",
                &[
                    "live::a_frame_goes_out_before_it_is_late_though_the_next_ones_do_not_come",
                    "live::a_longer_latency_holds_once_the_pipeline_is_set_to_it",
                    "live::held_frames_are_rectified_as_far_as_their_motion_is_known",
                ],
            ),
            promise(
                "Frames that wait are never dropped to make place for others.",
                &["stream::lookahead_frames_are_held", "attack fuzz", "attack slow-sinks"],
            ),
        ],
    ),
    (
        "Ends, flushes, order",
        &[
            promise(
                "The end of the stream or of a segment, a new stream, segment, caps, a gap and a drain query bring out all frames first.",
                &[
                    "stream::events_that_end_a_stretch_come_after_its_frames",
                    "stream::new_caps_come_after_the_frames_of_the_old_ones",
                    "stream::a_drain_query_brings_out_all_frames",
                    "stream::streams_of_no_and_of_one_frame",
                    "attack fuzz",
                    "attack playback",
                ],
            ),
            promise(
                "A push that fails while frames are brought out ends it; the rest is dropped.",
                &["stream::a_drain_that_fails_drops_the_rest"],
            ),
            promise(
                "A flush gets through at once, frees whoever is blocked, drops the frames held, keeps caps and sticky events.",
                &[
                    "promises::a_flush_frees_a_push_that_downstream_blocks",
                    "stream::a_flush_drops_frames_but_not_sticky_events",
                    "live::a_flush_and_a_stop_end_the_wait",
                    "attack fuzz",
                ],
            ),
            promise(
                "A hole in the stream restarts the analysis; the mark of it stays on its frame alone.",
                &["stream::a_hole_drains_and_its_mark_stays_on_its_frame"],
            ),
            promise(
                "In reverse playback, marks at each group of pictures lose neither frames nor lookahead.",
                &[
                    "stream::reverse_playback_keeps_its_lookahead_across_groups_of_pictures",
                    "attack playback",
                ],
            ),
            promise(
                "No lock is held while buffers, events, queries and messages leave: callbacks may call the element.",
                &["promises::callbacks_of_the_application_may_call_the_element", "attack fuzz"],
            ),
            promise(
                "Serialised events keep their places between the frames; others do not wait.",
                &[
                    "stream::other_events_keep_their_place_between_frames",
                    "stream::out_of_band_events_do_not_wait",
                    "queue::events_keep_their_place_between_frames",
                    "attack fuzz",
                ],
            ),
            promise(
                "Time without frames is handed on in order.",
                &[
                    "stream::events_that_end_a_stretch_come_after_its_frames",
                    "buffers::a_buffer_without_a_picture_keeps_its_place",
                    "attack fuzz",
                ],
            ),
            promise(
                "Events and queries that it does not know go on.",
                &["promises::events_and_queries_that_it_does_not_know_go_on"],
            ),
            promise(
                "Quality of service: only what would be dropped is skipped, the work comes back by itself, no frame is lost; the events go on upstream.",
                &[
                    "latency::lateness_that_does_not_grow_changes_nothing",
                    "latency::overload_stops_the_work_and_time_brings_it_back",
                    "latency::qos_can_be_turned_off",
                    "latency::qos_events_go_on_upstream",
                    "load_tests::under_overload_more_frames_are_shown_than_by_dropping",
                    "hostile::any_quality_of_service",
                    "attack slow-sinks",
                ],
            ),
            promise(
                "Seeks, rates and directions show the frames that they show without the element, rectified backwards too.",
                &[
                    "clip::every_seek_shows_what_it_shows_without_the_element",
                    "pixels::a_film_played_backwards_is_rectified_as_well",
                    "hostile::a_storm_of_seeks_from_two_threads",
                    "attack seeks",
                    "attack playback",
                ],
            ),
            promise(
                "A frame leaves with the timestamps, offsets and flags it came with, missing and wrong ones included.",
                &[
                    "stream::every_frame_comes_out_once_with_what_it_says_of_itself",
                    "stream::frames_without_timestamps_come_out_too",
                    "hostile::any_timestamps",
                    "attack fuzz",
                ],
            ),
        ],
    ),
    (
        "Caps and formats",
        &[
            promise(
                "The formats offered are those that are rectified, of 8 to 16 bits; caps are the same on both sides.",
                &[
                    "buffers::every_format_in_every_size_with_any_stride",
                    "buffers::other_formats_are_not_taken",
                    "formats::every_format_is_rectified_as_its_conversion_is",
                    "formats::a_format_that_is_not_taken_is_converted_to_one_that_holds_as_much",
                    "pixels::every_format_shows_what_a_global_shutter_would_have_seen",
                ],
            ),
            promise(
                "Caps may change in mid-stream, as often as they like, to the same ones too.",
                &[
                    "stream::new_caps_come_after_the_frames_of_the_old_ones",
                    "stream::the_same_caps_twice_change_nothing",
                    "hostile::other_caps_with_each_frame",
                    "clip::streams_of_different_sizes_one_after_another",
                    "attack other-sizes",
                ],
            ),
            promise(
                "A renegotiation asked for by downstream comes before the next frame and loses none; one that fails says so and is tried again.",
                &["hostile::a_renegotiation_loses_no_frame", "promises::a_renegotiation_that_fails_says_so"],
            ),
            promise(
                "Interlaced and multiview frames pass with one warning.",
                &["buffers::what_is_not_one_exposure_a_frame_passes_with_one_warning"],
            ),
            promise(
                "Colorimetry and the like pass unchanged; each plane is warped at its own resolution and siting, alpha too.",
                &[
                    "buffers::colorimetry_and_the_like_go_on_unchanged",
                    "pixels::chroma_planes_and_chroma_pairs_are_warped_alike",
                    "pixels::the_border_colour_is_that_colour_in_every_format",
                    "formats_tests::chroma_lies_where_its_site_says",
                ],
            ),
            promise(
                "Memory other than the system's is refused.",
                &[
                    "formats::memory_that_is_not_the_systems_is_refused",
                    "buffers::other_formats_are_not_taken",
                ],
            ),
            promise(
                "The readout may run along either axis, from either end.",
                &["pixels::every_readout_direction_is_undone"],
            ),
        ],
    ),
    (
        "Buffers",
        &[
            promise(
                "Any strides, offsets and odd sizes are read right; what is not a frame is one error that costs no other frame, and never a panic.",
                &[
                    "buffers::every_format_in_every_size_with_any_stride",
                    "buffers::a_buffer_that_is_too_small_is_an_error_not_a_panic",
                    "hostile::moving_pictures_of_odd_sizes",
                    "hostile::metas_that_claim_another_frame",
                    "process::a_meta_of_a_smaller_frame_is_no_programming_error",
                    "hostile::a_plane_in_two_memories_is_read_as_far_as_it_is_mapped",
                    "hostile::a_frame_cut_off_in_its_last_plane_costs_no_other",
                    "attack fuzz",
                ],
            ),
            promise(
                "Upstream is asked for enough buffers; frames of a pool that cannot grow are copied and given back.",
                &[
                    "buffers::upstream_is_asked_for_a_pool_that_survives_the_frames_held",
                    "buffers::a_pool_that_cannot_grow_is_not_emptied",
                    "attack small-pools",
                ],
            ),
            promise(
                "Downstream's pool is used where it offers one.",
                &["buffers::the_pool_of_downstream_is_used"],
            ),
            promise(
                "A frame that came in is never written to.",
                &["promises::a_frame_that_others_hold_is_not_written_to", "attack fuzz"],
            ),
            promise(
                "A frame with nothing to correct is the buffer that came; packed anew only for a sink that would take its padding for picture.",
                &[
                    "buffers::a_frame_that_does_not_move_is_the_buffer_that_came",
                    "buffers::strength_zero_touches_nothing_and_keeps_the_latency",
                    "buffers::a_sink_that_reads_no_strides_gets_packed_rows",
                    "buffers::a_file_of_raw_frames_is_what_identity_writes",
                    "hostile::padding_is_taken_out_of_every_format_and_nothing_else",
                    "attack raw-sinks",
                ],
            ),
            promise(
                "Metas are kept, those of size and orientation too.",
                &[
                    "buffers::metas_are_kept_those_of_size_and_orientation_too",
                    "formats::overlays_beside_the_picture_are_kept",
                ],
            ),
            promise(
                "Upstream is not told that the element crops.",
                &["promises::upstream_may_not_leave_the_cropping_to_it"],
            ),
            promise(
                "Each frame's motion is told by meta and by message.",
                &["buffers::each_frame_brings_its_motion_along", "stream::a_message_for_each_frame"],
            ),
            promise(
                "A repeated frame is no motion of its own.",
                &["stream::a_frame_flagged_as_repeated_is_no_motion_of_its_own"],
            ),
        ],
    ),
    (
        "Life",
        &[
            promise(
                "A stop forgets the stream; any order of states, from any threads, is survived.",
                &[
                    "stream::stopped_and_started_again_it_knows_nothing_of_before",
                    "stream::every_order_of_states",
                    "clip::many_states_in_a_row",
                    "hostile::a_storm_of_states_from_three_threads",
                    "attack restarts",
                    "attack fuzz",
                ],
            ),
            promise(
                "Properties may be set from any thread at any time to anything in their range, and lose no frame.",
                &[
                    "hostile::settings_change_while_frames_flow",
                    "hostile::every_property_at_its_extremes",
                    "stream::readout_settings_that_change_lose_no_frame",
                    "properties_tests::every_setting_is_read_from_where_it_is_written",
                    "attack fuzz",
                ],
            ),
            promise(
                "What can be animated has its value at the time of the frame that goes out.",
                &[
                    "stream::properties_follow_their_curves_at_the_time_of_the_frame_given_out",
                    "stream::an_animated_crop_is_that_of_the_frame_given_out",
                ],
            ),
            promise("Presets keep every setting.", &["presets::a_preset_brings_back_every_setting"]),
            promise(
                "A panic would be an error on the bus, and the process would live. No stream is known that makes one, so no test does; all attacks fail at the first.",
                &[],
            ),
            promise(
                "Downstream's answers are handed upstream; only the element's own failures are its errors.",
                &["promises::what_downstream_answers_goes_upstream_without_an_error_of_the_element"],
            ),
            promise(
                "A frame before caps is not negotiated.",
                &["stream::a_frame_before_caps_is_not_negotiated"],
            ),
            promise(
                "Memory is bounded.",
                &[
                    "process::a_long_film_takes_no_more_memory_than_a_short_one",
                    "attack long-film",
                    "attack restarts",
                    "attack leaks",
                ],
            ),
            promise(
                "It logs under its own name and prints nothing, which a lint makes sure of.",
                &["promises::it_logs_under_its_own_name"],
            ),
            promise(
                "The first picture after a seek while paused is the right one.",
                &["clip::scrubbing_always_shows_the_right_first_frame", "attack seeks"],
            ),
            promise(
                "Threads end with the stop.",
                &[
                    "process::its_threads_end_when_it_stops",
                    "timer::it_acts_at_the_time_and_only_then",
                    "attack restarts",
                ],
            ),
            promise(
                "It can be put into a playing pipeline and taken out again.",
                &[
                    "inserting::an_element_put_in_and_taken_out_loses_no_frame",
                    "inserting::elements_put_in_and_taken_out_at_any_time_lose_no_frame",
                ],
            ),
        ],
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Whether a file of the tests, or one of the plugin's with tests of its own, has a function of this name.
    fn exists(file: &str, test: &str) -> bool {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        ["tests/element", "tests/element_alone", "gst-plugin/src/rsrectify"].iter().any(|folder| {
            let path = root.join(folder).join(format!("{file}.rs"));
            std::fs::read_to_string(path).is_ok_and(|text| text.contains(&format!("fn {test}()")))
        })
    }

    #[test]
    fn every_test_that_is_named_exists() {
        let attacks: Vec<_> = crate::soak::ATTACKS.iter().map(|attack| attack.name).collect();
        let mut missing = Vec::new();
        for name in PROMISES.iter().flat_map(|(_, group)| *group).flat_map(|promise| promise.shown_by) {
            let found = match (name.strip_prefix("attack "), name.split_once("::")) {
                (Some(attack), _) => attack == "fuzz" || attacks.contains(&attack),
                (None, Some((file, test))) => exists(file, test),
                (None, None) => false,
            };
            if !found {
                missing.push(name);
            }
        }
        assert!(missing.is_empty(), "{missing:?}");
    }

    #[test]
    fn every_attack_shows_a_promise() {
        let named: Vec<_> =
            PROMISES.iter().flat_map(|(_, group)| *group).flat_map(|promise| promise.shown_by).collect();
        for attack in crate::soak::ATTACKS {
            let name = format!("attack {}", attack.name);
            let beside = ["damaged-files", "many-elements"].contains(&attack.name);
            assert!(beside || named.iter().any(|other| **other == name), "{name}");
        }
    }
}
