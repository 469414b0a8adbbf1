// SPDX-License-Identifier: MIT OR Apache-2.0

//! What this process uses of the machine.

/// Memory, file descriptors and threads in use.
#[derive(Clone, Copy, Debug, Default)]
pub struct Usage {
    /// Resident memory in kilobytes.
    pub memory: u64,
    /// Open file descriptors.
    pub descriptors: u64,
    /// Threads.
    pub threads: u64,
}

impl Usage {
    /// What is in use now.
    pub fn now() -> anyhow::Result<Self> {
        let status = std::fs::read_to_string("/proc/self/status")?;
        let value = |name: &str| {
            let line = status.lines().find(|line| line.starts_with(name))?;
            line.split_whitespace().nth(1)?.parse().ok()
        };
        Ok(Self {
            memory: value("VmRSS:").unwrap_or(0),
            descriptors: std::fs::read_dir("/proc/self/fd")?.count() as u64,
            threads: value("Threads:").unwrap_or(0),
        })
    }

    /// In what `later` is above this by more than so many kilobytes, or by anything else.
    pub fn growth(&self, later: &Self, memory: u64) -> Option<String> {
        let grown = later.memory > self.memory + memory
            || later.descriptors > self.descriptors
            || later.threads > self.threads;
        grown.then(|| format!("{self:?} became {later:?}"))
    }
}
