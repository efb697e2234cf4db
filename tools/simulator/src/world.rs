//! A scene made ready: its floor found, its light baked, its rays cast.

use std::path::Path;

use hal::Pose2;

use crate::error::SceneError;
use crate::floor::{self, FloorPlan};
use crate::load::{self, LoadOptions, UpAxis};
use crate::render::Renderer;
use crate::scene::Scene;

/// Scenes of this kind are made, not loaded.
const BUILTIN: &str = "builtin:";

/// How a scene is opened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpenOptions {
    /// Which axis of a file points up. Builtin scenes need none.
    pub up_axis: UpAxis,
    /// Metres in one unit of a file.
    pub scale: f64,
    /// Radius of the robot's footprint, metres: what counts as floor depends on it.
    pub footprint_radius_m: f64,
    /// Furniture of builtin homes stands elsewhere than in training.
    pub moved_furniture: bool,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { up_axis: UpAxis::Auto, scale: 1.0, footprint_radius_m: 0.16, moved_furniture: false }
    }
}

/// A home that a robot can be put into.
pub struct World {
    /// Pictures and beams.
    pub renderer: Renderer,
    /// Where the robot can be.
    pub floor: FloorPlan,
    /// How many triangles it has.
    pub triangles: usize,
}

impl World {
    /// Opens `builtin:NAME?seed=K` or a file.
    ///
    /// # Errors
    /// When there is no such scene, a file is damaged, or it has no floor.
    pub fn open(spec: &str, options: &OpenOptions) -> Result<Self, SceneError> {
        match spec.strip_prefix(BUILTIN) {
            Some(name) => Self::from_scene(builtin(spec, name, options)?, spec, options),
            None => {
                let file = LoadOptions { up_axis: options.up_axis, scale: options.scale };
                let mut loaded = load::load(Path::new(spec), &file)?;
                if loaded.dropped_triangles > 0 {
                    tracing::warn!(
                        dropped = loaded.dropped_triangles,
                        scene = spec,
                        "triangles with NaN were left out"
                    );
                }

                Self::from_scene(loaded.scene, spec, options)
            }
        }
    }

    /// Makes a scene ready; `name` is for errors.
    ///
    /// # Errors
    /// When it has no triangles or no floor.
    pub fn from_scene(mut scene: Scene, name: &str, options: &OpenOptions) -> Result<Self, SceneError> {
        if scene.triangles.is_empty() {
            return Err(SceneError::Empty { scene: name.to_owned() });
        }
        let no_floor = |problem: &str| SceneError::NoFloor { scene: name.to_owned(), problem: problem.to_owned() };
        let radius_m = options.footprint_radius_m;
        let level_m = floor::find_level(&scene, radius_m)
            .ok_or_else(|| no_floor("no level surface inside walls has room for the footprint"))?;
        for triangle in &mut scene.triangles {
            for vertex in &mut triangle.vertices {
                vertex.position_m[2] -= level_m as f32;
            }
        }
        let floor = FloorPlan::new(&scene, radius_m).ok_or_else(|| no_floor("the footprint fits nowhere on it"))?;
        Ok(Self { renderer: Renderer::new(&scene), floor, triangles: scene.triangles.len() })
    }

    /// The start that was asked for, or a free one by the seed.
    ///
    /// # Errors
    /// [`SceneError::StartBlocked`] when the footprint does not fit there.
    pub fn start_pose(&self, asked: Option<Pose2>, footprint_radius_m: f64, seed: u64) -> Result<Pose2, SceneError> {
        let pose = match asked {
            Some(pose) => pose,
            None => self.floor.start_pose(seed).unwrap_or_default(),
        };
        if self.floor.clearance_m(pose.x_m, pose.y_m) >= footprint_radius_m {
            return Ok(pose);
        }
        let [nearest_x_m, nearest_y_m] = self.floor.nearest_free(pose.x_m, pose.y_m);
        Err(SceneError::StartBlocked { x_m: pose.x_m, y_m: pose.y_m, nearest_x_m, nearest_y_m })
    }
}

fn builtin(spec: &str, _name: &str, _options: &OpenOptions) -> Result<Scene, SceneError> {
    Err(SceneError::Builtin { spec: spec.to_owned(), problem: "homes come next".to_owned() })
}
