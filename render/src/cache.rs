// SPDX-License-Identifier: MIT OR Apache-2.0

//! Footage kept on disk, so that a sequence is rendered once.
//!
//! Each footage is a folder named by a hash of all that determines it:
//!
//! | file | what it holds |
//! |---|---|
//! | `frame_0000.png` … | the frames as they arrive |
//! | `global_0000.png` … | the frames of a global shutter, if wanted, named by the capture they belong to |
//! | `truth.bin` | amplitudes, samples, masks and displacement maps, and a hash of each picture |
//!
//! `truth.bin` is written last and checked against its own hash: a folder without it, or with a picture
//! that has changed, is damaged.

use crate::footage::{Footage, FrameTruth, GlobalView, Truth};
use crate::scene::Frame;
use crate::sequence::{Sequence, Settings};
use crate::truth::{DisplacementMap, Sample};
use anyhow::{Context, Result, ensure};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// A hash of this crate's sources, the versions of its dependencies and the compiler: see `build.rs`.
const RENDERER: &str = env!("RENDERER");

/// How many bytes are kept by default: 5 GB.
const LIMIT: u64 = 5_000_000_000;

/// The name of the file that completes an entry.
const TRUTH: &str = "truth.bin";

/// What the names of entries begin with while they are being written.
const FRESH: &str = "new-";

/// After this time without another file, nobody writes an entry any more: its process was stopped.
const STALE: Duration = Duration::from_secs(3600);

/// A folder in which footage is kept.
#[derive(Clone, Debug)]
pub struct Cache {
    folder: PathBuf,
    limit: u64,
}

/// What `truth.bin` holds.
#[derive(Serialize, Deserialize)]
struct Record {
    amplitudes: Vec<f64>,
    /// By capture.
    truth: BTreeMap<usize, Known>,
    /// BLAKE3 of each picture's file, by its name.
    pictures: BTreeMap<String, [u8; 32]>,
}

/// The truth of a capture without its picture.
#[derive(Serialize, Deserialize)]
struct Known {
    /// Seen and true place, x and y each.
    samples: Vec<[f64; 4]>,
    /// Eight pixels a byte, the first in the lowest bit; none where the global shutter's frame is not wanted.
    visible: Vec<u8>,
    first: DisplacementMap,
    last: DisplacementMap,
    forward: Option<DisplacementMap>,
    backward: Option<DisplacementMap>,
}

impl Known {
    fn of(truth: &FrameTruth) -> Self {
        let numbers = |sample: &Sample| [sample.seen.x, sample.seen.y, sample.truth.x, sample.truth.y];
        let byte = |pixels: &[bool]| pixels.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
        Self {
            samples: truth.samples.iter().map(numbers).collect(),
            visible: truth.global.iter().flat_map(|global| global.visible.chunks(8)).map(byte).collect(),
            first: truth.first.clone(),
            last: truth.last.clone(),
            forward: truth.forward.clone(),
            backward: truth.backward.clone(),
        }
    }

    fn with(&self, size: [usize; 2], global: Option<Frame>) -> FrameTruth {
        let sample =
            |[x, y, u, v]: &[f64; 4]| Sample { seen: Vector2::new(*x, *y), truth: Vector2::new(*u, *v) };
        let bits = self.visible.iter().flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1 == 1));
        let visible = bits.take(size[0] * size[1]).collect();
        FrameTruth {
            size,
            samples: self.samples.iter().map(sample).collect(),
            first: self.first.clone(),
            last: self.last.clone(),
            forward: self.forward.clone(),
            backward: self.backward.clone(),
            global: global.map(|picture| GlobalView { picture, visible }),
        }
    }
}

