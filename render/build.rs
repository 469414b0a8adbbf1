// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sets `RENDERER`, a hash of all that determines what is rendered beside the settings: the sources, the versions of the
//! dependencies, the compiler. Footage that another renderer has kept is then not taken for its own.

use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let lock_file = Path::new("../Cargo.lock");
    let mut hasher = DefaultHasher::new();
    for file in files(Path::new("src"))?.iter().chain([&lock_file.to_owned()]) {
        println!("cargo:rerun-if-changed={}", file.display());
        hasher.write(file.as_os_str().as_encoded_bytes());
        hasher.write(&fs::read(file)?);
    }
    // New files.
    println!("cargo:rerun-if-changed=src");
    let compiler = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    hasher.write(&std::process::Command::new(compiler).arg("--version").output()?.stdout);
    println!("cargo:rustc-env=RENDERER={:016x}", hasher.finish());
    Ok(())
}

/// All files below a folder, in the order of their names.
fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut entries = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    entries.sort();
    let mut found = Vec::new();
    for entry in entries {
        if entry.is_dir() { found.append(&mut files(&entry)?) } else { found.push(entry) }
    }
    Ok(found)
}
