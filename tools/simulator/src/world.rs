//! A scene that is ready for a robot: floor at z = 0, free space known, renderer built.

use std::path::Path;
use std::sync::Arc;

use crate::error::SceneError;
use crate::floor::{FloorPlan, Footprint, find_floor};
use crate::load::{LoadOptions, UpAxis, load};
use crate::render::Renderer;
use crate::scene::Scene;

/// How to open a scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OpenOptions {
    /// Axes and units of a file. Built-in homes need none.
    pub load: LoadOptions,
    /// The robot that free space is for.
    pub footprint: Footprint,
}

/// A world for one robot. Immutable; share it between robots.
#[derive(Debug, Clone)]
pub struct World {
    name: String,
    renderer: Arc<Renderer>,
    floor_plan: Arc<FloorPlan>,
    origin: Origin,
}

/// What was done to a file's numbers to make the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Origin {
    /// The axis that was taken as up; `None` for a built-in home.
    pub up_axis: Option<UpAxis>,
    /// Height of the floor in the file, after axes and scale, metres.
    pub floor_m: f64,
    /// Triangles that were left out because a corner is NaN or infinite.
    pub dropped_triangles: usize,
    /// Triangles of the world.
    pub triangles: usize,
}

impl World {
    /// Opens `builtin:apartment`, `builtin:house` or `builtin:office`, with any of `?seed=K&texture=0.35&moved=1`, or a
    /// .glb, .gltf or .obj file.
    ///
    /// # Errors
    /// When there is no such scene, it is damaged or not supported, or there is no floor in it with room for the robot.
    pub fn open(spec: &str, options: &OpenOptions) -> Result<Self, SceneError> {
        check_footprint(&options.footprint)?;
        if let Some(home) = spec.strip_prefix("builtin:") {
            let scene = crate::builtin::build(spec, home)?;
            return Self::new(spec, scene, 0.0, Origin::default(), &options.footprint);
        }
        let loaded = load(Path::new(spec), &options.load)?;
        let floor_m = find_floor(&loaded.scene, &options.footprint).map_err(|problem| no_floor(spec, problem))?;
        let origin =
            Origin { up_axis: Some(loaded.up_axis), dropped_triangles: loaded.dropped_triangles, ..Origin::default() };
        Self::new(spec, loaded.scene, floor_m, origin, &options.footprint)
    }

    /// A world of a scene from elsewhere, z up, metres, with its floor at the height where most room is.
    ///
    /// # Errors
    /// When it has no triangles or no floor with room for the robot.
    pub fn from_scene(name: &str, scene: Scene, footprint: &Footprint) -> Result<Self, SceneError> {
        check_footprint(footprint)?;
        if scene.triangles.is_empty() {
            return Err(SceneError::Empty { scene: name.into() });
        }
        let floor_m = find_floor(&scene, footprint).map_err(|problem| no_floor(name, problem))?;
        Self::new(name, scene, floor_m, Origin::default(), footprint)
    }

    fn new(
        name: &str,
        mut scene: Scene,
        floor_m: f64,
        origin: Origin,
        footprint: &Footprint,
    ) -> Result<Self, SceneError> {
        for vertex in scene.triangles.iter_mut().flat_map(|t| &mut t.vertices) {
            vertex.position_m[2] -= floor_m as f32;
        }
        let floor_plan = FloorPlan::new(&scene, footprint).map_err(|problem| no_floor(name, problem))?;
        let origin = Origin { floor_m, triangles: scene.triangles.len(), ..origin };
        let renderer = Arc::new(Renderer::new(&scene));
        Ok(Self { name: name.into(), renderer, floor_plan: Arc::new(floor_plan), origin })
    }

    /// The scene as it was asked for.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What takes pictures and distances.
    #[must_use]
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// Where a robot can be.
    #[must_use]
    pub fn floor_plan(&self) -> &Arc<FloorPlan> {
        &self.floor_plan
    }

    /// What was done to a file's numbers.
    #[must_use]
    pub fn origin(&self) -> &Origin {
        &self.origin
    }
}

fn no_floor(scene: &str, problem: String) -> SceneError {
    SceneError::NoFloor { scene: scene.into(), problem }
}

fn check_footprint(footprint: &Footprint) -> Result<(), SceneError> {
    let fields = [
        ("footprint radius", footprint.radius_m, 0.05..=1.0, "from 0.05 to 1 m"),
        ("robot height", footprint.height_m, 0.1..=2.5, "from 0.1 to 2.5 m"),
    ];
    match fields.into_iter().find(|(_, value, range, _)| !range.contains(value)) {
        Some((option, value, _, allowed)) => Err(SceneError::Option { option, value: value.to_string(), allowed }),
        None => Ok(()),
    }
}
