//! What is asked: one entry for each question, with its words and the keys that its answer sets.
//!
//! Units, ranges, choices and defaults of numbers are those of the keys, as the sections of the configuration declare them.

use std::sync::LazyLock;

use drivers::can::config::OdriveConfig;
use hal::settings::{Key, Kind, Range};

use super::answers::{Answer, Answers};
use super::found::Found;
use crate::config::Config;

/// A question of `init`, and the keys that its answer sets.
#[derive(Debug)]
pub struct Question {
    /// Its name in a file of answers.
    pub key: &'static str,
    /// The question, for a person in front of the robot.
    pub words: &'static str,
    /// How to find the answer; may be empty.
    pub help: &'static str,
    /// What an answer is.
    pub asked: Asked,
    /// It is asked only after this question had one of these answers.
    pub only_with: Option<(&'static str, &'static [&'static str])>,
    /// The keys that the answer sets, in the order of its numbers.
    pub sets: &'static [Sets],
}

/// A key of the configuration that an answer sets.
#[derive(Debug)]
pub struct Sets {
    /// Full name of the key.
    pub key: &'static str,
    /// Its comment in the file, with the unit.
    pub comment: &'static str,
    /// The key is written even if it has its default, because every robot must measure it.
    pub always: bool,
}

/// What an answer is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Asked {
    /// The name of a device of this kind.
    Device(Device),
    /// One of the texts of the key.
    Choice,
    /// A scanner, by its model.
    Scanner,
    /// One number for each key. With one key more than numbers, the last number is for both.
    Numbers(usize),
    /// Version and endpoints of an ODrive's firmware.
    Endpoints,
    /// An angle within the range of another key, from which the keys are computed.
    FieldOfView,
}

/// The kinds of devices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Device {
    Camera,
    /// The port of a scanner.
    Port,
    /// A CAN bus.
    Bus,
}

/// The scanners that rotate slowly, whose zero may point anywhere.
const ROTARY: &[&str] = &["rplidar-a1", "rplidar-a2", "rplidar-a3", "rplidar-s2", "ld06"];
/// The key whose range a field of view has.
const FIELD_OF_VIEW: &str = "camera.horizontal_fov_deg";

const fn measured(key: &'static str, comment: &'static str) -> Sets {
    Sets { key, comment, always: true }
}

const fn if_other(key: &'static str, comment: &'static str) -> Sets {
    Sets { key, comment, always: false }
}

