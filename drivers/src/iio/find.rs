//! Finds a device or a trigger by its name.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::ImuError;
use super::attributes::{Attributes, names};

/// Where the kernel shows its devices.
#[derive(Debug, Clone)]
pub struct Roots {
    /// The folder with a folder for each device and trigger.
    pub sysfs: PathBuf,
    /// The folder with the devices' files.
    pub dev: PathBuf,
}

impl Default for Roots {
    fn default() -> Self {
        Self { sysfs: "/sys/bus/iio/devices".into(), dev: "/dev".into() }
    }
}

impl Roots {
    /// The folder of the device of this name.
    pub(super) fn device(&self, name: &Arc<str>) -> Result<PathBuf, ImuError> {
        let all = self.named("iio:device");
        let mut found: Vec<_> = all
            .iter()
            .filter(|(known, _)| known.as_str() == &**name)
            .map(|(_, path)| path)
            .collect();
        match (found.pop(), found.is_empty()) {
            (Some(path), true) => Ok(path.clone()),
            (Some(path), false) => Err(ImuError::Unsupported {
                device: Arc::clone(name),
                what: format!(
                    "several devices have this name; set `device` to the folder of one, such as {}",
                    path.display()
                ),
            }),
            (None, _) => Err(ImuError::Absent {
                device: Arc::clone(name),
                what: format!(
                    "there is no such device in {} (there are: {})",
                    self.sysfs.display(),
                    list(&all)
                ),
            }),
        }
    }

    /// The folder of the trigger of this name.
    pub(super) fn trigger(&self, name: &str) -> Option<PathBuf> {
        self.named("trigger").into_iter().find(|(known, _)| known == name).map(|(_, path)| path)
    }

    /// The names of all triggers, as a message lists them.
    pub(super) fn triggers(&self) -> String {
        list(&self.named("trigger"))
    }

    /// Names and folders of everything whose folder begins like this. Without the subsystem there is nothing.
    fn named(&self, prefix: &str) -> Vec<(String, PathBuf)> {
        let folders = names(&self.sysfs).unwrap_or_default().into_iter();
        folders
            .filter(|folder| folder.starts_with(prefix))
            .filter_map(|folder| {
                let path = self.sysfs.join(folder);
                Some((Attributes::new(path.clone()).read("name").ok()?, path))
            })
            .collect()
    }

    /// The character device that belongs to a device's folder.
    pub(super) fn node(&self, folder: &Path) -> PathBuf {
        self.dev.join(folder.file_name().unwrap_or_default())
    }
}

fn list(named: &[(String, PathBuf)]) -> String {
    if named.is_empty() {
        return "none".to_owned();
    }
    named.iter().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}
