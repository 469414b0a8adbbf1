// SPDX-License-Identifier: MIT OR Apache-2.0

//! Which frames of its clip a part has, as a comment among its tags: parts of one length would else be mistaken for each other.

use std::ops::Range;

const START: &str = "rsrectify: frames ";

/// The comment of a part with these frames.
pub fn of(frames: &Range<usize>) -> String {
    format!("{START}{}:{}", frames.start, frames.end)
}

/// The frames that a comment tells; `None` of any other comment.
pub fn read(comment: &str) -> Option<Range<usize>> {
    let (start, end) = comment.strip_prefix(START)?.split_once(':')?;
    Some(start.parse().ok()?..end.parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_are_read_again() {
        assert_eq!(read(&of(&(15..31))), Some(15..31));
        for other in ["", "frames 15:31", "rsrectify: frames 15", "rsrectify: frames a:b"] {
            assert_eq!(read(other), None, "{other}");
        }
    }
}
