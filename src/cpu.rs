//! Which instructions of the machine the kernels of all rooms may use.

/// Which instructions the kernels may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CpuLevel {
    /// Plain Rust.
    Scalar,
    /// x86-64 with AVX2.
    Avx2,
}

impl CpuLevel {
    /// All levels, the lowest first.
    pub const ALL: [Self; 2] = [Self::Scalar, Self::Avx2];

    /// The highest level of this machine; the environment variable `RSRECTIFY_CPU` (`scalar`, `avx2`) can
    /// lower it.
    pub fn detect() -> Self {
        let asked = match std::env::var("RSRECTIFY_CPU").as_deref() {
            Ok("scalar") => Self::Scalar,
            _ => Self::Avx2,
        };
        asked.min(Self::of_machine())
    }

    #[cfg(target_arch = "x86_64")]
    fn of_machine() -> Self {
        if is_x86_feature_detected!("avx2") { Self::Avx2 } else { Self::Scalar }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn of_machine() -> Self {
        Self::Scalar
    }

    /// This level, or the machine's where that is lower.
    pub fn available(self) -> Self {
        self.min(Self::of_machine())
    }
}
