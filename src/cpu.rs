// SPDX-License-Identifier: MIT OR Apache-2.0

//! The instruction sets that the kernels of all modules can use.

use std::fmt;

/// Proof that the CPU has AVX2 and FMA; only detection creates one.
///
/// With this proof a kernel compiled for AVX2 and FMA can be called safely.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Avx2(());

impl Avx2 {
    /// The proof, if the CPU has AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    pub fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }

    /// The proof, if the CPU has AVX2 and FMA: never on this architecture.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn detect() -> Option<Self> {
        None
    }
}

/// Proof that the CPU has NEON, and the byte order that the kernels expect; only detection creates one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Neon(());

impl Neon {
    /// The proof, if the CPU has NEON: always on AArch64 of little-endian byte order, never elsewhere.
    pub fn detect() -> Option<Self> {
        cfg!(all(target_arch = "aarch64", target_feature = "neon", target_endian = "little"))
            .then_some(Self(()))
    }
}

/// The instruction set that the kernels use. A level can be created only on a machine that has its
/// instructions, so that no safe code can cause undefined behaviour:
///
/// ```compile_fail
/// let forged = rsrectify::CpuLevel::Avx2(rsrectify::cpu::Avx2(()));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum CpuLevel {
    /// Plain Rust, one number after the other where vectors differ from it: the reference of the tests.
    Scalar,
    /// Plain Rust in vectors, which compilers translate to what every machine of the architecture has.
    Portable,
    /// x86-64 with AVX2 and FMA.
    Avx2(Avx2),
    /// AArch64 with NEON.
    Neon(Neon),
}

impl fmt::Display for CpuLevel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Scalar => "Scalar",
            Self::Portable => "Portable",
            Self::Avx2(_) => "Avx2",
            Self::Neon(_) => "Neon",
        })
    }
}

impl CpuLevel {
    /// The levels of this machine, the lowest first.
    pub fn supported() -> impl Iterator<Item = Self> {
        [Self::Scalar, Self::Portable]
            .into_iter()
            .chain(Avx2::detect().map(Self::Avx2))
            .chain(Neon::detect().map(Self::Neon))
    }

    /// The highest level of this machine; the environment variable `RSRECTIFY_CPU` (`scalar`, `portable`)
    /// can lower it.
    #[must_use]
    pub fn detect() -> Self {
        match std::env::var("RSRECTIFY_CPU").as_deref() {
            Ok("scalar") => Self::Scalar,
            Ok("portable") => Self::Portable,
            _ => Self::supported().last().unwrap_or(Self::Scalar),
        }
    }
}

/// Compiles a function twice, for any CPU and for AVX2 and FMA; the first argument, a [`CpuLevel`], selects
/// the version. Both give the same results: the compiler uses wider vectors, and fuses no operations. On
/// AArch64, any CPU has NEON.
///
/// All functions that it calls must be `inline(always)`: others are compiled for any CPU.
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
        let has_neon = cfg!(all(target_arch = "aarch64", target_endian = "little"));
        assert_eq!(levels.len(), 2 + usize::from(has_avx2) + usize::from(has_neon));
        assert!(levels.is_sorted() && levels.contains(&CpuLevel::detect()));
    }
}
