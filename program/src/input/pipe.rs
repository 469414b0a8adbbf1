// SPDX-License-Identifier: MIT OR Apache-2.0

//! What comes on the standard input: it is read once, but its beginning can be looked at before.

use crate::interruption::Interruption;
use anyhow::{Result, bail};
use std::fmt;
use std::io::{self, Read};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Bytes that are read at once.
const CHUNK: usize = 1 << 18;
/// Chunks that wait to be decoded.
const WAITING: usize = 16;
/// Bytes by which kinds of streams are told apart, at most.
const LONGEST_NAME: u64 = 16;
/// How long data is waited for before it is looked whether the pipeline has ended.
const LOOK: Duration = Duration::from_millis(100);

/// The standard input.
#[derive(Clone)]
pub struct Pipe {
    state: Arc<Mutex<State>>,
    interruption: Interruption,
}

struct State {
    chunks: Receiver<io::Result<Vec<u8>>>,
    /// What has been read while it was looked at.
    beginning: Vec<u8>,
    is_taken: bool,
    /// Its first bytes, once they have been looked at.
    first: Option<Vec<u8>>,
}

impl fmt::Debug for Pipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Pipe")
    }
}

impl Pipe {
    /// Begins to read the standard input.
    pub fn standard_input(interruption: &Interruption) -> Self {
        let (sender, chunks) = sync_channel(WAITING);
        // Where nothing comes it waits until the program ends.
        std::thread::spawn(move || {
            let mut input = io::stdin().lock();
            loop {
                let mut chunk = vec![0; CHUNK];
                let read = match input.read(&mut chunk) {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                    Ok(0) => return,
                    Ok(length) => {
                        chunk.truncate(length);
                        Ok(chunk)
                    }
                    Err(error) => Err(error),
                };
                let has_failed = read.is_err();
                if sender.send(read).is_err() || has_failed {
                    return;
                }
            }
        });
        let state = State { chunks, beginning: Vec::new(), is_taken: false, first: None };
        Self { state: Arc::new(Mutex::new(state)), interruption: interruption.clone() }
    }

    /// A reader from the beginning on, after which there can be others.
    ///
    /// # Errors
    /// If the pipe has been read already.
    pub fn look(&self) -> Result<PipeReader> {
        self.reader(true)
    }

    /// Whether it begins with these bytes; `false` too where nothing can be read.
    pub fn begins_with(&self, bytes: &[u8]) -> bool {
        let lock = || self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().first.clone();
        let first = known.unwrap_or_else(|| {
            let mut first = Vec::new();
            let read = self.look().map(|reader| reader.take(LONGEST_NAME).read_to_end(&mut first));
            if matches!(read, Ok(Ok(_))) {
                lock().first = Some(first.clone());
            }
            first
        });
        first.starts_with(bytes)
    }

    /// What has been looked at.
    pub fn looked_at(&self) -> Vec<u8> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).beginning.clone()
    }

    /// The reader to whom it is left.
    ///
    /// # Errors
    /// If the pipe has been read already.
    pub fn take(&self) -> Result<PipeReader> {
        self.reader(false)
    }

    fn reader(&self, is_kept: bool) -> Result<PipeReader> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.is_taken {
            bail!("the standard input can be read only once");
        }
        state.is_taken = !is_kept;
        let interruption = self.interruption.clone();
        let is_stopped = Box::new(move || interruption.has_come());
        Ok(PipeReader {
            state: self.state.clone(),
            position: 0,
            chunk: io::Cursor::default(),
            is_kept,
            is_stopped,
        })
    }
}

/// Reads a pipe.
pub struct PipeReader {
    state: Arc<Mutex<State>>,
    /// How much of the beginning has been read.
    position: usize,
    /// What has come since.
    chunk: io::Cursor<Vec<u8>>,
    is_kept: bool,
    is_stopped: Box<dyn Fn() -> bool + Send>,
}

impl PipeReader {
    /// Has it also give up waiting where this is so.
    pub fn stop_if(&mut self, is_stopped: impl Fn() -> bool + Send + 'static) {
        let before = std::mem::replace(&mut self.is_stopped, Box::new(|| false));
        self.is_stopped = Box::new(move || before() || is_stopped());
    }
}

impl Read for PipeReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.chunk.read(buffer)?;
            if read > 0 || buffer.is_empty() {
                return Ok(read);
            }
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(rest) = state.beginning.get(self.position..).filter(|rest| !rest.is_empty()) {
                let length = rest.len().min(buffer.len());
                buffer[..length].copy_from_slice(&rest[..length]);
                self.position += length;
                if !self.is_kept && self.position == state.beginning.len() {
                    (state.beginning, self.position) = (Vec::new(), 0);
                }
                return Ok(length);
            }
            match state.chunks.recv_timeout(LOOK) {
                Ok(chunk) if self.is_kept => state.beginning.extend(chunk?),
                Ok(chunk) => self.chunk = io::Cursor::new(chunk?),
                Err(RecvTimeoutError::Disconnected) => return Ok(0),
                Err(RecvTimeoutError::Timeout) if (self.is_stopped)() => {
                    return Err(io::Error::other("given up"));
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }
}
