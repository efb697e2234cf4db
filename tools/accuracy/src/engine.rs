//! The compared methods: coarse and dense depth, a scan without a camera, and the paper's method with two kinds of flow.

use std::collections::VecDeque;
use std::path::Path;

use anyhow::{Context, Result};
use firmware_host::config::Config;
use firmware_host::frame_depth::{FrameDepth, Shot};
use hal::{CameraModel, ImageView, Pose3};
use runtime::perception::flow::{DenseFlow, FlowPreset};
use runtime::perception::walls::Walls;
use runtime::perception::{CoarseDepth, DepthEstimate};

use crate::flow_network::FlowNetwork;
use crate::least_squares::{FlowView, triangulate};
use crate::sequence::{Sequence, View};

/// The paper computes flow from each frame to the fifth before it.
const GAP: usize = 5;
/// The paper's range of valid triangulations, metres.
const RANGE_M: (f64, f64) = (0.1, 40.0);
/// Threads of a learned flow.
const NETWORK_THREADS: usize = 2;
/// Bearing error of a match that is half a pixel off at f = 320, radians.
const BEARING_ERROR_RAD: f32 = 0.0016;

/// A method that computes depth from frames.
pub trait Engine {
    /// Its name in the table.
    fn name(&self) -> String;
    /// Processes the next frame, which is of `view` and disturbed. Its depth is computed only if `evaluated`; otherwise it only
    /// serves later frames. `None` for a frame without depth.
    ///
    /// # Errors
    /// When the method fails altogether.
    fn process(
        &mut self,
        frame: ImageView<'_>,
        pose: &Pose3,
        view: &View,
        evaluated: bool,
    ) -> Result<Option<DepthEstimate>>;
}

/// The robot's coarse depth.
pub struct Coarse {
    name: String,
    engine: CoarseDepth,
}

impl Coarse {
    /// # Errors
    /// When a setting is out of range.
    pub fn new(name: &str, config: &Config, sequence: &Sequence) -> Result<Self> {
        let engine = CoarseDepth::new(config.coarse.clone(), sequence.camera)?;
        Ok(Self { name: name.to_owned(), engine: engine.with_floor(sequence.mount.is_some()) })
    }
}

impl Engine for Coarse {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn process(
        &mut self,
        frame: ImageView<'_>,
        pose: &Pose3,
        _view: &View,
        _evaluated: bool,
    ) -> Result<Option<DepthEstimate>> {
        Ok(self.engine.estimate(frame, pose).ok().cloned())
    }
}

/// Dense depth: coarse depth, completed by the voxel map and by filling.
pub struct Dense {
    name: String,
    depth: FrameDepth,
}

impl Dense {
    /// # Errors
    /// When a setting is out of range.
    pub fn new(name: &str, config: &Config, sequence: &Sequence) -> Result<Self> {
        let camera = sequence.camera;
        let mount = sequence.mount.as_ref();
        let depth = FrameDepth::new(&config.coarse, &config.dense, camera, mount)?;
        Ok(Self { name: name.to_owned(), depth })
    }
}

impl Engine for Dense {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn process(
        &mut self,
        frame: ImageView<'_>,
        pose: &Pose3,
        view: &View,
        _evaluated: bool,
    ) -> Result<Option<DepthEstimate>> {
        let shot = Shot {
            frame,
            t_odom_camera: *pose,
            scan: view.scan.as_ref().map(|(scan, t_odom_laser)| (scan, *t_odom_laser)),
            moment: view.moment,
        };
        let _ = self.depth.estimate(&shot);
        self.depth.complete(&shot);
        Ok(self.depth.dense().cloned())
    }
}

/// A baseline without a camera: floor before the hits of the scanner, and a wall above them.
pub struct ScanAlone {
    camera: CameraModel,
    cells: CameraModel,
    walls: Walls,
}

impl ScanAlone {
    /// # Errors
    /// When a setting is out of range.
    pub fn new(config: &Config, sequence: &Sequence) -> Result<Self> {
        let camera = sequence.camera;
        let cells = *CoarseDepth::new(config.coarse.clone(), camera)?.cell_camera();
        let walls = sequence.mount.as_ref().map(|mount| Walls::new(&cells, mount));
        Ok(Self { camera, cells, walls: walls.unwrap_or_default() })
    }
}

