// SPDX-License-Identifier: MIT OR Apache-2.0

//! Encoders in hardware, as GStreamer's plugins of VA, V4L2, NVENC and others offer them.

use super::codec::{Codec, Rate};
use gst::glib;
use gst::prelude::*;

/// An encoder, as the registry of GStreamer describes it.
struct Offer {
    name: String,
    /// GStreamer's order of preference, the highest first.
    rank: i32,
    /// What kind of element it is, such as `Codec/Encoder/Video/Hardware`.
    class: String,
    /// The kinds of streams that it writes, as caps call them.
    streams: Vec<String>,
}

/// The encoder of a codec in hardware that is preferred of those that work here.
pub fn encoder(codec: Codec) -> Option<String> {
    let offers =
        gst::ElementFactory::factories_with_type(gst::ElementFactoryType::VIDEO_ENCODER, gst::Rank::NONE);
    let offers = offers.iter().map(|factory| Offer {
        name: factory.name().to_string(),
        rank: factory.rank().into(),
        class: factory.metadata("klass").unwrap_or_default().to_owned(),
        streams: streams(factory),
    });
    in_order(codec, offers.collect()).into_iter().find(|name| works(name))
}

/// The encoders of a codec in hardware, the preferred ones first.
fn in_order(codec: Codec, mut offers: Vec<Offer>) -> Vec<String> {
    offers.retain(|offer| {
        offer.class.contains("Hardware") && offer.streams.iter().any(|stream| stream == codec.media_type())
    });
    offers.sort_by(|one, other| other.rank.cmp(&one.rank).then_with(|| one.name.cmp(&other.name)));
    offers.into_iter().map(|offer| offer.name).collect()
}

fn streams(factory: &gst::ElementFactory) -> Vec<String> {
    let templates = factory.static_pad_templates().into_iter();
    let outputs = templates.filter(|template| template.direction() == gst::PadDirection::Src);
    outputs
        .flat_map(|output| output.caps().iter().map(|caps| caps.name().to_string()).collect::<Vec<_>>())
        .collect()
}

/// Whether the device is there and can be opened.
fn works(name: &str) -> bool {
    let Ok(element) = gst::ElementFactory::make(name).build() else { return false };
    let is_ready = element.set_state(gst::State::Ready).is_ok();
    element.set_state(gst::State::Null).is_ok() && is_ready
}

/// Sets an encoder to a rate; whether it can be set to one of this kind.
pub fn configure(encoder: &gst::Element, codec: Codec, rate: Rate) -> bool {
    match rate {
        Rate::Bits(rate) => {
            set(encoder, "bitrate", &rate.to_string())
                || set(
                    encoder,
                    "extra-controls",
                    &format!("controls,video_bitrate={}", u64::from(rate) * 1000),
                )
        }
        Rate::Quality(quality) => {
            let quality = quality.unwrap_or_else(|| codec.usual_quality());
            // Their scale of AV1 goes to 255, that of the encoder in software to 63.
            let quality = if codec == Codec::Av1 { 4 * quality } else { quality }.to_string();
            // Each plugin has names of its own: VA's old and new one and Quick Sync, then NVENC.
            let is_constant = set(encoder, "rate-control", "cqp") || set(encoder, "rc-mode", "constqp");
            let names = ["qpi", "qpp", "qpb", "qp-i", "qp-p", "qp-b", "qp", "init-qp", "qp-const"];
            let is_set = names.into_iter().filter(|name| set(encoder, name, &quality)).count() > 0;
            is_constant && is_set
        }
    }
}

/// Sets a property, where there is one of this name that has such a value.
fn set(element: &gst::Element, name: &str, value: &str) -> bool {
    let Some(property) = element.find_property(name) else { return false };
    let Ok(value) = glib::Value::deserialize_with_pspec(value, &property) else { return false };
    element.set_property_from_value(name, &value);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoders_in_hardware_are_chosen_by_codec_and_rank() {
        gst::init().unwrap();
        let offer = |name: &str, rank: i32, class: &str, stream: &str| Offer {
            name: name.to_owned(),
            rank,
            class: class.to_owned(),
            streams: vec![stream.to_owned()],
        };
        const HARDWARE: &str = "Codec/Encoder/Video/Hardware";
        let offers = || {
            vec![
                offer("x264enc", 257, "Codec/Encoder/Video", "video/x-h264"),
                offer("v4l2h264enc", 257, HARDWARE, "video/x-h264"),
                offer("nvh264enc", 258, HARDWARE, "video/x-h264"),
                offer("vah264enc", 0, HARDWARE, "video/x-h264"),
                offer("vah265enc", 0, HARDWARE, "video/x-h265"),
            ]
        };
        assert_eq!(in_order(Codec::H264, offers()), ["nvh264enc", "v4l2h264enc", "vah264enc"]);
        assert_eq!(in_order(Codec::Hevc, offers()), ["vah265enc"]);
        assert!(in_order(Codec::Av1, offers()).is_empty());
        assert!(in_order(Codec::Prores, offers()).is_empty());
    }

    #[test]
    fn properties_that_are_not_there_are_not_set() {
        gst::init().unwrap();
        let encoder = gst::ElementFactory::make("x264enc").build().unwrap();
        assert!(configure(&encoder, Codec::H264, Rate::Bits(1234)));
        assert_eq!(encoder.property::<u32>("bitrate"), 1234);
        assert!(!configure(&encoder, Codec::H264, Rate::Quality(None)));
        assert!(
            !set(&encoder, "speed-preset", "none of these") && !works("no-such-encoder") && works("x264enc")
        );
    }
}
