//! The model store: the models that are installed on the robot.
//!
//! ```text
//! current                the installed models, newest first, and whether the newest is on trial
//! models/DIGEST.onnx     a model, named by its BLAKE3 digest, so that damage is detected
//! models/DIGEST.minisig  its signature
//! counts.json            what trial and resident model have counted so far
//! history.json           what happened to every model that was ever offered
//! lock                   locked during each change
//! ```
//!
//! The file `current` defines the state. It is replaced atomically (written under another name,
//! synced, renamed, folder synced). A model is completely on the disk before `current` names it,
//! and is removed only after `current` no longer does. So a crash or a disk error at any time
//! leaves the store either unchanged or completely changed. The history is written last: a crash
//! can cost its last entry.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::counts::SavedCounts;
use super::disk::{PARTIAL, RealDisk, StoreDisk, replace};
use super::error::StoreError;
use super::history::{Entry, History, What};

/// Extension of the file that marks the model that came with the program: it has no signature.
const CAME_WITH_THE_PROGRAM: &str = "program";
/// Number of models that are kept, including the current one.
const KEPT: usize = 4;
/// A model on trial is rolled back if the robot was started this number of times with it and never
/// ran for long: the model may crash the program.
pub const MOST_TRIAL_STARTS: u32 = 3;

/// The installed models; the content of the file `current`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// BLAKE3 digests, newest first. The robot uses the first one.
    pub models: Vec<String>,
    /// While the first model is on trial: how many times the robot was started with it since it last
    /// ran for long enough.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trial_starts: Option<u32>,
}

impl State {
    /// Digest of the model that the robot uses.
    #[must_use]
    pub fn current(&self) -> Option<&str> {
        self.models.first().map(String::as_str)
    }

    /// Digest of the model to which a rollback goes.
    #[must_use]
    pub fn previous(&self) -> Option<&str> {
        self.models.get(1).map(String::as_str)
    }
}

/// The model store of a robot. Several processes may use one store: each change locks it.
pub struct Store {
    dir: PathBuf,
    disk: Box<dyn StoreDisk>,
}

