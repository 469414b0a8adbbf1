// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames → the encoded stream: what the encoder is given, and what the stream states of it.

use super::codec::{Codec, Preset, Rate};
use super::{av1, hardware, prores, tags};
use crate::colour::Colour;
use crate::elements::{named, pad, replace_caps};
use crate::picture::Picture;
use anyhow::Result;
use gst::prelude::*;
use gst_video::{VideoColorimetry, VideoFormat, VideoFormatInfo, VideoInfo};

/// The matrix of BT.709, by which RGB is encoded.
const BT709: u8 = 1;

/// Formats of the frames that Y4M files hold.
const OF_Y4M: [&str; 10] = [
    "GRAY8",
    "I420",
    "Y42B",
    "Y444",
    "I420_10LE",
    "I422_10LE",
    "Y444_10LE",
    "I420_12LE",
    "I422_12LE",
    "Y444_12LE",
];
/// Formats of the frames of which PNG images are made.
const OF_PNG: [&str; 5] = ["GRAY8", "RGB", "RGBA", "GRAY16_BE", "RGBA64_BE"];

/// What encodes, and how.
#[derive(Clone, Debug)]
pub struct Encoder {
    codec: Codec,
    /// The name of GStreamer's element.
    element: String,
    is_hardware: bool,
    rate: Rate,
    preset: Preset,
}

impl Encoder {
    /// That in software.
    pub fn new(codec: Codec, rate: Rate, preset: Preset) -> Self {
        Self { codec, element: codec.encoder().to_owned(), is_hardware: false, rate, preset }
    }

    /// One in hardware.
    pub fn in_hardware(codec: Codec, rate: Rate, element: &str) -> Self {
        Self { codec, element: element.to_owned(), is_hardware: true, rate, preset: Preset::default() }
    }

    /// The formats that it takes.
    fn formats(&self) -> Vec<VideoFormat> {
        let names = match self.codec {
            Codec::Raw => OF_Y4M.map(str::to_owned).to_vec(),
            Codec::Png => OF_PNG.map(str::to_owned).to_vec(),
            _ => self.names_of_formats().unwrap_or_default(),
        };
        let formats = names.iter().map(|name| VideoFormat::from_string(name));
        formats.filter(|format| *format != VideoFormat::Unknown).collect()
    }

    fn names_of_formats(&self) -> Option<Vec<String>> {
        let factory = gst::ElementFactory::find(&self.element)?;
        let mut templates = factory.static_pad_templates().into_iter();
        let template = templates.find(|template| template.direction() == gst::PadDirection::Sink)?.caps();
        // Those in hardware also take frames that are there already.
        let is_plain = |features: &gst::CapsFeaturesRef| {
            features.is_any() || features.contains(gst::CAPS_FEATURE_MEMORY_SYSTEM_MEMORY)
        };
        let (taken, _) = template.iter_with_features().find(|(_, features)| is_plain(features))?;
        let taken = taken.value("format").ok()?;
        Some(match taken.get::<gst::List>() {
            Ok(list) => list.iter().filter_map(|name| name.get::<String>().ok()).collect(),
            Err(_) => vec![taken.get::<String>().ok()?],
        })
    }
}

/// What encodes the pictures of a clip.
#[derive(Clone, Debug)]
pub struct Encoding {
    encoder: Encoder,
    /// As they are encoded: RGB becomes YUV for most.
    picture: Picture,
    /// The format that the encoder is given; `None` where that of the clip is not known.
    format: Option<VideoFormat>,
    is_rgb: bool,
    /// The colours of the frames, where the stream cannot hold their full range.
    narrowed: Option<VideoColorimetry>,
}

impl Encoding {
    pub fn new(encoder: Encoder, mut picture: Picture) -> Self {
        let codec = encoder.codec;
        let format = picture.info.as_ref().and_then(|info| nearest_format(&encoder, info, picture.is_opaque));
        let is_rgb = picture.info.as_ref().is_some_and(|info| info.format_info().is_rgb());
        if is_rgb && format.is_some_and(|format| VideoFormatInfo::from_format(format).is_yuv()) {
            picture.colour.matrix = BT709;
            picture.colour.full_range = Some(false);
        }
        // Streams that leave their range open are limited: the new one states it, as some codecs' streams do and their files need not.
        picture.colour.full_range.get_or_insert(false);
        // Whatever a file says of ProRes, players take it for limited range.
        let is_narrowed = codec == Codec::Prores && picture.colour.full_range == Some(true) && !is_rgb;
        let narrowed = picture.colorimetry().filter(|_| is_narrowed);
        if narrowed.is_some() {
            picture.colour.full_range = Some(false);
        }
        Self { encoder, picture, format, is_rgb, narrowed }
    }