/// All questions, in their order. At most fifteen of them are asked.
pub const QUESTIONS: &[Question] = &[
    Question {
        key: "camera",
        words: "Which camera does the robot look through?",
        help: "",
        asked: Asked::Device(Device::Camera),
        only_with: None,
        sets: &[measured("devices.camera.device", "The camera.")],
    },
    Question {
        key: "camera_place_m",
        words: "Where is its lens: height above the floor, and distance ahead of the axle?",
        help: "Two numbers. Behind the axle is negative.",
        asked: Asked::Numbers(2),
        only_with: None,
        sets: &[
            measured("camera.height_m", "Lens above the floor, m."),
            measured("camera.forward_m", "Lens ahead of the middle of the axle, m."),
        ],
    },
    Question {
        key: "camera_pitch_down_deg",
        words: "How far does it look down?",
        help: "0 is level. At 16 the camera sees the floor, and stairs down, from 1.25 m on.",
        asked: Asked::Numbers(1),
        only_with: None,
        sets: &[measured("camera.pitch_down_deg", "Optical axis below the horizon, degrees.")],
    },
    Question {
        key: "camera_fov_deg",
        words: "How wide is its view, from the left to the right edge of the image?",
        help: "From the data sheet; many webcams have 60. A calibration replaces it.",
        asked: Asked::FieldOfView,
        only_with: None,
        sets: &[],
    },
    Question {
        key: "lidar_port",
        words: "Where is the safety LiDAR connected?",
        help: "A scanner on Ethernet is tcp:ADDRESS, such as tcp:192.168.0.10",
        asked: Asked::Device(Device::Port),
        only_with: None,
        sets: &[measured("devices.lidar.port", "The port of the safety LiDAR.")],
    },
    Question {
        key: "lidar",
        words: "Which scanner is it?",
        help: "An LD19 is an ld06.",
        asked: Asked::Scanner,
        only_with: None,
        sets: &[],
    },
    Question {
        key: "lidar_place_m",
        words: "Where is it: height of its beams above the floor, and distance ahead of the axle?",
        help: "Two numbers. Behind the axle is negative.",
        asked: Asked::Numbers(2),
        only_with: None,
        sets: &[
            measured("lidar.height_m", "Beams above the floor, m."),
            measured("lidar.forward_m", "Scanner ahead of the middle of the axle, m."),
        ],
    },
    Question {
        key: "lidar_zero_deg",
        words: "Where does its zero point?",
        help: "0 is ahead, 90 left, 180 back, -90 right. The maker's drawing shows the zero; in the live view, what stands ahead must be ahead.",
        asked: Asked::Numbers(1),
        only_with: Some(("lidar", ROTARY)),
        sets: &[measured(
            "devices.lidar.zero_deg",
            "Its zero, counter-clockwise from ahead, degrees.",
        )],
    },
    Question {
        key: "bus",
        words: "On which CAN bus are the motors?",
        help: "",
        asked: Asked::Device(Device::Bus),
        only_with: None,
        sets: &[measured("devices.base.bus", "The CAN bus of the motors.")],
    },
    Question {
        key: "protocol",
        words: "What do the motor controllers speak?",
        help: "cia402 are CANopen drives.",
        asked: Asked::Choice,
        only_with: None,
        sets: &[if_other("devices.base.protocol", "What the motor controllers speak.")],
    },
    Question {
        key: "nodes",
        words: "Which node is the left motor's controller, and which the right one's?",
        help: "Two numbers. If you do not know which is which: --turn-wheels finds out.",
        asked: Asked::Numbers(2),
        only_with: None,
        sets: &[
            if_other("devices.base.left_node", "Controller of the left wheel."),
            if_other("devices.base.right_node", "Controller of the right wheel."),
        ],
    },
    Question {
        key: "odrive",
        words: "Which firmware do the ODrives have, and which of its endpoints are axis0.config.enable_watchdog and axis0.config.watchdog_timeout?",
        help: "The version and two numbers, or the path of its flat_endpoints.json. 0 means unknown; the robot does not drive until both endpoints are set.",
        asked: Asked::Endpoints,
        only_with: Some(("protocol", &["odrive"])),
        sets: &[],
    },
    Question {
        key: "pole_pairs",
        words: "How many pole pairs does each motor have?",
        help: "Half the number of its magnets.",
        asked: Asked::Numbers(1),
        only_with: Some(("protocol", &["vesc"])),
        sets: &[if_other("devices.base.vesc.pole_pairs", "Half the number of magnets of a motor.")],
    },
    Question {
        key: "counts_per_turn",
        words: "How many units of position has one turn of a motor, in the drive's own settings?",
        help: "Velocities are taken to be these units a second.",
        asked: Asked::Numbers(1),
        only_with: Some(("protocol", &["cia402"])),
        sets: &[
            if_other(
                "devices.base.cia402.position_units",
                "Units of position in a turn of the motor.",
            ),
            if_other(
                "devices.base.cia402.velocity_units",
                "Units of velocity at one turn a second.",
            ),
        ],
    },
    Question {
        key: "wheels_m",
        words: "How large are the wheels: radius, and distance between the middles of their treads?",
        help: "Two numbers. Measure to 1 mm. To find the radius, push the robot until a wheel has made ten revolutions and divide the distance by 62.83.",
        asked: Asked::Numbers(2),
        only_with: None,
        sets: &[
            measured("devices.base.wheel_radius_m", "Radius of the driven wheels, m."),
            measured("devices.base.track_m", "Between the middles of their treads, m."),
        ],
    },
    Question {
        key: "gear_ratio",
        words: "How many turns does a motor make in one turn of its wheel?",
        help: "1 without a gearbox.",
        asked: Asked::Numbers(1),
        only_with: None,
        sets: &[measured("devices.base.gear_ratio", "Turns of the motor in a turn of the wheel.")],
    },
    Question {
        key: "footprint_radius_m",
        words: "How far from the middle of the axle is the farthest point of the robot?",
        help: "",
        asked: Asked::Numbers(1),
        only_with: None,
        sets: &[measured(
            "base.footprint_radius_m",
            "Circle around the axle's middle that contains the robot, m.",
        )],
    },
];

