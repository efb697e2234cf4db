//! A change of the calibration in words.

use crate::calibration_watch::{Change, Manner, Watched, Withdrawal};

/// What has changed, by how much and since when. `health` and logs show it.
#[must_use]
pub fn changed(change: &Change) -> String {
    let Change { what, by, sigma, since_m, manner, .. } = change;
    let manner = match manner {
        Manner::AtOnce => "at once",
        Manner::Slowly => "little by little",
    };
    format!(
        "calibration changed {manner} after {since_m:.0} m of this run: {} (+- {})",
        by_how_much(*what, *by),
        size(*what, *sigma)
    )
}

/// That a reported change was not confirmed.
#[must_use]
pub fn withdrawn(withdrawal: &Withdrawal) -> String {
    let Withdrawal { what, still, sigma } = withdrawal;
    format!(
        "a reported change of the calibration is not confirmed: {} differs from before it by {} (+- {})",
        name(*what),
        size(*what, *still),
        size(*what, *sigma)
    )
}

fn name(what: Watched) -> &'static str {
    match what {
        Watched::WheelHeading => "the yaw per metre by the wheels",
        Watched::WheelTrack => "the track",
        Watched::WheelDistance => "the distance by the wheels",
        Watched::LidarYaw => "the LiDAR's yaw",
        Watched::LidarForward | Watched::LidarLeft => "the LiDAR's place",
        Watched::CameraPitch => "the camera's pitch",
        Watched::CameraYaw => "the camera's yaw",
        Watched::CameraRoll => "the camera's roll",
        Watched::CameraLatency => "the latency of frames",
        Watched::LidarLatency => "the latency of scans",
        Watched::WheelLatency => "the latency of the wheels",
    }
}

/// The parameter and its change, with the direction in words.
fn by_how_much(what: Watched, by: f64) -> String {
    let size = size(what, by);
    match what {
        Watched::WheelHeading => {
            let larger = direction(by, "right", "left");
            let smaller = direction(by, "left", "right");
            format!("the {larger} wheel is larger or the {smaller} one smaller, {size} of yaw")
        }
        Watched::WheelTrack => {
            format!("the track is {} by {size}", direction(by, "narrower", "wider"))
        }
        Watched::WheelDistance => {
            format!("both wheels are {} by {size}", direction(by, "larger", "smaller"))
        }
        Watched::LidarYaw => {
            format!("the LiDAR points {size} more to the {}", direction(by, "left", "right"))
        }
        Watched::LidarForward => {
            format!("the LiDAR is {size} more {}", direction(by, "forward", "backward"))
        }
        Watched::LidarLeft => {
            format!("the LiDAR is {size} more to the {}", direction(by, "left", "right"))
        }
        Watched::CameraPitch => {
            format!("the camera points {size} more {}", direction(by, "down", "up"))
        }
        Watched::CameraYaw => {
            format!("the camera points {size} more to the {}", direction(by, "left", "right"))
        }
        Watched::CameraRoll => {
            format!("the {} side of the camera is {size} lower", direction(by, "right", "left"))
        }
        Watched::CameraLatency => {
            format!("frames come {size} {}", direction(by, "later", "earlier"))
        }
        Watched::LidarLatency => {
            format!("scans come {size} {}", direction(by, "later", "earlier"))
        }
        Watched::WheelLatency => {
            format!("the wheels' reports come {size} {}", direction(by, "later", "earlier"))
        }
    }
}

fn direction(by: f64, more: &'static str, less: &'static str) -> &'static str {
    if by > 0.0 { more } else { less }
}

fn size(what: Watched, value: f64) -> String {
    let value = value.abs();
    match what {
        Watched::WheelHeading => format!("{:.1} degrees/m", value.to_degrees()),
        Watched::WheelTrack | Watched::WheelDistance => format!("{:.1} %", 100.0 * value),
        Watched::LidarForward | Watched::LidarLeft => format!("{:.0} mm", 1000.0 * value),
        Watched::CameraLatency | Watched::LidarLatency | Watched::WheelLatency => {
            format!("{:.0} ms", 1000.0 * value)
        }
        _ => format!("{:.1} degrees", value.to_degrees()),
    }
}
