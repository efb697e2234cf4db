//! What the computer has beside what the configuration names: names that stay the same, and CAN interfaces.

use std::path::{Path, PathBuf};

/// `ARPHRD_CAN` of linux/if_arp.h.
const CAN: &str = "280";
/// `IFF_UP` of linux/if.h.
const UP: u32 = 1;

/// Where a kind of device has its names.
pub struct Names {
    /// Names that stay the same when a device is plugged in again, made by udev.
    pub stable: &'static str,
    /// How the kernel's own names begin.
    pub kernel: &'static [&'static str],
}

/// Of cameras.
pub const CAMERAS: Names = Names { stable: "/dev/v4l/by-id", kernel: &["/dev/video"] };
/// Of serial ports, also those behind USB.
pub const PORTS: Names =
    Names { stable: "/dev/serial/by-id", kernel: &["/dev/ttyACM", "/dev/ttyUSB"] };

impl Names {
    /// Which there are, as a sentence.
    pub fn list(&self) -> String {
        let mut found = entries(Path::new(self.stable));
        if found.is_empty() {
            let begins = |path: &PathBuf| {
                self.kernel.iter().any(|name| path.to_string_lossy().starts_with(name))
            };
            found = entries(Path::new("/dev")).into_iter().filter(begins).collect();
        }
        if found.is_empty() {
            return format!(
                "nothing of its kind is plugged in: {} and {}* are empty",
                self.stable,
                self.kernel.join("*, ")
            );
        }
        let found: Vec<_> = found.iter().map(|path| path.display().to_string()).collect();
        format!("there are: {}", found.join(", "))
    }

    /// The stable name of a device that was named by the kernel's.
    pub fn stable_name_of(&self, path: &Path) -> Option<PathBuf> {
        if !self.kernel.iter().any(|name| path.to_string_lossy().starts_with(name)) {
            return None;
        }
        same_device(Path::new(self.stable), path)
    }
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    paths.sort();
    paths
}

fn same_device(folder: &Path, path: &Path) -> Option<PathBuf> {
    let device = path.canonicalize().ok()?;
    entries(folder)
        .into_iter()
        .find(|name| name.canonicalize().is_ok_and(|target| target == device))
}

/// What is wrong with a CAN interface as the kernel tells it, and what to type.
pub fn can_interface(name: &str) -> Option<String> {
    interface(Path::new("/sys/class/net"), name)
}

fn interface(folder: &Path, name: &str) -> Option<String> {
    let attribute =
        |interface: &Path, file| std::fs::read_to_string(interface.join(file)).unwrap_or_default();
    let is_can = |interface: &Path| attribute(interface, "type").trim() == CAN;
    let wanted = folder.join(name);
    if !wanted.exists() {
        let others: Vec<_> = entries(folder)
            .into_iter()
            .filter(|interface| is_can(interface))
            .filter_map(|interface| Some(interface.file_name()?.to_string_lossy().into_owned()))
            .collect();
        return Some(if others.is_empty() {
            format!(
                "there is no interface {name}, nor any other of CAN: plug the adapter in; `dmesg` says whether it has a driver"
            )
        } else {
            format!("there is no interface {name}; those of CAN are: {}", others.join(", "))
        });
    }
    if !is_can(&wanted) {
        return Some(format!("{name} is no CAN interface"));
    }
    let flags = attribute(&wanted, "flags");
    let flags = flags
        .trim()
        .strip_prefix("0x")
        .and_then(|hex| u32::from_str_radix(hex, 16).ok())
        .unwrap_or_default();
    (flags & UP == 0).then(|| {
        format!(
            "{name} is down: `ip link set {name} up type can bitrate 500000 restart-ms 100` as root, at the bit rate of the motors"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn make(folder: &Path, interface: &str, kind: &str, flags: &str) {
        let folder = folder.join(interface);
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("type"), format!("{kind}\n")).unwrap();
        std::fs::write(folder.join("flags"), format!("{flags}\n")).unwrap();
    }

    #[test]
    fn an_interface_that_is_missing_down_or_no_can_is_told_with_what_to_type() {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), "eth0", "1", "0x1003");
        let said = |name| interface(folder.path(), name);
        assert!(said("can0").unwrap().contains("plug the adapter in"));
        assert!(said("eth0").unwrap().contains("no CAN interface"));
        make(folder.path(), "can1", "280", "0x40080");
        assert!(said("can0").unwrap().ends_with("are: can1"));
        assert!(said("can1").unwrap().contains("ip link set can1 up type can bitrate 500000"));
        make(folder.path(), "can0", "280", "0x40081");
        assert_eq!(said("can0"), None);
    }

    #[test]
    fn the_stable_name_of_a_device_is_the_one_that_leads_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let [device, names] = ["video7", "by-id"].map(|name| folder.path().join(name));
        std::fs::write(&device, "").unwrap();
        std::fs::create_dir(&names).unwrap();
        assert_eq!(same_device(&names, &device), None);
        let name = names.join("usb-046d_C270-video-index0");
        std::os::unix::fs::symlink("../video7", &name).unwrap();
        assert_eq!(same_device(&names, &device), Some(name));
    }

    #[test]
    fn a_computer_without_such_devices_is_told_where_they_would_be() {
        let nowhere =
            Names { stable: "/nowhere/by-id", kernel: &["/dev/no-such-a", "/dev/no-such-b"] };
        let text = nowhere.list();
        for part in ["nothing of its kind", "/nowhere/by-id", "/dev/no-such-a*", "/dev/no-such-b*"]
        {
            assert!(text.contains(part), "{text}");
        }
    }
}
