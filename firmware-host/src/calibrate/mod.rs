//! `firmware-host calibrate`: wheels, mounts and latencies from a recorded drive.

mod base_path;
mod camera;
mod drive;
mod finding;
mod floor;
mod frames;
mod klt;
mod laser;
mod least_squares;
mod scan_path;
mod wheels;

use anyhow::Result;

use crate::cli::CalibrateArgs;
use crate::localize::log::Log;
use crate::recorded::Recorded;
use base_path::BasePath;
use camera::{CameraModelFit, CameraParameters};
use drive::Drive;
use finding::{Finding, Parameter};
use frames::FrameMatcher;
use laser::{LaserParameters, LaserResult};

/// Measures, and writes the file if every result is plausible.
///
/// # Errors
/// A drive that cannot be read or shows too little, or an implausible result. Nothing is written then.
pub fn run(args: &CalibrateArgs) -> Result<()> {
    let (drive, frames) = match (&args.recording, &args.log) {
        (Some(recording), _) => {
            let recorded = Recorded::open(recording)?;
            let mut frames = FrameMatcher::new(&recorded.run().camera)?;
            let drive = Drive::of_run(&recorded, &mut frames)?;
            let header = recorded.run();
            (drive, Some((frames.pairs, header.camera, header.t_base_camera)))
        }
        (None, Some(log)) => (Drive::of_log(&Log::read(log)?), None),
        (None, None) => anyhow::bail!("give --recording RUN or --log FILE"),
    };
    let result = laser::estimate(&drive)?;
    for finding in laser_findings(&drive, &result) {
        println!("{finding}");
    }
    println!("{:?} {:?} {:?}", result.spans, result.before, result.after);
    if let Some((pairs, camera, mount)) = frames {
        let base = BasePath::new(&drive.wheels, &result.path, &result.parameters);
        let configured = CameraParameters::configured(&mount);
        let height_m = mount.translation.z;
        let mut fit = CameraModelFit::new(camera, height_m, &base, &pairs);
        println!(
            "{} pairs, {} matches",
            pairs.len(),
            pairs.iter().map(|p| p.matches.len()).sum::<usize>()
        );
        let estimate = fit.estimate(&configured)?;
        let old = configured.to_vector();
        let list = [
            Parameter::CameraRoll,
            Parameter::CameraPitch,
            Parameter::CameraYaw,
            Parameter::CameraForward,
            Parameter::CameraLeft,
            Parameter::FocalLength,
            Parameter::CameraLatency,
        ];
        let units =
            [1f64.to_degrees(), 1f64.to_degrees(), 1f64.to_degrees(), 1.0, 1.0, 1.0, 1000.0];
        for (index, (parameter, unit)) in list.into_iter().zip(units).enumerate() {
            let finding = Finding {
                parameter,
                old: unit * old[index],
                new: unit * estimate.parameters[index],
                sigma: unit * estimate.sigma(index),
            };
            println!("{finding}");
        }
        let at = CameraParameters::from_vector(&estimate.parameters);
        println!(
            "{:?} px; height {:?}",
            fit.sigma_px,
            floor::height(&fit.low_points(&at), height_m)
        );
    }
    Ok(())
}

/// The findings about wheels and scanner.
fn laser_findings(drive: &Drive, result: &LaserResult) -> Vec<Finding> {
    let old = LaserParameters::configured(&drive.configured).to_vector();
    let parameters = [
        (Parameter::LeftRadius, 1.0),
        (Parameter::RightRadius, 1.0),
        (Parameter::Track, 1.0),
        (Parameter::LidarForward, 1.0),
        (Parameter::LidarLeft, 1.0),
        (Parameter::LidarYaw, 1f64.to_degrees()),
        (Parameter::LidarLatency, 1000.0),
    ];
    let finding = |(index, (parameter, unit)): (usize, (Parameter, f64))| Finding {
        parameter,
        old: unit * old[index],
        new: unit * result.estimate.parameters[index],
        sigma: unit * result.estimate.sigma(index),
    };
    parameters.into_iter().enumerate().map(finding).collect()
}
