// SPDX-License-Identifier: MIT OR Apache-2.0

//! Numbered images: `frames/%06d.png` names one file for each number.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// Kinds of images that are read, by their extensions.
const EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "tif", "tiff"];
/// The highest number: GStreamer counts in 32 bits with a sign.
const HIGHEST: u64 = i32::MAX as u64;
/// Most digits to which numbers are filled up.
const MOST_DIGITS: usize = 20;

/// Names of files that differ in a number only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Numbered {
    folder: PathBuf,
    before: String,
    /// Digits to which numbers are filled up with zeros; 1 for none.
    digits: usize,
    after: String,
}

impl Numbered {
    /// The pattern that a path is: its file name has one `%d`, or `%06d` with any number of digits. Any other `%` stands for itself.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let mut found = None;
        for (at, _) in name.match_indices('%') {
            let rest = &name[at + 1..];
            let length = rest.find(|letter: char| !letter.is_ascii_digit())?;
            if !rest[length..].starts_with('d') {
                continue;
            }
            let digits = match &rest[..length] {
                "" => Some(1),
                text => text.strip_prefix('0').and_then(|digits| digits.parse().ok()),
            };
            let Some(digits) = digits.filter(|digits| (1..=MOST_DIGITS).contains(digits)) else { continue };
            if found.replace((at, digits, at + 1 + length + 1)).is_some() {
                return None;
            }
        }
        let (start, digits, end) = found?;
        let folder = path.parent().map_or_else(PathBuf::new, Path::to_owned);
        Some(Self { folder, before: name[..start].to_owned(), digits, after: name[end..].to_owned() })
    }

    /// The numbered images in a folder; `None` where there are none.
    ///
    /// # Errors
    /// If they are of several kinds, or the folder cannot be read.
    pub fn in_folder(folder: &Path) -> Result<Option<Self>> {
        let mut first: Option<Self> = None;
        let (mut shortest, mut has_zeros) = (usize::MAX, false);
        for name in names(folder)? {
            let Some((start, end)) = last_number(&name) else { continue };
            let (before, after) = (name[..start].to_owned(), name[end..].to_owned());
            let found = Self { folder: folder.to_owned(), before, digits: 1, after };
            if !found.are_images() {
                continue;
            }
            let number = &name[start..end];
            shortest = shortest.min(number.len());
            has_zeros |= number.len() > 1 && number.starts_with('0');
            match &first {
                Some(first) if *first != found => bail!(
                    "{}: there are images of several kinds in this folder, such as {} and {}; name those that are meant by a pattern",
                    folder.display(),
                    first.name(),
                    found.name()
                ),
                _ => first = Some(found),
            }
        }
        Ok(first.map(|first| Self { digits: if has_zeros { shortest } else { 1 }, ..first }))
    }

    /// Whether they are images that can be read, by their extension.
    pub fn are_images(&self) -> bool {
        let extension = Path::new(&self.after).extension().and_then(|extension| extension.to_str());
        let extension = extension.or_else(|| self.after.strip_prefix('.')).map(str::to_ascii_lowercase);
        extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str()))
    }

    /// The folder in which they are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder as a path that can be opened.
    pub fn folder_to_open(&self) -> &Path {
        if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder }
    }

    /// The pattern without its folder.
    pub fn name(&self) -> String {
        let Self { before, digits, after, .. } = self;
        if *digits > 1 { format!("{before}%0{digits}d{after}") } else { format!("{before}%d{after}") }
    }

    /// The pattern.
    pub fn path(&self) -> PathBuf {
        self.folder.join(self.name())
    }

    /// The file with a number.
    pub fn file(&self, number: u64) -> PathBuf {
        let Self { before, digits, after, .. } = self;
        self.folder.join(format!("{before}{number:0digits$}{after}"))
    }

    /// The pattern as C's `printf` has it, in which each other `%` is doubled.
    pub fn printf(&self) -> Result<String> {
        let folder = self.folder.to_str().context("the name of the folder is no text")?.replace('%', "%%");
        let [before, after] = [&self.before, &self.after].map(|text| text.replace('%', "%%"));
        let name = format!("{before}%0{}d{after}", self.digits);
        Ok(Path::new(&folder).join(name).to_string_lossy().into_owned())
    }

    /// The numbers of the files that are there, rising.
    pub fn numbers(&self) -> Result<Vec<u64>> {
        let number = |name: &String| {
            let digits = name.strip_prefix(&self.before)?.strip_suffix(&self.after)?;
            let number = digits.parse().ok().filter(|number| *number <= HIGHEST)?;
            // Numbers are written in one way only.
            (digits == format!("{number:0width$}", width = self.digits)).then_some(number)
        };
        let mut numbers: Vec<u64> = names(self.folder_to_open())?.iter().filter_map(number).collect();
        numbers.sort_unstable();
        Ok(numbers)
    }

    /// The first and the last number of files without a gap between them.
    ///
    /// # Errors
    /// If there are none, or one is missing.
    pub fn range(&self) -> Result<[u64; 2]> {
        let numbers = self.numbers()?;
        let Some((first, last)) = numbers.first().copied().zip(numbers.last().copied()) else {
            bail!("no file matches");
        };
        if let Some(pair) = numbers.windows(2).find(|pair| pair[1] != pair[0] + 1) {
            bail!(
                "{} is missing: there are images from {first} to {last}, and each is a frame",
                self.file(pair[0] + 1).display()
            );
        }
        Ok([first, last])
    }
}

