//! Finds devices by their names, without opening any: in `/sys` and `/dev`, or in the folder of simulated devices.

use std::path::{Path, PathBuf};

use drivers::v4l2::V4l2Error;
use rustix::fs::{Access, access};
use rustix::io::Errno;

use super::found::{Found, FoundBus, FoundCamera, FoundPort};
use crate::check::nearby::{attribute, entries, interface, is_can, same_device};

/// Where devices are looked for.
#[derive(Debug, Clone)]
pub struct Places {
    /// The root of the folders `sys` and `dev`.
    pub root: PathBuf,
    /// The folder of simulated devices (`hil world --dir`). If there is one, the others are not looked for.
    pub simulated: Option<PathBuf>,
}

/// The driver of 8250 ports that a computer may or may not have; nothing tells which exist.
const PHANTOM_PORTS: &str = "serial8250";

impl Places {
    /// Finds the devices. What only an open device tells is not known yet: every camera counts as missing, no bus has motors.
    #[must_use]
    pub fn search(&self) -> Found {
        match &self.simulated {
            Some(folder) => simulated(folder),
            None => Found {
                cameras: self.cameras(),
                ports: self.ports(),
                buses: self.buses(),
                imus: self.imus(),
                simulated: None,
            },
        }
    }

    /// Video nodes. A camera has several nodes; the first, of index 0, delivers the frames.
    fn cameras(&self) -> Vec<FoundCamera> {
        let nodes = entries(&self.root.join("sys/class/video4linux"));
        let first =
            nodes.into_iter().filter(|node| matches!(attribute(node, "index").trim(), "" | "0"));
        let with_path = first.filter_map(|node| Some((self.device_of(&node)?, node)));
        let mut cameras: Vec<FoundCamera> = with_path
            .map(|(path, node)| {
                let device = self.stable_name(&path, &["dev/v4l/by-id", "dev/v4l/by-path"]);
                unopened(&device, attribute(&node, "name").trim())
            })
            .collect();
        cameras.sort_by(|a, b| a.device.cmp(&b.device));
        cameras
    }

    /// Serial ports that have hardware.
    fn ports(&self) -> Vec<FoundPort> {
        let with_hardware = entries(&self.root.join("sys/class/tty")).into_iter().filter(|port| {
            let driver = port.join("device/driver").canonicalize().unwrap_or_default();
            port.join("device").exists() && !driver.ends_with(PHANTOM_PORTS)
        });
        let with_path = with_hardware.filter_map(|port| Some((self.device_of(&port)?, port)));
        with_path.map(|(path, port)| self.port(&path, &port)).collect()
    }

    fn port(&self, path: &Path, in_sys: &Path) -> FoundPort {
        let usb = usb_device(in_sys);
        let usb = usb.as_deref();
        let name =
            format!("{} {}", usb_text(usb, "manufacturer").trim(), usb_text(usb, "product").trim());
        FoundPort {
            path: self.stable_name(path, &["dev/serial/by-id", "dev/serial/by-path"]),
            name: name.trim().to_owned(),
            usb: usb_number(usb, "idVendor").zip(usb_number(usb, "idProduct")),
            problem: port_problem(path),
        }
    }

    fn buses(&self) -> Vec<FoundBus> {
        let folder = self.root.join("sys/class/net");
        let buses = entries(&folder).into_iter().filter(|interface| is_can(interface));
        let names = buses.filter_map(|bus| Some(bus.file_name()?.to_str()?.to_owned()));
        names
            .map(|name| FoundBus { problem: interface(&folder, &name), name, senders: Vec::new() })
            .collect()
    }

    /// Devices of Industrial I/O that measure an angular velocity.
    fn imus(&self) -> Vec<String> {
        let devices = entries(&self.root.join("sys/bus/iio/devices"));
        let gyroscopes = devices.into_iter().filter(|device| {
            ["x", "y", "z"]
                .iter()
                .any(|axis| device.join(format!("in_anglvel_{axis}_raw")).exists())
        });
        let gyroscopes: Vec<(String, PathBuf)> = gyroscopes
            .map(|device| (attribute(&device, "name").trim().to_owned(), device))
            .collect();
        // A name that two devices have does not tell which is meant, but a folder does.
        let name_of = |(name, device): &(String, PathBuf)| {
            let alike = gyroscopes.iter().filter(|(other, _)| other == name).count();
            if alike == 1 { name.clone() } else { device.display().to_string() }
        };
        gyroscopes.iter().map(name_of).collect()
    }