impl Store {
    /// Opens a store. Missing folders are created.
    ///
    /// # Errors
    /// [`StoreError::Folder`].
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        Self::open_on(dir, Box::new(RealDisk))
    }

    /// Like [`open`](Self::open), with other file operations.
    ///
    /// # Errors
    /// [`StoreError::Folder`].
    pub fn open_on(dir: &Path, disk: Box<dyn StoreDisk>) -> Result<Self, StoreError> {
        fs::create_dir_all(dir.join("models"))
            .map_err(|source| StoreError::Folder { dir: dir.to_owned(), source })?;
        Ok(Self { dir: dir.to_owned(), disk })
    }

    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Path of a model's file, whether or not it exists.
    #[must_use]
    pub fn model_path(&self, digest: &str) -> PathBuf {
        self.dir.join("models").join(format!("{digest}.onnx"))
    }

    fn state_path(&self) -> PathBuf {
        self.dir.join("current")
    }

    /// The installed models. A store without the file `current` has none.
    ///
    /// # Errors
    /// [`StoreError::State`].
    pub fn state(&self) -> Result<State, StoreError> {
        let path = self.state_path();
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(State::default());
            }
            Err(error) => return Err(StoreError::State { path, reason: error.to_string() }),
            Ok(text) => text,
        };
        let state: State = match serde_json::from_str(&text) {
            Ok(state) => state,
            Err(error) => return Err(StoreError::State { path, reason: error.to_string() }),
        };
        // Digests become file names, so anything else is refused here.
        match state.models.iter().find(|digest| !is_digest(digest)) {
            Some(other) => {
                Err(StoreError::State { path, reason: format!("`{other}` is not a digest") })
            }
            None => Ok(state),
        }
    }

    /// The history of all models. An unreadable history is treated as empty: only explanations and
    /// the refusal of models that were rolled back depend on it.
    #[must_use]
    pub fn history(&self) -> History {
        let text = fs::read_to_string(self.dir.join("history.json")).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// Reads a model and checks its digest.
    ///
    /// # Errors
    /// [`StoreError::Model`].
    pub fn read_model(&self, digest: &str) -> Result<Vec<u8>, StoreError> {
        let read = if is_digest(digest) { fs::read(self.model_path(digest)).ok() } else { None };
        read.filter(|bytes| blake3::hash(bytes).to_hex().as_str() == digest)
            .ok_or_else(|| StoreError::Model { digest: digest.to_owned(), dir: self.dir.clone() })
    }

    /// The signature with which a model was installed; `None` for the model that came with the program.
    ///
    /// # Errors
    /// [`StoreError::Unsigned`] for a model that has no signature and did not come with the program.
    pub fn signature(&self, digest: &str) -> Result<Option<String>, StoreError> {
        match fs::read_to_string(self.beside_model(digest, "minisig")) {
            Ok(signature) => Ok(Some(signature)),
            Err(_) if self.beside_model(digest, CAME_WITH_THE_PROGRAM).exists() => Ok(None),
            Err(_) => {
                Err(StoreError::Unsigned { digest: digest.to_owned(), dir: self.dir.clone() })
            }
        }
    }

    /// A file that belongs to a model.
    fn beside_model(&self, digest: &str, extension: &str) -> PathBuf {
        self.dir.join("models").join(format!("{digest}.{extension}"))
    }

    /// Whether the store never had a model.
    #[must_use]
    pub fn is_new(&self) -> bool {
        !self.state_path().exists()
    }

    /// Installs the model that came with the program, without a trial, if the store never had a
    /// model. A model that the operator has rolled back therefore does not come back. Returns
    /// whether the model was installed.
    ///
    /// # Errors
    /// If the disk fails; the store is unchanged then.
    pub fn adopt(&mut self, model: &[u8], name: &str) -> Result<bool, StoreError> {
        let _lock = self.lock()?;
        if !self.is_new() {
            return Ok(false);
        }
        let digest = blake3::hash(model).to_hex().to_string();
        self.put(&self.model_path(&digest), model)?;
        self.put(&self.beside_model(&digest, CAME_WITH_THE_PROGRAM), name.as_bytes())?;
        self.set(&State { models: vec![digest.clone()], trial_starts: None })?;
        self.add_line(Entry::now(
            What::Kept,
            &digest,
            name,
            "first model of the store, which came with the program",
        ));
        Ok(true)
    }

    /// Makes a model the current one, on trial. A model that was still on trial is removed, so that
    /// a rollback always goes to a model that has passed its trial.
    ///
    /// # Errors
    /// If the disk fails; the store is unchanged then.
    pub fn install(&mut self, model: &[u8], signature: &str, name: &str) -> Result<(), StoreError> {
        let _lock = self.lock()?;
        let digest = blake3::hash(model).to_hex().to_string();
        let old = self.state()?;
        self.put(&self.model_path(&digest), model)?;
        self.put(&self.beside_model(&digest, "minisig"), signature.as_bytes())?;
        let unproven = usize::from(old.trial_starts.is_some());
        let others = old.models.iter().skip(unproven).filter(|other| **other != digest).cloned();
        let models: Vec<String> =
            std::iter::once(digest.clone()).chain(others).take(KEPT).collect();
        self.set(&State { models, trial_starts: Some(0) })?;
        self.add_line(Entry::now(What::Installed, &digest, name, ""));
        self.clean_up();
        Ok(())
    }

    /// Goes back to the newest intact model before the current one, or to none. This also works if
    /// the current model or the file `current` is damaged.
    ///
    /// # Errors
    /// If no model is installed, or the disk fails.
    pub fn roll_back(&mut self, why: &str) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        self.go_back(why)
    }

    /// Like [`roll_back`](Self::roll_back), but does nothing if another model is the current one.
    ///
    /// # Errors
    /// Like [`roll_back`](Self::roll_back).
    pub fn give_up(&mut self, digest: &str, why: &str) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        match self.state() {
            Ok(state) if state.current() != Some(digest) => Ok(state),
            _ => self.go_back(why),
        }
    }

    /// The caller must hold the lock.
    fn go_back(&mut self, why: &str) -> Result<State, StoreError> {
        let (left, rest) = match self.state() {
            Ok(state) => match state.models.split_first() {
                Some((left, rest)) => (left.clone(), rest.to_vec()),
                None => return Err(StoreError::Empty { dir: self.dir.clone() }),
            },
            // `current` is damaged: use the models that have passed their trial by the history.
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

    /// Ends the trial of the model `digest` with success. Does nothing if another model is the
    /// current one.
    ///
    /// # Errors
    /// If the disk fails; the model is still on trial then.
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

    /// Counts a start of the robot and returns the state that it starts with. A model on trial that
    /// did not run for long within [`MOST_TRIAL_STARTS`] starts is rolled back.
    ///
    /// # Errors
    /// If the disk fails or the state is damaged.
    pub fn start(&mut self) -> Result<State, StoreError> {
        let _lock = self.lock()?;
        let state = self.state()?;
        match state.trial_starts {
            Some(starts) if starts >= MOST_TRIAL_STARTS => self.go_back(&format!(
                "rolled back: the robot was started {starts} times with it and never ran for long"
            )),
            Some(starts) => {
                let state = State { trial_starts: Some(starts + 1), ..state };
                self.set(&state)?;
                Ok(state)
            }
            None => Ok(state),
        }
    }

    /// Forgets the starts that were counted: the model `digest`, which is on trial, has run for long
    /// enough not to be the cause of crashes. Does nothing if another model is the current one.
    ///
    /// # Errors
    /// If the disk fails.
    pub fn survived(&mut self, digest: &str) -> Result<(), StoreError> {
        let _lock = self.lock()?;
        let state = self.state()?;
        if state.current() != Some(digest) || state.trial_starts.is_none() {
            return Ok(());
        }
        self.set(&State { trial_starts: Some(0), ..state })
    }

    /// What trial and resident model have counted. An unreadable file is treated as empty: the trial
    /// begins again then, with the absolute limits only.
    #[must_use]
    pub fn counts(&self) -> SavedCounts {
        let text = fs::read_to_string(self.counts_path()).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// Replaces the counts.
    ///
    /// # Errors
    /// If the disk fails; the old counts are valid then.
    pub fn save_counts(&mut self, counts: &SavedCounts) -> Result<(), StoreError> {
        let _lock = self.lock()?;
        let bytes = serde_json::to_vec(counts).unwrap_or_default();
        self.put(&self.counts_path(), &bytes)
    }

    fn counts_path(&self) -> PathBuf {
        self.dir.join("counts.json")
    }

    /// Adds an entry to the history. An error is only logged, because the history is not essential.
    pub fn note(&mut self, entry: Entry) {
        match self.lock() {
            Ok(_lock) => self.add_line(entry),
            Err(error) => tracing::warn!("{error}; an entry is missing in the history"),
        }
    }

    /// Reads, extends and writes the history. The caller must hold the lock, so that entries of
    /// other processes are not lost.
    fn add_line(&mut self, entry: Entry) {
        let mut history = self.history();
        history.add(entry);
        let path = self.dir.join("history.json");
        let written = serde_json::to_vec_pretty(&history)
            .map_err(std::io::Error::other)
            .and_then(|bytes| replace(self.disk.as_mut(), &path, &bytes));
        if let Err(error) = written {
            tracing::warn!(
                "cannot write {}: {error}; an entry is missing in the history",
                path.display()
            );
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

    /// Removes models that `current` does not name, and incomplete files left by a crash. Best
    /// effort.
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
        File::create(self.dir.join("lock"))
            .and_then(|file| file.lock().map(|()| file))
            .map_err(|source| StoreError::Folder { dir: self.dir.clone(), source })
    }
}

/// Whether this is a BLAKE3 digest in hexadecimal. Only then may it become part of a path.
fn is_digest(text: &str) -> bool {
    text.len() == 64
        && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}
