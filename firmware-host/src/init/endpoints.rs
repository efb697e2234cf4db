//! What has to be known of an ODrive's firmware: its version, and the numbers of two endpoints.

use std::path::Path;

use serde::Deserialize;
use std::collections::BTreeMap;

const ENABLE: &str = "axis0.config.enable_watchdog";
const TIMEOUT: &str = "axis0.config.watchdog_timeout";
const WANTED: &str = "it must be the version and both numbers, such as 0.6.10 195 196, or the path of flat_endpoints.json";

/// Version and endpoints. An endpoint of 0 is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Endpoints {
    /// Major, minor, revision.
    pub firmware: [u8; 3],
    /// The endpoint of `axis0.config.enable_watchdog`.
    pub enable_watchdog: u16,
    /// The endpoint of `axis0.config.watchdog_timeout`.
    pub watchdog_timeout: u16,
}

/// The parts of `flat_endpoints.json` that are read ("Arbitrary Parameter Access", docs.odriverobotics.com).
#[derive(Deserialize)]
struct FlatEndpoints {
    fw_version: String,
    endpoints: BTreeMap<String, Endpoint>,
}

#[derive(Deserialize)]
struct Endpoint {
    id: u16,
}

impl Endpoints {
    /// Reads `VERSION ENABLE TIMEOUT`, or the file at a path.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.ends_with(".json") {
            return Self::from_file(Path::new(text));
        }
        let words: Vec<&str> = text.split_whitespace().collect();
        let [version, enable, timeout] = words[..] else { return Err(not_allowed(text)) };
        Ok(Self {
            firmware: version_of(version).ok_or_else(|| not_allowed(text))?,
            enable_watchdog: enable.parse().map_err(|_| not_allowed(text))?,
            watchdog_timeout: timeout.parse().map_err(|_| not_allowed(text))?,
        })
    }

    fn from_file(path: &Path) -> Result<Self, String> {
        let name = path.display();
        let text = std::fs::read_to_string(path)
            .map_err(|error| format!("cannot read {name}: {error}"))?;
        let file: FlatEndpoints = serde_json::from_str(&text)
            .map_err(|error| format!("{name} is not a flat_endpoints.json: {error}"))?;
        let firmware = version_of(&file.fw_version).ok_or_else(|| {
            format!("{name} has the fw_version `{}`, not one such as 0.6.10", file.fw_version)
        })?;
        Ok(Self {
            firmware,
            enable_watchdog: id_of(&file, ENABLE, path)?,
            watchdog_timeout: id_of(&file, TIMEOUT, path)?,
        })
    }
}

fn not_allowed(text: &str) -> String {
    format!("`{text}` is not allowed: {WANTED}")
}

fn id_of(file: &FlatEndpoints, property: &str, path: &Path) -> Result<u16, String> {
    let endpoint = file.endpoints.get(property).map(|endpoint| endpoint.id);
    endpoint.ok_or_else(|| format!("{} has no {property}", path.display()))
}

fn version_of(text: &str) -> Option<[u8; 3]> {
    let parts: Option<Vec<u8>> = text.split('.').map(|part| part.parse().ok()).collect();
    parts?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: Endpoints =
        Endpoints { firmware: [0, 6, 10], enable_watchdog: 195, watchdog_timeout: 196 };

    #[test]
    fn version_and_numbers_are_read_and_anything_else_is_refused_with_an_example() {
        assert_eq!(Endpoints::parse("0.6.10 195 196"), Ok(KNOWN));
        for text in ["", "195 196", "0.6 195 196", "0.6.10 195", "0.6.10 195 99999", "0.6.10 a b"] {
            assert!(Endpoints::parse(text).unwrap_err().contains("0.6.10 195 196"), "{text}");
        }
    }

    #[test]
    fn the_makers_file_has_both_and_a_file_without_them_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flat_endpoints.json");
        let both = format!("{}, {}", endpoint(ENABLE, 195), endpoint(TIMEOUT, 196));
        assert_eq!(
            read(&path, &format!("{{\"fw_version\": \"0.6.10\", \"endpoints\": {{{both}}}}}")),
            Ok(KNOWN)
        );
        let one = endpoint(ENABLE, 195);
        let error =
            read(&path, &format!("{{\"fw_version\": \"0.6.10\", \"endpoints\": {{{one}}}}}"))
                .unwrap_err();
        assert!(error.contains(TIMEOUT), "{error}");
        assert!(read(&path, "{}").unwrap_err().contains("is not a flat_endpoints.json"));
        assert!(Endpoints::parse("/nowhere/a.json").unwrap_err().contains("cannot read /nowhere"));
    }

    fn read(path: &Path, text: &str) -> Result<Endpoints, String> {
        std::fs::write(path, text).unwrap();
        Endpoints::parse(path.to_str().unwrap())
    }

    fn endpoint(property: &str, id: u16) -> String {
        format!("\"{property}\": {{\"id\": {id}, \"type\": \"float\"}}")
    }
}
