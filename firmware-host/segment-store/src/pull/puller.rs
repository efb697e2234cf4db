//! One pull from one source into one directory.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hal::Clock;

use super::disk::{Disk, PartFile};
use super::index::{Index, Indexed};
use super::options::Options;
use super::part::{PartReceiver, Paths};
use super::progress::{Progress, Report};
use super::rate_limiter::RateLimiter;
use crate::digest::{Digest, Hasher};
use crate::entry::{Entry, State};
use crate::error::StoreError;
use crate::private;
use crate::root::file_modified_ns;
use crate::source::Source;
use crate::verify::{Finding, verify};

/// This many received files may wait for the disk while the next ones are received.
const MAX_WAITING_FOR_DISK: usize = 2;

/// The index is written at most once in this time, and at the end.
const SAVE_EVERY_NS: u64 = 2_000_000_000;

/// The lock file. It is hidden and never deleted: deleting it would let two processes lock different files of this name.
const LOCK_FILE: &str = ".pull.lock";

/// A directory that only one pull at a time writes into.
pub struct Destination<'a> {
    dir: PathBuf,
    disk: &'a dyn Disk,
    index: Index,
    saved_ns: u64,
    _lock: File,
}

impl<'a> Destination<'a> {
    /// Creates the directory if it does not exist, for this account only, and locks it.
    ///
    /// # Errors
    /// When it cannot be written, or another pull holds the lock.
    pub fn open(dir: &Path, disk: &'a dyn Disk) -> Result<Self, StoreError> {
        private::create_folder(dir).map_err(StoreError::write(dir))?;
        let path = dir.join(LOCK_FILE);
        let lock = File::options().write(true).create(true).truncate(false).open(&path);
        let lock = lock.map_err(StoreError::write(&path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { dir: dir.to_owned() }),
            Err(TryLockError::Error(error)) => return Err(StoreError::write(path)(error)),
        }
        Ok(Self { index: Index::open(dir), dir: dir.to_owned(), disk, saved_ns: 0, _lock: lock })
    }
}

/// A received file that is to be synced to disk and renamed.
struct Job {
    part: Option<Box<dyn PartFile>>,
    paths: Paths,
    /// The new name of a different file that has the final name now.
    keep_old_as: Option<PathBuf>,
    entry: Entry,
    digest: Digest,
}

/// Pulls all segments that are closed or cut and not here yet.
///
/// # Errors
/// When the link, the robot or the disk fails. What was received is kept. Of several errors the first is returned.
pub fn pull(
    source: &mut dyn Source,
    to: &mut Destination<'_>,
    options: &Options,
    clock: &mut dyn Clock,
    progress: &mut dyn Progress,
) -> Result<Report, StoreError> {
    let mut puller =
        Puller { source, to, options, progress, report: Report::default(), damaged: None };
    let missing = puller.plan()?;
    let pulled = std::thread::scope(|scope| {
        let (jobs, waiting) = sync_channel::<Job>(MAX_WAITING_FOR_DISK);
        let (done, results) = sync_channel(1024);
        let disk = puller.to.disk;
        scope.spawn(move || persist_all(disk, &waiting, &done));
        let limiter = RateLimiter::new(clock, options.limit);
        let pulled = puller.pull_all(missing, limiter, &jobs, &results);
        // Files that were received are finished even after an error.
        drop(jobs);
        let finished = results.iter().try_for_each(|result| puller.finish_file(result));
        pulled.and(finished)
    });
    let saved = puller.to.index.save(puller.to.disk);
    pulled.and(saved)?;
    Ok(puller.report)
}

/// Runs in a thread of its own, so that the next file is received while the disk syncs the previous one.
fn persist_all(disk: &dyn Disk, jobs: &Receiver<Job>, done: &SyncSender<Result<Job, StoreError>>) {
    for mut job in jobs {
        let persisted = match job.part.take() {
            Some(part) => persist(disk, part, &job.paths, job.keep_old_as.as_deref()),
            None => Ok(()),
        };
        let persisted = persisted.map_err(StoreError::write(&job.paths.whole));
        if done.send(persisted.map(|()| job)).is_err() {
            return;
        }
    }
}

