//! A folder that is like sysfs, with the devices that a test puts there.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;

use rustix::fs::{CWD, FileType, Mode, mknodat};

use super::super::{ImuConfig, Roots};

pub(super) struct Fake {
    root: PathBuf,
}

impl Fake {
    /// An empty folder for the test of this name.
    pub(super) fn new(test: &str) -> Self {
        let root = std::env::temp_dir().join(format!("iio_{}_{test}", std::process::id()));
        _ = fs::remove_dir_all(&root);
        for folder in ["sys", "dev"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        Self { root }
    }

    pub(super) fn roots(&self) -> Roots {
        Roots { sysfs: self.root.join("sys"), dev: self.root.join("dev") }
    }

    pub(super) fn config(&self, device: &str) -> ImuConfig {
        ImuConfig { device: device.to_owned(), ..ImuConfig::default() }
    }

    pub(super) fn path(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    /// Writes an attribute, such as `iio:device0/name`, and the folders above it.
    pub(super) fn write(&self, attribute: &str, text: &str) {
        let path = self.root.join("sys").join(attribute);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, format!("{text}\n")).unwrap();
    }

    pub(super) fn read(&self, attribute: &str) -> String {
        fs::read_to_string(self.root.join("sys").join(attribute)).unwrap().trim().to_owned()
    }

    pub(super) fn remove(&self, attribute: &str) {
        let path = self.root.join("sys").join(attribute);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }

    /// Adds a channel that is switched off.
    pub(super) fn channel(&self, device: &str, name: &str, index: u32, kind: &str) {
        for (what, text) in [("en", "0"), ("index", &index.to_string()), ("type", kind)] {
            self.write(&format!("{device}/scan_elements/{name}_{what}"), text);
        }
    }

    /// Adds a gyroscope with these channels, which measures in steps of 0.5 rad/s, and the other end of its node.
    pub(super) fn gyroscope(&self, axes: &[&str]) -> File {
        let device = "iio:device0";
        for (index, axis) in (0..).zip(axes) {
            self.channel(device, &format!("in_anglvel_{axis}"), index, "le:s16/16>>0");
        }
        self.channel(device, "in_timestamp", 9, "le:s64/64>>0");
        for (attribute, text) in [
            ("name", "gyro_3d"),
            ("in_anglvel_scale", "0.5"),
            ("in_anglvel_sampling_frequency", "10.000000"),
            ("current_timestamp_clock", "realtime"),
            ("buffer/enable", "1"),
            ("buffer/length", "2"),
            ("trigger/current_trigger", "gyro_3d-dev0"),
        ] {
            self.write(&format!("{device}/{attribute}"), text);
        }
        self.node()
    }

    /// The other end of the device's node, which is made if it is absent.
    pub(super) fn node(&self) -> File {
        let path = self.root.join("dev/iio:device0");
        if !path.exists() {
            mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        }
        // Opening only one end would wait for the other.
        OpenOptions::new().read(true).write(true).open(path).unwrap()
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        _ = fs::remove_dir_all(&self.root);
    }
}

/// Sends a record of a gyroscope with three axes, laid out by hand.
pub(super) fn send(node: &mut File, time_ns: u64, raw: [i16; 3]) {
    let [x, y, z] = raw.map(i16::to_le_bytes);
    let record = [&x[..], &y, &z, &[0; 2], &time_ns.to_le_bytes()].concat();
    node.write_all(&record).unwrap();
}
