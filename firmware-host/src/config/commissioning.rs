//! How the numbers are known that the safety plane assumes.

use serde::{Deserialize, Serialize};

/// How they are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Commissioning {
    /// It is not known how. For a bench, and for simulated devices.
    #[default]
    Unchecked,
    /// `firmware-host check --drive` has measured them.
    Measured,
    /// A person has measured them in another way.
    ByHand,
}

hal::choices!(Commissioning: "unchecked", "measured", "by_hand");
