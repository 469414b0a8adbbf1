// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where the bytes of a motion file are.

use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::{Mutex, PoisonError};

/// Bytes in memory or in a file.
pub(super) enum Source {
    /// In memory, mapped or owned.
    Bytes(Box<dyn AsRef<[u8]> + Send + Sync>),
    /// In a file of this length, of which parts are read. What others do to the file meanwhile is an error at worst, where
    /// a memory map would end the process.
    File(Mutex<File>, u64),
}

impl Source {
    pub(super) fn length(&self) -> u64 {
        match self {
            Self::Bytes(bytes) => (**bytes).as_ref().len() as u64,
            Self::File(_, length) => *length,
        }
    }

    /// At most `length` bytes from an offset on; fewer at the end.
    pub(super) fn read(&self, offset: u64, length: u64) -> io::Result<Cow<'_, [u8]>> {
        let length = length.min(self.length().saturating_sub(offset));
        match self {
            Self::Bytes(bytes) => {
                let bytes = (**bytes).as_ref();
                // Both are at most the length of the bytes.
                let start = (offset as usize).min(bytes.len());
                Ok(Cow::Borrowed(bytes.get(start..start + length as usize).unwrap_or_default()))
            }
            Self::File(file, _) => {
                let mut bytes = Vec::new();
                let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
                file.seek(SeekFrom::Start(offset))?;
                (&mut *file).take(length).read_to_end(&mut bytes)?;
                Ok(Cow::Owned(bytes))
            }
        }
    }
}

impl fmt::Debug for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.length())
    }
}
