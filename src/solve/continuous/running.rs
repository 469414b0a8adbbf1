//! A running estimate of a number that belongs to the camera and does not change.

/// How fast the scatter follows, per estimate.
const SCATTER_RATE: f64 = 0.05;

/// What was seen of a number so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Running {
    /// Best estimate.
    pub mean: f64,
    /// Inverse variance, if the estimates scattered as their variances say.
    information: f64,
    /// By how much more their squares scatter, at least 1.
    scatter: f64,
}

impl Running {
    /// A belief before anything was seen.
    pub fn new(mean: f64, deviation: f64) -> Self {
        Self { mean, information: 1.0 / (deviation * deviation), scatter: 1.0 }
    }

    /// Takes in an estimate of the given inverse variance, a `share` of which is new.
    pub fn add(&mut self, value: f64, information: f64, share: f64) {
        if !(value.is_finite() && information.is_finite() && information > 0.0) {
            return;
        }
        let surprise = (value - self.mean).powi(2) / (1.0 / information + 1.0 / self.information());
        let believed = information / self.scatter;
        self.scatter += SCATTER_RATE * (surprise.min(100.0) - self.scatter);
        self.scatter = self.scatter.max(1.0);
        let sum = self.information + share * believed;
        self.mean += (value - self.mean) * share * believed / sum;
        self.information = sum;
    }

    /// Goes on in units that are smaller by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.mean *= factor;
        self.information /= factor * factor;
    }

    /// Inverse variance.
    pub fn information(&self) -> f64 {
        self.information
    }
}
