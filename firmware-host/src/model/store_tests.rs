//! The guarantees of the store, with disk errors and crashes at every operation.

use std::collections::HashSet;
use std::io;
use std::path::Path;

use super::disk::{RealDisk, StoreDisk};
use super::error::StoreErrorKind;
use super::history::{Entry, What};
use super::store::{MOST_TRIAL_STARTS, Store};

const MODELS: [&[u8]; 6] = [b"first", b"second", b"third", b"fourth", b"fifth", b"sixth"];

fn digest(model: &[u8]) -> String {
    blake3::hash(model).to_hex().to_string()
}

/// A store in which the first `count` models were installed and kept.
fn store_with(dir: &Path, count: usize) -> Store {
    let mut store = Store::open(dir).unwrap();
    for model in &MODELS[..count] {
        store.install(model, "signature", "m").unwrap();
        store.keep(&digest(model), "behaved").unwrap();
    }
    store
}

#[test]
fn an_installed_model_is_current_and_on_trial_until_it_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 1);
    assert_eq!(store.state().unwrap().trial_starts, None);
    store.install(MODELS[1], "signature", "better").unwrap();
    let state = store.state().unwrap();
    assert_eq!(
        (state.current(), state.previous()),
        (Some(&*digest(MODELS[1])), Some(&*digest(MODELS[0])))
    );
    assert_eq!(state.trial_starts, Some(0));
    assert_eq!(store.read_model(&digest(MODELS[1])).unwrap(), MODELS[1]);
    assert_eq!(store.history().name(&digest(MODELS[1])), "better");
}

#[test]
fn an_empty_store_has_no_model_and_nothing_to_go_back_from() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = Store::open(dir.path()).unwrap();
    assert_eq!(store.state().unwrap().current(), None);
    assert_eq!(store.roll_back("").unwrap_err().kind(), StoreErrorKind::Missing);
}

#[test]
fn rollback_goes_back_model_by_model_to_none_and_records_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 3);
    for model in [Some(MODELS[1]), Some(MODELS[0]), None] {
        let state = store.roll_back("it hit the sofa").unwrap();
        assert_eq!(state.current().map(str::to_owned), model.map(digest));
    }
    let history = store.history();
    assert_eq!(history.rolled_back(&digest(MODELS[2])).unwrap().why, "it hit the sofa");
    assert_eq!(history.entries.iter().filter(|entry| entry.what == What::RolledBack).count(), 3);
}

#[test]
fn rollback_works_with_the_new_model_damaged_and_skips_older_ones_that_are() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 3);
    for damaged in [MODELS[2], MODELS[1]] {
        std::fs::write(store.model_path(&digest(damaged)), b"rot").unwrap();
    }
    assert_eq!(store.read_model(&digest(MODELS[2])).unwrap_err().kind(), StoreErrorKind::Damaged);
    assert_eq!(store.roll_back("damaged").unwrap().current(), Some(&*digest(MODELS[0])));
}

#[test]
fn rollback_works_when_the_file_that_names_the_current_model_is_damaged() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 2);
    for damage in ["", "{", r#"{"models":["../../etc/passwd"]}"#] {
        std::fs::write(dir.path().join("current"), damage).unwrap();
        assert_eq!(store.state().unwrap_err().kind(), StoreErrorKind::Damaged);
        assert_eq!(store.roll_back("damaged").unwrap().current(), Some(&*digest(MODELS[1])));
    }
}

#[test]
fn a_rollback_goes_to_a_model_that_has_passed_its_trial() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 1);
    store.install(MODELS[1], "signature", "unproven").unwrap();
    store.install(MODELS[2], "signature", "newer").unwrap();
    assert_eq!(store.roll_back("").unwrap().current(), Some(&*digest(MODELS[0])));
}

#[test]
fn only_the_last_four_models_are_kept_on_the_disk() {
    let dir = tempfile::tempdir().unwrap();
    let store = store_with(dir.path(), MODELS.len());
    assert_eq!(store.state().unwrap().models.len(), 4);
    assert_eq!(
        std::fs::read_dir(dir.path().join("models")).unwrap().count(),
        8,
        "four models, four signatures"
    );
}

#[test]
fn a_model_that_crashes_the_program_three_times_is_rolled_back() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 1);
    store.install(MODELS[1], "signature", "deadly").unwrap();
    for _ in 0..MOST_TRIAL_STARTS {
        assert_eq!(store.start().unwrap().current(), Some(&*digest(MODELS[1])));
    }
    assert_eq!(store.start().unwrap().current(), Some(&*digest(MODELS[0])));
    assert!(store.history().rolled_back(&digest(MODELS[1])).unwrap().why.contains("3 times"));
}

/// A store with one model and a second one on trial.
fn store_with_trial() -> (Store, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 1);
    store.install(MODELS[1], "signature", "m").unwrap();
    (store, dir)
}

/// A disk on which operation number `fails_at` fails. With `dies` all later operations fail too,
/// like after a crash.
struct BadDisk {
    done: usize,
    fails_at: usize,
    dies: bool,
    error: i32,
}

impl BadDisk {
    fn step(&mut self) -> io::Result<()> {
        let now = self.done;
        self.done += 1;
        if now == self.fails_at || self.dies && now > self.fails_at {
            return Err(io::Error::from_raw_os_error(self.error));
        }
        Ok(())
    }
}

