// SPDX-License-Identifier: MIT OR Apache-2.0

//! Fields of Protocol Buffers' wire format (protobuf.dev/programming-guides/encoding).

/// A field's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    Number(u64),
    Double(f64),
    Float(f32),
    /// Text, bytes or a message.
    Bytes(&'a [u8]),
}

impl<'a> Value<'a> {
    pub fn bytes(self) -> Option<&'a [u8]> {
        if let Self::Bytes(bytes) = self { Some(bytes) } else { None }
    }

    pub fn number(self) -> Option<u64> {
        if let Self::Number(number) = self { Some(number) } else { None }
    }

    pub fn double(self) -> Option<f64> {
        if let Self::Double(number) = self { Some(number) } else { None }
    }

    pub fn float(self) -> Option<f64> {
        if let Self::Float(number) = self { Some(f64::from(number)) } else { None }
    }
}

/// The value of a field of a message, as far as the message is whole.
pub fn field(message: &[u8], wanted: u64) -> Option<Value<'_>> {
    fields(message).find(|(number, _)| *number == wanted).map(|(_, value)| value)
}

/// The message in a message, along a path of fields.
pub fn message<'a>(message: &'a [u8], path: &[u64]) -> Option<&'a [u8]> {
    path.iter().try_fold(message, |message, wanted| field(message, *wanted)?.bytes())
}

fn fields(mut rest: &[u8]) -> impl Iterator<Item = (u64, Value<'_>)> {
    std::iter::from_fn(move || {
        let key = varint(&mut rest)?;
        let value = match key & 7 {
            0 => Value::Number(varint(&mut rest)?),
            1 => Value::Double(f64::from_le_bytes(take(&mut rest, 8)?.try_into().ok()?)),
            2 => {
                let length = usize::try_from(varint(&mut rest)?).ok()?;
                Value::Bytes(take(&mut rest, length)?)
            }
            5 => Value::Float(f32::from_le_bytes(take(&mut rest, 4)?.try_into().ok()?)),
            _ => return None,
        };
        Some((key >> 3, value))
    })
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(length)?;
    *rest = left;
    Some(taken)
}

fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let byte = *take(rest, 1)?.first()?;
        number |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
pub mod tests {
    use super::*;

    fn write_varint(mut number: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while number >= 0x80 {
            bytes.push(number as u8 | 0x80);
            number >>= 7;
        }
        bytes.push(number as u8);
        bytes
    }

    /// A field as it is written.
    pub fn written(number: u64, value: Value<'_>) -> Vec<u8> {
        let (kind, content) = match value {
            Value::Number(number) => (0, write_varint(number)),
            Value::Double(number) => (1, number.to_le_bytes().to_vec()),
            Value::Bytes(bytes) => (2, [write_varint(bytes.len() as u64), bytes.to_vec()].concat()),
            Value::Float(number) => (5, number.to_le_bytes().to_vec()),
        };
        [write_varint(number << 3 | kind), content].concat()
    }

    #[test]
    fn fields_are_found_by_their_number() {
        // The examples of the format's documentation.
        assert_eq!(field(&[0x08, 0x96, 0x01], 1), Some(Value::Number(150)));
        assert_eq!(field(b"\x12\x07testing", 2), Some(Value::Bytes(b"testing")));
        let inner = written(25, Value::Double(1.5));
        let outer = [written(3, Value::Float(2.0)), written(40, Value::Bytes(&inner))].concat();
        assert_eq!(field(message(&outer, &[40]).unwrap(), 25).unwrap().double(), Some(1.5));
        assert_eq!(field(&outer, 3).unwrap().float(), Some(2.0));
        assert_eq!(field(&outer, 4), None);
    }

    #[test]
    fn damaged_messages_have_no_such_field() {
        assert_eq!(field(&[0xff; 20], 1), None);
        assert_eq!(field(&[0x12, 0x7f, 0], 2), None);
        assert_eq!(field(&[0x12, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f], 2), None);
    }
}
