//! What the driver of a rotating scanner has to know.

use hal::ScanGeometry;

use super::Mount;
use crate::scanner::Port;

/// What the driver of every rotating scanner has to know.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) port: Port,
    /// The scanner's name in messages.
    pub(crate) device: &'static str,
    pub(crate) baud: u32,
    pub(crate) geometry: ScanGeometry,
    pub(crate) mount: Mount,
    /// Consecutive valid scans that are needed before the scanner counts as working.
    pub(crate) good_scans: u32,
}

/// Where the scanner is and how it is mounted, which every driver of a rotating scanner takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    pub port: Port,
    pub mount: Mount,
    /// Consecutive valid scans that are needed before the scanner counts as working.
    pub good_scans: u32,
}

impl Place {
    /// An upright scanner at this port whose zero points ahead.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self { port, mount: Mount::default(), good_scans: 3 }
    }
}
