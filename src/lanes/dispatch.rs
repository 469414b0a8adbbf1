// SPDX-License-Identifier: MIT OR Apache-2.0

//! From the level of a CPU to the vectors that it has.

/// `$vectors` with `$cpu` bound to the vectors of a [`CpuLevel`](crate::cpu::CpuLevel), which are [`Cpu`](crate::lanes::Cpu),
/// [`WordCpu`](crate::lanes::WordCpu) and [`DoubleCpu`](crate::lanes::DoubleCpu). At the level `Scalar` they are those of `Portable`, or
/// `$scalar` is the result.
macro_rules! with_cpu {
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
            level => $crate::lanes::dispatch::with_cpu!(level, $cpu => $vectors),
        }
    };
}
pub(crate) use with_cpu;

#[cfg(test)]
mod tests {
    use crate::cpu::CpuLevel;
    use crate::lanes::{Cpu, DOUBLES, DoubleCpu, FLOATS, WordCpu};

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

    /// Each of these with each: what is equal, of either sign or no number is where instructions differ.
    const NUMBERS: [f32; FLOATS] =
        [0.0, -0.0, f32::NAN, 1.5, -2.5, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE];

    /// The greater and the lesser of [`NUMBERS`] and `other`, and [`NUMBERS`] limited to −1 to 1.
    #[inline(always)]
    fn bounded<C: WordCpu>(cpu: C, other: f32) -> [[f32; FLOATS]; 5] {
        let (a, b) = (cpu.load(&NUMBERS), cpu.splat(other));
        let orders = [cpu.greater(a, b), cpu.greater(b, a), cpu.lesser(a, b), cpu.lesser(b, a)];
        let [p, q, r, s] = orders;
        [cpu.store(p), cpu.store(q), cpu.store(r), cpu.store(s), cpu.store(cpu.clamped(a, -1.0, 1.0))]
    }

    #[test]
    fn of_two_numbers_that_do_not_differ_all_levels_take_the_second() {
        for level in CpuLevel::supported() {
            for other in NUMBERS {
                let found = with_cpu!(level, cpu => cpu.vectorize(#[inline(always)] || bounded(cpu, other)));
                let bits = with_cpu!(level, cpu => cpu.vectorize(
                    #[inline(always)]
                    || cpu.bits_above(cpu.load(&NUMBERS), cpu.splat(other))
                ));
                for (lane, number) in NUMBERS.into_iter().enumerate() {
                    assert_eq!(bits >> lane & 1 == 1, number > other, "{level}: {number} {other}");
                    let greater = |a: f32, b: f32| if a > b { a } else { b };
                    let lesser = |a: f32, b: f32| if a < b { a } else { b };
                    let expected = [
                        greater(number, other),
                        greater(other, number),
                        lesser(number, other),
                        lesser(other, number),
                        greater(-1.0, lesser(1.0, number)),
                    ];
                    let found = found.map(|found| found[lane].to_bits());
                    assert_eq!(found, expected.map(f32::to_bits), "{level}: {number} {other}");
                }
            }
        }
    }

    #[test]
    fn lanes_are_those_of_their_definition_on_all_levels() {
        for level in CpuLevel::supported() {
            let (columns, [low, high], [quotient, root, magnitude]) = with_cpu!(
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

    /// a·b, a·b + c, c − a·b, c with a·b added in memory, a + c and a − c.
    #[inline(always)]
    fn of_doubles<C: DoubleCpu>(cpu: C, a: [f64; DOUBLES], b: f64, c: [f64; DOUBLES]) -> [[f64; DOUBLES]; 6] {
        let (first, factor, last) = (cpu.load_doubles(&a), cpu.splat_double(b), cpu.load_doubles(&c));
        let mut sum = c;
        cpu.add_product(first, factor, &mut sum);
        let found = [
            first * factor,
            cpu.fused_doubles(first, factor, last),
            cpu.fused_less_doubles(first, factor, last),
            first + last,
            first - last,
        ];
        let [product, more, less, both, beside] = found.map(
            #[inline(always)]
            |doubles| cpu.store_doubles(doubles),
        );
        [product, more, less, sum, both, beside]
    }

    #[test]
    fn doubles_are_those_of_their_definition_on_all_levels() {
        // The products are exact.
        let (a, b, c) = ([1.5, -2.25, 0.0, 1e10], 0.75, [0.5, 8.0, -3.0, 0.25]);
        for level in CpuLevel::supported() {
            let found = with_cpu!(level, cpu => cpu.vectorize(#[inline(always)] || of_doubles(cpu, a, b, c)));
            for lane in 0..DOUBLES {
                let (product, last) = (a[lane] * b, c[lane]);
                let (both, beside) = (a[lane] + last, a[lane] - last);
                let expected = [product, last + product, last - product, last + product, both, beside];
                assert_eq!(found.map(|of| of[lane]), expected, "{level} {lane}");
            }
        }
    }
}
