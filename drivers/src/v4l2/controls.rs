//! Exposure, gain and white balance: switched to automatic or fixed, and read back.

use std::sync::Arc;

use rustix::io::Errno;

use super::config::{CameraDeviceConfig, Setting};
use super::error::V4l2Error;
use super::node::VideoNode;

/// A setting: a control for its value, and one that says who chooses it.
#[derive(Debug)]
struct Knob {
    name: &'static str,
    value: u32,
    mode: u32,
    manual: i32,
    /// In the order in which they are tried.
    automatic: &'static [i32],
}

/// `V4L2_CID_EXPOSURE_ABSOLUTE` counts in 100 microseconds. Automatic is 3 (aperture priority) on USB cameras, 0 on others.
const EXPOSURE: Knob =
    Knob { name: "exposure", value: 0x009a_0902, mode: 0x009a_0901, manual: 1, automatic: &[3, 0] };
const GAIN: Knob =
    Knob { name: "gain", value: 0x0098_0913, mode: 0x0098_0912, manual: 0, automatic: &[1] };
const WHITE_BALANCE: Knob = Knob {
    name: "white balance",
    value: 0x0098_091a,
    mode: 0x0098_090c,
    manual: 0,
    automatic: &[1],
};

/// Exposure times are counted in these.
pub const EXPOSURE_UNIT_US: i32 = 100;

/// Sets what the configuration names.
///
/// # Errors
/// When the camera has no such control, or it cannot have this value.
pub fn apply(
    node: &mut dyn VideoNode,
    config: &CameraDeviceConfig,
    device: &Arc<str>,
) -> Result<(), V4l2Error> {
    let exposure = config.exposure_us.map(|setting| match setting {
        Setting::Auto => Setting::Auto,
        Setting::Manual(us) => Setting::Manual(us / EXPOSURE_UNIT_US),
    });
    for (knob, setting) in
        [(EXPOSURE, exposure), (GAIN, config.gain), (WHITE_BALANCE, config.white_balance_k)]
    {
        if let Some(setting) = setting {
            knob.set(node, setting).map_err(|why| V4l2Error::Control {
                device: device.clone(),
                control: knob.name,
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

impl Knob {
    fn set(&self, node: &mut dyn VideoNode, setting: Setting) -> Result<(), String> {
        match setting {
            Setting::Auto
                if self.automatic.iter().any(|mode| hold(node, self.mode, *mode).is_ok()) =>
            {
                Ok(())
            }
            Setting::Auto => {
                Err("the camera cannot choose it by itself; configure a number".to_owned())
            }
            Setting::Manual(value) => {
                // A camera without the switch has nothing to switch off.
                if node.control(self.mode).is_ok_and(|control| !control.disabled) {
                    hold(node, self.mode, self.manual)?;
                }
                hold(node, self.value, value)
            }
        }
    }
}

/// Sets a control and reads back that it holds.
fn hold(node: &mut dyn VideoNode, id: u32, value: i32) -> Result<(), String> {
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
    let now =
        node.control_value(id).map_err(|errno| format!("reading it back failed ({errno})"))?;
    // A value between two steps is rounded to one of them.
    if now.abs_diff(value) >= control.step.unsigned_abs().max(1) {
        return Err(format!("the camera holds {now} instead"));
    }
    Ok(())
}