/// The default configuration as TOML, for the defaults of keys.
static DEFAULTS: LazyLock<toml::Table> = LazyLock::new(|| {
    let text = Config::default().to_toml().unwrap_or_default();
    text.parse().unwrap_or_default()
});

/// The declaration of a key.
pub fn setting(path: &str) -> Option<&'static Key> {
    let mut section = &Config::SECTION;
    let mut parts = path.split('.').peekable();
    while let Some(part) = parts.next() {
        let key = section.keys.iter().find(|key| key.name == part)?;
        match (&key.kind, parts.peek()) {
            (_, None) => return Some(key),
            (Kind::Table(inner), _) => section = inner,
            _ => return None,
        }
    }
    None
}

/// The default of a key, as TOML.
pub fn default_value(path: &str) -> Option<&'static toml::Value> {
    let mut parts = path.split('.');
    let first = DEFAULTS.get(parts.next()?)?;
    parts.try_fold(first, |value, part| value.get(part))
}

fn default_number(path: &str) -> f64 {
    let value = default_value(path);
    let integer = value.and_then(toml::Value::as_integer).map(|number| number as f64);
    value.and_then(toml::Value::as_float).or(integer).unwrap_or(0.0)
}

/// The scanners, by the names that `hil world` has for them, too.
pub fn scanners() -> Vec<String> {
    let hokuyo = choices_of("devices.lidar.model").iter().map(|model| (*model).to_owned());
    let rplidar = choices_of("devices.lidar.rplidar.model").iter();
    hokuyo
        .chain(rplidar.map(|model| format!("rplidar-{model}")))
        .chain(["ld06".to_owned()])
        .collect()
}

fn choices_of(path: &str) -> &'static [&'static str] {
    match setting(path).map(|key| &key.kind) {
        Some(Kind::Choice(choices)) => choices,
        _ => &[],
    }
}

impl Question {
    /// Whether it has to be asked after these answers.
    pub fn applies(&self, answers: &Answers) -> bool {
        self.only_with.is_none_or(|(key, values)| {
            answers.text(key).is_some_and(|given| values.contains(&given))
        })
    }

    /// The ranges of its numbers.
    pub fn ranges(&self) -> Vec<Option<Range>> {
        match self.asked {
            Asked::Numbers(count) => {
                self.sets.iter().take(count).map(|sets| setting(sets.key)?.range).collect()
            }
            Asked::FieldOfView => vec![setting(FIELD_OF_VIEW).and_then(|key| key.range)],
            _ => Vec::new(),
        }
    }

    /// The ranges of its numbers in words.
    pub fn allowed(&self) -> Option<String> {
        let texts: Vec<&str> =
            self.ranges().iter().map(|range| range.map_or("", |it| it.text)).collect();
        (!texts.is_empty()).then(|| texts.join(", and "))
    }

    /// Whether its number of this place is a whole one.
    pub fn is_whole(&self, place: usize) -> bool {
        let key = self.sets.get(place).and_then(|sets| setting(sets.key));
        key.is_some_and(|key| matches!(key.kind, Kind::Integer))
    }

    /// What may be chosen, in the order in which it is shown; empty for numbers.
    pub fn options(&self, found: &Found) -> Vec<String> {
        match self.asked {
            Asked::Device(Device::Camera) => names(&found.cameras, |camera| &camera.device),
            Asked::Device(Device::Port) => names(&found.ports, |port| &port.path),
            Asked::Device(Device::Bus) => names(&found.buses, |bus| &bus.name),
            Asked::Choice => {
                let key = self.sets.first().map_or("", |sets| sets.key);
                choices_of(key).iter().map(|choice| (*choice).to_owned()).collect()
            }
            Asked::Scanner => scanners(),
            Asked::Numbers(_) | Asked::FieldOfView | Asked::Endpoints => Vec::new(),
        }
    }

