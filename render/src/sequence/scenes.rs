// SPDX-License-Identifier: MIT OR Apache-2.0

//! Scenes that several sequences share: to build one takes seconds.

use crate::scene::{Scene, SceneKind};
use anyhow::Result;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// How many scenes are kept, some 60 MB each.
const KEPT: usize = 4;

/// What determines a scene.
type Key = (SceneKind, u64, Option<PathBuf>);

/// The scenes asked for last, the latest at the end.
static SCENES: Mutex<Vec<(Key, Arc<Scene>)>> = Mutex::new(Vec::new());

/// The scene of a seed, covered with the photographs of a folder or procedurally.
///
/// # Errors
/// If the folder cannot be read or holds no photographs.
pub fn shared(kind: SceneKind, seed: u64, textures: Option<&Path>) -> Result<Arc<Scene>> {
    let key = (kind, seed, textures.map(Path::to_owned));
    // Held while a scene is built, so that whoever else needs it does not build it too.
    let mut scenes = SCENES.lock().unwrap_or_else(PoisonError::into_inner);
    let known = scenes.iter().position(|(other, _)| *other == key).map(|index| scenes.remove(index).1);
    let scene = match known {
        Some(scene) => scene,
        None => Arc::new(kind.build(seed, textures)?),
    };
    if scenes.len() >= KEPT {
        scenes.remove(0);
    }
    scenes.push((key, scene.clone()));
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_folder_is_an_error_and_not_kept() {
        let missing = Some(Path::new("/nowhere"));
        assert!(shared(SceneKind::Room, 1, missing).is_err());
        assert!(shared(SceneKind::Room, 1, missing).is_err());
    }
}