impl Cache {
    /// Keeps footage in a folder, at most 5 GB of it.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), limit: LIMIT }
    }

    /// Keeps footage in `$XDG_CACHE_HOME/rsrectify-eval` or `~/.cache/rsrectify-eval`.
    ///
    /// # Errors
    /// If neither `XDG_CACHE_HOME` nor `HOME` is set.
    pub fn in_default_folder() -> Result<Self> {
        let set = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let caches = set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache")));
        Ok(Self::new(caches.context("neither XDG_CACHE_HOME nor HOME is set")?.join("rsrectify-eval")))
    }

    /// The footage of the settings with the photographs of a folder as textures, procedural ones without
    /// it: from the cache, or rendered and kept there. A damaged entry is rendered anew.
    ///
    /// # Errors
    /// If the textures or the cache's folder cannot be used, or where the settings ask for H.264 and it
    /// is not to be had.
    pub fn footage(&self, settings: &Settings, textures: Option<&Path>, wanted: Truth) -> Result<Footage> {
        let entry = self.folder.join(name(settings, textures, wanted)?);
        if let Ok(footage) = read(&entry, settings, textures, wanted) {
            // The time of the last use is that of the truth's file.
            let touched = File::options().append(true).open(entry.join(TRUTH));
            touched.and_then(|file| file.set_modified(SystemTime::now())).ok();
            return Ok(footage);
        }
        let footage = Footage::render(Sequence::with_textures(settings.clone(), textures)?, wanted)?;
        self.keep(&entry, &footage).with_context(|| format!("cannot keep footage in {}", entry.display()))?;
        Ok(footage)
    }

    /// Writes an entry beside its place and moves it there, so that other processes never see half of it.
    fn keep(&self, entry: &Path, footage: &Footage) -> Result<()> {
        fs::create_dir_all(&self.folder)?;
        let fresh = tempfile::Builder::new().prefix(FRESH).tempdir_in(&self.folder)?;
        write(fresh.path(), footage)?;
        self.remove(entry)?;
        // Another process may have been quicker; what it wrote is the same.
        if fs::rename(fresh.path(), entry).is_ok() {
            let _moved = fresh.keep();
        }
        self.forget(entry)
    }

    /// Deletes what stopped processes left half written, and what was not used for longest until the
    /// limit is kept, except for `entry`. Other processes may do the same meanwhile.
    fn forget(&self, entry: &Path) -> Result<()> {
        let mut entries = Vec::new();
        for path in folders(&self.folder)? {
            if existing(is_stale(&path))? == Some(true) {
                self.remove(&path)?;
                continue;
            }
            let Some(size) = existing(size(&path))? else { continue };
            let used = fs::metadata(path.join(TRUTH)).and_then(|truth| truth.modified());
            entries.push((used.unwrap_or(SystemTime::UNIX_EPOCH), size, path));
        }
        entries.sort();
        let mut total: u64 = entries.iter().map(|(_, size, _)| size).sum();
        for (_, size, path) in entries {
            // Entries of other processes that are being written have no name of 64 digits yet.
            let complete = path.file_name().is_some_and(|name| name.len() == 64);
            if total > self.limit && complete && path != entry {
                self.remove(&path)?;
                total -= size;
            }
        }
        Ok(())
    }

    /// Deletes a folder that may be missing, or deleted by another process at the same time.
    ///
    /// It is moved into a folder of this process first: of several processes one succeeds in that, and only that
    /// one deletes files, so that nobody deletes from an entry which another process has just put in its place.
    fn remove(&self, path: &Path) -> Result<()> {
        let deleted = tempfile::Builder::new().prefix(FRESH).tempdir_in(&self.folder)?;
        existing(fs::rename(path, deleted.path().join("entry")))?;
        Ok(deleted.close()?)
    }
}

/// The name of an entry: a hash of the settings, the renderer, the textures' files, and whether the whole truth is wanted.
fn name(settings: &Settings, textures: Option<&Path>, wanted: Truth) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(RENDERER.as_bytes());
    hasher.update(&[u8::from(wanted == Truth::Whole)]);
    hasher.update(&serde_json::to_vec(settings)?);
    for path in textures.map(files).transpose()?.unwrap_or_default() {
        let bytes = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        hasher.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        hasher.update(blake3::hash(&bytes).as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// The files of a folder in the order of their names.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.retain(|path| path.is_file());
    paths.sort();
    Ok(paths)
}

fn folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.retain(|path| path.is_dir());
    Ok(paths)
}

