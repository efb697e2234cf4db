//! Sets exposure, gain and white balance to automatic or a fixed value, and reads them back.

use std::sync::Arc;

use rustix::io::Errno;

use super::config::{CameraDeviceConfig, Setting};
use super::error::V4l2Error;
use super::node::VideoNode;

/// A setting that consists of two controls: one for its value, and one that selects manual or
/// automatic mode.
#[derive(Debug)]
struct ControlPair {
    name: &'static str,
    value: u32,
    mode: u32,
    manual: i32,
    /// The values of the automatic mode, in the order in which they are tried.
    automatic: &'static [i32],
}

/// `V4L2_CID_EXPOSURE_ABSOLUTE` counts in 100 microseconds. Automatic is 3 (aperture priority) on
/// USB cameras, 0 on others.
const EXPOSURE: ControlPair = ControlPair {
    name: "exposure",
    value: 0x009a_0902,
    mode: 0x009a_0901,
    manual: 1,
    automatic: &[3, 0],
};
const GAIN: ControlPair =
    ControlPair { name: "gain", value: 0x0098_0913, mode: 0x0098_0912, manual: 0, automatic: &[1] };
const WHITE_BALANCE: ControlPair = ControlPair {
    name: "white balance",
    value: 0x0098_091a,
    mode: 0x0098_090c,
    manual: 0,
    automatic: &[1],
};

/// The unit of the exposure time control.
pub const EXPOSURE_UNIT_US: i32 = 100;

/// Applies the settings that the configuration names.
///
/// # Errors
/// When the camera has no such control, or refuses the value.
pub fn apply(
    node: &mut dyn VideoNode,
    config: &CameraDeviceConfig,
    device: &Arc<str>,
) -> Result<(), V4l2Error> {
    let exposure = config.exposure_us.map(|setting| match setting {
        Setting::Auto => Setting::Auto,
        Setting::Manual(us) => Setting::Manual(us / EXPOSURE_UNIT_US),
    });
    for (pair, setting) in
        [(EXPOSURE, exposure), (GAIN, config.gain), (WHITE_BALANCE, config.white_balance_k)]
    {
        if let Some(setting) = setting {
            pair.set(node, setting).map_err(|why| V4l2Error::Control {
                device: device.clone(),
                control: pair.name,
                value: match setting {
                    Setting::Auto => "automatic".to_owned(),
                    Setting::Manual(value) => value.to_string(),
                },
                why,
            })?;
        }
    }
    Ok(())
}

impl ControlPair {
    fn set(&self, node: &mut dyn VideoNode, setting: Setting) -> Result<(), String> {
        match setting {
            Setting::Auto
                if self
                    .automatic
                    .iter()
                    .any(|mode| set_and_verify(node, self.mode, *mode).is_ok()) =>
            {
                Ok(())
            }
            Setting::Auto => {
                Err("the camera has no automatic mode for it; configure a number".to_owned())
            }
            Setting::Manual(value) => {
                // A camera without a mode control has no automatic mode to switch off.
                if node.control(self.mode).is_ok_and(|control| !control.disabled) {
                    set_and_verify(node, self.mode, self.manual)?;
                }
                set_and_verify(node, self.value, value)
            }
        }
    }
}

/// Sets a control and verifies it by reading it back.
fn set_and_verify(node: &mut dyn VideoNode, id: u32, value: i32) -> Result<(), String> {
    let control = match node.control(id) {
        Ok(control) if !control.disabled => control,
        Ok(_) | Err(Errno::INVAL) => {
            return Err("the camera has no such control; leave it out".to_owned());
        }
        Err(errno) => return Err(format!("asking for its range failed ({errno})")),
    };
    if !(control.minimum..=control.maximum).contains(&value) {
        return Err(format!("it goes from {} to {}", control.minimum, control.maximum));
    }
    node.set_control(id, value).map_err(|errno| format!("the camera refuses it ({errno})"))?;
    let actual =
        node.control_value(id).map_err(|errno| format!("reading it back failed ({errno})"))?;
    // The camera rounds a value between two steps to one of them.
    if actual.abs_diff(value) >= control.step.unsigned_abs().max(1) {
        return Err(format!("the camera set it to {actual} instead"));
    }
    Ok(())
}
