// SPDX-License-Identifier: MIT OR Apache-2.0

//! From the level of a CPU to the vectors that it has.

/// `$vectors` with `$cpu` bound to the [`WordCpu`](crate::lanes::WordCpu) of a [`CpuLevel`](crate::cpu::CpuLevel). At the level `Scalar` that is
/// the one of `Portable`, or `$scalar` is the result.
macro_rules! with_word_cpu {
    ($level:expr, $cpu:ident => $vectors:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            $crate::cpu::CpuLevel::Avx2($cpu) => $vectors,
            #[cfg(target_arch = "aarch64")]
            $crate::cpu::CpuLevel::Neon($cpu) => $vectors,
            _ => {
                let $cpu = $crate::lanes::scalar::Scalar;
                $vectors
            }
        }
    };
    ($level:expr, $cpu:ident => $vectors:expr, _ => $scalar:expr) => {
        match $level {
            $crate::cpu::CpuLevel::Scalar => $scalar,
            level => $crate::lanes::dispatch::with_word_cpu!(level, $cpu => $vectors),
        }
    };
}
pub(crate) use with_word_cpu;
