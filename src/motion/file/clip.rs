//! The clip whose motion a file holds.

/// The identity of the clip whose motion a file holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Clip {
    /// Name of its file, without the folder.
    pub name: String,
    /// Size of its file in bytes.
    pub bytes: u64,
    /// Degrees, 0, 90, 180 or 270, by which players turn its frames clockwise to show them upright. The motions are those
    /// of the frames before.
    pub turned: u16,
}
