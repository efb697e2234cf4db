//! A scene prepared for a robot: its floor is at z = 0, its free space is known and its renderer is
//! built.

use std::path::Path;
use std::sync::Arc;

use crate::error::SceneError;
use crate::floor::{FloorPlan, Footprint, find_floor};
use crate::load::{LoadOptions, UpAxis, load};
use crate::render::{AmbientOptions, Renderer, bake_ambient};
use crate::scene::Scene;

/// Options for opening a scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OpenOptions {
    /// Axes and units of a scene file. Built-in homes ignore them.
    pub load: LoadOptions,
    /// Robot size for which free space is computed.
    pub footprint: Footprint,
}

/// A scene with its free space and renderer. It is immutable and can be shared between robots.
#[derive(Debug, Clone)]
pub struct World {
    name: String,
    renderer: Arc<Renderer>,
    floor_plan: Arc<FloorPlan>,
    origin: Origin,
}

/// How the coordinates of a file were changed when it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Origin {
    /// Axis of the file that was taken as up; `None` for a built-in home.
    pub up_axis: Option<UpAxis>,
    /// Height of the floor in the file, after axis conversion and scaling, metres.
    pub floor_m: f64,
    /// Triangles that were dropped because a corner is NaN or infinite.
    pub dropped_triangles: usize,
    pub triangles: usize,
}

impl World {
    /// Opens `builtin:apartment`, `builtin:house` or `builtin:office`, optionally with
    /// `?seed=K&texture=0.35&moved=1&stairs=1&cables=1` (any subset of these keys), or a .glb,
    /// .gltf or .obj file.
    ///
    /// # Errors
    /// Returns an error if the scene does not exist, is damaged or not supported, or has no floor
    /// with enough free space for the robot.
    pub fn open(spec: &str, options: &OpenOptions) -> Result<Self, SceneError> {
        check_footprint(&options.footprint)?;
        if let Some(home) = spec.strip_prefix("builtin:") {
            let scene = crate::builtin::build(spec, home)?;
            return Self::new(spec, scene, 0.0, Origin::default(), &options.footprint);
        }
        let mut loaded = load(Path::new(spec), &options.load)?;
        let floor_m = find_floor(&loaded.scene, &options.footprint)
            .map_err(|problem| no_floor(spec, problem))?;
        bake_ambient(&mut loaded.scene, &AmbientOptions::default());
        let origin = Origin {
            up_axis: Some(loaded.up_axis),
            dropped_triangles: loaded.dropped_triangles,
            ..Origin::default()
        };
        Self::new(spec, loaded.scene, floor_m, origin, &options.footprint)
    }