    /// Of frames that have been drawn over as RGB, of a clip that is YUV.
    pub fn of_rgb(self) -> Self {
        Self { is_rgb: true, ..self }
    }

    /// Raw video → the encoded stream; the encoder is called `encoder`.
    pub fn description(&self) -> String {
        // GStreamer 1.22 passes over a change of range alone, but not over one to and from RGB; and its short way from YUV to RGB of 8 bits
        // is off by up to five steps of 255.
        let is_image_of_yuv = self.encoder.codec == Codec::Png && !self.is_rgb;
        let by_way_of = match self.narrowed {
            Some(_) => Some("ARGB64"),
            None if is_image_of_yuv && self.has_alpha() => Some("AYUV64"),
            None => is_image_of_yuv.then_some("Y444_16LE"),
        };
        let detour = by_way_of.map(|format| format!("videoconvert ! video/x-raw,format={format} ! "));
        let (detour, dither) =
            (detour.unwrap_or_default(), if is_image_of_yuv { " dither=none" } else { "" });
        let mut raw = String::from("video/x-raw");
        if let Some(format) = self.format {
            raw += &format!(",format={}", format.to_str());
            // YUV keeps whatever it stands for as long as nothing else is asked for.
            let colorimetry = self.picture.colorimetry().filter(|_| self.is_rgb || self.narrowed.is_some());
            if let Some(colorimetry) = colorimetry.filter(|_| VideoFormatInfo::from_format(format).is_yuv()) {
                raw += &format!(",colorimetry=(string){colorimetry}");
            }
        }
        let parser = self.encoder.codec.parser().map(|parser| format!(" ! {parser} name=parser"));
        format!(
            "{detour}videoconvert{dither} ! {raw} ! {} name=encoder{}",
            self.encoder.element,
            parser.unwrap_or_default()
        )
    }

    /// Has decoded frames that come to a pad state their true colours where they are to be converted: their caps may have them from the
    /// file.
    pub fn label(&self, frames: &gst::Pad) {
        // Of images, RGB is made by them.
        let of_images =
            self.picture.colorimetry().filter(|_| self.encoder.codec == Codec::Png && !self.is_rgb);
        let Some(colours) = self.narrowed.or(of_images).map(|colours| colours.to_string()) else {
            return;
        };
        self.on_caps(frames, move |_, caps| caps.set("colorimetry", &colours));
    }

    /// Sets the encoder up that was made by the description.
    pub fn configure(&self, bin: &impl IsA<gst::Bin>) -> Result<()> {
        let encoder = named(bin, "encoder")?;
        if self.encoder.is_hardware {
            if !hardware::configure(&encoder, self.encoder.codec, self.encoder.rate) {
                let name = &self.encoder.element;
                gst::element_warning!(
                    encoder,
                    gst::LibraryError::Settings,
                    ("{name} cannot be set to this quality or bit rate: its default is used")
                );
            }
        } else {
            self.encoder.codec.configure(&encoder, self.encoder.rate, self.encoder.preset);
        }
        let options = match self.encoder.codec {
            Codec::H264 if !self.encoder.is_hardware => tags::x264(&self.picture),
            Codec::Hevc if !self.encoder.is_hardware => tags::x265(&self.picture),
            _ => String::new(),
        };
        if !options.is_empty() {
            let own = encoder.property::<Option<String>>("option-string").filter(|own| !own.is_empty());
            let all = own.map_or(options.clone(), |own| format!("{own}:{options}"));
            encoder.set_property("option-string", all);
        }
        if self.encoder.codec == Codec::H264 && !self.encoder.is_hardware {
            // Else what GStreamer makes of the caps wins over the options, and that is a guess where they state nothing.
            encoder.set_property("insert-vui", false);
        }
        if self.encoder.codec == Codec::Prores {
            let keeps_all = self.format.is_some_and(|format| format != VideoFormat::I42210le);
            encoder.set_property_from_str("profile", if keeps_all { "4444" } else { "hq" });
            if self.is_interlaced() {
                encoder.set_property_from_str("flags", "ildct");
            }
        }
        let coded = pad(&encoder, "src")?;
        let picture = self.picture.clone();
        match self.encoder.codec {
            Codec::Av1 => rewrite(&coded, move |unit| av1::stated(unit, &picture)),
            Codec::Prores => rewrite(&coded, move |frame| prores::stated(frame, picture.colour)),
            _ => {}
        }
        // Encoders go by the caps, which some decoders leave open.
        self.on_caps(&pad(&encoder, "sink")?, |this, caps| {
            this.state_scanning(caps);
            mend_aspect(caps);
        });
        let last = if self.encoder.codec.parser().is_some() { named(bin, "parser")? } else { encoder };
        self.on_caps(&pad(&last, "src")?, |this, caps| {
            this.picture.state_in(caps);
            this.state_scanning(caps);
        });
        Ok(())
    }

