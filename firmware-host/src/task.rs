//! `firmware-host go-to X,Y`, `return` and `resume`: tasks for the running robot.
//!
//! A task is a small file beside the status file. The running robot takes it between two ticks, and the recording holds it as an
//! input of the next one.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use runtime::task::Task;

use crate::failure::sentence;
use crate::report::atomic::write_atomically;

/// Writes a task for the running robot.
///
/// # Errors
/// When the file cannot be written.
pub fn give(task: Task, path: &Path) -> Result<()> {
    let json = serde_json::to_vec(&task.check()?)?;
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        ensure!(
            folder.is_dir(),
            "no robot takes tasks at {}: is `firmware-host run` running? If its configuration has another run.task_file, \
             give that by --task-file",
            path.display()
        );
    }
    write_atomically(path, &json).context("is the robot running, and may you write there?")?;
    println!("{}: the robot takes it with its next tick", path.display());
    Ok(())
}

/// Where a running robot gets its tasks.
#[derive(Debug)]
pub struct TaskFile {
    path: PathBuf,
}

impl TaskFile {
    /// The file at this path. A task that was left for an earlier run is removed, not done.
    #[must_use]
    pub fn open(path: &Path) -> Self {
        let file = Self { path: path.to_owned() };
        if file.remove() {
            tracing::warn!("a task from before the start was removed: {}", file.path.display());
        }
        file
    }

    /// Takes the task, if there is one. What is not a task is removed with a message in the log.
    #[must_use]
    pub fn take(&self) -> Option<Task> {
        let text = match std::fs::read_to_string(&self.path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => return None,
            Err(error) => {
                tracing::error!("cannot read the task {}: {error}", self.path.display());
                self.remove();
                return None;
            }
        };
        self.remove();
        let task = serde_json::from_str(&text).map_err(anyhow::Error::from);
        match task.and_then(|task: Task| Ok(task.check()?)) {
            Ok(task) => Some(task),
            Err(error) => {
                tracing::error!("{} is not a task: {}", self.path.display(), sentence(&error));
                None
            }
        }
    }

    fn remove(&self) -> bool {
        std::fs::remove_file(&self.path).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_is_taken_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.json");
        let file = TaskFile::open(&path);
        assert_eq!(file.take(), None);
        let task = Task::GoTo { x_m: 1.5, y_m: -2.0 };
        give(task, &path).unwrap();
        assert_eq!(file.take(), Some(task));
        assert_eq!(file.take(), None);
    }

    #[test]
    fn a_task_from_before_the_start_is_not_done() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.json");
        give(Task::Return, &path).unwrap();
        assert_eq!(TaskFile::open(&path).take(), None);
    }

    #[test]
    fn what_is_not_a_task_is_removed_and_a_place_that_is_not_finite_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("task.json");
        let file = TaskFile::open(&path);
        std::fs::write(&path, r#"{"task": "go_to", "x_m": 1}"#).unwrap();
        assert_eq!(file.take(), None);
        assert!(!path.exists());
        assert!(give(Task::GoTo { x_m: f64::NAN, y_m: 0.0 }, &path).is_err());
        assert!(!path.exists());
    }
}
