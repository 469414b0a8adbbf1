// SPDX-License-Identifier: MIT OR Apache-2.0

//! Clips as they are given: files, numbered images, or what comes on the standard input.

mod clock;
mod deep;
mod images;
mod numbered;
mod pipe;
mod y4m;

pub use images::{Fps, Images};
pub use numbered::Numbered;

use crate::elements::make;
use crate::interruption::Interruption;
use crate::{boxes, decoder, matroska};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use gst::glib;
use gst::prelude::*;
use pipe::Pipe;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Bytes that wait in front of the decoder of a pipe.
const QUEUED: u64 = 1 << 22;
/// Bytes of a pipe that are given to the decoder at once.
const PIECE: usize = 1 << 16;

/// What the user may say of the clips.
#[derive(Args, Clone, Debug, Default)]
pub struct InputOptions {
    /// Frames a second of numbered images, 25 unless given: a number, or a fraction such as 30000/1001.
    #[arg(long, value_name = "RATE")]
    pub fps: Option<Fps>,
}

/// A clip.
#[derive(Clone, Debug)]
pub struct Clip {
    /// The file; what no file is called, where it is none.
    path: PathBuf,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    File,
    Images(Images),
    Pipe(Pipe),
}

/// How often a clip is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opening {
    /// To look at its beginning.
    Look,
    /// To its end.
    Whole,
}

impl Clip {
    /// A file, whatever its name is.
    pub fn file(path: &Path) -> Self {
        Self { path: path.to_owned(), kind: Kind::File }
    }

    /// Numbered images.
    pub fn images(pattern: Numbered, options: &InputOptions) -> Self {
        let fps = options.fps.unwrap_or_else(Fps::usual);
        let images = Images { fps, is_rate_given: options.fps.is_some(), pattern };
        Self { path: images.pattern.path(), kind: Kind::Images(images) }
    }

    /// The standard input.
    pub fn pipe(interruption: &Interruption) -> Self {
        // No file is called so, not even where one is called `-`.
        Self { path: PathBuf::new(), kind: Kind::Pipe(Pipe::standard_input(interruption)) }
    }

    /// The clip that an argument names: `-` is the standard input; a pattern, or a folder with nothing else, numbered images.
    pub fn named(argument: &Path, options: &InputOptions, interruption: &Interruption) -> Result<Self> {
        let clip = if argument.as_os_str() == "-" {
            Self::pipe(interruption)
        } else if argument.is_dir()
            && let Some(pattern) = Numbered::in_folder(argument)?
        {
            Self::images(pattern, options)
        } else if let Some(pattern) = Self::pattern(argument) {
            Self::images(pattern, options)
        } else {
            Self::file(argument)
        };
        clip.check_options(options)?;
        Ok(clip)
    }

    /// The pattern of numbered images that an argument is, where it is not a file.
    pub fn pattern(argument: &Path) -> Option<Numbered> {
        Numbered::of(argument).filter(|pattern| pattern.are_images() && !argument.exists())
    }

    /// Refuses what can be said of other clips only.
    pub fn check_options(&self, options: &InputOptions) -> Result<()> {
        if options.fps.is_some() && !matches!(self.kind, Kind::Images(_)) {
            bail!("--fps is of numbered images; {} states its frame rate itself", self.display());
        }
        Ok(())
    }