    /// Has caps that come to a pad state more.
    fn on_caps(&self, pad: &gst::Pad, state: impl Fn(&Self, &mut gst::CapsRef) + Send + Sync + 'static) {
        let this = self.clone();
        pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |_, info| {
            if let Some(gst::EventView::Caps(event)) = info.event().map(|event| event.view()) {
                let mut caps = event.caps_owned();
                state(&this, caps.make_mut());
                replace_caps(info, &caps);
            }
            gst::PadProbeReturn::Ok
        });
    }

    fn state_scanning(&self, caps: &mut gst::CapsRef) {
        if let Some(info) = self.picture.info.as_ref().filter(|_| self.is_interlaced()) {
            caps.set("interlace-mode", info.interlace_mode().to_str().to_string());
            if info.field_order() != gst_video::VideoFieldOrder::Unknown {
                caps.set("field-order", info.field_order().to_str().to_string());
            }
        }
    }

    fn is_interlaced(&self) -> bool {
        let mode = self.picture.info.as_ref().map(|info| info.interlace_mode());
        mode.is_some_and(|mode| mode != gst_video::VideoInterlaceMode::Progressive)
    }

    /// What encodes.
    pub fn encoder(&self) -> &Encoder {
        &self.encoder
    }

    /// The codec.
    pub fn codec(&self) -> Codec {
        self.encoder.codec
    }

    /// What the encoded pictures stand for.
    pub fn colour(&self) -> Colour {
        self.picture.colour
    }

    /// The first of the bits, colours, transparency and fields that the stream does not keep, in a sentence.
    pub fn lost_samples(&self) -> Option<String> {
        self.losses().into_iter().find(|(is_of_samples, _)| *is_of_samples).map(|(_, loss)| loss)
    }

    /// By how many packets the decoder of the clip waits.
    pub fn delay(&self) -> usize {
        self.picture.delay
    }

    /// Whether the clip has transparency.
    pub fn has_alpha(&self) -> bool {
        let has_alpha = self.picture.info.as_ref().is_some_and(|info| info.format_info().has_alpha());
        has_alpha && !self.picture.is_opaque
    }

    /// What of the pictures the stream does not keep, each in a sentence; whether samples or fields are lost by it.
    pub fn losses(&self) -> Vec<(bool, String)> {
        let (Some(info), Some(format)) = (&self.picture.info, self.format) else { return Vec::new() };
        let (clip, coded) = (info.format_info(), VideoFormatInfo::from_format(format));
        let codec = self.encoder.codec;
        let mut losses = Vec::new();
        if bits(&coded) < bits(&clip) {
            let (clip, coded) = (bits(&clip), bits(&coded));
            let loss = format!(
                "the {codec} encoder takes {coded} bits, the clip has {clip}; another --codec keeps them"
            );
            losses.push((true, loss));
        }
        if lost_chroma(&clip, &coded) > 0 {
            let loss = format!("the {codec} encoder has less resolution of colour than the clip");
            losses.push((true, loss));
        } else if coded.is_yuv() && !clip.is_gray() && chroma(&coded) != chroma(&clip) && is_strict(codec) {
            let why = match !is_whole(&clip, info) {
                true => format!(" for pictures of {} x {} pixels", info.width(), info.height()),
                false => String::new(),
            };
            let raised = match chroma(&coded) {
                [0, 0] => "4:4:4",
                [1, 0] => "4:2:2",
                _ => "4:2:0",
            };
            let loss =
                format!("{codec} cannot hold the clip's resolution of colour{why}: it is raised to {raised}");
            losses.push((false, loss));
        }
        if clip.is_rgb() && coded.is_yuv() {
            let loss = format!("the {codec} encoder takes no RGB: the clip's pictures are converted to YUV");
            losses.push((false, loss));
        }
        if self.has_alpha() && !coded.has_alpha() {
            losses.push((true, format!("{codec} has no transparency: that of the clip is left out")));
        }
        if self.narrowed.is_some() {
            let loss = format!("{codec} has limited range only: the clip's full range is converted to it");
            losses.push((false, loss));
        }
        if self.is_interlaced() && matches!(codec, Codec::Hevc | Codec::Av1 | Codec::Png) {
            let loss = format!("the {codec} encoder cannot mark the clip's fields; --codec h264 keeps them");
            losses.push((true, loss));
        }
        losses.extend(self.lost_statements().map(|loss| (false, loss)));
        losses
    }

    /// That what holds frames only does not state what they stand for, where that is not what is usual.
    fn lost_statements(&self) -> Option<String> {
        let colour = self.picture.colour;
        let is_lit = self.picture.mastering_display.is_some() || self.picture.light_level.is_some();
        let (what, is_stated) = match self.encoder.codec {
            Codec::Raw => ("Y4M files state no primaries, transfer and matrix", !colour.is_untagged()),
            // Programs take images for sRGB, which BT.709 comes close to.
            Codec::Png => (
                "PNG images state no primaries and transfer here",
                !matches!(colour.primaries, 1 | 2) || !matches!(colour.transfer, 1 | 2 | 6 | 13),
            ),
            _ => return None,
        };
        (is_stated || is_lit).then(|| format!("{what}: those of the clip are left out"))
    }
}