fn persist(
    disk: &dyn Disk,
    mut part: Box<dyn PartFile>,
    paths: &Paths,
    keep_old_as: Option<&Path>,
) -> io::Result<()> {
    part.sync()?;
    drop(part);
    if let Some(old) = keep_old_as {
        disk.rename(&paths.whole, old)?;
    }
    disk.rename(&paths.part, &paths.whole)
}

struct Puller<'a, 'b> {
    source: &'a mut dyn Source,
    to: &'a mut Destination<'b>,
    options: &'a Options,
    progress: &'a mut dyn Progress,
    report: Report,
    /// The digest of the file that was deleted last because its own checksums are wrong.
    damaged: Option<Digest>,
}

impl Puller<'_, '_> {
    /// The segments to pull, in order. Also repeats the reports that a segment is here which the robot did not record.
    fn plan(&mut self) -> Result<Vec<Entry>, StoreError> {
        let mut missing = Vec::new();
        let mut bytes: u64 = 0;
        let mut done_bytes: u64 = 0;
        let listing = self.source.list()?;
        self.report.unread = listing.unread;
        for entry in listing.entries {
            if entry.state == State::Open || entry.bytes == 0 {
                self.report.open += u64::from(entry.state == State::Open);
                continue;
            }
            // Saturating, because the sizes come from the peer and can be any number.
            bytes = bytes.saturating_add(entry.bytes);
            match self.to.index.has(&entry).cloned() {
                Some(here) => {
                    self.report.there += 1;
                    done_bytes = done_bytes.saturating_add(entry.bytes);
                    if !here.marked && entry.pulled_digest() != Some(here.digest) {
                        self.mark(&entry, &here.digest)?;
                    }
                }
                None => missing.push(entry),
            }
        }
        self.options.order.sort(&mut missing);
        self.source.expect(bytes.saturating_sub(done_bytes));
        self.progress.planned(missing.len() as u64, bytes, done_bytes);
        Ok(missing)
    }

    fn pull_all(
        &mut self,
        missing: Vec<Entry>,
        mut limiter: RateLimiter<'_>,
        jobs: &SyncSender<Job>,
        results: &Receiver<Result<Job, StoreError>>,
    ) -> Result<(), StoreError> {
        for entry in missing {
            let pulled = match self.pull_one(&entry, &mut limiter) {
                // Damaged in transit: pulled once more.
                Err(StoreError::Digest { name }) => {
                    self.progress
                        .warning(&format!("{name} arrived damaged and is pulled once more"));
                    self.pull_one(&entry, &mut limiter)
                }
                pulled => pulled,
            };
            let job = match pulled {
                Err(StoreError::Unread(why)) => {
                    self.report.unread.push(why);
                    continue;
                }
                // Deleted or written to since it was listed; the next pull handles it.
                Err(StoreError::Refused { refusal, .. }) => {
                    self.progress.warning(&refusal.to_string());
                    continue;
                }
                pulled => pulled?,
            };
            // The receiving thread ends early only when this thread is gone.
            if jobs.send(job).is_err() {
                return Ok(());
            }
            while let Ok(result) = results.try_recv() {
                self.finish_file(result)?;
            }
            if limiter.now_ns().saturating_sub(self.to.saved_ns) > SAVE_EVERY_NS {
                self.to.index.save(self.to.disk)?;
                self.to.saved_ns = limiter.now_ns();
            }
        }
        Ok(())
    }

