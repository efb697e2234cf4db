//! One pull from one source into one directory.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hal::Clock;

use super::disk::{Disk, PartFile};
use super::index::{Index, Indexed};
use super::pace::Pace;
use super::part::{Part, Paths};
use super::{Options, Report, Watch};
use crate::catalogue::{Entry, State};
use crate::digest::{Digest, Hasher};
use crate::error::BufferError;
use crate::root::file_modified_ns;
use crate::source::Source;
use crate::verify::{Finding, verify};

/// Files that may wait for the disk while the next ones arrive.
const WAITING: usize = 2;

/// The index is written at most this often, and at the end.
const SAVE_EVERY_NS: u64 = 2_000_000_000;

/// The lock's name. Hidden, and left where it is: who removes a lock file, breaks the lock.
const LOCK_FILE: &str = ".pull.lock";

/// A directory that one pull at a time writes into.
pub struct Destination<'a> {
    dir: PathBuf,
    disk: &'a dyn Disk,
    index: Index,
    saved_ns: u64,
    _lock: File,
}

impl<'a> Destination<'a> {
    /// Makes the directory if it is missing, and locks it.
    ///
    /// # Errors
    /// When it cannot be written, or another pull is at work there.
    pub fn open(dir: &Path, disk: &'a dyn Disk) -> Result<Self, BufferError> {
        std::fs::create_dir_all(dir).map_err(BufferError::write(dir))?;
        let path = dir.join(LOCK_FILE);
        let lock = File::options().write(true).create(true).truncate(false).open(&path);
        let lock = lock.map_err(BufferError::write(&path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(BufferError::Busy { dir: dir.to_owned() }),
            Err(TryLockError::Error(error)) => return Err(BufferError::write(path)(error)),
        }
        Ok(Self { index: Index::open(dir), dir: dir.to_owned(), disk, saved_ns: 0, _lock: lock })
    }
}

/// A file that has arrived and is to become durable under its name.
struct Job {
    part: Option<Box<dyn PartFile>>,
    paths: Paths,
    /// Under this name a different file of that name is kept.
    aside: Option<PathBuf>,
    entry: Entry,
    digest: Digest,
}

/// Pulls everything that is closed or cut and not here yet.
///
/// # Errors
/// When the link, the robot or the disk fails; what arrived is kept. Of several errors the first.
pub fn pull(
    source: &mut dyn Source,
    to: &mut Destination<'_>,
    options: &Options,
    clock: &mut dyn Clock,
    watch: &mut dyn Watch,
) -> Result<Report, BufferError> {
    let mut work = Work { source, to, options, watch, report: Report::default(), damaged: None };
    let missing = work.plan()?;
    let pulled = std::thread::scope(|scope| {
        let (jobs, waiting) = sync_channel::<Job>(WAITING);
        let (done, results) = sync_channel(1024);
        let disk = work.to.disk;
        scope.spawn(move || keep_all(disk, &waiting, &done));
        let pulled = work.pull_all(missing, Pace::new(clock, options.limit), &jobs, &results);
        // Whatever happened, what has arrived is finished.
        drop(jobs);
        let finished = results.iter().try_for_each(|result| work.finished(result));
        pulled.and(finished)
    });
    let saved = work.to.index.save(work.to.disk);
    pulled.and(saved)?;
    Ok(work.report)
}

/// On a thread of its own: while the disk syncs one file, the next arrives.
fn keep_all(disk: &dyn Disk, jobs: &Receiver<Job>, done: &SyncSender<Result<Job, BufferError>>) {
    for mut job in jobs {
        let kept = match job.part.take() {
            Some(part) => make_durable(disk, part, &job.paths, job.aside.as_deref()),
            None => Ok(()),
        };
        let kept = kept.map_err(BufferError::write(&job.paths.whole));
        if done.send(kept.map(|()| job)).is_err() {
            return;
        }
    }
}

fn make_durable(
    disk: &dyn Disk,
    mut part: Box<dyn PartFile>,
    paths: &Paths,
    aside: Option<&Path>,
) -> std::io::Result<()> {
    part.sync()?;
    drop(part);
    if let Some(aside) = aside {
        disk.rename(&paths.whole, aside)?;
    }
    disk.rename(&paths.part, &paths.whole)
}

struct Work<'a, 'b> {
    source: &'a mut dyn Source,
    to: &'a mut Destination<'b>,
    options: &'a Options,
    watch: &'a mut dyn Watch,
    report: Report,
    /// What was thrown away last because its checksums are wrong.
    damaged: Option<Digest>,
}

impl Work<'_, '_> {
    /// What is to be pulled, in order; tells the robot again about what it does not know.
    fn plan(&mut self) -> Result<Vec<Entry>, BufferError> {
        let (mut missing, mut done_bytes, mut bytes) = (Vec::new(), 0, 0);
        for entry in self.source.list()? {
            if entry.state == State::Open || entry.bytes == 0 {
                self.report.open += u64::from(entry.state == State::Open);
                continue;
            }
            // As many as the other side says, which may be anything.
            bytes = u64::saturating_add(bytes, entry.bytes);
            match self.to.index.has(&entry).cloned() {
                Some(here) => {
                    self.report.there += 1;
                    done_bytes = u64::saturating_add(done_bytes, entry.bytes);
                    if !here.marked && entry.pulled_digest() != Some(here.digest) {
                        self.mark(&entry, &here.digest)?;
                    }
                }
                None => missing.push(entry),
            }
        }
        self.options.order.sort(&mut missing);
        self.source.expect(bytes.saturating_sub(done_bytes));
        self.watch.planned(missing.len() as u64, bytes, done_bytes);
        Ok(missing)
    }

