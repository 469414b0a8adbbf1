//! Which instructions of the machine the kernels of all modules may use.

use std::fmt;

/// Proof that the CPU has AVX2 and FMA, which came together: detection is the only thing that makes one.
///
/// A kernel compiled for AVX2 and FMA may be called wherever one of these is at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Avx2(());

impl Avx2 {
    /// The proof, where the CPU has AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    pub fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }

    /// The proof, where the CPU has AVX2 and FMA: never here.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn detect() -> Option<Self> {
        None
    }
}

/// Which instructions the kernels may use. A level exists only on a machine that has its instructions, so that
/// no caller can ask for what would be undefined behaviour:
///
/// ```compile_fail
/// let forged = rsrectify::CpuLevel::Avx2(rsrectify::cpu::Avx2(()));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CpuLevel {
    /// Plain Rust.
    Scalar,
    /// x86-64 with AVX2 and FMA.
    Avx2(Avx2),
}

impl fmt::Display for CpuLevel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Scalar => "Scalar",
            Self::Avx2(_) => "Avx2",
        })
    }
}

impl CpuLevel {
    /// The levels of this machine, the lowest first.
    pub fn supported() -> impl Iterator<Item = Self> {
        std::iter::once(Self::Scalar).chain(Avx2::detect().map(Self::Avx2))
    }

    /// The highest level of this machine; the environment variable `RSRECTIFY_CPU` (`scalar`, `avx2`) can
    /// lower it.
    #[must_use]
    pub fn detect() -> Self {
        match std::env::var("RSRECTIFY_CPU").as_deref() {
            Ok("scalar") => Self::Scalar,
            _ => Self::supported().last().unwrap_or(Self::Scalar),
        }
    }
}

/// Compiles a function twice, for any CPU and for AVX2 and FMA; which one is called is told by a [`CpuLevel`] before its other
/// arguments. Both find the same: the compiler puts more numbers into a vector, and fuses nothing.
///
/// What the function calls is to be `inline(always)`: the rest is compiled for any CPU.
macro_rules! for_each_cpu {
    ($(#[$attribute:meta])* $visible:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $out:ty)? $body:block) => {
        $(#[$attribute])*
        $visible fn $name(cpu: $crate::cpu::CpuLevel, $($argument: $type),*) $(-> $out)? {
            #[inline(always)]
            fn any($($argument: $type),*) $(-> $out)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $type),*) $(-> $out)? {
                any($($argument),*)
            }

            match cpu {
                // SAFETY: the level is a proof of AVX2 and FMA.
                #[cfg(target_arch = "x86_64")]
                $crate::cpu::CpuLevel::Avx2(_) => unsafe { avx2($($argument),*) },
                _ => any($($argument),*),
            }
        }
    };
}
pub(crate) use for_each_cpu;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_those_that_the_machine_reports() {
        let levels: Vec<CpuLevel> = CpuLevel::supported().collect();
        #[cfg(target_arch = "x86_64")]
        let has_avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        #[cfg(not(target_arch = "x86_64"))]
        let has_avx2 = false;
        assert_eq!(levels[0], CpuLevel::Scalar);
        assert_eq!(levels.len(), 1 + usize::from(has_avx2));
        assert!(levels.is_sorted() && levels.contains(&CpuLevel::detect()));
    }
}
