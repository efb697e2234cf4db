//! Reports in the log which devices do not work, and when they work again.

use super::status::DeviceHealth;

/// A device may take this long to start before it is reported, seconds.
const STARTS_WITHIN_S: f64 = 2.0;
/// A device is reported at most this often, seconds: one with a loose contact must not fill the log.
const EVERY_S: f64 = 10.0;

/// What the log says about the devices.
#[derive(Debug, Default)]
pub struct DeviceLog {
    /// Camera, scanner, base, and the inertial unit if there is one.
    reported: [Reported; 4],
}

#[derive(Debug)]
struct Reported {
    /// What does not work according to the log.
    problem: Option<String>,
    /// Uptime from which on the next report is due, seconds.
    due_s: f64,
}

impl Default for Reported {
    fn default() -> Self {
        Self { problem: None, due_s: STARTS_WITHIN_S }
    }
}

impl DeviceLog {
    /// Sentences about the devices whose state differs from what was reported last.
    pub fn changes<'a>(
        &mut self,
        devices: impl IntoIterator<Item = &'a DeviceHealth>,
        uptime_s: f64,
    ) -> Vec<String> {
        self.reported
            .iter_mut()
            .zip(devices)
            .filter_map(|(reported, device)| reported.change(device, uptime_s))
            .collect()
    }
}

impl Reported {
    fn change(&mut self, device: &DeviceHealth, uptime_s: f64) -> Option<String> {
        let problem = device.worry();
        if problem == self.problem || uptime_s < self.due_s {
            return None;
        }
        self.due_s = uptime_s + EVERY_S;
        self.problem = problem;
        let sentence = self.problem.clone();
        Some(sentence.unwrap_or_else(|| format!("{} works again", device.name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(name: &str, state: &str) -> DeviceHealth {
        let problem = (state != "working").then(|| "plug it in".to_owned());
        DeviceHealth {
            name: name.to_owned(),
            state: state.to_owned(),
            problem,
            ..DeviceHealth::default()
        }
    }

    #[test]
    fn a_missing_device_is_reported_once_with_its_remedy_and_again_when_it_works() {
        let mut log = DeviceLog::default();
        let [camera, lidar] = [device("camera", "working"), device("LiDAR", "working")];
        let missing = device("base can0", "disconnected");
        assert!(log.changes([&camera, &lidar, &missing], 0.5).is_empty(), "it may still start");
        let said = log.changes([&camera, &lidar, &missing], 2.5);
        assert_eq!(said, ["base can0 is disconnected: plug it in"]);
        assert!(log.changes([&camera, &lidar, &missing], 60.0).is_empty(), "said already");
        let base = device("base can0", "working");
        assert_eq!(log.changes([&camera, &lidar, &base], 61.0), ["base can0 works again"]);
    }

    #[test]
    fn a_loose_contact_is_reported_every_ten_seconds_at_most() {
        let mut log = DeviceLog::default();
        let well = device("x", "working");
        let states = [device("x", "silent"), device("x", "working")];
        let said: usize = (0..100)
            .map(|step| log.changes([&well, &states[step % 2], &well], step as f64 * 0.5).len())
            .sum();
        assert!((4..=5).contains(&said), "{said} in 50 s");
    }
}