    /// The file in `dev` of an entry in `sys/class`.
    fn device_of(&self, in_sys: &Path) -> Option<PathBuf> {
        let path = self.root.join("dev").join(in_sys.file_name()?);
        path.exists().then_some(path)
    }

    /// The name in the first of these folders that leads to the device, else its own.
    fn stable_name(&self, device: &Path, folders: &[&str]) -> String {
        let stable = folders.iter().find_map(|folder| same_device(&self.root.join(folder), device));
        stable.as_deref().unwrap_or(device).display().to_string()
    }
}

/// The USB device that an entry in `sys/class` belongs to: the nearest folder above it that has a vendor.
fn usb_device(in_sys: &Path) -> Option<PathBuf> {
    let device = in_sys.join("device").canonicalize().ok()?;
    device.ancestors().find(|folder| folder.join("idVendor").exists()).map(Path::to_path_buf)
}

fn usb_text(usb: Option<&Path>, file: &str) -> String {
    usb.map_or_else(String::new, |usb| attribute(usb, file))
}

fn usb_number(usb: Option<&Path>, file: &str) -> Option<u16> {
    let text = attribute(usb?, file);
    u16::from_str_radix(text.trim(), 16).ok()
}

fn port_problem(path: &Path) -> Option<String> {
    match access(path, Access::READ_OK | Access::WRITE_OK) {
        Ok(()) => None,
        Err(Errno::ACCESS | Errno::PERM) => Some(format!(
            "no permission for {}; add the user to the group `dialout`",
            path.display()
        )),
        Err(errno) => Some(format!("{} cannot be opened: {errno}", path.display())),
    }
}

fn unopened(device: &str, name: &str) -> FoundCamera {
    let missing = V4l2Error::NotThere { device: device.into(), errno: Errno::NODEV };
    FoundCamera { device: device.to_owned(), name: name.to_owned(), offer: Err(missing) }
}

/// The devices of `hil world`: sockets, and a link to a pty.
fn simulated(folder: &Path) -> Found {
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let port = folder.join("lidar");
    let port = port.exists().then(|| FoundPort {
        path: port.display().to_string(),
        name: "simulated".to_owned(),
        usb: None,
        problem: port_problem(&port),
    });
    let bus =
        socket_in(&folder, "can").map(|name| FoundBus { name, problem: None, senders: Vec::new() });
    Found {
        cameras: socket_in(&folder, "camera")
            .iter()
            .map(|device| unopened(device, "simulated"))
            .collect(),
        ports: port.into_iter().collect(),
        buses: bus.into_iter().collect(),
        imus: socket_in(&folder, "imu").into_iter().collect(),
        simulated: Some(folder),
    }
}

