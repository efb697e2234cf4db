//! The areas that the robot keeps out of, as outlines for the 3D panel of Foxglove and for the page.

use foxglove::messages as fox;
use runtime::planning::KeepOut;
use runtime::recording::messages;

/// Width of the outlines, pixels.
const WIDTH_PX: f64 = 3.0;
/// The colour that warnings have, Okabe and Ito's vermilion.
const COLOR: fox::Color = fox::Color { r: 0.835, g: 0.369, b: 0.0, a: 1.0 };

/// One entity with a closed line for each area. It replaces the one before.
pub fn scene(areas_m: &[Vec<[f64; 2]>], time_ns: u64) -> fox::SceneUpdate {
    let entity = fox::SceneEntity {
        timestamp: messages::timestamp(time_ns),
        frame_id: "map".to_owned(),
        id: "keep_out".to_owned(),
        lines: areas_m.iter().map(|corners_m| outline(corners_m)).collect(),
        ..fox::SceneEntity::default()
    };
    fox::SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

fn outline(corners_m: &[[f64; 2]]) -> fox::LinePrimitive {
    fox::LinePrimitive {
        r#type: fox::line_primitive::Type::LineLoop as i32,
        thickness: WIDTH_PX,
        scale_invariant: true,
        points: corners_m.iter().map(|[x, y]| fox::Point3 { x: *x, y: *y, z: 0.0 }).collect(),
        color: Some(COLOR),
        ..fox::LinePrimitive::default()
    }
}

/// The corners of all areas.
pub fn areas_m(keep_out: &KeepOut) -> Vec<Vec<[f64; 2]>> {
    keep_out.polygons_m().map(<[[f64; 2]]>::to_vec).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_area_is_a_closed_line_in_map_and_no_area_an_entity_without_lines() {
        let areas = [vec![[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]], vec![[1.0, 1.0], [2.0, 2.0]]];
        let update = scene(&areas, 7);
        let [entity] = update.entities.as_slice() else { panic!() };
        assert_eq!((entity.frame_id.as_str(), entity.lines.len()), ("map", 2));
        let first = &entity.lines[0];
        assert_eq!(first.r#type, fox::line_primitive::Type::LineLoop as i32);
        assert_eq!(first.points[1], fox::Point3 { x: 2.0, y: 3.0, z: 0.0 });
        assert!(scene(&[], 7).entities[0].lines.is_empty());
    }
}
