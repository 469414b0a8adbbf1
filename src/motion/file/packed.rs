//! Integers in few bytes: predicted, as varints, compressed.

use super::error::RecordError;
use miniz_oxide::deflate::compress_to_vec_zlib;
use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;

/// Bytes of the longest varint: 64 bits in groups of 7.
const LONGEST_VARINT: usize = 10;
/// Of levels 0 to 10, that from which on files hardly get smaller.
const COMPRESSION: u8 = 7;
/// How often differences are taken of the samples of a path. Their noise from rounding grows with the order, to 8 steps for four;
/// the path itself is smooth over four of 32 samples.
const ORDER: usize = 4;

/// Compresses integers.
pub(super) fn pack(values: impl IntoIterator<Item = i64>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for value in values {
        let mut rest = (value.wrapping_shl(1) ^ (value >> 63)) as u64;
        while rest >= 0x80 {
            bytes.push(rest as u8 | 0x80);
            rest >>= 7;
        }
        bytes.push(rest as u8);
    }
    compress_to_vec_zlib(&bytes, COMPRESSION)
}

/// Decompresses exactly `count` integers.
pub(super) fn unpack(bytes: &[u8], count: usize) -> Result<Vec<i64>, RecordError> {
    let unpacked = decompress_to_vec_zlib_with_limit(bytes, count * LONGEST_VARINT);
    let bytes = unpacked.map_err(|_| RecordError::Packing)?;
    let mut values = Vec::with_capacity(count);
    let (mut value, mut shift) = (0u64, 0u32);
    for byte in bytes {
        let bits = u64::from(byte & 0x7f);
        // The tenth byte has one bit left.
        if shift > 63 || shift == 63 && bits > 1 {
            return Err(RecordError::Packing);
        }
        value |= bits << shift;
        shift += 7;
        if byte & 0x80 == 0 {
            values.push((value >> 1) as i64 ^ -((value & 1) as i64));
            (value, shift) = (0, 0);
        }
    }
    if values.len() != count || shift != 0 {
        return Err(RecordError::Packing);
    }
    Ok(values)
}

/// Replaces values by their fourth differences.
pub(super) fn difference(values: &mut [i64]) {
    for _ in 0..ORDER {
        let mut before = 0;
        for value in values.iter_mut() {
            (*value, before) = (value.wrapping_sub(before), *value);
        }
    }
}

/// Undoes [`difference`].
pub(super) fn sum(values: &mut [i64]) {
    for _ in 0..ORDER {
        let mut before = 0i64;
        for value in values.iter_mut() {
            before = before.wrapping_add(*value);
            *value = before;
        }
    }
}

/// The prediction of a node from its neighbours to the left, above, and above the left one: that of LOCO-I
/// (Weinberger, Seroussi and Sapiro, 2000). 0 at the first node.
fn prediction(values: &[i64], columns: usize, index: usize) -> i64 {
    let at = |back: usize| index.checked_sub(back).and_then(|index| values.get(index)).copied().unwrap_or(0);
    match (index >= columns, !index.is_multiple_of(columns.max(1))) {
        (false, _) => at(1),
        (true, false) => at(columns),
        (true, true) => {
            let (left, above, corner) = (at(1), at(columns), at(columns + 1));
            let plane = left.wrapping_add(above).wrapping_sub(corner);
            plane.clamp(left.min(above), left.max(above))
        }
    }
}

/// The differences of the values of a mesh, row by row, from their predictions.
pub(super) fn mesh_differences(values: &[i64], columns: usize) -> impl Iterator<Item = i64> + '_ {
    values
        .iter()
        .enumerate()
        .map(move |(index, value)| value.wrapping_sub(prediction(values, columns, index)))
}

/// Undoes [`mesh_differences`] in place.
pub(super) fn undo_mesh_differences(values: &mut [i64], columns: usize) {
    for index in 0..values.len() {
        let predicted = prediction(values, columns, index);
        if let Some(value) = values.get_mut(index) {
            *value = value.wrapping_add(predicted);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn integers_come_back(values in prop::collection::vec(any::<i64>(), 0..200), columns in 1..20usize) {
            prop_assert_eq!(unpack(&pack(values.iter().copied()), values.len()).unwrap(), values.clone());
            let mut changed = values.clone();
            difference(&mut changed);
            sum(&mut changed);
            prop_assert_eq!(&changed, &values);
            let mut changed: Vec<_> = mesh_differences(&values, columns).collect();
            undo_mesh_differences(&mut changed, columns);
            prop_assert_eq!(&changed, &values);
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..80), count in 0..50usize) {
            if let Ok(values) = unpack(&bytes, count) {
                prop_assert_eq!(values.len(), count);
            }
            if let Ok(values) = unpack(&compress_to_vec_zlib(&bytes, 1), count) {
                prop_assert_eq!(values.len(), count);
            }
        }
    }

    #[test]
    fn the_encoding_is_that_of_the_documentation() {
        // 300 << 1 = 600 = 4·128 + 88; −1 becomes 1.
        let bytes = decompress_to_vec_zlib_with_limit(&pack([300, -1, 0]), 10).unwrap();
        assert_eq!(bytes, [88 | 0x80, 4, 1, 0]);
        // A cubic has constant third differences, so the fourth are 0 but at the beginning.
        let mut cubic: Vec<i64> = (0..9).map(|i| i * i * i - 7 * i).collect();
        difference(&mut cubic);
        assert!(cubic[4..].iter().all(|value| *value == 0), "{cubic:?}");
        // 3 columns: 10 above 14 and so on; the planar prediction of 17 is 12 + 16 − 11.
        let mesh = [10, 11, 16, 10, 12, 17];
        assert_eq!(mesh_differences(&mesh, 3).collect::<Vec<_>>(), [10, 1, 5, 0, 1, 1]);
    }

    #[test]
    fn a_number_of_more_than_64_bits_is_refused() {
        let long = [0xff; 9].into_iter().chain([0x02]).collect::<Vec<u8>>();
        assert_eq!(unpack(&compress_to_vec_zlib(&long, 1), 1), Err(RecordError::Packing));
        let largest = [0xff; 9].into_iter().chain([0x01]).collect::<Vec<u8>>();
        assert_eq!(unpack(&compress_to_vec_zlib(&largest, 1), 1), Ok(vec![i64::MIN]));
    }
}