/// Has pixels be square whose aspect is none: the demuxer of AVI divides by the negative height of pictures from the bottom up.
fn mend_aspect(caps: &mut gst::CapsRef) {
    const FIELD: &str = "pixel-aspect-ratio";
    let Some(format) = caps.structure_mut(0) else { return };
    if format.get::<gst::Fraction>(FIELD).is_ok_and(|aspect| aspect.numer() <= 0) {
        format.set(FIELD, gst::Fraction::new(1, 1));
    }
}

/// Whether the codec has no odd sizes where colour is halved.
fn is_strict(codec: Codec) -> bool {
    matches!(codec, Codec::H264 | Codec::Hevc)
}

/// Whether all samples of colour of pictures of this size are whole.
fn is_whole(format: &VideoFormatInfo, info: &VideoInfo) -> bool {
    let [x, y] = chroma(format);
    info.width().is_multiple_of(1 << x) && info.height().is_multiple_of(1 << y)
}

fn bits(format: &VideoFormatInfo) -> u32 {
    format.depth().first().copied().unwrap_or(0)
}

/// By which powers of two the resolution of colour is lower than that of brightness, across and down.
fn chroma(format: &VideoFormatInfo) -> [u32; 2] {
    [format.w_sub(), format.h_sub()].map(|sub| sub.get(1).copied().unwrap_or(0))
}

/// How much of the resolution of colour is lost, in powers of two.
fn lost_chroma(from: &VideoFormatInfo, to: &VideoFormatInfo) -> u32 {
    if from.is_gray() {
        return 0;
    }
    if to.is_gray() {
        return u32::MAX;
    }
    let lost = chroma(to).into_iter().zip(chroma(from)).map(|(to, from)| to.saturating_sub(from));
    lost.sum()
}

/// Bits of a pixel.
fn storage(format: &VideoFormatInfo) -> u32 {
    let subs = format.w_sub().iter().zip(format.h_sub());
    // In sixteenths, for colour of a quarter of the resolution each way.
    format.depth().iter().zip(subs).map(|(bits, (x, y))| (bits << 4) >> (x + y)).sum()
}

/// Of the formats that an encoder takes, the one that loses least of the clip's and then adds least to it.
fn nearest_format(encoder: &Encoder, info: &VideoInfo, is_opaque: bool) -> Option<VideoFormat> {
    let codec = encoder.codec;
    let clip = info.format_info();
    let formats = encoder.formats().into_iter().map(VideoFormatInfo::from_format);
    let formats = formats.filter(|format| !is_strict(codec) || is_whole(format, info));
    let nearest = formats.min_by_key(|format| {
        (
            bits(&clip).saturating_sub(bits(format)),
            lost_chroma(&clip, format),
            clip.has_alpha() && !is_opaque && !format.has_alpha(),
            clip.is_rgb() != format.is_rgb(),
            storage(format),
        )
    });
    nearest.map(|format| format.format())
}

/// Puts what is made of each buffer in its place; `None` leaves it as it is.
fn rewrite(pad: &gst::Pad, made: impl Fn(&[u8]) -> Option<Vec<u8>> + Send + Sync + 'static) {
    pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
        let new = info.buffer().and_then(|buffer| {
            let bytes = made(&buffer.map_readable().ok()?)?;
            let mut new = gst::Buffer::from_mut_slice(bytes);
            buffer.copy_into(new.get_mut()?, gst::BUFFER_COPY_METADATA, ..).ok()?;
            Some(new)
        });
        if let Some(new) = new {
            info.data = Some(gst::PadProbeData::Buffer(new));
        }
        gst::PadProbeReturn::Ok
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_without_an_aspect_are_square() {
        gst::init().unwrap();
        for (stated, written) in [((-1, 1), (1, 1)), ((4, 3), (4, 3))] {
            let mut caps = gst::Caps::builder("video/x-raw")
                .field("pixel-aspect-ratio", gst::Fraction::new(stated.0, stated.1))
                .build();
            mend_aspect(caps.make_mut());
            let aspect = caps.structure(0).unwrap().get::<gst::Fraction>("pixel-aspect-ratio").unwrap();
            assert_eq!(aspect, gst::Fraction::new(written.0, written.1));
        }
    }
}
