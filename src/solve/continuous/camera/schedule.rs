// SPDX-License-Identifier: MIT OR Apache-2.0

//! When something is tried again. All intervals are in frames.
//!
//! | trial | condition | first | next | at most |
//! |---|---|---|---|---|
//! | γ from several starts | γ unknown, and the picture moves and constrains it | at once | 15 after the last search | 15 |
//! | other knot density | it may explain residuals | at once, then 15 | doubled after each failure | 120 |
//! | the likeliest smoothness | its evidence is greater | at once | 15 after a failure | 15 |
//! | another camera | up to two hypotheses, and γ does not rest | 90, or at a gap or cut | doubled each time | 1440 |
//! | fit of an unlikely rival | nothing about it is being sought | when its path does not reach to the end of the frame | | |
//! | rivals that rest | a window constrains the γ of any hypothesis | at once | | |

/// Interval of trials of γ, of the smoothness and of the knot density.
const TRIAL: usize = 15;
/// Longest interval after several failed trials of the knot density.
const MAX_TRIAL: usize = 8 * TRIAL;
/// First and longest interval of trials of other cameras. It doubles each time, as an event that has not
/// happened in n frames has a probability of about 1/n in the next one (Laplace's rule of succession).
const OTHER_CAMERA: [usize; 2] = [90, 16 * 90];

/// Counts the frames until a trial is due.
#[derive(Clone, Copy, Debug)]
pub struct Timer {
    waited: usize,
    interval: usize,
    longest: usize,
}

impl Timer {
    /// One that waits for an interval, which [backs off](Self::back_off) up to the longest.
    const fn new(interval: usize, longest: usize) -> Self {
        Self { waited: 0, interval, longest }
    }

    /// The same, due at once.
    const fn due(self) -> Self {
        Self { waited: self.interval, ..self }
    }

    /// Counts a frame.
    pub fn tick(&mut self) {
        self.waited += 1;
    }

    pub fn is_due(&self) -> bool {
        self.waited >= self.interval
    }

    pub fn restart(&mut self) {
        self.waited = 0;
    }

    /// Restarts with twice the interval.
    pub fn back_off(&mut self) {
        self.restart();
        self.interval = (2 * self.interval).min(self.longest);
    }
}

/// The trials of a hypothesis.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// Search for γ from several starts; `None` before the first one.
    pub search: Option<Timer>,
    /// The other knot density.
    pub density: Timer,
    /// The smoothness of the likeliest hypothesis.
    pub smoothness: Timer,
}

impl Schedule {
    pub const fn new() -> Self {
        let due = Timer::new(TRIAL, MAX_TRIAL).due();
        Self { search: None, density: due, smoothness: due }
    }

    /// Makes the search for γ due.
    pub fn expect_search(&mut self) {
        self.search = Some(Timer::new(TRIAL, TRIAL).due());
    }

    /// Restarts the interval after a search for γ.
    pub fn restart_search(&mut self) {
        self.search = Some(Timer::new(TRIAL, TRIAL));
    }
}

/// The trial of other cameras.
pub const fn other_camera() -> Timer {
    let [interval, longest] = OTHER_CAMERA;
    Timer::new(interval, longest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames until a timer is due.
    fn frames(mut timer: Timer) -> usize {
        let is_waiting = |timer: &mut Timer| {
            let is_due = timer.is_due();
            timer.tick();
            !is_due
        };
        (0..1000).take_while(|_| is_waiting(&mut timer)).count()
    }

    #[test]
    fn the_interval_doubles_after_each_failure() {
        let mut timer = Schedule::new().density;
        assert_eq!(frames(timer), 0);
        timer.restart();
        assert_eq!(frames(timer), TRIAL);
        let waits = [(); 5].map(|()| {
            timer.back_off();
            frames(timer)
        });
        assert_eq!(waits, [30, 60, 120, 120, 120]);
    }
}
