//! Other devices of this computer, to suggest when a configured one is missing: stable names of cameras and serial ports, and
//! CAN interfaces.

use std::path::{Path, PathBuf};
use std::process::Command;

/// `ARPHRD_CAN` of linux/if_arp.h.
const ARPHRD_CAN: &str = "280";
/// `IFF_UP` of linux/if.h.
const IFF_UP: u32 = 1;

/// The places of the names of one kind of device.
pub struct Names {
    /// Directory of udev's names, which stay the same after a device was unplugged.
    pub stable: &'static str,
    /// Prefixes of the kernel's own names.
    pub kernel: &'static [&'static str],
}

pub const CAMERAS: Names = Names { stable: "/dev/v4l/by-id", kernel: &["/dev/video"] };
pub const PORTS: Names =
    Names { stable: "/dev/serial/by-id", kernel: &["/dev/ttyACM", "/dev/ttyUSB"] };

impl Names {
    /// The names of the connected devices, as a sentence.
    pub fn list(&self) -> String {
        let mut found = entries(Path::new(self.stable));
        if found.is_empty() {
            found = entries(Path::new("/dev"));
            found.retain(|path| self.is_kernel_name(path));
        }
        if found.is_empty() {
            return format!(
                "no such device is connected: {} and {}* are empty",
                self.stable,
                self.kernel.join("*, ")
            );
        }
        let found: Vec<_> = found.iter().map(|path| path.display().to_string()).collect();
        format!("available: {}", found.join(", "))
    }

    /// The stable name of a device that is configured with its kernel name.
    pub fn stable_name_of(&self, path: &Path) -> Option<PathBuf> {
        if !self.is_kernel_name(path) {
            return None;
        }
        same_device(Path::new(self.stable), path)
    }

    fn is_kernel_name(&self, path: &Path) -> bool {
        self.kernel.iter().any(|prefix| path.to_string_lossy().starts_with(prefix))
    }
}

/// The paths in a folder, sorted; none if it cannot be read.
pub fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    paths.sort();
    paths
}

/// The entry of a folder that leads to the same device.
pub fn same_device(folder: &Path, path: &Path) -> Option<PathBuf> {
    let device = path.canonicalize().ok()?;
    entries(folder)
        .into_iter()
        .find(|name| name.canonicalize().is_ok_and(|target| target == device))
}

/// What is wrong with a CAN interface according to the kernel, and the command that corrects it.
pub fn can_interface(name: &str) -> Option<String> {
    interface(Path::new("/sys/class/net"), name)
}

/// As [`can_interface`], of the interfaces in this folder.
pub fn interface(folder: &Path, name: &str) -> Option<String> {
    let configured = folder.join(name);
    if !configured.exists() {
        let others: Vec<_> = entries(folder)
            .into_iter()
            .filter(|interface| is_can(interface))
            .filter_map(|interface| Some(interface.file_name()?.to_string_lossy().into_owned()))
            .collect();
        return Some(if others.is_empty() {
            format!(
                "there is no interface {name} and no other CAN interface: connect the adapter; `dmesg` shows whether it has a driver"
            )
        } else {
            format!("there is no interface {name}; the CAN interfaces are: {}", others.join(", "))
        });
    }
    if !is_can(&configured) {
        return Some(format!("{name} is not a CAN interface"));
    }
    let flags = attribute(&configured, "flags");
    let flags = flags
        .trim()
        .strip_prefix("0x")
        .and_then(|hex| u32::from_str_radix(hex, 16).ok())
        .unwrap_or_default();
    if flags & IFF_UP != 0 {
        return None;
    }
    Some(format!(
        "{name} is down: run `ip link set {name} up type can bitrate 500000 restart-ms 100` as root, with the bit rate of \
         the motors"
    ))
}

/// What to do if the kernel leaves a CAN controller off the bus after too many errors; `None` if it restarts the controller, or if
/// that cannot be read, as from an interface without a controller.
pub fn bus_off_restart(name: &str) -> Option<String> {
    let output =
        Command::new("ip").args(["-details", "link", "show", "dev", name]).output().ok()?;
    let details = String::from_utf8_lossy(&output.stdout);
    (restart_ms(&details)? == 0).then(|| {
        format!(
            "{name} stays off the bus after too many errors, because its `restart-ms` is 0: run `ip link set {name} down` and \
             `ip link set {name} up type can restart-ms 100` as root"
        )
    })
}

/// The time after which the kernel restarts a controller, 0 for never, in the output of `ip -details link show`.
fn restart_ms(details: &str) -> Option<u32> {
    let mut words = details.split_whitespace();
    words.find(|word| *word == "restart-ms")?;
    words.next()?.parse().ok()
}

/// Whether an interface is one of CAN.
pub fn is_can(interface: &Path) -> bool {
    attribute(interface, "type").trim() == ARPHRD_CAN
}

/// The text of a file of the kernel; empty if it cannot be read.
pub fn attribute(interface: &Path, file: &str) -> String {
    std::fs::read_to_string(interface.join(file)).unwrap_or_default()
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
    fn a_missing_wrong_or_disabled_can_interface_is_reported_with_the_command_to_run() {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), "eth0", "1", "0x1003");
        assert!(interface(folder.path(), "can0").unwrap().contains("connect the adapter"));
        assert!(interface(folder.path(), "eth0").unwrap().contains("not a CAN interface"));
        make(folder.path(), "can1", "280", "0x40080");
        assert!(interface(folder.path(), "can0").unwrap().ends_with("are: can1"));
        assert!(
            interface(folder.path(), "can1")
                .unwrap()
                .contains("ip link set can1 up type can bitrate 500000")
        );
        make(folder.path(), "can0", "280", "0x40081");
        assert_eq!(interface(folder.path(), "can0"), None);
    }

    #[test]
    fn the_restart_time_of_a_controller_is_read_from_the_details_of_its_interface() {
        let details = "3: can0: <NOARP,UP,LOWER_UP,ECHO> mtu 16 qdisc pfifo_fast state UP mode DEFAULT group default qlen 10\n    \
                       link/can  promiscuity 0 minmtu 0 maxmtu 0\n    can state ERROR-ACTIVE restart-ms 100\n\t  bitrate 500000 \
                       sample-point 0.875\n";
        assert_eq!(restart_ms(details), Some(100));
        assert_eq!(restart_ms(&details.replace("restart-ms 100", "restart-ms 0")), Some(0));
        let without_controller = "4: vcan0: <NOARP,UP,LOWER_UP> mtu 72 qdisc noqueue state UNKNOWN\n    link/can\n    vcan\n";
        assert_eq!(restart_ms(without_controller), None);
        assert_eq!(bus_off_restart("no-such-interface"), None);
    }

    #[test]
    fn the_stable_name_of_a_device_is_the_link_to_it() {
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
    fn without_such_devices_the_message_names_the_searched_directories() {
        let nowhere =
            Names { stable: "/nowhere/by-id", kernel: &["/dev/no-such-a", "/dev/no-such-b"] };
        let text = nowhere.list();
        for part in
            ["no such device is connected", "/nowhere/by-id", "/dev/no-such-a*", "/dev/no-such-b*"]
        {
            assert!(text.contains(part), "{text}");
        }
    }
}