    /// The answer of a person who presses Enter.
    pub fn default(&self, found: &Found, answers: &Answers) -> Answer {
        match self.asked {
            Asked::Device(_) => Answer::Text(self.default_device(found)),
            Asked::Scanner => Answer::Text(likely_scanner(found, answers)),
            Asked::Choice => Answer::Text(self.default_choice(found, answers)),
            Asked::Endpoints => Answer::Text(unknown_endpoints()),
            Asked::FieldOfView => Answer::Numbers(vec![default_number(FIELD_OF_VIEW)]),
            Asked::Numbers(count) => {
                let keys = self.sets.iter().take(count);
                let heard = (self.key == "nodes").then(|| heard_nodes(found, answers)).flatten();
                Answer::Numbers(
                    heard.unwrap_or_else(|| keys.map(|it| default_number(it.key)).collect()),
                )
            }
        }
    }

    /// The first device of its kind that works, else the first one, else the default of the key.
    fn default_device(&self, found: &Found) -> String {
        let options = self.options(found);
        let key = self.sets.first().map_or("", |sets| sets.key);
        let default = default_value(key).and_then(toml::Value::as_str).unwrap_or("");
        let working = match self.asked {
            Asked::Device(Device::Camera) => found.cameras.iter().position(|it| it.offer.is_ok()),
            Asked::Device(Device::Port) => likely_port(found),
            _ => found.buses.iter().position(|it| !it.senders.is_empty()),
        };
        options.get(working.unwrap_or(0)).map_or(default, String::as_str).to_owned()
    }

    fn default_choice(&self, found: &Found, answers: &Answers) -> String {
        let key = self.sets.first().map_or("", |sets| sets.key);
        let default = default_value(key).and_then(toml::Value::as_str).unwrap_or("");
        let heard = heard(found, answers).map(|[first, _]| first.protocol);
        let heard = heard.and_then(|protocol| toml::Value::try_from(protocol).ok());
        heard.as_ref().and_then(toml::Value::as_str).unwrap_or(default).to_owned()
    }
}

/// The firmware of the defaults, and two endpoints that are not known.
fn unknown_endpoints() -> String {
    let [major, minor, revision] = OdriveConfig::default().firmware;
    format!("{major}.{minor}.{revision} 0 0")
}

fn names<T>(found: &[T], name: impl Fn(&T) -> &String) -> Vec<String> {
    found.iter().map(|it| name(it).clone()).collect()
}

/// The vendor of Hokuyo's scanners on USB (usb.ids).
const HOKUYO: u16 = 0x15d1;

/// A port that can be opened, those with Hokuyo's own USB identity first.
fn likely_port(found: &Found) -> Option<usize> {
    let usable = found.ports.iter().enumerate().filter(|(_, port)| port.problem.is_none());
    let likely = usable.min_by_key(|(_, port)| {
        let is_hokuyo = port.usb.is_some_and(|(vendor, _)| vendor == HOKUYO);
        !is_hokuyo
    });
    likely.map(|(index, _)| index)
}

/// The vendors of the USB serial adapters that come with an RPLIDAR, LD06 or LD19: Silicon Labs and WCH (usb.ids).
const ADAPTERS: [u16; 2] = [0x10c4, 0x1a86];

/// The scanner that is likely at the port that was named.
fn likely_scanner(found: &Found, answers: &Answers) -> String {
    let path = answers.text("lidar_port").unwrap_or("");
    let usb = found.ports.iter().find(|port| port.path == path).and_then(|port| port.usb);
    let name = match usb {
        Some((vendor, _)) if ADAPTERS.contains(&vendor) => "rplidar-a1",
        _ => default_value("devices.lidar.model").and_then(toml::Value::as_str).unwrap_or(""),
    };
    name.to_owned()
}

/// The two controllers on the bus that was named.
fn heard(found: &Found, answers: &Answers) -> Option<[drivers::can::sender::Sender; 2]> {
    let bus = answers.text("bus")?;
    found.buses.iter().find(|it| it.name == bus)?.pair()
}