/// What was done with a file or folder; `None` if another process has deleted it meanwhile.
fn existing<T>(done: io::Result<T>) -> io::Result<Option<T>> {
    match done {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Whether a folder is an entry that was begun and left; its time is that of its last new file.
fn is_stale(folder: &Path) -> io::Result<bool> {
    let begun = folder.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(FRESH.as_bytes()));
    Ok(begun && fs::metadata(folder)?.modified()?.elapsed().is_ok_and(|age| age > STALE))
}

/// The bytes of all files of an entry.
fn size(entry: &Path) -> io::Result<u64> {
    fs::read_dir(entry)?.map(|file| Ok(file?.metadata()?.len())).sum()
}

fn frame_name(index: usize) -> String {
    format!("frame_{index:04}.png")
}

fn global_name(capture: usize) -> String {
    format!("global_{capture:04}.png")
}

fn write(folder: &Path, footage: &Footage) -> Result<()> {
    let mut pictures = BTreeMap::new();
    let mut picture = |name: String, frame: &Frame| -> Result<()> {
        write_png(&folder.join(&name), frame)?;
        pictures.insert(name.clone(), *blake3::hash(&fs::read(folder.join(name))?).as_bytes());
        Ok(())
    };
    let mut truth = BTreeMap::new();
    for (index, frame) in footage.frames.iter().enumerate() {
        picture(frame_name(index), frame)?;
        let (capture, known) = (footage.captures[index], &footage.truth[index]);
        if let Entry::Vacant(place) = truth.entry(capture) {
            if let Some(global) = &known.global {
                picture(global_name(capture), &global.picture)?;
            }
            place.insert(Known::of(known));
        }
    }
    let record = Record { amplitudes: footage.sequence.amplitudes.clone(), truth, pictures };
    let bytes = postcard::to_stdvec(&record)?;
    let hash = blake3::hash(&bytes);
    Ok(fs::write(folder.join(TRUTH), [hash.as_bytes(), &bytes[..]].concat())?)
}

/// Reads an entry.
///
/// # Errors
/// If it is missing or damaged.
fn read(folder: &Path, settings: &Settings, textures: Option<&Path>, wanted: Truth) -> Result<Footage> {
    let bytes = fs::read(folder.join(TRUTH))?;
    let (hash, bytes) = bytes.split_at_checked(32).context("a record that is cut off")?;
    ensure!(blake3::hash(bytes).as_bytes() == hash, "a damaged record");
    let record: Record = postcard::from_bytes(bytes)?;
    let picture = |name: String| -> Result<Frame> {
        let bytes = fs::read(folder.join(&name))?;
        let hash = record.pictures.get(&name).context("a picture without a record")?;
        ensure!(blake3::hash(&bytes).as_bytes() == hash, "a damaged picture");
        let rgb = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png)?.into_rgb8();
        Ok(Frame { width: rgb.width() as usize, height: rgb.height() as usize, rgb: rgb.into_raw() })
    };
    let deliveries = settings.timeline.deliveries(settings.frames, settings.fps);
    let frames = (0..deliveries.len()).map(|index| picture(frame_name(index))).collect::<Result<_>>()?;
    let truth = deliveries.iter().map(|delivery| {
        let known = record.truth.get(&delivery.capture).context("a capture without truth")?;
        let global = (wanted == Truth::Whole).then(|| picture(global_name(delivery.capture)));
        Ok(known.with([settings.width, settings.height], global.transpose()?))
    });
    let truth = truth.collect::<Result<_>>()?;
    let sequence = Sequence::with_amplitudes(settings.clone(), textures, record.amplitudes)?;
    Ok(Footage::of(sequence, frames, truth))
}

