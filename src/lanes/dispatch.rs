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

#[cfg(test)]
mod tests {
    use crate::cpu::CpuLevel;
    use crate::lanes::{Cpu, FLOATS};

    const ROWS: [[f32; FLOATS]; FLOATS] = {
        let mut rows = [[0.0; FLOATS]; FLOATS];
        let mut k = 0;
        while k < FLOATS * FLOATS {
            rows[k / FLOATS][k % FLOATS] = (k * k % 61) as f32 + 0.25;
            k += 1;
        }
        rows
    };

    type Found = ([[f32; FLOATS]; FLOATS], [[f32; FLOATS]; 2], [[f32; FLOATS]; 3]);

    #[inline(always)]
    fn found<C: Cpu>(cpu: C) -> Found {
        let mut rows = [cpu.splat(0.0); FLOATS];
        for (out, row) in rows.iter_mut().zip(&ROWS) {
            *out = cpu.load(row);
        }
        let mut columns = [[0.0; FLOATS]; FLOATS];
        for (out, column) in columns.iter_mut().zip(cpu.transposed(rows)) {
            *out = cpu.store(column);
        }
        let [low, high] = cpu.halves(rows);
        let quotient = cpu.divided(rows[1], rows[2]);
        let magnitude = cpu.magnitude(rows[4] - rows[5]);
        let others = [cpu.store(quotient), cpu.store(cpu.root(rows[3])), cpu.store(magnitude)];
        (columns, [cpu.store(low), cpu.store(high)], others)
    }

    #[test]
    fn lanes_are_those_of_their_definition_on_all_levels() {
        for level in CpuLevel::supported() {
            let (columns, [low, high], [quotient, root, magnitude]) = with_word_cpu!(
                level,
                cpu => cpu.vectorize(#[inline(always)] || found(cpu))
            );
            for (k, row) in ROWS.iter().enumerate() {
                assert_eq!(columns.map(|column| column[k]), *row, "{level}");
                // Quarters are exact.
                assert_eq!((low[k], high[k]), (row[..4].iter().sum(), row[4..].iter().sum()), "{level}");
                assert_eq!((quotient[k], root[k]), (ROWS[1][k] / ROWS[2][k], ROWS[3][k].sqrt()), "{level}");
                assert_eq!(magnitude[k], (ROWS[4][k] - ROWS[5][k]).abs(), "{level}");
            }
        }
    }
}