    /// Builds a world from a scene in memory (z up, metres). The floor is set to the height with
    /// the most free space.
    ///
    /// # Errors
    /// Returns an error if the scene has no triangles or no floor with enough free space for the
    /// robot.
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
        let floor_plan =
            FloorPlan::new(&scene, footprint).map_err(|problem| no_floor(name, problem))?;
        let origin = Origin { floor_m, triangles: scene.triangles.len(), ..origin };
        let renderer = Arc::new(Renderer::new(&scene));
        Ok(Self { name: name.into(), renderer, floor_plan: Arc::new(floor_plan), origin })
    }

    /// The scene specification that was passed to [`World::open`].
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Renders images and casts rays.
    #[must_use]
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// The free space of the floor.
    #[must_use]
    pub fn floor_plan(&self) -> &Arc<FloorPlan> {
        &self.floor_plan
    }

    /// How the coordinates of the file were changed when it was opened.
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
        Some((option, value, _, allowed)) => {
            Err(SceneError::Option { option, value: value.to_string(), allowed })
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::hand_made;
    use crate::load::tests::{png, shared_scenes};

    /// A room of 4 by 3 m with its floor at z = 1, as OBJ text with z up. `keep` selects which of
    /// the six faces are written.
    fn room_obj(keep: [bool; 6]) -> String {
        let corners = [
            (0, 0, 1),
            (4, 0, 1),
            (4, 3, 1),
            (0, 3, 1),
            (0, 0, 4),
            (4, 0, 4),
            (4, 3, 4),
            (0, 3, 4),
        ];
        let faces = ["1 2 3 4", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8"];
        let v: String = corners.iter().map(|(x, y, z)| format!("v {x} {y} {z}\n")).collect();
        let f: String = faces
            .iter()
            .zip(keep)
            .filter(|(_, keep)| *keep)
            .map(|(f, _)| format!("f {f}\n"))
            .collect();
        v + &f
    }

    fn open(text: &str, options: &OpenOptions) -> Result<World, SceneError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.obj");
        std::fs::write(&path, text).unwrap();
        World::open(&path.to_string_lossy(), options)
    }

    fn z_up(scale: f64) -> OpenOptions {
        OpenOptions { load: LoadOptions { up_axis: UpAxis::Z, scale }, ..OpenOptions::default() }
    }

    #[test]
    fn a_file_is_shifted_so_that_its_floor_is_at_height_zero() {
        let world = open(&room_obj([true; 6]), &z_up(1.0)).unwrap();
        assert!((world.origin().floor_m - 1.0).abs() < 1e-6);
        let down = world.renderer().cast([2.0, 1.5, 0.8], [0.0, 0.0, -1.0], 5.0, &[]).unwrap();
        assert!((down - 0.8).abs() < 1e-5, "{down}");
        assert!((world.floor_plan().reachable_floor_m2() - 12.0).abs() < 0.7);
    }

    #[test]
    fn the_scale_converts_file_units_to_metres() {
        let doubled = open(&room_obj([true; 6]), &z_up(2.0)).unwrap();
        assert!((doubled.floor_plan().reachable_floor_m2() - 48.0).abs() < 1.5);
    }

    #[test]
    fn a_scene_without_a_floor_is_refused_with_a_hint_to_check_axis_and_scale() {
        let walls = open(&room_obj([false, false, true, true, true, true]), &z_up(1.0))
            .unwrap_err()
            .to_string();
        assert!(walls.contains("no floor") && walls.contains("up axis"), "{walls}");
        assert!(matches!(open(&room_obj([true; 6]), &z_up(0.01)), Err(SceneError::NoFloor { .. })));
    }

    #[test]
    fn impossible_footprints_are_refused() {
        for footprint in [
            Footprint { radius_m: f64::NAN, ..Footprint::default() },
            Footprint { height_m: 9.0, ..Footprint::default() },
        ] {
            let options = OpenOptions { footprint, ..OpenOptions::default() };
            assert!(matches!(
                World::open("builtin:house", &options),
                Err(SceneError::Option { .. })
            ));
        }
    }

    #[test]
    fn a_built_in_home_opens_with_its_floor_at_zero() {
        let world = World::open("builtin:apartment?seed=2", &OpenOptions::default()).unwrap();
        assert_eq!((world.origin().up_axis, world.origin().floor_m), (None, 0.0));
        assert!(world.floor_plan().reachable_floor_m2() > 20.0);
    }

    #[test]
    fn a_hand_made_home_has_the_floor_and_the_free_area_that_it_was_built_with() {
        let dir = hand_made::folder(&png());
        for name in ["home.glb", "home.obj"] {
            let path = dir.path().join(name);
            let world = World::open(&path.to_string_lossy(), &OpenOptions::default()).unwrap();
            assert!((world.origin().floor_m - hand_made::FLOOR_M).abs() < 1e-6, "{name}");
            let plan = world.floor_plan();
            let area_m2 = plan.reachable_floor_m2();
            assert!((0.95..1.02).contains(&(area_m2 / hand_made::FREE_M2)), "{name}: {area_m2} m2");
            // The door connects the rooms, and the table blocks.
            assert!(hand_made::ROOMS_M.iter().all(|[x, y]| plan.is_reachable(*x, *y)), "{name}");
            assert!(plan.is_blocked(2.0, 2.0) && !plan.is_reachable(2.5, 2.0), "{name}");
            let start = plan.start_pose(1);
            assert!(plan.fits(start.x_m, start.y_m, &[]), "{name}");
            assert!(plan.clearance_m(start.x_m, start.y_m) > 0.3, "{name}");
        }
    }

    #[test]
    #[ignore = "needs the shared scenes; `cargo xtask test` runs it where they are"]
    fn shared_scenes_have_the_listed_drivable_area() {
        let scenes = shared_scenes();
        // Drivable area by the scenes' list. The floor area that the base covers while driving is
        // slightly larger.
        let listed = [
            ("aws_small_house", 138.0),
            ("office_small", 59.0),
            ("aws_warehouse", 190.0),
            ("kitchen", 34.0),
            ("living-room", 12.0),
            ("bathroom", 7.0),
        ];
        for (name, area_m2) in listed {
            let path = scenes.join(format!("{name}.glb"));
            let scene = load(&path, &LoadOptions::default()).unwrap().scene;
            // Baked light and textures take most of the time and do not affect this test.
            let world =
                World::from_scene(name, Scene { textures: vec![], ..scene }, &Footprint::default())
                    .unwrap();
            let plan = world.floor_plan();
            let ratio = plan.reachable_floor_m2() / area_m2;
            assert!(
                (0.9..1.4).contains(&ratio),
                "{name}: {} m2, listed {area_m2}",
                plan.reachable_floor_m2()
            );
            assert!(world.origin().floor_m.abs() < 0.06, "{name}: {}", world.origin().floor_m);
            let start = plan.start_pose(1);
            assert!(
                plan.fits(start.x_m, start.y_m, &[])
                    && plan.clearance_m(start.x_m, start.y_m) > 0.3,
                "{name}"
            );
        }
    }
}
