// SPDX-License-Identifier: MIT OR Apache-2.0

//! The hash by which changed bytes are noticed.

/// The 64-bit FNV-1a hash of bytes.
pub(super) fn fnv1a(bytes: impl IntoIterator<Item = u8>) -> u64 {
    // Offset basis and prime of the hash's definition.
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// The hash of times, each as eight little-endian bytes.
pub(super) fn hash(times: impl IntoIterator<Item = i64>) -> u64 {
    fnv1a(times.into_iter().flat_map(i64::to_le_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_fnv_1a() {
        // Published values of the hash of nothing, of `a` and of `foobar`.
        assert_eq!(fnv1a([]), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(*b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a(*b"foobar"), 0x85944171f73967e8);
        assert_eq!(hash([i64::from_le_bytes(*b"foobar\0\0")]), fnv1a(*b"foobar\0\0"));
    }
}
