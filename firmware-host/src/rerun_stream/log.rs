//! The content sent to Rerun: a 2-D map with path and robot, camera and depth in 3-D, and plots.

use std::time::Duration;

use hal::{CameraModel, Pose2, Pose3};
use rerun::{
    DepthImage, EncodedImage, LineStrips2D, LineStrips3D, Pinhole, Points2D, Points3D, Quaternion,
    RecordingStream, RecordingStreamBuilder, Scalars, Transform3D, ViewCoordinates,
    blueprint::{Blueprint, Horizontal, Spatial2DView, Spatial3DView, TimeSeriesView, Vertical},
};
use runtime::recording::MapView;

use super::{Moment, RerunError, RerunTargets, encode};

/// Interval in ticks at which the travelled path is sent. The whole path is sent each time, so
/// sending it in every tick would have a quadratic cost.
const TRAVELLED_EVERY: u64 = 10;
/// Shortest distance between two points of the travelled path, metres.
const TRAVELLED_STEP_M: f64 = 0.05;
/// How long the end of a run waits for a viewer that does not accept data.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(5);

const TRAVELLED: [u8; 3] = [198, 40, 90];
const PATH: [u8; 3] = [0, 137, 150];
const GOAL: [u8; 3] = [239, 108, 0];

/// One run, sent to every target.
pub(super) struct RunLog {
    streams: Vec<RecordingStream>,
    travelled_m: Vec<[f64; 2]>,
    map: Option<MapFrame>,
    failed: u64,
}

/// Position of the map's image in `map`.
#[derive(Debug, Clone, Copy)]
struct MapFrame {
    origin_m: [f64; 2],
    cell_m: f64,
    rows: usize,
}

impl MapFrame {
    fn of(map: &MapView) -> Self {
        let rows = map.occupancy.len() / map.columns.max(1);
        Self { origin_m: map.origin_m, cell_m: map.cell_m, rows }
    }

    /// Pixel coordinates of a point in `map`. In Rerun, the corner of a pixel has integer
    /// coordinates.
    fn pixel(&self, point_m: [f64; 2]) -> [f32; 2] {
        let [right, up] = [0, 1].map(|axis| (point_m[axis] - self.origin_m[axis]) / self.cell_m);
        [right as f32, (self.rows as f64 - up) as f32]
    }

    fn line(&self, line_m: &[[f64; 2]]) -> Vec<[f32; 2]> {
        line_m.iter().map(|point_m| self.pixel(*point_m)).collect()
    }
}

impl RunLog {
    pub(super) fn open(
        targets: &RerunTargets,
        camera: &CameraModel,
        t_base_camera: &Pose3,
    ) -> Result<Self, RerunError> {
        let mut streams = Vec::new();
        if let Some(file) = &targets.file {
            streams.push(named(&file.display().to_string(), new_stream().save(file))?);
        }
        if let Some(viewer) = &targets.viewer {
            streams.push(named(viewer, new_stream().connect_grpc_opts(viewer))?);
        }
        for stream in &streams {
            // Only the time of the run is sent. Wall-clock time would depend on the speed of the
            // computer.
            stream.set_log_time_enabled(false);
            stream.set_log_tick_enabled(false);
        }
        let mut log = Self { streams, travelled_m: Vec::new(), map: None, failed: 0 };
        log.robot(camera, t_base_camera);
        Ok(log)
    }

