// SPDX-License-Identifier: MIT OR Apache-2.0

//! What became of the frames of an attack.

use serde::{Deserialize, Serialize};

/// Counts of one attack; all but `tried` are to be 0.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outcome {
    /// How often it was tried.
    pub tried: u64,
    /// Frames that went through.
    pub frames: u64,
    /// Frames that did not come out.
    pub lost: u64,
    /// Frames that came out twice, or that nobody put in.
    pub doubled: u64,
    /// Frames that came out in another order, with other bytes, times or flags than they must.
    pub changed: u64,
    /// Processes that died.
    pub crashed: u64,
    /// Tries that did not end.
    pub hung: u64,
    /// What is good to know besides.
    pub notes: Vec<String>,
    /// What was wrong, in words.
    pub faults: Vec<String>,
}

impl Outcome {
    /// Adds the counts of another one.
    pub fn add(&mut self, other: Outcome) {
        self.tried += other.tried;
        self.frames += other.frames;
        self.lost += other.lost;
        self.doubled += other.doubled;
        self.changed += other.changed;
        self.crashed += other.crashed;
        self.hung += other.hung;
        self.notes.extend(other.notes);
        self.faults.extend(other.faults);
    }

    /// Whether nothing went wrong.
    pub fn is_clean(&self) -> bool {
        self.tried > 0
            && self.lost + self.doubled + self.changed + self.crashed + self.hung == 0
            && self.faults.is_empty()
    }

    /// Notes something that is wrong beyond the counts.
    pub fn fault(&mut self, what: impl Into<String>) {
        self.faults.push(what.into());
    }

    /// Compares what came out of a try with what must come out.
    pub fn compare<T: PartialEq + std::fmt::Debug>(&mut self, wanted: &[T], got: &[T], what: &str) {
        let missing = |of: &[T], from: &[T]| {
            let mut left: Vec<&T> = from.iter().collect();
            let mut missing = 0;
            for item in of {
                match left.iter().position(|other| *other == item) {
                    Some(at) => drop(left.swap_remove(at)),
                    None => missing += 1,
                }
            }
            missing
        };
        let (lost, doubled) = (missing(wanted, got), missing(got, wanted));
        self.frames += wanted.len() as u64;
        self.lost += lost;
        self.doubled += doubled;
        if lost + doubled > 0 {
            self.fault(format!(
                "{what}: {} of {} frames, {lost} lost, {doubled} doubled",
                got.len(),
                wanted.len()
            ));
        } else if wanted != got {
            self.changed += 1;
            self.fault(format!("{what}: another order"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_missing_and_each_surplus_frame_counts() {
        let mut outcome = Outcome { tried: 1, ..Outcome::default() };
        outcome.compare(&[1, 2, 3, 3], &[1, 2, 3, 3], "");
        assert!(outcome.is_clean());
        outcome.compare(&[1, 2, 3, 4], &[1, 3, 3, 5], "");
        assert_eq!((outcome.lost, outcome.doubled, outcome.changed), (2, 2, 0));
        outcome.compare(&[1, 2], &[2, 1], "");
        assert_eq!((outcome.changed, outcome.frames), (1, 10));
    }
}
