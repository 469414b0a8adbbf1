use super::*;

/// Repeatable pseudo-random grey levels (xorshift).
fn greys(seed: u64, count: usize) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 * (255.0 / (1 << 24) as f32)
    };
    (0..count).map(|_| next()).collect()
}

#[test]
fn all_levels_agree_to_the_last_bit() {
    for seed in 1..200 {
        let stride = 10 + (seed % 7) as usize;
        let (first, second) = (greys(seed, stride * 10), greys(seed + 1000, stride * 10));
        let shift = [(seed % 11) as f32 / 11.0, (seed % 13) as f32 / 13.0];
        let patch = centred(CpuLevel::Scalar, &first, stride).unwrap();
        for cpu in CpuLevel::supported() {
            assert_eq!(centred(cpu, &first, stride), Some(patch.clone()), "{cpu}");
            let expected = sums(CpuLevel::Scalar, &patch, &second, stride, shift);
            assert!(expected.is_some() && sums(cpu, &patch, &second, stride, shift) == expected, "{cpu}");
            let expected = whole_sums(CpuLevel::Scalar, &patch.values, &second, stride);
            assert_eq!(whole_sums(cpu, &patch.values, &second, stride), expected, "{cpu}");
        }
    }
}

#[test]
fn sums_are_those_of_their_definition() {
    let (first, second) = (greys(3, 160), greys(4, 160));
    let patch = centred(CpuLevel::Scalar, &first, 16).unwrap();
    let mean = (0..64).map(|i| first[(1 + i / 8) * 16 + 1 + i % 8]).sum::<f32>() / 64.0;
    assert!((patch.values[2][5] - (first[3 * 16 + 6] - mean)).abs() < 1e-3);
    assert!(patch.gradient_x.iter().flatten().sum::<f32>().abs() < 1e-2);
    let found = sums(CpuLevel::Scalar, &patch, &second, 16, [0.0, 0.0]).unwrap();
    let raw = |r: usize, c: usize| second[r * 16 + c] - patch.values[r][c];
    let all = (0..64).map(|i| raw(i / 8, i % 8)).sum::<f32>() / 64.0;
    let difference = |r: usize, c: usize| raw(r, c) - all;
    let quarter = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
        rows.flat_map(|r| columns.clone().map(move |c| (r, c)))
            .map(|(r, c)| difference(r, c).powi(2))
            .sum::<f32>()
    };
    for (found, expected) in found.squares.into_iter().zip([
        quarter(0..4, 0..4),
        quarter(4..8, 0..4),
        quarter(0..4, 4..8),
        quarter(4..8, 4..8),
    ]) {
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
    }
}

/// A slice without a sample to spare does; a shorter one is refused.
#[test]
fn nothing_is_read_past_the_slice() {
    let all = greys(9, 400);
    for cpu in CpuLevel::supported() {
        let patch = centred(cpu, &all, 20).unwrap();
        let enough = |rows: usize, width: usize| (rows - 1) * 20 + width;
        assert!(centred(cpu, &all[..enough(10, 10)], 20).is_some());
        assert!(centred(cpu, &all[..enough(10, 10) - 1], 20).is_none());
        assert!(sums(cpu, &patch, &all[..enough(9, 9)], 20, [0.5; 2]).is_some());
        assert!(sums(cpu, &patch, &all[..enough(9, 9) - 1], 20, [0.5; 2]).is_none());
        assert!(whole_sums(cpu, &patch.values, &all[..enough(8, 8)], 20).is_some());
        assert!(whole_sums(cpu, &patch.values, &all[..enough(8, 8) - 1], 20).is_none());
    }
}