fn heard_nodes(found: &Found, answers: &Answers) -> Option<Vec<f64>> {
    let [left, right] = heard(found, answers)?;
    Some(vec![f64::from(left.node), f64::from(right.node)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::init::answers::typed;
    use crate::init::found::{FoundBus, FoundCamera, FoundPort, FrameOffer};
    use drivers::can::Protocol;
    use drivers::can::sender::Sender;
    use drivers::v4l2::V4l2Error;

    #[test]
    fn at_most_fifteen_questions_are_asked_whatever_the_answers_are() {
        for scanner in scanners() {
            for protocol in choices_of("devices.base.protocol") {
                let mut answers = Answers::default();
                answers.put("lidar", Answer::Text(scanner.clone()));
                answers.put("protocol", Answer::Text((*protocol).to_owned()));
                let count = QUESTIONS.iter().filter(|question| question.applies(&answers)).count();
                assert!(count <= 15, "{count} questions with {scanner} and {protocol}");
            }
        }
    }

    #[test]
    fn every_question_sets_keys_that_exist_and_each_number_has_a_range() {
        for question in QUESTIONS {
            for sets in question.sets {
                assert!(setting(sets.key).is_some(), "{}", sets.key);
                assert!(default_value(sets.key).is_some(), "{}", sets.key);
            }
            assert!(question.ranges().iter().all(Option::is_some), "{}", question.key);
        }
    }

    fn camera(device: &str, works: bool) -> FoundCamera {
        let denied = V4l2Error::Denied { device: device.into() };
        let offer =
            FrameOffer { formats: Vec::new(), format: None, width: 640, height: 480, fps: None };
        let offer = if works { Ok(offer) } else { Err(denied) };
        FoundCamera { device: device.to_owned(), name: String::new(), offer }
    }

    #[test]
    fn of_two_cameras_the_one_that_can_be_opened_is_suggested_and_the_other_can_be_chosen() {
        let cameras = vec![camera("/dev/video0", false), camera("/dev/video2", true)];
        let found = Found { cameras, ..Found::default() };
        let question = &QUESTIONS[0];
        let suggested = question.default(&found, &Answers::default());
        assert_eq!(suggested, Answer::Text("/dev/video2".to_owned()));
        let chosen = typed(question, "1", &found, &Answers::default());
        assert_eq!(chosen, Ok(Answer::Text("/dev/video0".to_owned())));
    }

    #[test]
    fn a_scanner_is_suggested_by_the_usb_identity_of_its_port_and_motors_by_what_is_heard() {
        let heard = [7, 9].map(|node| Sender { protocol: Protocol::Vesc, node }).to_vec();
        let bus = FoundBus { name: "can1".to_owned(), problem: None, senders: heard };
        let found = Found {
            ports: vec![port("/dev/a", (0x10c4, 0xea60)), port("/dev/b", (HOKUYO, 0))],
            buses: vec![bus],
            ..Found::default()
        };
        let mut answers = Answers::default();
        assert_eq!(suggested(&found, "lidar_port", &answers), "/dev/b");
        assert_eq!(suggested(&found, "bus", &answers), "can1");
        answers.put("lidar_port", Answer::Text("/dev/a".to_owned()));
        answers.put("bus", Answer::Text("can1".to_owned()));
        assert_eq!(suggested(&found, "lidar", &answers), "rplidar-a1");
        assert_eq!(suggested(&found, "protocol", &answers), "vesc");
        assert_eq!(suggested(&found, "nodes", &answers), "7 9");
    }

    fn port(path: &str, usb: (u16, u16)) -> FoundPort {
        FoundPort { path: path.to_owned(), name: String::new(), usb: Some(usb), problem: None }
    }

    fn suggested(found: &Found, key: &str, answers: &Answers) -> String {
        let question = QUESTIONS.iter().find(|question| question.key == key).unwrap();
        question.default(found, answers).to_string()
    }

    #[test]
    fn scanners_have_one_name_each() {
        let names = scanners();
        assert_eq!(names.len(), 9, "{names:?}");
        assert!(ROTARY.iter().all(|name| names.contains(&(*name).to_owned())));
    }
}