/// The names of the files in a folder, in order.
fn names(folder: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.with_context(|| folder.display().to_string())?;
        names.extend(entry.file_name().into_string());
    }
    names.sort();
    Ok(names)
}

/// Where the last number before the extension of a name is.
fn last_number(name: &str) -> Option<(usize, usize)> {
    let stem = &name[..name.rfind('.')?];
    let end = stem.rfind(|letter: char| letter.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|letter: char| !letter.is_ascii_digit());
    // A letter may have several bytes.
    let start = start.map_or(0, |at| at + stem[at..].chars().next().map_or(1, char::len_utf8));
    Some((start, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(path: &str) -> Option<Numbered> {
        Numbered::of(Path::new(path))
    }

    #[test]
    fn patterns_have_one_number_in_their_name() {
        let pattern = of("50% %d/100% %04d.png").unwrap();
        assert_eq!(pattern.file(7), Path::new("50% %d/100% 0007.png"));
        assert_eq!(pattern.file(12345), Path::new("50% %d/100% 12345.png"));
        assert_eq!(pattern.printf().unwrap(), "50%% %%d/100%% %04d.png");
        assert_eq!((pattern.path(), pattern.are_images()), (PathBuf::from("50% %d/100% %04d.png"), true));
        assert_eq!(of("%d.JPG").unwrap().file(3), Path::new("3.JPG"));
        assert!(of("%d.JPG").unwrap().are_images() && !of("%d.mp4").unwrap().are_images());
        for other in ["a.png", "50%.mp4", "%4d.png", "%d/a.png", "%d-%d.png", "%099d.png", "%06x.png", "%"] {
            assert_eq!(of(other), None, "{other}");
        }
    }

    #[test]
    fn folders_have_images_of_one_kind() {
        let folder = std::env::temp_dir().join(format!("rsrectify-numbered-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str| std::fs::write(folder.join(name), "").unwrap();
        assert_eq!(Numbered::in_folder(&folder).unwrap(), None);
        for name in ["é8.png", "é9.png", "é10.png", "notes1.txt", "cover.png"] {
            write(name);
        }
        let found = Numbered::in_folder(&folder).unwrap().unwrap();
        assert_eq!((found.name().as_str(), found.range().unwrap()), ("é%d.png", [8, 10]));
        write("é12.png");
        let missing = found.range().unwrap_err().to_string();
        assert!(missing.contains("é11.png is missing"), "{missing}");
        write("é012.png");
        write("v2 é012.png");
        let several = Numbered::in_folder(&folder).unwrap_err().to_string();
        assert!(several.contains("several kinds") && several.contains("v2 é%d.png"), "{several}");
        let padded = Numbered::of(&folder.join("é%03d.png")).unwrap();
        assert_eq!(padded.numbers().unwrap(), [12]);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