    /// The file, or a path that no file has.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What it is called in messages.
    pub fn display(&self) -> impl fmt::Display + '_ {
        match self.kind {
            Kind::Pipe(_) => "standard input".into(),
            _ => self.path.to_string_lossy(),
        }
    }

    /// A path by whose name, without its extension, what is made of the clip is called.
    pub fn namesake(&self) -> Result<PathBuf> {
        match &self.kind {
            Kind::File => Ok(self.path.clone()),
            Kind::Images(images) => {
                let folder = images.pattern.folder();
                let name = folder.file_name().filter(|_| !folder.as_os_str().is_empty());
                let Some(name) = name else { return Ok(folder.join("images.png")) };
                let mut name = name.to_owned();
                name.push(".png");
                Ok(folder.with_file_name(name))
            }
            Kind::Pipe(_) => bail!("what comes on the standard input has no name: give --output"),
        }
    }

    /// What it is called in files that are made of it.
    pub fn name(&self) -> String {
        match self.kind {
            Kind::Pipe(_) => "standard input".to_owned(),
            _ => self.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        }
    }

    /// The numbered images that it is.
    pub fn as_images(&self) -> Option<&Images> {
        match &self.kind {
            Kind::Images(images) => Some(images),
            Kind::File | Kind::Pipe(_) => None,
        }
    }

    /// Whether it is of images without transparency, which decoders may add to those of 16 bits.
    pub fn is_opaque(&self) -> bool {
        let kind = self.as_images().and_then(kind_of);
        kind.is_some_and(|(_, is_transparent)| !is_transparent)
    }

    /// Whether it can be read only once.
    pub fn is_pipe(&self) -> bool {
        matches!(self.kind, Kind::Pipe(_))
    }

    /// Its file, where something else will not do.
    pub fn only_file(&self, what: &str) -> Result<&Path> {
        match self.kind {
            Kind::File => Ok(&self.path),
            Kind::Images(_) => bail!("{what} takes a file, not numbered images"),
            Kind::Pipe(_) => bail!("{what} takes a file, not the standard input"),
        }
    }

    /// What is to be said before it is worked on.
    fn note(&self) -> Option<String> {
        let images = self.as_images()?;
        let [first, last] = images.pattern.range().ok()?;
        let hint = if images.is_rate_given { "" } else { ", as --fps is not given" };
        Some(format!("images: {} at {} frames/s{hint}", last - first + 1, images.fps))
    }

    /// Checks it, and says what is to be said of it, on the standard error output: others may carry a file.
    pub fn begin(&self) -> Result<()> {
        self.check()?;
        if let Some(note) = self.note() {
            log::info!("{note}");
        }
        Ok(())
    }

    /// Refuses what cannot be a clip, before a pipeline says so in its own words.
    pub fn check(&self) -> Result<()> {
        match &self.kind {
            Kind::File => check_file(&self.path),
            Kind::Images(images) => images.check(),
            Kind::Pipe(_) => Ok(()),
        }
    }

    /// The bytes with which it begins; of a pipe, those that have been looked at.
    pub fn beginning(&self) -> Vec<u8> {
        match &self.kind {
            Kind::File => matroska::beginning(&self.path),
            Kind::Images(_) => Vec::new(),
            Kind::Pipe(pipe) => pipe.looked_at(),
        }
    }

    /// Whether it is a Matroska file.
    pub fn is_matroska(&self) -> bool {
        match &self.kind {
            Kind::File => matroska::is_matroska(&self.path),
            Kind::Images(_) => false,
            Kind::Pipe(pipe) => pipe.begins_with(matroska::FILE),
        }
    }

    /// Adds to a pipeline what reads the clip and the decoder of it, which is given back.
    pub fn open(&self, pipeline: &gst::Pipeline, opening: Opening) -> Result<gst::Element> {
        let decoder = decoder::of(&self.path)?;
        let source = self.source(opening)?;
        pipeline.add_many([&source, &decoder])?;
        source.link(&decoder)?;
        Ok(decoder)
    }

    /// Has a pipeline decode the clip into a pad: its first stream of raw video, an error where there is none.
    pub fn read_video(&self, pipeline: &gst::Pipeline, opening: Opening, input: &gst::Pad) -> Result<()> {
        decoder::link_video(&self.open(pipeline, opening)?, self.is_matroska(), input)
    }

    fn source(&self, opening: Opening) -> Result<gst::Element> {
        match &self.kind {
            Kind::File if is_y4m(&self.path) => y4m_source(File::open(&self.path)?, |_, _| {}),
            Kind::File => {
                let source = make("filesrc")?;
                source.set_property("location", &self.path);
                Ok(source)
            }
            Kind::Images(images) if kind_of(images).is_some_and(|(is_deep, _)| is_deep) => {
                deep_source(images)
            }
            Kind::Images(images) => images.source(),
            Kind::Pipe(pipe) => {
                let [is_y4m, is_matroska] =
                    [y4m::BEGINNING, matroska::FILE].map(|bytes| pipe.begins_with(bytes));
                if !is_y4m && !is_matroska {
                    bail!("what comes on the standard input is neither Y4M nor Matroska");
                }
                let reader = if opening == Opening::Look { pipe.look() } else { pipe.take() }?;
                let stop_if =
                    |reader: &mut pipe::PipeReader, stop: Stop| reader.stop_if(move || stop.has_come());
                if is_y4m { y4m_source(reader, stop_if) } else { bytes_source(reader, stop_if) }
            }
        }
    }
}

/// Whether PNG images have 16 bits, and transparency, by the first.
fn kind_of(images: &Images) -> Option<(bool, bool)> {
    let [first, _] = images.pattern.range().ok()?;
    deep::depth(&images.pattern.file(first))
}

fn is_y4m(file: &Path) -> bool {
    let mut bytes = [0; y4m::BEGINNING.len()];
    // What is read of a named pipe is gone.
    let read = Some(file).filter(|file| file.is_file()).and_then(|file| File::open(file).ok());
    read.is_some_and(|mut file| file.read_exact(&mut bytes).is_ok()) && bytes == y4m::BEGINNING
}

