//! The images of a run on a real robot: `map.png` and `depth.png`.

use std::path::Path;

use runtime::robot::Robot;

use super::exploration::RunLog;
use crate::report::atomic::ReportError;
use crate::report::depth_sample::SheetSampler;
use crate::report::depth_scale::DepthScale;
use crate::report::depth_sheet::{DEPTH_FILE, DepthSheet};
use crate::report::known_cells::KnownCells;
use crate::report::map_image::{MAP_FILE, MapPlot};

/// Writes the images into `out`, and returns the names of those for which the run has content.
pub(super) fn write(
    out: &Path,
    robot: &Robot,
    log: RunLog,
) -> Result<Vec<&'static str>, ReportError> {
    let policy = robot.explorer().policy().name();
    let title = format!("{policy}, {} frames", log.frames);
    let mut written = Vec::new();
    if let Some(known) = KnownCells::of(robot.map()) {
        let figures = format!(
            "{:.1} m2 of free floor, path {:.1} m by the wheels",
            known.free_m2(),
            log.path_m
        );
        let plot = MapPlot {
            title: &title,
            figures: &figures,
            map: known.as_cells(),
            trajectory: &log.trajectory,
            goals: log.goals.goals(),
            trips: &log.trips_m,
            truth: None,
        };
        plot.write(out)?;
        written.push(MAP_FILE);
    }
    let rows = log.sheet.map_or_else(Vec::new, SheetSampler::into_rows);
    if !rows.is_empty() {
        let scale = DepthScale::of(rows.iter());
        DepthSheet { title: &title, rows: &rows, scale }.write(out)?;
        written.push(DEPTH_FILE);
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use hal::ImageView;
    use runtime::exploration::PolicyKind;
    use runtime::robot::DepthSource;

    use super::*;
    use crate::config::Config;
    use crate::report::depth_sample::{FrameDepths, SheetRow};
    use crate::setup::Mission;

    fn robot(config: &Config) -> Robot {
        let mission =
            Mission { policy: PolicyKind::Active, depth_source: DepthSource::Dense, seed: 1 };
        Robot::new(config.robot(&mission), None).unwrap()
    }

    #[test]
    fn only_images_that_exist_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let config = Config::default();
        let nothing = RunLog::new(&config, None, None);
        assert!(write(dir.path(), &robot(&config), nothing).unwrap().is_empty());
        let mut sheet = SheetSampler::default();
        let rgb = [7; 4 * 2 * 3];
        let frame = ImageView::rgb8(4, 2, &rgb).unwrap();
        sheet.offer(0, 0, || SheetRow::capture(0, &frame, &FrameDepths::default()));
        let mut seen = RunLog::new(&config, None, None);
        seen.sheet = Some(sheet);
        assert_eq!(write(dir.path(), &robot(&config), seen).unwrap(), [DEPTH_FILE]);
        assert!(dir.path().join(DEPTH_FILE).exists() && !dir.path().join(MAP_FILE).exists());
    }

    #[test]
    fn a_run_that_is_not_recorded_keeps_no_image_of_the_home() {
        assert!(RunLog::new(&Config::default(), None, None).sheet.is_none());
    }
}
