// SPDX-License-Identifier: MIT OR Apache-2.0

//! The plugin as it is built, for other programs.

use std::path::PathBuf;
use std::process::Command;

/// A folder with the plugin and nothing else; it goes when it is dropped.
pub struct PluginFolder(pub PathBuf);

impl PluginFolder {
    pub fn new(test: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("rsrectify-{}-{test}-plugin", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        // Cargo leaves the plugin beside the test programs.
        let built = std::env::current_exe().unwrap().with_file_name("libgstrsrectify.so");
        std::fs::copy(built, folder.join("libgstrsrectify.so")).unwrap();
        Self(folder)
    }

    /// A program that finds the plugin, and no other version of it.
    pub fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new(program);
        command.env("GST_PLUGIN_PATH", &self.0).env("GST_REGISTRY", self.0.join("registry.bin"));
        command
    }
}

impl Drop for PluginFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