/// Refuses a file that cannot be a clip.
pub fn check_file(clip: &Path) -> Result<()> {
    let metadata = std::fs::metadata(clip).context("cannot be read")?;
    if metadata.is_dir() {
        bail!("is a folder");
    }
    // Each look at a pipe would take something of it.
    if !metadata.is_file() {
        bail!("is no file; what comes from a pipe is given on the standard input, as -");
    }
    // GStreamer may wait for ever for what is not there.
    if boxes::lacks_index(&mut File::open(clip).context("cannot be read")?) {
        bail!("has no index of its frames: it was not written to its end");
    }
    Ok(())
}

/// Whether what reads for a pipeline is to give up: the pipeline has ended.
#[derive(Clone)]
struct Stop {
    output: glib::WeakRef<gst::Pad>,
    has_begun: Arc<AtomicBool>,
}

impl Stop {
    fn has_come(&self) -> bool {
        let is_flushing =
            || self.output.upgrade().is_none_or(|pad| pad.pad_flags().contains(gst::PadFlags::FLUSHING));
        self.has_begun.load(Ordering::Relaxed) && is_flushing()
    }
}

/// An element that gives out what is read elsewhere, and what tells the reader that it has ended.
fn app_source() -> Result<(gst_app::AppSrc, Stop)> {
    let source = make("appsrc")?;
    let output = source.static_pad("src").context("appsrc has no output")?.downgrade();
    let source = source.downcast::<gst_app::AppSrc>().map_err(|_| anyhow!("appsrc is another element"))?;
    source.set_max_bytes(QUEUED);
    Ok((source, Stop { output, has_begun: Arc::default() }))
}

/// Has an element give out raw frames of so many bytes.
fn announce(source: &gst_app::AppSrc, caps: &gst::Caps, size: usize) {
    source.set_format(gst::Format::Time);
    source.set_caps(Some(caps));
    // A frame of 4K has more than the usual bytes.
    source.set_max_bytes(2 * size as u64);
}

/// Has an element give out what `next` reads, until there is no more.
fn feed(
    source: &gst_app::AppSrc,
    stop: Stop,
    mut next: impl FnMut(&gst_app::AppSrc) -> Result<Option<gst::Buffer>> + Send + 'static,
) {
    let need = move |source: &gst_app::AppSrc, _: u32| {
        stop.has_begun.store(true, Ordering::Relaxed);
        match next(source) {
            // Where nobody takes it any more, the pipeline has ended.
            Ok(Some(buffer)) => {
                let _ = source.push_buffer(buffer);
            }
            Ok(None) => {
                let _ = source.end_of_stream();
            }
            Err(error) => {
                if !stop.has_come() {
                    gst::element_error!(source, gst::ResourceError::Read, ("{error:#}"));
                }
                let _ = source.end_of_stream();
            }
        }
    };
    source.set_callbacks(gst_app::AppSrcCallbacks::builder().need_data(need).build());
}

fn bytes_source<R: Read + Send + 'static>(
    mut reader: R,
    stop_if: impl Fn(&mut R, Stop),
) -> Result<gst::Element> {
    let (source, stop) = app_source()?;
    stop_if(&mut reader, stop.clone());
    feed(&source, stop, move |_| {
        let mut piece = vec![0; PIECE];
        let read = reader.read(&mut piece)?;
        piece.truncate(read);
        Ok((read > 0).then(|| gst::Buffer::from_mut_slice(piece)))
    });
    Ok(source.upcast())
}

fn deep_source(images: &Images) -> Result<gst::Element> {
    let (source, stop) = app_source()?;
    let mut images = deep::DeepImages::new(images)?;
    announce(&source, &images.info().to_caps()?, images.info().size());
    feed(&source, stop, move |_| images.next());
    Ok(source.upcast())
}

fn y4m_source<R: Read + Send + 'static>(
    mut reader: R,
    stop_if: impl Fn(&mut R, Stop),
) -> Result<gst::Element> {
    let (source, stop) = app_source()?;
    stop_if(&mut reader, stop.clone());
    let mut frames = y4m::Frames::new(reader)?;
    announce(&source, &frames.caps()?, frames.size());
    feed(&source, stop, move |source| match frames.next()? {
        y4m::Next::Frame(buffer) => Ok(Some(buffer)),
        y4m::Next::End => Ok(None),
        y4m::Next::Cut => {
            gst::element_warning!(
                source,
                gst::ResourceError::Read,
                ("the stream ends within a frame, which is left out")
            );
            Ok(None)
        }
    });
    Ok(source.upcast())
}
