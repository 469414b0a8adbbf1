// SPDX-License-Identifier: MIT OR Apache-2.0

//! What an MP4 or MOV clip has that its demuxer does not give out, so that another container cannot get it.

use crate::boxes::{child, children};
use crate::isobmff::{Film, Track};
use crate::output::container::Container;

/// Kinds of tracks that the demuxer gives out, or that are named or of no use elsewhere: timecode, and hints to streaming and
/// the other systems of MPEG-4, which describe samples that are replaced.
const KNOWN: [&[u8; 4]; 11] =
    [b"vide", b"soun", b"text", b"sbtl", b"subt", b"subp", b"clcp", b"tmcd", b"hint", b"odsm", b"sdsm"];
/// Parts of the user data that are no tags, and tags that name the program that wrote the file.
const NO_TAGS: [&[u8; 4]; 7] = [b"chpl", b"meta", b"name", b"free", b"hnti", b"\xa9too", b"\xa9swr"];

/// Sentences about each kind of it; `copies` of a track whether it is copied as it is.
pub fn of(film: &Film, container: Container, copies: impl Fn(&Track<'_>) -> bool) -> Vec<String> {
    let mut all = Vec::new();
    let unheld = film.tracks().filter(|track| !KNOWN.contains(&&track.handler) && !copies(track));
    let kinds: Vec<_> = unheld.map(|track| track.handler.escape_ascii().to_string()).collect();
    if !kinds.is_empty() {
        let kinds = kinds.join(", ");
        all.push(format!(
            "timed metadata ({kinds}) is left out: it cannot go from here into {container} files"
        ));
    }
    // Of other films, all but the tracks is taken over.
    if container.is_isobmff() {
        return all;
    }
    let user_data = film.child(b"udta").unwrap_or_default();
    let refers_to_chapters = |track: &Track<'_>| child(track.content, &[b"tref", b"chap"]).is_some();
    if child(user_data, &[b"chpl"]).is_some() || film.tracks().any(|track| refers_to_chapters(&track)) {
        all.push(format!(
            "chapters are left out: those of MP4 and MOV cannot go into {container} files here"
        ));
    }
    if has_tags(film, user_data) {
        all.push("tags, such as place and camera, are left out but for a few".to_owned());
    }
    all
}

/// Whether a film has tags: in the user data, or in the lists of iTunes and QuickTime.
fn has_tags(film: &Film, user_data: &[u8]) -> bool {
    let is_tag = |name: &[u8]| !NO_TAGS.iter().any(|other| name == *other);
    // Its header is one of ISO or none.
    let metas = [film.child(b"meta"), child(user_data, &[b"meta"])].into_iter().flatten();
    let mut lists =
        metas.filter_map(|meta| child(meta, &[b"ilst"]).or_else(|| child(meta.get(4..)?, &[b"ilst"])));
    children(user_data).any(|(name, _)| is_tag(name))
        || lists.any(|list| children(list).any(|(name, _)| is_tag(name)))
}
