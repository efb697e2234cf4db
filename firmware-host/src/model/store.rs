//! The models on the robot.
//!
//! ```text
//! current                which models there are, newest first, and whether the newest is on trial
//! models/DIGEST.onnx     each named by the BLAKE3 digest of its bytes, and so recognised when it is damaged
//! models/DIGEST.minisig  who signed it
//! history.json           what became of every model that was offered
//! lock                   held while something is changed
//! ```
//!
//! Only `current` decides, one small file that is replaced in one step (written beside, synced, renamed, folder synced). A model
//! is whole on the disk before `current` names it and is removed only after `current` has stopped to. So whatever crashes or
//! fails, whenever, the store is what it was before or what it was to become. The history comes after: a crash may cost its
//! last line and nothing else.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::disk::{PARTIAL, RealDisk, StoreDisk, replace};
use super::error::StoreError;
use super::history::{Entry, History, What};

/// Models that are kept to go back to.
const KEPT: usize = 4;
/// A model on trial that the robot was started with so often without finishing the trial is given up: something about it
/// may end the program.
pub const MOST_TRIAL_STARTS: u32 = 3;

/// Which models there are.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// Digests, newest first. The first is the one that drives.
    pub models: Vec<String>,
    /// Present while the first is on trial: how often the robot was started with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trial_starts: Option<u32>,
}

impl State {
    /// The model that drives.
    #[must_use]
    pub fn current(&self) -> Option<&str> {
        self.models.first().map(String::as_str)
    }

    /// The model that the robot goes back to.
    #[must_use]
    pub fn previous(&self) -> Option<&str> {
        self.models.get(1).map(String::as_str)
    }
}

/// The models on the robot. Several processes may use one store: each change takes its lock.
pub struct Store {
    dir: PathBuf,
    disk: Box<dyn StoreDisk>,
}