    fn pull_one(
        &mut self,
        entry: &Entry,
        limiter: &mut RateLimiter<'_>,
    ) -> Result<Job, StoreError> {
        let paths = Paths::create(&self.to.dir, &entry.name)?;
        let mut part = PartReceiver::new(&paths, self.to.disk, self.progress, limiter)?;
        let local = part.local_copy();
        let sent_digest = self.source.fetch(&entry.name, local, &mut part);
        self.report.bytes += part.received;
        let sent_digest = sent_digest?;
        let received = part.finish();
        let digest = received.hasher.digest();
        let is_new = received.part.is_some();
        let is_good = match sent_digest {
            Some(sent_digest) => sent_digest == digest,
            None => {
                self.is_whole(entry, if is_new { &paths.part } else { &paths.whole }, digest)?
            }
        };
        if !is_good {
            drop(received.part);
            // Nothing tells which of the bytes are good.
            std::fs::remove_file(&paths.part).map_err(StoreError::write(&paths.part))?;
            return Err(StoreError::Digest { name: entry.name.to_string() });
        }
        let keep_old_as = if is_new { self.name_for_old_file(&paths, digest)? } else { None };
        // The file may be longer than it was listed.
        let entry = Entry { bytes: received.bytes, ..entry.clone() };
        Ok(Job { part: received.part, paths, keep_old_as, entry, digest })
    }

    /// Whether the segment's own checksums confirm that it is what was listed.
    fn is_whole(&mut self, entry: &Entry, path: &Path, digest: Digest) -> Result<bool, StoreError> {
        let finding = File::open(path)
            .and_then(|file| verify(&file))
            .map_err(StoreError::write(path))?
            .finding;
        let is_whole = match finding {
            Finding::Whole | Finding::Unindexed => true,
            Finding::Cut { .. } => entry.state == State::Cut,
            Finding::Corrupt { .. } => false,
        };
        // The same bytes arrived twice, so the damage is at the source and not in transit.
        if !is_whole && self.damaged == Some(digest) {
            self.progress.warning(&format!(
                "{} is damaged at its source, too, and is kept as it is",
                entry.name
            ));
            return Ok(true);
        }
        self.damaged = (!is_whole).then_some(digest);
        Ok(is_whole)
    }

    /// The new name for a file that has the same name as the received one, or `None` when it can be replaced. Only a file that
    /// had no end or has the same contents is replaced; any other is a recording that must not be lost.
    fn name_for_old_file(
        &self,
        paths: &Paths,
        digest: Digest,
    ) -> Result<Option<PathBuf>, StoreError> {
        let name = &paths.name;
        let Ok(metadata) = std::fs::symlink_metadata(&paths.whole) else { return Ok(None) };
        let known = self.to.index.get(name.as_str());
        if known.is_some_and(|known| known.cut) {
            return Ok(None);
        }
        let mut hasher = Hasher::default();
        File::open(&paths.whole)
            .and_then(|mut file| hasher.update_from(&mut file, u64::MAX))
            .map_err(StoreError::write(&paths.whole))?;
        if hasher.digest() == digest {
            return Ok(None);
        }
        let suffix = match known {
            Some(known) => known.digest.short(),
            None => file_modified_ns(&metadata).to_string(),
        };
        Ok(Some(paths.whole.with_file_name(format!("{}.{suffix}", name.file()))))
    }

    /// Records a file that is durably on disk, and tells the robot.
    fn finish_file(&mut self, result: Result<Job, StoreError>) -> Result<(), StoreError> {
        let Job { paths, keep_old_as, entry, digest, .. } = result?;
        if let Some(old) = keep_old_as {
            self.progress.warning(&format!(
                "another {} was here and is now {}",
                entry.name,
                old.display()
            ));
        }
        let here = std::fs::metadata(&paths.whole).map_err(StoreError::write(&paths.whole))?;
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
        self.progress.file_completed(&entry.name, &digest);
        self.mark(&entry, &digest)
    }

    fn mark(&mut self, entry: &Entry, digest: &Digest) -> Result<(), StoreError> {
        if self.options.no_mark {
            return Ok(());
        }
        match self.source.mark_pulled(&entry.name, digest) {
            Ok(()) => self.to.index.set_marked(entry.name.as_str()),
            Err(error @ StoreError::Refused { .. }) => {
                self.report.unmarked += 1;
                self.progress.warning(&error.to_string());
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }
}