    /// Sends the static data: the camera's mount and intrinsics.
    fn robot(&mut self, camera: &CameraModel, t_base_camera: &Pose3) {
        let pinhole = Pinhole::new([
            [camera.fx as f32, 0.0, 0.0],
            [0.0, camera.fy as f32, 0.0],
            // Rerun's pixel centres are at half-integers, ours at integers.
            [camera.cx as f32 + 0.5, camera.cy as f32 + 0.5, 1.0],
        ])
        .with_resolution([camera.width as f32, camera.height as f32])
        .with_image_plane_distance(0.3);
        self.each(|stream| {
            stream.log_static("world", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
            stream.log_static("world/robot/camera", &transform(t_base_camera))?;
            stream.log_static("world/robot/camera", &pinhole)
        });
    }

    /// Sends one moment. Returns the number of values that failed.
    pub(super) fn moment(&mut self, moment: &Moment) -> u64 {
        let failed_before = self.failed;
        self.each(|stream| {
            stream.set_time_sequence("tick", moment.tick as i64);
            stream.set_duration_secs("time", moment.time_ns as f64 * 1e-9);
            Ok(())
        });
        self.camera(moment);
        self.map(moment);
        if moment.t_map_base.is_finite() {
            self.motion(moment);
        }
        for (name, value) in moment.numbers.iter().filter(|(_, value)| value.is_finite()) {
            self.each(|stream| stream.log(format!("plots/{name}"), &Scalars::new([*value])));
        }
        self.failed - failed_before
    }

    fn camera(&mut self, moment: &Moment) {
        if let Some((width, height, rgb)) = &moment.image {
            match encode::jpeg(*width, *height, rgb) {
                Ok(jpeg) => self.each(|stream| {
                    stream.log(
                        "world/robot/camera/image",
                        &EncodedImage::from_file_contents(jpeg.clone()),
                    )
                }),
                Err(_) => self.failed += 1,
            }
        }
        if let Some(depth) = &moment.views.depth {
            let size = [depth.width() as u32, depth.height() as u32];
            let image = DepthImage::from_gray16(encode::depth_mm(depth), size).with_meter(1000.0);
            self.each(|stream| stream.log("world/robot/camera/depth", &image));
        }
    }

    fn map(&mut self, moment: &Moment) {
        let Some(map) = &moment.views.map else { return };
        self.map = Some(MapFrame::of(map));
        match encode::map_png(map) {
            Ok(png) => {
                self.each(|stream| {
                    stream.log("map/cells", &EncodedImage::from_file_contents(png.clone()))
                });
            }
            Err(_) => self.failed += 1,
        }
    }

    /// Sends robot, travelled path, planned path and goal, in 3-D and on the map.
    fn motion(&mut self, moment: &Moment) {
        let at_m = [moment.t_map_base.x_m, moment.t_map_base.y_m];
        if self
            .travelled_m
            .last()
            .is_none_or(|last| (last[0] - at_m[0]).hypot(last[1] - at_m[1]) >= TRAVELLED_STEP_M)
        {
            self.travelled_m.push(at_m);
        }
        let pose = transform(&moment.t_map_base.to_pose3());
        self.each(|stream| stream.log("world/robot", &pose));
        if moment.tick.is_multiple_of(TRAVELLED_EVERY) {
            let travelled_m = std::mem::take(&mut self.travelled_m);
            self.line("way", &travelled_m, TRAVELLED);
            self.travelled_m = travelled_m;
        }
        if let Some(path_m) = &moment.views.path_m {
            self.line("path", path_m, PATH);
        }
        let goal: Vec<[f64; 2]> = moment.goal_m.into_iter().collect();
        self.points("goal", &goal, GOAL);
        self.points("robot", &[nose(&moment.t_map_base), at_m], TRAVELLED);
    }

    fn line(&mut self, name: &str, line_m: &[[f64; 2]], color: [u8; 3]) {
        let map = self.map;
        self.each(|stream| {
            let space =
                LineStrips3D::new([on_floor(line_m)]).with_colors([color]).with_radii([0.015]);
            stream.log(format!("world/{name}"), &space)?;
            let Some(map) = map else { return Ok(()) };
            let flat = LineStrips2D::new([map.line(line_m)]).with_colors([color]).with_radii([0.8]);
            stream.log(format!("map/{name}"), &flat)
        });
    }

    fn points(&mut self, name: &str, points_m: &[[f64; 2]], color: [u8; 3]) {
        let map = self.map;
        self.each(|stream| {
            let space = Points3D::new(on_floor(points_m)).with_colors([color]).with_radii([0.06]);
            stream.log(format!("world/{name}_mark"), &space)?;
            let Some(map) = map else { return Ok(()) };
            let flat = Points2D::new(map.line(points_m)).with_colors([color]).with_radii([3.0]);
            stream.log(format!("map/{name}"), &flat)
        });
    }

    fn each(&mut self, send: impl Fn(&RecordingStream) -> rerun::RecordingStreamResult<()>) {
        self.failed += self.streams.iter().filter(|stream| send(stream).is_err()).count() as u64;
    }
}

impl Drop for RunLog {
    fn drop(&mut self) {
        for stream in &self.streams {
            // A viewer that does not respond must not keep the run from ending.
            let _ = stream.flush_with_timeout(FLUSH_TIMEOUT);
        }
    }
}

fn new_stream() -> RecordingStreamBuilder {
    RecordingStreamBuilder::new("embodied-depth").with_blueprint(layout())
}

fn named(
    target: &str,
    stream: rerun::RecordingStreamResult<RecordingStream>,
) -> Result<RecordingStream, RerunError> {
    stream.map_err(|error| RerunError::Target {
        target: target.to_owned(),
        reason: error.to_string(),
    })
}

fn layout() -> Blueprint {
    let seen = Vertical::new([
        Spatial2DView::new("camera")
            .with_origin("world/robot/camera")
            .with_contents(["$origin/image"])
            .into(),
        Spatial2DView::new("depth")
            .with_origin("world/robot/camera")
            .with_contents(["$origin/depth"])
            .into(),
        Spatial3DView::new("space").with_origin("world").into(),
    ]);
    let known = Vertical::new([
        Spatial2DView::new("map").with_origin("map").into(),
        TimeSeriesView::new("plots").with_origin("plots").into(),
    ])
    .with_row_shares([2.0, 1.0]);
    Blueprint::new(Horizontal::new([seen.into(), known.into()]))
}

fn transform(pose: &Pose3) -> Transform3D {
    let [x, y, z, w] = [pose.rotation.i, pose.rotation.j, pose.rotation.k, pose.rotation.w]
        .map(|value| value as f32);
    let translation =
        [pose.translation.x as f32, pose.translation.y as f32, pose.translation.z as f32];
    Transform3D::from_translation_rotation(translation, Quaternion::from_xyzw([x, y, z, w]))
}

fn on_floor(points_m: &[[f64; 2]]) -> Vec<[f32; 3]> {
    points_m.iter().map(|[x_m, y_m]| [*x_m as f32, *y_m as f32, 0.02]).collect()
}

/// A point in front of the robot, which shows its heading.
fn nose(pose: &Pose2) -> [f64; 2] {
    pose.transform(0.12, 0.0).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_of_the_world_is_drawn_at_its_cell() {
        let map =
            MapView { origin_m: [-1.0, -2.0], cell_m: 0.5, columns: 4, occupancy: vec![0; 12] };
        let frame = MapFrame::of(&map);
        assert_eq!(frame.pixel([-1.0, -2.0]), [0.0, 3.0]);
        assert_eq!(frame.pixel([1.0, -0.5]), [4.0, 0.0]);
    }
}