impl Store {
    /// Opens a store and makes what is missing of it.
    ///
    /// # Errors
    /// [`StoreError::Folder`].
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        Self::open_on(dir, Box::new(RealDisk))
    }

    /// As [`open`](Self::open), on any disk.
    ///
    /// # Errors
    /// [`StoreError::Folder`].
    pub fn open_on(dir: &Path, disk: Box<dyn StoreDisk>) -> Result<Self, StoreError> {
        fs::create_dir_all(dir.join("models"))
            .map_err(|source| StoreError::Folder { dir: dir.to_owned(), source })?;
        Ok(Self { dir: dir.to_owned(), disk })
    }

    /// The folder.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Where a model lies.
    #[must_use]
    pub fn model_path(&self, digest: &str) -> PathBuf {
        self.dir.join("models").join(format!("{digest}.onnx"))
    }

    fn state_path(&self) -> PathBuf {
        self.dir.join("current")
    }

    /// Which models there are. A store without `current` has none.
    ///
    /// # Errors
    /// [`StoreError::State`].
    pub fn state(&self) -> Result<State, StoreError> {
        let path = self.state_path();
        let damaged = |reason: String| StoreError::State { path: path.clone(), reason };
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(State::default());
            }
            read => read.map_err(|error| damaged(error.to_string()))?,
        };
        let state: State =
            serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        // Digests become file names.
        match state.models.iter().find(|digest| !is_digest(digest)) {
            Some(other) => Err(damaged(format!("`{other}` is no digest"))),
            None => Ok(state),
        }
    }

    /// What became of every model. A history that cannot be read is an empty one: nothing depends on it but explanations and
    /// the memory of models that were rolled back.
    #[must_use]
    pub fn history(&self) -> History {
        let text = fs::read_to_string(self.dir.join("history.json")).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// The bytes of a model, if they are what they were when it was installed.
    ///
    /// # Errors
    /// [`StoreError::Model`].
    pub fn read_model(&self, digest: &str) -> Result<Vec<u8>, StoreError> {
        let whole = |bytes: &Vec<u8>| blake3::hash(bytes).to_hex().as_str() == digest;
        let read = if is_digest(digest) { fs::read(self.model_path(digest)).ok() } else { None };
        read.filter(whole)
            .ok_or_else(|| StoreError::Model { digest: digest.to_owned(), dir: self.dir.clone() })
    }

    /// Whether it never had a model.
    #[must_use]
    pub fn is_new(&self) -> bool {
        !self.state_path().exists()
    }

    /// Puts in the model that came with the program, as one that has proved itself. Only into a store that never had any: what an
    /// operator has rolled back stays away. Whether it did.
    ///
    /// # Errors
    /// When the disk fails; the store is then as it was.
    pub fn adopt(&mut self, model: &[u8], name: &str) -> Result<bool, StoreError> {
        let _lock = self.lock()?;
        if !self.is_new() {
            return Ok(false);
        }
        let digest = blake3::hash(model).to_hex().to_string();
        self.put(&self.model_path(&digest), model)?;
        self.set(&State { models: vec![digest.clone()], trial_starts: None })?;
        self.add_line(Entry::now(
            What::Kept,
            &digest,
            name,
            "the store's first, it came with the program",
        ));
        Ok(true)
    }

    /// Makes a model the current one, on trial. One that still was on trial is dropped: what is gone back to has proved itself.
    ///
    /// # Errors
    /// When the disk fails; the store is then as it was.
    pub fn install(&mut self, model: &[u8], signature: &str, name: &str) -> Result<(), StoreError> {
        let _lock = self.lock()?;
        let digest = blake3::hash(model).to_hex().to_string();
        let old = self.state()?;
        self.put(&self.model_path(&digest), model)?;
        self.put(&self.dir.join("models").join(format!("{digest}.minisig")), signature.as_bytes())?;
        let unproven = usize::from(old.trial_starts.is_some());
        let others = old.models.iter().skip(unproven).filter(|other| **other != digest).cloned();
        let models: Vec<String> =
            std::iter::once(digest.clone()).chain(others).take(KEPT).collect();
        self.set(&State { models, trial_starts: Some(0) })?;
        self.add_line(Entry::now(What::Installed, &digest, name, ""));
        self.clean_up();
        Ok(())
    }

    /// Goes back to the newest model before the current one that is whole, or to none. Works with the current model and
    /// `current` itself damaged.
    ///
    /// # Errors
    /// When there is nothing to go back from, or the disk fails.
    pub fn roll_back(&mut self, why: &str) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        self.go_back(why)
    }

    /// As [`roll_back`](Self::roll_back), unless another model is current meanwhile.
    ///
    /// # Errors
    /// As [`roll_back`](Self::roll_back).
    pub fn give_up(&mut self, digest: &str, why: &str) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        match self.state() {
            Ok(state) if state.current() != Some(digest) => Ok(state),
            _ => self.go_back(why),
        }
    }

    /// To be called with the lock.
    fn go_back(&mut self, why: &str) -> Result<State, StoreError> {
        let (left, rest) = match self.state() {
            Ok(state) => match state.models.split_first() {
                Some((left, rest)) => (left.clone(), rest.to_vec()),
                None => return Err(StoreError::Empty { dir: self.dir.clone() }),
            },
            // What the history says has proved itself.
            Err(_) => (String::new(), self.kept_by_history()),
        };
        let models =
            rest.into_iter().skip_while(|digest| self.read_model(digest).is_err()).collect();
        let state = State { models, trial_starts: None };
        self.set(&state)?;
        let name = self.history().name(&left).to_owned();
        self.add_line(Entry::now(What::RolledBack, &left, &name, why));
        Ok(state)
    }

    fn kept_by_history(&self) -> Vec<String> {
        let mut models = Vec::new();
        for entry in self.history().entries.iter().rev().filter(|entry| entry.what == What::Kept) {
            if is_digest(&entry.digest) && !models.contains(&entry.digest) && models.len() < KEPT {
                models.push(entry.digest.clone());
            }
        }
        models
    }

    /// The trial of the current model ended well; nothing happens when another one is current meanwhile.
    ///
    /// # Errors
    /// When the disk fails; the model is then still on trial.
    pub fn keep(&mut self, digest: &str, why: &str) -> Result<(), StoreError> {
        let _lock = self.lock()?;
        let state = self.state()?;
        if state.current() != Some(digest) || state.trial_starts.is_none() {
            return Ok(());
        }
        self.set(&State { trial_starts: None, ..state })?;
        let name = self.history().name(digest).to_owned();
        self.add_line(Entry::now(What::Kept, digest, &name, why));
        self.clean_up();
        Ok(())
    }

    /// The robot starts with what this returns. A model that does not get through its trial is given up after
    /// [`MOST_TRIAL_STARTS`] starts.
    ///
    /// # Errors
    /// When the disk fails or the state is damaged.
    pub fn start(&mut self) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        let state = self.state()?;
        match state.trial_starts {
            Some(starts) if starts >= MOST_TRIAL_STARTS => self.go_back(&format!(
                "rolled back: the robot was started {starts} times with it, and its trial never ended"
            )),
            Some(starts) => {
                let state = State { trial_starts: Some(starts + 1), ..state };
                self.set(&state)?;
                Ok(state)
            }
            None => Ok(state),
        }
    }

    /// Writes a line of the history. A disk that takes no line is no reason to stop; it is logged.
    pub fn note(&mut self, entry: Entry) {
        match self.lock() {
            Ok(_lock) => self.add_line(entry),
            Err(error) => tracing::warn!("{error}; the history lacks a line"),
        }
    }

    /// To be called with the lock: what another process has added meanwhile must not be lost.
    fn add_line(&mut self, entry: Entry) {
        let mut history = self.history();
        history.add(entry);
        let path = self.dir.join("history.json");
        let written = serde_json::to_vec_pretty(&history)
            .map_err(std::io::Error::other)
            .and_then(|bytes| replace(self.disk.as_mut(), &path, &bytes));
        if let Err(error) = written {
            tracing::warn!("cannot write {}: {error}; the history lacks a line", path.display());
        }
    }

    fn set(&mut self, state: &State) -> Result<(), StoreError> {
        let path = self.state_path();
        let bytes = serde_json::to_vec(state).unwrap_or_default();
        replace(self.disk.as_mut(), &path, &bytes)
            .map_err(|source| StoreError::Write { path, source })
    }

    fn put(&mut self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        replace(self.disk.as_mut(), path, bytes)
            .map_err(|source| StoreError::Write { path: path.to_owned(), source })
    }

    /// Removes models that no `current` names, and what a crash left half-written. Best effort.
    fn clean_up(&mut self) {
        let Ok(state) = self.state() else { return };
        for entry in fs::read_dir(self.dir.join("models")).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let digest = name.split('.').next().unwrap_or_default();
            if name.ends_with(PARTIAL) || !state.models.iter().any(|kept| kept == digest) {
                let _ = self.disk.remove(&entry.path());
            }
        }
    }

    fn lock(&self) -> Result<File, StoreError> {
        let error = |source| StoreError::Folder { dir: self.dir.clone(), source };
        let file = File::create(self.dir.join("lock")).map_err(error)?;
        file.lock().map_err(error)?;
        Ok(file)
    }
}

/// Whether this is a BLAKE3 digest in hex: it becomes part of a path.
fn is_digest(text: &str) -> bool {
    text.len() == 64
        && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}