    fn pull_all(
        &mut self,
        missing: Vec<Entry>,
        mut pace: Pace<'_>,
        jobs: &SyncSender<Job>,
        results: &Receiver<Result<Job, BufferError>>,
    ) -> Result<(), BufferError> {
        for entry in missing {
            let job = match self.pull_one(&entry, &mut pace) {
                // Damaged on the way: once more, from its beginning.
                Err(BufferError::Digest { name }) => {
                    self.watch.warns(&format!("{name} arrived damaged and is pulled once more"));
                    self.pull_one(&entry, &mut pace)?
                }
                // Gone or written to since it was listed; the next pull sees to it.
                Err(BufferError::Refused { refusal, .. }) => {
                    self.watch.warns(&refusal.to_string());
                    continue;
                }
                other => other?,
            };
            // The thread only ends early when this side is gone.
            if jobs.send(job).is_err() {
                return Ok(());
            }
            while let Ok(result) = results.try_recv() {
                self.finished(result)?;
            }
            if pace.now_ns().saturating_sub(self.to.saved_ns) > SAVE_EVERY_NS {
                self.to.index.save(self.to.disk)?;
                self.to.saved_ns = pace.now_ns();
            }
        }
        Ok(())
    }

    fn pull_one(&mut self, entry: &Entry, pace: &mut Pace<'_>) -> Result<Job, BufferError> {
        let paths = Paths::new(&self.to.dir, &entry.name)?;
        let mut part = Part::find(&paths, self.to.disk, self.watch, pace)?;
        let have = part.have();
        let promised = self.source.fetch(&entry.name, have, &mut part);
        self.report.bytes += part.arrived;
        let promised = promised?;
        let arrived = part.finish();
        let digest = arrived.hasher.digest();
        let is_good = match promised {
            Some(promised) => promised == digest,
            None => self.is_whole(
                entry,
                if arrived.part.is_some() { &paths.part } else { &paths.whole },
                digest,
            )?,
        };
        if !is_good {
            drop(arrived.part);
            // Nobody knows which of its bytes are good.
            std::fs::remove_file(&paths.part).map_err(BufferError::write(&paths.part))?;
            return Err(BufferError::Digest { name: entry.name.to_string() });
        }
        let aside =
            arrived.part.is_some().then(|| self.aside(&paths, digest)).transpose()?.flatten();
        // What came is what is there now, which may be more than was listed.
        Ok(Job {
            part: arrived.part,
            paths,
            aside,
            entry: Entry { bytes: arrived.bytes, ..entry.clone() },
            digest,
        })
    }

    /// Whether a segment's own checksums say that it is what was listed.
    fn is_whole(
        &mut self,
        entry: &Entry,
        path: &Path,
        digest: Digest,
    ) -> Result<bool, BufferError> {
        let finding = File::open(path)
            .and_then(|file| verify(&file))
            .map_err(BufferError::write(path))?
            .finding;
        let is_whole = match finding {
            Finding::Whole | Finding::Unindexed => true,
            Finding::Cut { .. } => entry.state == State::Cut,
            Finding::Corrupt { .. } => false,
        };
        // The same bytes twice: that is what is there, and not damage on the way.
        if !is_whole && self.damaged == Some(digest) {
            self.watch.warns(&format!(
                "{} is damaged where it comes from, too, and is kept as it is",
                entry.name
            ));
            return Ok(true);
        }
        self.damaged = (!is_whole).then_some(digest);
        Ok(is_whole)
    }

    /// Where to put a file of the same name that is here. One that had no end is replaced; anything else was a whole
    /// recording, and nothing that was pulled is ever lost.
    fn aside(&self, paths: &Paths, digest: Digest) -> Result<Option<PathBuf>, BufferError> {
        let name = &paths.name;
        let Ok(metadata) = std::fs::symlink_metadata(&paths.whole) else { return Ok(None) };
        let known = self.to.index.get(name.as_str());
        if known.is_some_and(|known| known.cut) {
            return Ok(None);
        }
        let mut hasher = Hasher::default();
        let read =
            File::open(&paths.whole).and_then(|mut file| hasher.update_from(&mut file, u64::MAX));
        read.map_err(BufferError::write(&paths.whole))?;
        if hasher.digest() == digest {
            return Ok(None);
        }
        let word = known
            .map_or_else(|| file_modified_ns(&metadata).to_string(), |known| known.digest.short());
        Ok(Some(paths.whole.with_file_name(format!("{}.{word}", name.file()))))
    }

    /// A file is safe here, or not.
    fn finished(&mut self, result: Result<Job, BufferError>) -> Result<(), BufferError> {
        let Job { paths, aside, entry, digest, .. } = result?;
        if let Some(aside) = aside {
            self.watch.warns(&format!(
                "another {} was here and is now {}",
                entry.name,
                aside.display()
            ));
        }
        let here = std::fs::metadata(&paths.whole).map_err(BufferError::write(&paths.whole))?;
        let cut = entry.state == State::Cut;
        let indexed = Indexed {
            bytes: here.len(),
            digest,
            source_modified_ns: entry.modified_ns,
            modified_ns: file_modified_ns(&here),
            cut,
            marked: false,
        };
        self.to.index.insert(entry.name.as_str(), indexed);
        self.report.files += 1;
        self.report.cut += u64::from(cut);
        self.watch.complete(&entry.name, &digest);
        self.mark(&entry, &digest)
    }

    fn mark(&mut self, entry: &Entry, digest: &Digest) -> Result<(), BufferError> {
        if self.options.no_mark {
            return Ok(());
        }
        match self.source.mark_pulled(&entry.name, digest) {
            Ok(()) => self.to.index.set_marked(entry.name.as_str()),
            Err(error @ BufferError::Refused { .. }) => {
                self.report.unmarked += 1;
                self.watch.warns(&error.to_string());
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }
}
