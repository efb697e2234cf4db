//! What is connected to this computer, in words.

use std::fmt;
use std::path::PathBuf;

use drivers::can::sender::Sender;
use drivers::v4l2::{CameraFormat, V4l2Error};

/// Cameras, serial ports, CAN buses and gyroscopes.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Found {
    /// The cameras, in the order of their nodes.
    pub cameras: Vec<FoundCamera>,
    /// The serial ports to which a scanner may be connected.
    pub ports: Vec<FoundPort>,
    /// The CAN interfaces.
    pub buses: Vec<FoundBus>,
    /// Inertial units and gyroscopes, as `devices.imu.device` names them. They are optional, and not asked for.
    pub imus: Vec<String>,
    /// The folder of the devices if they are simulated. Status and tasks of the robot are there, too.
    pub simulated: Option<PathBuf>,
}

/// A camera that is connected, with the frames that it offers.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundCamera {
    /// The most stable of its names, or `unix:PATH`.
    pub device: String,
    /// The kernel's name of it.
    pub name: String,
    /// What it offers, or why it cannot be opened.
    pub offer: Result<FrameOffer, V4l2Error>,
}

/// The frames that a camera offers.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameOffer {
    /// The codes of its formats.
    pub formats: Vec<String>,
    /// The first of these that this program reads.
    pub format: Option<CameraFormat>,
    /// Columns of the frames.
    pub width: u32,
    /// Rows of the frames.
    pub height: u32,
    /// Frames per second, if the camera knows them.
    pub fps: Option<f64>,
}

/// A serial port.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundPort {
    /// The most stable of its names.
    pub path: String,
    /// Maker and product of the USB device; empty for another port.
    pub name: String,
    /// Vendor and product of the USB device.
    pub usb: Option<(u16, u16)>,
    /// Why it cannot be opened.
    pub problem: Option<String>,
}

/// A CAN interface.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBus {
    /// Its name, or `unix:PATH`.
    pub name: String,
    /// Why it cannot be used, with the command that corrects it.
    pub problem: Option<String>,
    /// The motor controllers that sent something, in the order of their nodes.
    pub senders: Vec<Sender>,
}

impl FoundCamera {
    fn words(&self) -> String {
        match &self.offer {
            Err(error) => error.to_string(),
            Ok(offer) => format!("{}{offer}", prefix(&self.name)),
        }
    }
}

impl fmt::Display for FrameOffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let formats = self.formats.join(", ");
        match self.format {
            None => write!(f, "{formats}: this program reads none of these formats"),
            Some(_) => write!(f, "{}x{}; {formats}", self.width, self.height),
        }
    }
}

impl FoundPort {
    /// USB identity and problem, as one text.
    fn words(&self) -> String {
        let usb = self.usb.map(|(vendor, product)| format!("USB {vendor:04x}:{product:04x}"));
        let parts = [Some(self.name.clone()), usb, self.problem.clone()];
        let parts: Vec<String> =
            parts.into_iter().flatten().filter(|part| !part.is_empty()).collect();
        parts.join("; ")
    }
}

impl FoundBus {
    fn words(&self) -> String {
        if let Some(problem) = &self.problem {
            return problem.clone();
        }
        if self.senders.is_empty() {
            return "nothing is sent on it: are the motors switched on?".to_owned();
        }
        let senders = self.senders.iter();
        let names = senders.map(|it| format!("{} {}", it.protocol.name(), it.node));
        format!("heard: {}", names.collect::<Vec<_>>().join(", "))
    }

    /// The two nodes that speak one protocol, if exactly two do.
    pub fn pair(&self) -> Option<[Sender; 2]> {
        let [left, right] = self.senders[..] else { return None };
        (left.protocol == right.protocol).then_some([left, right])
    }
}

fn prefix(name: &str) -> String {
    if name.is_empty() { String::new() } else { format!("{name}; ") }
}

impl Found {
    /// One line for each device, with its kind, name and what is known about it.
    pub fn lines(&self) -> Vec<String> {
        let cameras = self.cameras.iter().map(|it| line("camera", &it.device, &it.words()));
        let ports = self.ports.iter().map(|it| line("port", &it.path, &it.words()));
        let buses = self.buses.iter().map(|it| line("CAN bus", &it.name, &it.words()));
        let imus = self.imus.iter().map(|name| {
            line(
                "IMU",
                name,
                &format!("to use it, set devices.imu.device = \"{name}\" (docs/imu.md)"),
            )
        });
        let missing = [
            (self.cameras.is_empty(), "camera"),
            (self.ports.is_empty(), "serial port"),
            (self.buses.is_empty(), "CAN interface"),
        ];
        let missing = missing.into_iter().filter(|(is_missing, _)| *is_missing);
        let missing = missing
            .map(|(_, what)| format!("  no {what}: plug it in and start again, or name it below"));
        cameras.chain(ports).chain(buses).chain(imus).chain(missing).collect()
    }
}

fn line(kind: &str, name: &str, words: &str) -> String {
    let gap = if words.is_empty() { "" } else { ": " };
    format!("  {kind:<8} {name}{gap}{words}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::can::Protocol;

    #[test]
    fn what_is_missing_and_what_is_known_of_each_device_is_said() {
        let text = Found::default().lines().join("\n");
        assert_eq!(text.matches("plug it in").count(), 3, "{text}");
        let port = FoundPort {
            path: "/dev/ttyUSB0".to_owned(),
            name: "Silicon Labs CP2102".to_owned(),
            usb: Some((0x10c4, 0xea60)),
            problem: None,
        };
        let senders = [3, 5].map(|node| Sender { protocol: Protocol::Odrive, node });
        let bus = FoundBus { name: "can0".to_owned(), problem: None, senders: senders.to_vec() };
        assert_eq!(bus.pair(), Some(senders));
        let denied = FoundCamera {
            device: "/dev/video0".to_owned(),
            name: String::new(),
            offer: Err(V4l2Error::Denied { device: "/dev/video0".into() }),
        };
        let found = Found {
            cameras: vec![denied],
            ports: vec![port],
            buses: vec![bus],
            imus: vec!["bmi160".to_owned()],
            simulated: None,
        };
        let text = found.lines().join("\n");
        for part in [
            "camera   /dev/video0: no permission for /dev/video0; add the user to the group `video`",
            "port     /dev/ttyUSB0: Silicon Labs CP2102; USB 10c4:ea60",
            "CAN bus  can0: heard: ODrive 3, ODrive 5",
            "IMU      bmi160: to use it, set devices.imu.device = \"bmi160\"",
        ] {
            assert!(text.contains(part), "{part} in {text}");
        }
    }

    #[test]
    fn two_nodes_of_different_protocols_are_no_pair() {
        let senders =
            [Protocol::Odrive, Protocol::Vesc].map(|protocol| Sender { protocol, node: 1 });
        let bus = FoundBus { name: "can0".to_owned(), problem: None, senders: senders.to_vec() };
        assert_eq!(bus.pair(), None);
    }
}
