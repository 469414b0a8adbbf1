// SPDX-License-Identifier: MIT OR Apache-2.0

//! Pango markup in subtitles, which not every container can hold.

use gst::prelude::*;

/// Makes plain text of the Pango markup that comes to a pad.
pub fn strip(pad: &gst::Pad) {
    pad.add_probe(gst::PadProbeType::BUFFER, |_, info| {
        if let Some(gst::PadProbeData::Buffer(buffer)) = &mut info.data {
            let text = buffer.map_readable().map(|bytes| plain_text(&String::from_utf8_lossy(&bytes)));
            let mut plain = text.map(|text| gst::Buffer::from_mut_slice(text.into_bytes()));
            if let Ok(plain) = &mut plain
                && let Some(target) = plain.get_mut()
            {
                let kept = gst::BufferCopyFlags::TIMESTAMPS | gst::BufferCopyFlags::FLAGS;
                // Without times the muxer refuses the buffer, and says so.
                let _ = buffer.copy_into(target, kept, ..);
            }
            if let Ok(plain) = plain {
                *buffer = plain;
            }
        }
        gst::PadProbeReturn::Ok
    });
}

/// Text without the tags of Pango markup, its entities resolved.
fn plain_text(markup: &str) -> String {
    let mut text = String::with_capacity(markup.len());
    let mut rest = markup;
    while let Some(start) = rest.find('<') {
        text.push_str(rest.get(..start).unwrap_or_default());
        let tag = rest.get(start..).unwrap_or_default();
        rest = tag.find('>').and_then(|end| tag.get(end + 1..)).unwrap_or_default();
    }
    text.push_str(rest);
    // The ampersand last, or "&amp;lt;" would become "<".
    [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&#39;", "'"), ("&amp;", "&")]
        .iter()
        .fold(text, |text, (entity, character)| text.replace(entity, character))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_becomes_plain_text() {
        assert_eq!(plain_text("plain"), "plain");
        assert_eq!(plain_text("<span color=\"#fff\"><i>a</i> &lt;b&gt;</span> &amp;amp; c"), "a <b> &amp; c");
        assert_eq!(plain_text("an open <tag"), "an open ");
    }
}
