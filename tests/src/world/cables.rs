//! Connections to devices that the kernel's own drivers serve.

use std::str::FromStr;

/// The two ends of a connection: the device that the simulated world opens, and the one that the
/// robot opens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cable {
    pub world: String,
    pub robot: String,
}

impl FromStr for Cable {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((world, robot)) if !world.is_empty() && !robot.is_empty() => {
                Ok(Self { world: world.to_owned(), robot: robot.to_owned() })
            }
            _ => Err(format!(
                "`{text}` does not name two ends; write OURS=ROBOT'S, such as can1=can0"
            )),
        }
    }
}

/// Devices that are reached through kernel drivers. The others are sockets and a pty.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Cables {
    /// V4L2 output that is looped back to the robot's camera, such as /dev/video1=/dev/video0.
    /// `v4l2-ctl` writes the frames; size and format of the output must have been set.
    #[arg(long, value_name = "OURS=ROBOT'S")]
    pub camera_at: Option<Cable>,
    /// Serial port that is wired to the robot's, such as /dev/ttyS1=/dev/ttyUSB0.
    #[arg(long, value_name = "OURS=ROBOT'S")]
    pub lidar_at: Option<Cable>,
    /// CAN interface on the robot's bus, such as can1=can0.
    #[arg(long, value_name = "OURS=ROBOT'S")]
    pub motors_at: Option<Cable>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cable_has_two_ends() {
        let cable = Cable { world: "can1".to_owned(), robot: "can0".to_owned() };
        assert_eq!("can1=can0".parse(), Ok(cable));
        for text in ["can0", "=can0", "can1=", ""] {
            assert!(
                text.parse::<Cable>().is_err_and(|error| error.contains("can1=can0")),
                "{text}"
            );
        }
    }
}
