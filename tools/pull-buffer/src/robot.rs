//! Pulling from one source, with reconnection.

use std::path::{Path, PathBuf};

use hal::Clock;
use monotonic_clock::MonotonicClock;
use segment_store::pull::{Destination, FileSystem, Progress, Report, pull};
use segment_store::source::{Directory, Location, Source, Spec, Ssh, SshOptions};
use segment_store::{ErrorKind, StoreError};

use crate::options::{Layout, Options};
use crate::progress::{Bar, Display};
use crate::store::{Bucket, Keys};

/// The result of a pull, including all its retries.
pub struct Outcome {
    pub report: Report,
    /// The number of runs that were exported.
    pub exported: u64,
    /// The error that ended the pull early.
    pub error: Option<StoreError>,
}

/// One source and the state of its connection.
pub struct Robot<'a> {
    spec: &'a Spec,
    options: &'a Options,
    keys: &'a Keys,
    /// The connection. With --follow it is kept between pulls, as long as it works.
    source: Option<Box<dyn Source>>,
    /// The destination, if it is an object store.
    store: Option<Bucket>,
    /// The source has answered at least once.
    reached: bool,
    /// The link broke. The reason may be a shared connection that an earlier call left open, so the next one is not shared.
    broke: bool,
    /// What the source could not read at the last pull. With --follow, it is reported once.
    unread: Vec<String>,
}

impl<'a> Robot<'a> {
    pub fn new(spec: &'a Spec, options: &'a Options, keys: &'a Keys) -> Self {
        Self {
            spec,
            options,
            keys,
            source: None,
            store: None,
            reached: false,
            broke: false,
            unread: Vec::new(),
        }
    }

    pub fn spec(&self) -> &Spec {
        self.spec
    }

    /// Whether the source has ever answered.
    pub fn has_been_reached(&self) -> bool {
        self.reached
    }

    /// Pulls all new segments and reconnects up to `--retries` times when the link breaks.
    pub fn pull(&mut self, display: &Display, clock: &mut MonotonicClock) -> Outcome {
        let mut bar = display.bar(&self.spec.name);
        let mut outcome = Outcome { report: Report::default(), exported: 0, error: None };
        let mut tries_left = if self.options.follow { 0 } else { self.options.retries };
        let mut pause_s = 1;
        loop {
            let error = match self.pull_once(&mut bar, clock) {
                Ok(report) => {
                    outcome.report = add(&outcome.report, report);
                    self.warn_of_unread(&outcome.report.unread, &mut bar);
                    break;
                }
                Err(error) => error,
            };
            self.source = None;
            self.broke = true;
            if error.kind() != ErrorKind::Link || tries_left == 0 {
                outcome.error = Some(error);
                return outcome;
            }
            tries_left -= 1;
            bar.say(&format!("{error}; trying again in {pause_s} s"));
            let deadline_ns = clock.now_ns() + pause_s * 1_000_000_000;
            clock.sleep_until_ns(deadline_ns);
            pause_s *= 2;
        }
        if let Some(layout) = self.options.layout {
            match self.export(layout, &mut bar) {
                Ok(exported) => outcome.exported = exported,
                Err(error) => outcome.error = Some(error),
            }
        }
        outcome
    }

    fn warn_of_unread(&mut self, unread: &[String], bar: &mut Bar) {
        for why in unread.iter().filter(|why| !self.unread.contains(why)) {
            bar.warning(&format!("not pulled: {why}"));
        }
        self.unread = unread.to_vec();
    }

    fn pull_once(
        &mut self,
        bar: &mut Bar,
        clock: &mut MonotonicClock,
    ) -> Result<Report, StoreError> {
        let to_store = self.options.destination_store();
        if let (Some(url), None) = (to_store, &self.store) {
            let store = Bucket::open(url, self.options.stall_s)?.with_keys(self.keys);
            self.store = Some(store.with_subfolder(&self.spec.name));
        }
        let mut directory = match to_store {
            Some(_) => None,
            None => {
                Some(Destination::open(&self.options.directory_of(&self.spec.name), &FileSystem)?)
            }
        };
        if self.source.is_none() {
            self.source = Some(self.connect()?);
        }
        let Some(source) = self.source.as_deref_mut() else { return Ok(Report::default()) };
        self.reached = true;
        match (&mut directory, &mut self.store) {
            (Some(directory), _) => {
                pull(source, directory, &self.options.pull_options(), clock, bar)
            }
            (None, Some(store)) => store.upload(source, &self.options.pull_options(), clock, bar),
            (None, None) => Ok(Report::default()),
        }
    }

    fn connect(&self) -> Result<Box<dyn Source>, StoreError> {
        Ok(match &self.spec.location {
            Location::Directory(path) => Box::new(Directory::open(path)?),
            Location::Ssh { host, path } => {
                let options = SshOptions {
                    arguments: self.options.ssh_options.clone(),
                    remote_command: self.options.remote_command.clone(),
                    stall_s: self.options.stall_s,
                    share: !self.broke,
                    ..SshOptions::default()
                };
                Box::new(Ssh::connect(host, path, &options)?)
            }
            Location::ObjectStore(url) => {
                Box::new(Bucket::open(url, self.options.stall_s)?.with_keys(self.keys))
            }
        })
    }

    /// Exports the runs that have not been exported yet. Returns their number.
    fn export(&self, layout: Layout, bar: &mut Bar) -> Result<u64, StoreError> {
        let dir = self.options.directory_of(&self.spec.name);
        let (root, catalogue) = segment_store::Catalogue::open(&dir)?;
        let mut exported = 0;
        for (run, entries) in catalogue.runs() {
            let to =
                dir.join(layout.folder()).join(if run.is_empty() { &self.spec.name } else { run });
            if to.exists() {
                continue;
            }
            let segments: Vec<_> =
                entries.iter().map(|entry| root.path().join(entry.name.as_str())).collect();
            let images = layout.export(&segments, &to)?;
            bar.say(&format!("{}: {images} images", to.display()));
            exported += 1;
        }
        Ok(exported)
    }
}

impl Layout {
    /// The directory below the destination.
    fn folder(self) -> &'static str {
        match self {
            Self::Tum => "tum",
            Self::Lerobot => "lerobot",
        }
    }

    /// Refuses the format whose libraries are Python's, with the command of the trainer that writes it.
    pub fn check(self) -> Result<(), StoreError> {
        match self {
            Self::Tum => Ok(()),
            Self::Lerobot => Err(StoreError::Usage(
                "the trainer writes LeRobot datasets: pull without --as, then run `embodied-depth convert DEST/NAME --as lerobot \
                 --out DIR` (`pip install -e \"tools/trainer[exports]\"` in the checkout)"
                    .to_owned(),
            )),
        }
    }

    /// Exports a run. Returns the number of its images.
    fn export(self, segments: &[PathBuf], to: &Path) -> Result<u64, StoreError> {
        match self {
            Self::Tum => segment_store::export::tum(segments, to).map(|done| done.images),
            Self::Lerobot => self.check().map(|()| 0),
        }
    }
}

fn add(a: &Report, b: Report) -> Report {
    Report {
        files: a.files + b.files,
        bytes: a.bytes + b.bytes,
        unmarked: a.unmarked + b.unmarked,
        cut: a.cut + b.cut,
        ..b
    }
}
