//! The areas that the robot keeps out of and those that it keeps in, as outlines for the 3D panel of Foxglove and for the page.

use foxglove::messages as fox;
use runtime::planning::KeepOut;
use runtime::recording::messages;

/// Width of the outlines, pixels.
const WIDTH_PX: f64 = 3.0;
/// Okabe and Ito's vermilion, which warnings have, and their bluish green.
const CLOSED: fox::Color = fox::Color { r: 0.835, g: 0.369, b: 0.0, a: 1.0 };
const ALLOWED: fox::Color = fox::Color { r: 0.0, g: 0.62, b: 0.451, a: 1.0 };

/// The corners of all areas, metres in `map`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Areas {
    closed_m: Vec<Vec<[f64; 2]>>,
    keep_in_m: Vec<Vec<[f64; 2]>>,
}

impl Areas {
    pub fn of(keep_out: &KeepOut) -> Self {
        Self {
            closed_m: keep_out.closed_m().map(<[[f64; 2]]>::to_vec).collect(),
            keep_in_m: keep_out.keep_in_m().to_vec(),
        }
    }

    /// An entity of the closed areas and one of those to keep in, each with a closed line for each area. They replace those before.
    pub fn scene(&self, time_ns: u64) -> fox::SceneUpdate {
        let entities =
            [("keep_out", &self.closed_m, CLOSED), ("keep_in", &self.keep_in_m, ALLOWED)];
        let entities = entities.map(|(id, areas_m, color)| fox::SceneEntity {
            timestamp: messages::timestamp(time_ns),
            frame_id: "map".to_owned(),
            id: id.to_owned(),
            lines: areas_m.iter().map(|corners_m| outline(corners_m, color)).collect(),
            ..fox::SceneEntity::default()
        });
        fox::SceneUpdate { deletions: Vec::new(), entities: entities.to_vec() }
    }
}

fn outline(corners_m: &[[f64; 2]], color: fox::Color) -> fox::LinePrimitive {
    fox::LinePrimitive {
        r#type: fox::line_primitive::Type::LineLoop as i32,
        thickness: WIDTH_PX,
        scale_invariant: true,
        points: corners_m.iter().map(|[x, y]| fox::Point3 { x: *x, y: *y, z: 0.0 }).collect(),
        color: Some(color),
        ..fox::LinePrimitive::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_area_is_a_closed_line_in_map_and_no_area_an_entity_without_lines() {
        let closed = vec![vec![[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]], vec![[1.0, 1.0], [2.0, 2.0]]];
        let update = Areas::of(&KeepOut::new(closed, Vec::new())).scene(7);
        let [entity, keep_in] = update.entities.as_slice() else { panic!() };
        assert!(keep_in.id == "keep_in" && keep_in.lines.is_empty());
        assert_eq!((entity.frame_id.as_str(), entity.lines.len()), ("map", 2));
        let first = &entity.lines[0];
        assert_eq!(first.r#type, fox::line_primitive::Type::LineLoop as i32);
        assert_eq!(first.points[1], fox::Point3 { x: 2.0, y: 3.0, z: 0.0 });
        assert!(Areas::default().scene(7).entities[0].lines.is_empty());
    }

    #[test]
    fn areas_to_keep_in_are_an_entity_of_their_own_and_have_another_colour() {
        let square = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let areas = Areas::of(&KeepOut::new(vec![square.clone()], vec![square]));
        let update = areas.scene(7);
        let [closed, keep_in] = update.entities.as_slice() else { panic!() };
        assert_eq!((closed.id.as_str(), keep_in.id.as_str()), ("keep_out", "keep_in"));
        assert_eq!((closed.lines.len(), keep_in.lines.len()), (1, 1));
        assert_ne!(closed.lines[0].color, keep_in.lines[0].color);
    }
}
