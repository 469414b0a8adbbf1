// SPDX-License-Identifier: MIT OR Apache-2.0

//! Bits with adaptive probabilities, in little more space than their information: a binary range coder.

/// How probable it is that a bit is set, learnt from those before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Probability {
    /// In 1/65536.
    set: u16,
    /// Bits seen, at most 255.
    seen: u8,
}

impl Probability {
    /// Of a bit of which nothing is known.
    pub(super) const EVEN: Self = Self { set: 1 << 15, seen: 0 };

    fn learn(&mut self, bit: bool) {
        let target = if bit { 1 << 16 } else { 0 };
        // The mean of the bits so far and of an even chance that counts as half a bit. As the quotient is rounded towards 0, neither 0
        // nor 65536 is ever reached.
        let set = i32::from(self.set);
        let set = set + 2 * (target - set) / (2 * i32::from(self.seen) + 3);
        self.set = set as u16;
        self.seen = self.seen.saturating_add(1);
    }
}

/// Writes bits, or reads them: whoever codes something does both alike.
pub(super) trait Coder {
    /// The bit that is written, or that was read in its place.
    fn bit(&mut self, probability: &mut Probability, bit: bool) -> bool;
}

/// Below this range another byte is settled.
const LEAST_RANGE: u32 = 1 << 24;

/// Writes bits.
#[derive(Debug)]
pub(super) struct Encoder {
    bytes: Vec<u8>,
    /// Beginning of the interval that stands for the bits so far, in units of its last settled byte / 2³².
    low: u64,
    range: u32,
    /// The last byte, to which a carry may be added, and how many bytes 255 follow it.
    last: Option<u8>,
    full: usize,
}

impl Encoder {
    pub(super) const fn new() -> Self {
        Self { bytes: Vec::new(), low: 0, range: u32::MAX, last: None, full: 0 }
    }

    fn settle_byte(&mut self) {
        let byte = (self.low >> 24) as u8;
        let carry = (self.low >> 32) as u8;
        if byte == u8::MAX && carry == 0 {
            self.full += 1;
        } else {
            // Before the first byte there is nothing that a carry could reach: the interval begins at 0 and is shorter than 1.
            self.bytes.extend(self.last.map(|last| last.wrapping_add(carry)));
            self.bytes.extend(std::iter::repeat_n(u8::MAX.wrapping_add(carry), self.full));
            (self.last, self.full) = (Some(byte), 0);
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// The bytes of all bits; whoever reads them takes it that zeros follow.
    pub(super) fn finish(mut self) -> Vec<u8> {
        // The number in the interval that has the most zeros at its end: the range is not below 2²⁴.
        self.low = (self.low + 0x00ff_ffff) & !0x00ff_ffff;
        (0..5).for_each(|_| self.settle_byte());
        while self.bytes.last() == Some(&0) {
            self.bytes.pop();
        }
        self.bytes
    }
}

impl Coder for Encoder {
    fn bit(&mut self, probability: &mut Probability, bit: bool) -> bool {
        let bound = (self.range >> 16) * u32::from(probability.set);
        if bit {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.settle_byte();
        }
        probability.learn(bit);
        bit
    }
}

/// Reads bits.
#[derive(Debug)]
pub(super) struct Decoder<'a> {
    bytes: std::slice::Iter<'a, u8>,
    /// Where the number that was written lies in the interval.
    place: u32,
    range: u32,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { bytes: bytes.iter(), place: 0, range: u32::MAX };
        (0..4).for_each(|_| decoder.next_byte());
        decoder
    }

    fn next_byte(&mut self) {
        self.place = self.place << 8 | u32::from(self.bytes.next().copied().unwrap_or(0));
    }
}

impl Coder for Decoder<'_> {
    fn bit(&mut self, probability: &mut Probability, _: bool) -> bool {
        let bound = (self.range >> 16) * u32::from(probability.set);
        let bit = self.place < bound;
        if bit {
            self.range = bound;
        } else {
            self.place -= bound;
            self.range -= bound;
        }
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.next_byte();
        }
        probability.learn(bit);
        bit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn written(bits: &[bool], contexts: usize) -> Vec<u8> {
        let (mut encoder, mut probabilities) = (Encoder::new(), vec![Probability::EVEN; contexts]);
        for (index, bit) in bits.iter().enumerate() {
            encoder.bit(&mut probabilities[index % contexts], *bit);
        }
        encoder.finish()
    }

    proptest! {
        #[test]
        fn bits_come_back(bits in prop::collection::vec(any::<bool>(), 0..3000), rare in 0..60usize, contexts in 1..5usize) {
            // Rarely set ones lead to long runs of bytes that a carry changes.
            let bits: Vec<_> = bits.iter().enumerate().map(|(at, bit)| *bit && at % (rare + 1) == 0).collect();
            let bytes = written(&bits, contexts);
            let (mut decoder, mut probabilities) = (Decoder::new(&bytes), vec![Probability::EVEN; contexts]);
            for (index, bit) in bits.iter().enumerate() {
                prop_assert_eq!(decoder.bit(&mut probabilities[index % contexts], false), *bit);
            }
        }
    }

    #[test]
    fn the_length_is_that_of_the_information() {
        // 1 of 20 bits is set: 0.286 bits of information each, by −Σ p·log2 p.
        let bits: Vec<bool> = (0..20_000_u64).map(|at| at * at % 7919 % 20 == 3).collect();
        let share = bits.iter().filter(|bit| **bit).count() as f64 / bits.len() as f64;
        let bits_each = -(share * share.log2() + (1.0 - share) * (1.0 - share).log2());
        let expected = bits_each * bits.len() as f64 / 8.0;
        let length = written(&bits, 1).len() as f64;
        assert!((length / expected - 1.0).abs() < 0.03, "{length} bytes for {expected}");
        assert_eq!(written(&[], 1), [0; 0]);
    }

    #[test]
    fn a_probability_is_the_mean_of_the_bits() {
        let mut probability = Probability::EVEN;
        // 1/2 → 1/2 + 2/3 · 1/2 → that − 2/5 of itself.
        probability.learn(true);
        assert_eq!(probability.set, 54_613);
        probability.learn(false);
        assert_eq!(probability.set, 32_768);
        for bit in [false, true] {
            (0..10_000).for_each(|_| probability.learn(bit));
            let certain = if bit { 65_536 } else { 0 };
            assert!((1..=256).contains(&(certain - i32::from(probability.set)).abs()));
        }
    }
}
