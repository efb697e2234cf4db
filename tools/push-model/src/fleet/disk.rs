//! The state's file: where it is, reading it, replacing it atomically, and its lock.

use std::fs::{self, File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use super::state::Rollout;

/// Number of the digest's digits in the name of the state's file. The file itself has all of them.
const DIGEST_LEN: usize = 16;

/// The state's file of a model beside the fleet's file: `fleet.toml` has `fleet.rollout-DIGEST.json`.
#[must_use]
pub fn path_beside(fleet: &Path, digest: &str) -> PathBuf {
    let digest = digest.get(..DIGEST_LEN).unwrap_or(digest);
    fleet.with_file_name(format!("{}{digest}.json", prefix(fleet)))
}

fn prefix(fleet: &Path) -> String {
    format!("{}.rollout-", fleet.file_stem().unwrap_or_default().to_string_lossy())
}

/// The state's file of the rollout that began last.
///
/// # Errors
/// When there is none beside the fleet's file, or one of them is damaged.
pub fn newest_beside(fleet: &Path) -> Result<PathBuf> {
    let folder = fleet.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let prefix = prefix(fleet);
    let mut newest = None;
    let listed = fs::read_dir(folder)
        .with_context(|| format!("cannot read the folder {}", folder.display()))?;
    for entry in listed.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with(&prefix) || !name.ends_with(".json") {
            continue;
        }
        if let Some(rollout) = read(&entry.path())? {
            newest = newest.max(Some((rollout.begun_unix_s, entry.path())));
        }
    }
    let (_, path) = newest.with_context(|| {
        format!(
            "no rollout to {} has begun: there is no {prefix}*.json beside it; `push-model MODEL --fleet {}` begins one, and --state names a file elsewhere",
            fleet.display(),
            fleet.display()
        )
    })?;
    Ok(path)
}

/// Reads the state; `None` if the rollout has not begun.
///
/// # Errors
/// When the file cannot be read or is damaged.
pub fn read(path: &Path) -> Result<Option<Rollout>> {
    let text = match fs::read_to_string(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        read => {
            read.with_context(|| format!("cannot read {}; nothing was sent", path.display()))?
        }
    };
    let parsed = serde_json::from_str::<Rollout>(&text);
    let flaw = match &parsed {
        Ok(rollout) => rollout.flaw(),
        Err(error) => Some(error.to_string()),
    };
    match (parsed, flaw) {
        (Ok(rollout), None) => Ok(Some(rollout)),
        (_, flaw) => bail!(
            "the state of the rollout, {}, is damaged ({}); nothing was sent. Restore the file, or move it away: the rollout then begins again with the canaries, and asks each robot before it sends, so that a robot that uses the model is not sent it again",
            path.display(),
            flaw.unwrap_or_default()
        ),
    }
}

/// Replaces the state atomically: after a crash or a power cut the file has either the old or the new state.
///
/// # Errors
/// When the file cannot be written; the old one is valid then.
pub fn write(path: &Path, rollout: &Rollout) -> Result<()> {
    let partial = with_suffix(path, ".partial");
    let mut bytes = serde_json::to_vec_pretty(rollout)?;
    bytes.push(b'\n');
    replace(path, &partial, &bytes).with_context(|| {
        format!(
            "cannot write the state of the rollout, {}; free space or check the permissions, then run the same command again",
            path.display()
        )
    })
}

fn replace(path: &Path, partial: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = File::create(partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(partial, path)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Locks the rollout until the file is dropped, so that two passes do not send to one robot at once.
///
/// # Errors
/// When another pass of this rollout runs, or the lock's file cannot be written.
pub fn lock(path: &Path) -> Result<File> {
    let lock = with_suffix(path, ".lock");
    let file = File::create(&lock)
        .with_context(|| format!("cannot write {}; check the permissions", lock.display()))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => bail!(
            "another push-model works on this rollout ({} is locked); wait until it has ended, or use --status",
            lock.display()
        ),
        Err(TryLockError::Error(error)) => {
            Err(error).with_context(|| format!("cannot lock {}", lock.display()))
        }
    }
}

#[cfg(test)]
mod tests {
    use tempfile::tempdir;

    use super::super::state::{FORMAT, Record};
    use super::*;

    fn rollout(begun_unix_s: u64) -> Rollout {
        Rollout {
            format: FORMAT,
            digest: format!("{begun_unix_s:064}"),
            model: "student".to_owned(),
            begun_unix_s,
            rings: vec!["canary".to_owned()],
            open: 0,
            halted: None,
            robots: vec![Record::new("a", 0, 1)],
        }
    }

    #[test]
    fn what_was_written_is_read_and_a_missing_file_is_a_rollout_that_has_not_begun() {
        let dir = tempdir().unwrap();
        let path = path_beside(&dir.path().join("fleet.toml"), &"ab".repeat(32));
        assert!(path.ends_with("fleet.rollout-abababababababab.json"), "{}", path.display());
        assert_eq!(read(&path).unwrap(), None);
        write(&path, &rollout(7)).unwrap();
        assert_eq!(read(&path).unwrap(), Some(rollout(7)));
        assert!(!with_suffix(&path, ".partial").exists());
    }

    #[test]
    fn a_damaged_state_is_refused_with_the_reason_and_the_way_out() {
        let dir = tempdir().unwrap();
        let path = dir.path().join("state.json");
        let sound = serde_json::to_string(&rollout(7)).unwrap();
        let twice = {
            let mut twice = rollout(7);
            twice.robots.push(Record::new("a", 0, 1));
            serde_json::to_string(&twice).unwrap()
        };
        let cases = [
            ("", "EOF"),
            (&sound[..sound.len() / 2], "EOF"),
            (&sound.replace("\"waiting\"", "\"sold\""), "sold"),
            (&sound.replace("\"format\":1", "\"format\":2"), "its format is 2"),
            (&sound.replace("\"ring\":0", "\"ring\":1"), "ring that does not exist"),
            (&sound.replace("\"open\":0", "\"open\":1"), "ring 2 of 1 is open"),
            (&twice, "twice"),
        ];
        for (text, reason) in cases {
            fs::write(&path, text).unwrap();
            let error = format!("{:#}", read(&path).unwrap_err());
            assert!(error.contains(reason) && error.contains("nothing was sent"), "{error}");
            assert!(error.contains("state.json") && error.contains("move it away"), "{error}");
        }
    }

    #[test]
    fn the_newest_rollout_of_a_fleet_is_found_and_none_is_an_error_with_the_command_that_begins_one()
     {
        let dir = tempdir().unwrap();
        let fleet = dir.path().join("fleet.toml");
        let error = format!("{:#}", newest_beside(&fleet).unwrap_err());
        assert!(error.contains("push-model MODEL --fleet"), "{error}");
        for (digest, begun_unix_s) in [("a", 1), ("c", 3), ("b", 2)] {
            write(&path_beside(&fleet, digest), &rollout(begun_unix_s)).unwrap();
        }
        write(&path_beside(&dir.path().join("other.toml"), "d"), &rollout(9)).unwrap();
        assert_eq!(newest_beside(&fleet).unwrap(), path_beside(&fleet, "c"));
    }

    #[test]
    fn a_rollout_is_locked_by_one_pass_at_a_time() {
        let dir = tempdir().unwrap();
        let path = dir.path().join("state.json");
        let held = lock(&path).unwrap();
        let error = format!("{:#}", lock(&path).unwrap_err());
        assert!(error.contains("another push-model"), "{error}");
        drop(held);
        assert!(lock(&path).is_ok());
    }
}