fn socket_in(folder: &Path, name: &str) -> Option<String> {
    let path = folder.join(name);
    path.exists().then(|| format!("unix:{}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    /// A computer in a folder.
    struct Fake(tempfile::TempDir);

    impl Fake {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }

        fn file(&self, path: &str, text: &str) -> PathBuf {
            let path = self.0.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, text).unwrap();
            path
        }

        fn link(&self, path: &str, target: &Path) {
            let path = self.0.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            symlink(target, path).unwrap();
        }

        fn search(&self) -> Found {
            Places { root: self.0.path().to_owned(), simulated: None }.search()
        }

        fn camera(&self, node: u32, name: &str, index: u32) -> PathBuf {
            self.file(&format!("sys/class/video4linux/video{node}/name"), &format!("{name}\n"));
            self.file(&format!("sys/class/video4linux/video{node}/index"), &format!("{index}\n"));
            self.file(&format!("dev/video{node}"), "")
        }

        fn usb_port(&self, tty: &str, vendor: &str, product: &str, name: &str) -> PathBuf {
            let usb = format!("sys/devices/usb-{tty}");
            self.file(&format!("{usb}/idVendor"), &format!("{vendor}\n"));
            self.file(&format!("{usb}/idProduct"), &format!("{product}\n"));
            self.file(&format!("{usb}/product"), &format!("{name}\n"));
            let device = self.file(&format!("{usb}/interface/{tty}/port_number"), "0");
            self.link(&format!("sys/class/tty/{tty}/device"), device.parent().unwrap());
            self.file(&format!("dev/{tty}"), "")
        }
    }

    #[test]
    fn an_empty_computer_has_no_devices() {
        assert_eq!(Fake::new().search(), Found::default());
    }

    #[test]
    fn of_each_camera_the_first_node_is_found_under_its_most_stable_name() {
        let computer = Fake::new();
        let first = computer.camera(0, "HD Webcam", 0);
        computer.camera(1, "HD Webcam", 1);
        computer.camera(2, "Other", 0);
        computer.link("dev/v4l/by-id/usb-HD_Webcam-video-index0", &first);
        let found = computer.search();
        let names: Vec<&str> = found.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names.len(), 2, "{found:?}");
        let stable = found.cameras.iter().find(|camera| camera.name == "HD Webcam").unwrap();
        assert!(stable.device.ends_with("dev/v4l/by-id/usb-HD_Webcam-video-index0"), "{stable:?}");
        assert!(found.cameras.iter().any(|camera| camera.device.ends_with("dev/video2")));
    }

    #[test]
    fn a_serial_port_is_known_by_its_usb_identity_and_a_phantom_port_is_none() {
        let computer = Fake::new();
        computer.usb_port("ttyUSB0", "10c4", "ea60", "CP2102 USB to UART Bridge Controller");
        let driver = computer.file("sys/bus/drivers/serial8250/bind", "");
        computer.file("sys/devices/platform/ttyS0/uevent", "");
        computer.link("sys/devices/platform/ttyS0/driver", driver.parent().unwrap());
        computer.link(
            "sys/class/tty/ttyS0/device",
            &computer.0.path().join("sys/devices/platform/ttyS0"),
        );
        computer.file("dev/ttyS0", "");
        computer.file("sys/class/tty/tty1/dev", "4:1");
        computer.file("dev/tty1", "");
        let found = computer.search();
        let [port] = &found.ports[..] else { panic!("{found:?}") };
        assert_eq!(port.usb, Some((0x10c4, 0xea60)));
        assert!(port.path.ends_with("dev/ttyUSB0") && port.name.starts_with("CP2102"), "{port:?}");
    }

    #[test]
    fn can_interfaces_are_found_with_what_is_wrong_with_them() {
        let computer = Fake::new();
        for (name, kind, flags) in
            [("can0", "280", "0x40081"), ("can1", "280", "0x40080"), ("eth0", "1", "0x1003")]
        {
            computer.file(&format!("sys/class/net/{name}/type"), kind);
            computer.file(&format!("sys/class/net/{name}/flags"), flags);
        }
        let found = computer.search();
        let [up, down] = &found.buses[..] else { panic!("{found:?}") };
        assert_eq!((up.name.as_str(), up.problem.as_ref()), ("can0", None));
        assert!(down.problem.as_ref().unwrap().contains("ip link set can1 up"), "{down:?}");
    }

    #[test]
    fn a_gyroscope_is_found_by_its_name_and_a_light_sensor_is_none() {
        let computer = Fake::new();
        for (device, name, channel) in [
            ("iio:device0", "als", "in_illuminance_raw"),
            ("iio:device1", "bmi160", "in_anglvel_z_raw"),
        ] {
            computer.file(&format!("sys/bus/iio/devices/{device}/name"), &format!("{name}\n"));
            computer.file(&format!("sys/bus/iio/devices/{device}/{channel}"), "0\n");
        }
        assert_eq!(computer.search().imus, ["bmi160"]);
    }

    #[test]
    fn simulated_devices_are_found_by_their_names_in_their_folder_alone() {
        let computer = Fake::new();
        computer.camera(0, "real", 0);
        for name in ["camera", "can"] {
            computer.file(&format!("world/{name}"), "");
        }
        let folder = computer.0.path().join("world");
        let places = Places { root: computer.0.path().to_owned(), simulated: Some(folder.clone()) };
        let found = places.search();
        assert!(found.cameras[0].device.starts_with("unix:/") && found.cameras.len() == 1);
        assert!(found.buses[0].name.ends_with("/world/can") && found.ports.is_empty(), "{found:?}");
    }
}