/// Writes a frame so that it is quick to read: sensor noise would not shrink much anyway.
fn write_png(path: &Path, frame: &Frame) -> Result<()> {
    let out = BufWriter::new(File::create(path)?);
    let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive);
    let (width, height) = (u32::try_from(frame.width)?, u32::try_from(frame.height)?);
    Ok(encoder.write_image(&frame.rgb, width, height, ExtendedColorType::Rgb8)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::{Timeline, named};

    fn settings() -> Settings {
        let timeline = Timeline::Duplicates(vec![1]);
        Settings { width: 77, height: 58, frames: 3, timeline, ..named("rot2_B40").unwrap() }
    }

    fn entries(cache: &Cache) -> Vec<PathBuf> {
        folders(&cache.folder).unwrap()
    }

    fn assert_same(a: &Footage, b: &Footage) {
        assert!(a.frames == b.frames && a.truth == b.truth && a.captures == b.captures);
        assert_eq!((&a.stamps, &a.sequence.amplitudes), (&b.stamps, &b.sequence.amplitudes));
    }

    #[test]
    fn blended_footage_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::new(folder.path());
        let settings = Settings { fps: 25.0, frames: 7, timeline: Timeline::Blended(30.0), ..settings() };
        for wanted in [Truth::Whole, Truth::Displacements] {
            let rendered = cache.footage(&settings, None, wanted).unwrap();
            assert_same(&cache.footage(&settings, None, wanted).unwrap(), &rendered);
            assert_eq!(rendered.truth[1].global.is_some(), wanted == Truth::Whole);
        }
    }

    #[test]
    fn what_is_kept_comes_back_and_damage_is_repaired() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::new(folder.path().join("deep").join("cache"));
        let rendered = Footage::of_settings(&settings()).unwrap();
        assert_same(&cache.footage(&settings(), None, Truth::Whole).unwrap(), &rendered);
        let [entry] = &entries(&cache)[..] else { panic!("one entry") };
        assert_same(&read(entry, &settings(), None, Truth::Whole).unwrap(), &rendered);
        // Another picture of the same size is as damaged as half a file.
        let (frame, truth) = (entry.join("frame_0002.png"), entry.join(TRUTH));
        for damage in [0, 1, 2] {
            match damage {
                0 => drop(fs::copy(entry.join("global_0000.png"), &frame).unwrap()),
                1 => fs::write(&truth, &fs::read(&truth).unwrap()[..100]).unwrap(),
                _ => fs::remove_file(&frame).unwrap(),
            }
            assert!(read(entry, &settings(), None, Truth::Whole).is_err(), "{damage}");
            assert_same(&cache.footage(&settings(), None, Truth::Whole).unwrap(), &rendered);
            assert!(read(entry, &settings(), None, Truth::Whole).is_ok(), "{damage}");
        }
        assert_eq!(entries(&cache).len(), 1);
    }

    #[test]
    fn the_least_recently_used_is_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache { folder: folder.path().into(), limit: 2500 };
        for (index, letter) in ["a", "b", "c"].into_iter().enumerate() {
            let entry = folder.path().join(letter.repeat(64));
            fs::create_dir(&entry).unwrap();
            fs::write(entry.join(TRUTH), [0; 1000]).unwrap();
            let truth = File::options().append(true).open(entry.join(TRUTH)).unwrap();
            let minutes = std::time::Duration::from_secs(60 * [2, 3, 1][index]);
            truth.set_modified(SystemTime::UNIX_EPOCH + minutes).unwrap();
        }
        // c was used first, but is the entry just written; then a.
        cache.forget(&folder.path().join("c".repeat(64))).unwrap();
        let left = |letter: &str| folder.path().join(letter.repeat(64)).exists();
        assert_eq!(["a", "b", "c"].map(left), [false, true, true]);
    }

    #[test]
    fn processes_may_clear_the_same_folder_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache { folder: folder.path().into(), limit: 0 };
        let own = folder.path().join("e".repeat(64));
        let clear = || {
            for round in 0..40 {
                // Each thread completes some of the entries, and both delete all of them.
                for letter in ["a", "b", "c", "d"] {
                    let fresh = tempfile::Builder::new().prefix(FRESH).tempdir_in(folder.path()).unwrap();
                    (0..5).for_each(|k| fs::write(fresh.path().join(frame_name(k)), [0; 100]).unwrap());
                    fs::write(fresh.path().join(TRUTH), [0; 100]).unwrap();
                    if fs::rename(fresh.path(), folder.path().join(letter.repeat(64))).is_ok() {
                        let _moved = fresh.keep();
                    }
                }
                cache.forget(&own).unwrap_or_else(|error| panic!("{round}: {error:#}"));
            }
        };
        std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(clear))));
        cache.forget(&own).unwrap();
        assert_eq!(entries(&cache), Vec::<PathBuf>::new());
    }

    #[test]
    fn what_stopped_processes_left_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let [left, begun] = ["new-left", "new-begun"].map(|name| folder.path().join(name));
        for path in [&left, &begun] {
            fs::create_dir(path).unwrap();
            fs::write(path.join(frame_name(0)), "half").unwrap();
        }
        let before = SystemTime::now() - 2 * STALE;
        File::open(&left).unwrap().set_modified(before).unwrap();
        Cache::new(folder.path()).forget(&folder.path().join("c".repeat(64))).unwrap();
        assert!(!left.exists() && begun.exists());
    }

    #[test]
    fn the_name_depends_on_settings_and_textures() {
        let folder = tempfile::tempdir().unwrap();
        let named = |settings: &Settings| name(settings, Some(folder.path()), Truth::Whole).unwrap();
        let empty = named(&settings());
        assert_eq!(empty.len(), 64);
        assert_ne!(empty, named(&Settings { seed: 2, ..settings() }));
        fs::write(folder.path().join("wall.jpg"), "one").unwrap();
        let one = named(&settings());
        fs::write(folder.path().join("wall.jpg"), "two").unwrap();
        assert!(empty != one && one != named(&settings()));
    }
}