impl StoreDisk for BadDisk {
    fn write(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.step().inspect_err(|_| {
            // A full disk leaves a partial file behind.
            let _ = RealDisk.write(path, &bytes[..bytes.len() / 2]);
        })?;
        RealDisk.write(path, bytes)
    }

    fn sync(&mut self, path: &Path) -> io::Result<()> {
        self.step()?;
        RealDisk.sync(path)
    }

    fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        self.step()?;
        RealDisk.rename(from, to)
    }

    fn sync_dir(&mut self, dir: &Path) -> io::Result<()> {
        self.step()?;
        RealDisk.sync_dir(dir)
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        self.step()?;
        RealDisk.remove(path)
    }
}

#[test]
fn wherever_the_disk_fails_or_the_program_dies_the_store_is_as_before_or_as_after() {
    type Change = fn(&mut Store) -> bool;
    let changes: [(&str, Change); 4] = [
        ("install", |store| store.install(MODELS[2], "signature", "m").is_ok()),
        ("keep", |store| {
            let current = store.state().unwrap().current().unwrap().to_owned();
            store.keep(&current, "").is_ok()
        }),
        ("roll back", |store| store.roll_back("").is_ok()),
        ("start", |store| store.start().is_ok()),
    ];
    const ENOSPC: i32 = 28;
    const EIO: i32 = 5;
    const EROFS: i32 = 30;
    let mut trials = 0;
    for (name, change) in changes {
        let (mut store, _dir) = store_with_trial();
        let before = store.state().unwrap();
        assert!(change(&mut store));
        let after = store.state().unwrap();
        assert_ne!(before, after);
        for (error, dies) in [(ENOSPC, false), (EIO, false), (EROFS, false), (EIO, true)] {
            for fails_at in 0..30 {
                let (_, dir) = store_with_trial();
                let disk = BadDisk { done: 0, fails_at, dies, error };
                let done = change(&mut Store::open_on(dir.path(), Box::new(disk)).unwrap());
                // The state as another process sees it.
                let mut store = Store::open(dir.path()).unwrap();
                let state = store.state().unwrap();
                assert!(
                    state == after || !done && state == before,
                    "{name}, {error}, {fails_at}: {state:?}"
                );
                for digest in &state.models {
                    store
                        .read_model(digest)
                        .unwrap_or_else(|error| panic!("{name}, {fails_at}: {error}"));
                }
                // The store can still be used.
                store.install(MODELS[3], "signature", "m").unwrap();
                assert_eq!(store.state().unwrap().current(), Some(&*digest(MODELS[3])));
                store.roll_back("").unwrap();
                trials += 1;
            }
        }
    }
    assert_eq!(trials, 480);
}

#[test]
fn two_processes_change_a_store_one_after_the_other() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().to_owned();
    let threads: Vec<_> = MODELS
        .iter()
        .map(|model| {
            let path = path.clone();
            std::thread::spawn(move || {
                let mut store = Store::open(&path).unwrap();
                store.install(model, "signature", "m").unwrap();
                store.keep(&digest(model), "").unwrap();
            })
        })
        .collect();
    threads.into_iter().for_each(|thread| thread.join().unwrap());
    let store = Store::open(&path).unwrap();
    let state = store.state().unwrap();
    assert!(!state.models.is_empty());
    let distinct: HashSet<_> = state.models.iter().collect();
    assert_eq!(distinct.len(), state.models.len());
    state.models.iter().for_each(|digest| drop(store.read_model(digest).unwrap()));
}

#[test]
fn the_model_that_came_with_the_program_becomes_the_first_one_of_a_new_store() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = Store::open(dir.path()).unwrap();
    assert!(store.adopt(MODELS[0], "default").unwrap());
    let state = store.state().unwrap();
    assert_eq!((state.current(), state.trial_starts), (Some(&*digest(MODELS[0])), None));
    assert_eq!(store.history().name(&digest(MODELS[0])), "default");
    // A damaged store goes back to it.
    std::fs::write(dir.path().join("current"), "{").unwrap();
    assert!(!store.adopt(MODELS[1], "newer").unwrap());
    assert_eq!(store.roll_back("damaged").unwrap().current(), Some(&*digest(MODELS[0])));
    // After a rollback by the operator it is not installed again.
    store.roll_back("").unwrap();
    assert!(!store.adopt(MODELS[0], "default").unwrap());
    assert_eq!(store.state().unwrap().current(), None);
}

#[test]
fn a_model_is_given_up_only_while_it_is_the_current_one() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = store_with(dir.path(), 2);
    let second = digest(MODELS[1]);
    assert_eq!(store.give_up(&digest(MODELS[0]), "late").unwrap().current(), Some(&*second));
    assert_eq!(store.give_up(&second, "late").unwrap().current(), Some(&*digest(MODELS[0])));
    // A second call changes nothing.
    assert_eq!(store.give_up(&second, "late").unwrap().current(), Some(&*digest(MODELS[0])));
}

#[test]
fn no_entry_of_the_history_is_lost_when_several_processes_write() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path();
    std::thread::scope(|scope| {
        for model in &MODELS[..4] {
            scope.spawn(|| {
                let mut store = Store::open(path).unwrap();
                for _ in 0..20 {
                    store.note(Entry::now(What::Refused, &digest(model), "m", ""));
                }
            });
        }
    });
    assert_eq!(Store::open(dir.path()).unwrap().history().entries.len(), 80);
}
