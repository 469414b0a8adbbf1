//! When something is tried again. All intervals are frames.
//!
//! | what is tried | when | first | next | at most |
//! |---|---|---|---|---|
//! | γ from several starts | while it is vague and the picture moves | at once | 15 after the last search | 15 |
//! | the other knot density | while the path leaves what that may explain | at once; 15 after it was tried | doubled after each failure | 120 |
//! | the smoothness of the likeliest hypothesis | while it explains more | at once | 15 after a failure | 15 |
//! | another camera | while there is one hypothesis, or two | 90; at once after a gap or a cut | doubled each time | 1440 |

/// From one search for γ, offer of another smoothness, or trial of another knot density, to the next.
const TRIAL: usize = 15;
/// And at most, where several trials in a row have failed.
const LONGEST_TRIAL: usize = 8 * TRIAL;
/// With one hypothesis, after which the camera may be another one: at first, and at most. Each time that it is not, twice as
/// many, for what has not happened in n frames happens in the next one with a probability of about 1/n (Laplace's rule of
/// succession).
const OTHER_CAMERA: [usize; 2] = [90, 16 * 90];

/// Counts the frames until something is due.
#[derive(Clone, Copy, Debug)]
pub struct Timer {
    waited: usize,
    interval: usize,
    longest: usize,
}

impl Timer {
    /// One that is due at once.
    const fn due(interval: usize, longest: usize) -> Self {
        Self { waited: interval, interval, longest }
    }

    /// The next frame has come.
    pub fn tick(&mut self) {
        self.waited += 1;
    }

    pub fn is_due(&self) -> bool {
        self.waited >= self.interval
    }

    /// Counts from now on.
    pub fn restart(&mut self) {
        self.waited = 0;
    }

    /// Counts from now on, twice as far.
    pub fn back_off(&mut self) {
        self.waited = 0;
        self.interval = (2 * self.interval).min(self.longest);
    }
}

/// When a hypothesis tries something again.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// The search for γ from several starts; `None` before the first one.
    pub search: Option<Timer>,
    /// The other knot density.
    pub density: Timer,
    /// The smoothness of the likeliest hypothesis.
    pub smoothness: Timer,
}

impl Schedule {
    pub const fn new() -> Self {
        let due = Timer::due(TRIAL, LONGEST_TRIAL);
        Self { search: None, density: due, smoothness: due }
    }

    /// Has γ searched at the next frame at which it is vague and the picture moves.
    pub fn expect_search(&mut self) {
        self.search = Some(Timer::due(TRIAL, TRIAL));
    }

    /// A search for γ has ended.
    pub fn restart_search(&mut self) {
        self.search = Some(Timer { waited: 0, interval: TRIAL, longest: TRIAL });
    }
}

/// When it is tried whether the camera is another one.
pub const fn other_camera() -> Timer {
    let [first, longest] = OTHER_CAMERA;
    Timer { waited: 0, interval: first, longest }
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
    fn what_fails_is_tried_half_as_often() {
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
