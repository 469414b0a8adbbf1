// SPDX-License-Identifier: MIT OR Apache-2.0

//! Keeps the plugin loaded.

fn main() {
    // Hosts unload plugins after they have asked for their names. Were the library built with threads, as it is together with
    // the rest of the workspace, their code would be gone while they run.
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-z,nodelete");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