impl Engine for ScanAlone {
    fn name(&self) -> String {
        "scan alone".to_owned()
    }

    fn process(
        &mut self,
        _frame: ImageView<'_>,
        _pose: &Pose3,
        view: &View,
        _evaluated: bool,
    ) -> Result<Option<DepthEstimate>> {
        let Some((scan, t_odom_laser)) = &view.scan else { return Ok(None) };
        self.walls.see(scan, t_odom_laser);
        let walls = self.walls.project(&view.moment.t_odom_base, view.moment.time_ns);
        let mut found = DepthEstimate::none(self.camera.width, self.camera.height);
        if walls.is_empty() {
            return Ok(None);
        }
        let pixels_per_cell = self.camera.width / self.cells.width;
        let depths = found.depth.values_mut().iter_mut().zip(&mut found.confidence);
        for (pixel, (depth_m, confidence)) in depths.enumerate() {
            let row = pixel / self.camera.width / pixels_per_cell;
            let column = pixel % self.camera.width / pixels_per_cell;
            let inverse_depth = walls[row * self.cells.width + column].inverse_depth;
            if inverse_depth > 0.0 {
                *depth_m = 1.0 / inverse_depth;
                *confidence = 0.5;
            }
        }
        Ok(Some(found))
    }
}

/// A source of flow.
enum Flow {
    Search(Box<DenseFlow>),
    Network(Box<FlowNetwork>),
}

/// Flow to the fifth frame before, then closed-form least squares: the paper's coarse depth, with one past frame as in
/// its released code.
pub struct FlowDepth {
    name: &'static str,
    camera: CameraModel,
    flow: Flow,
    past: VecDeque<(Vec<u8>, Pose3)>,
}

impl FlowDepth {
    /// Uses dense inverse search with preset medium.
    ///
    /// # Errors
    /// When the image is smaller than a patch.
    pub fn search(camera: CameraModel) -> Result<Self> {
        let flow = Box::new(DenseFlow::new(FlowPreset::Medium, camera.width, camera.height)?);
        Ok(Self { name: "DIS + LS", camera, flow: Flow::Search(flow), past: VecDeque::new() })
    }

    /// Uses a learned flow.
    ///
    /// # Errors
    /// When the model cannot be used.
    pub fn network(model: &Path, camera: CameraModel) -> Result<Self> {
        let (onnx_runtime, _) = firmware_host::onnx_runtime::init()?;
        let bytes = std::fs::read(model).with_context(|| model.display().to_string())?;
        let flow = Box::new(FlowNetwork::load(
            &onnx_runtime,
            &bytes,
            (camera.width, camera.height),
            NETWORK_THREADS,
        )?);
        Ok(Self { name: "RAFT + LS", camera, flow: Flow::Network(flow), past: VecDeque::new() })
    }
}

impl Engine for FlowDepth {
    fn name(&self) -> String {
        self.name.to_owned()
    }

    fn process(
        &mut self,
        frame: ImageView<'_>,
        pose: &Pose3,
        _view: &View,
        evaluated: bool,
    ) -> Result<Option<DepthEstimate>> {
        let mut found = None;
        if let Some((rgb, before)) =
            self.past.front().filter(|_| evaluated && self.past.len() == GAP)
        {
            let past = ImageView::rgb8(self.camera.width, self.camera.height, rgb)?;
            let field = match &mut self.flow {
                Flow::Search(engine) => engine.flow(frame, past)?,
                Flow::Network(network) => network.estimate(frame, past)?,
            };
            let view = FlowView { flow: field, t_view_camera: before.inverse() * pose };
            let found_depth = triangulate(&self.camera, &[view], RANGE_M)?;
            // sigma_z / z = sigma / sin(parallax): orders pixels by parallax, but is not a calibrated probability.
            let confidence = found_depth.parallax_rad.iter().zip(found_depth.depth.values());
            let confidence = confidence.map(|(parallax, depth)| match *depth > 0.0 {
                true => (0.25 * parallax / (0.25 * parallax + BEARING_ERROR_RAD)).clamp(0.0, 1.0),
                false => 0.0,
            });
            found =
                Some(DepthEstimate { confidence: confidence.collect(), depth: found_depth.depth });
        }
        if self.past.len() == GAP {
            self.past.pop_front();
        }
        self.past.push_back((frame.data().to_vec(), *pose));
        Ok(found)
    }
}
