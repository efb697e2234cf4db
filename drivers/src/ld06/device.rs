//! The driver's part that only an LD06 or LD19 needs. It cannot be asked for anything.

use super::{BAUD, Decoder, Ld06Config};
use crate::rotary::{Device, Event, Place, RotaryError, RotaryLidar, Settings, WireError};
use crate::scanner::{End, Identity, Link};

/// The name of the scanners in messages.
const NAME: &str = "LD06 or LD19";

/// Starts the driver. The scanner may be connected later.
///
/// # Errors
/// [`RotaryError::Config`] when the configuration is invalid; [`RotaryError::Link`] when the system
/// cannot create a thread or descriptor.
pub fn open(place: Place, config: &Ld06Config) -> Result<RotaryLidar, RotaryError> {
    config.validate()?;
    let settings = Settings {
        port: place.port,
        device: NAME,
        baud: BAUD,
        geometry: place.mount.geometry(config.geometry()),
        mount: place.mount,
        good_scans: place.good_scans,
    };
    let min_confidence = config.min_confidence;
    let decoder = Decoder::new(min_confidence);
    RotaryLidar::start(settings, Box::new(Ld06 { min_confidence, decoder }))
}

struct Ld06 {
    min_confidence: u8,
    decoder: Decoder,
}

impl Device for Ld06 {
    fn bring_up(&mut self, _link: &Link) -> Result<Identity, End<RotaryError>> {
        self.decoder = Decoder::new(self.min_confidence);
        Ok(Identity { model: NAME.to_owned(), ..Identity::default() })
    }

    fn push(&mut self, byte: u8, sink: &mut dyn FnMut(Event<WireError>)) {
        self.decoder.push(byte, |event| sink(event.map_error(WireError::from)));
    }

    fn shut_down(&mut self, _link: &Link) {}
}
