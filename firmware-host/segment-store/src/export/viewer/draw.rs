//! What Foxglove draws of a recording and Rerun does not, as messages that both draw.

use fox::packed_element_field::NumericType;
use foxglove::messages as fox;
use hal::Pose3;
use nalgebra::Point3;
use runtime::recording::messages;

/// Okabe and Ito's colours, which eyes that do not tell red from green distinguish, too.
pub(super) const VERMILION: [u8; 4] = [213, 94, 0, 255];
pub(super) const BLUE: [u8; 4] = [0, 114, 178, 255];
pub(super) const SKY: [u8; 4] = [86, 180, 233, 255];
pub(super) const PURPLE: [u8; 4] = [204, 121, 167, 255];
pub(super) const ORANGE: [u8; 4] = [230, 159, 0, 255];

/// Colours of the map: those of `map.png`. A viewer does not draw a cube without opacity.
const UNKNOWN: [u8; 4] = [0; 4];
const FREE: [u8; 3] = [252, 252, 250];
const OCCUPIED: [u8; 3] = [52, 58, 70];

/// Radius of the circle that marks the robot, and length of its heading, metres. It is not the footprint.
const MARK_M: f64 = 0.2;
const HEADING_M: f64 = 0.45;

/// Bytes of a cell of the recorder's map: red, green, blue, alpha, occupancy.
const CELL_BYTES: u32 = 5;

/// Distance between the points of a drawn path, metres.
const SPACING_M: f64 = 0.05;

/// Number of points of a drawn path after which the rest is left out.
const MAX_POINTS: usize = 100_000;

/// The depths at the ends of the colour scale, metres. It is the same for all recordings, so that they can be compared.
const NEAR_M: f64 = 0.3;
const FAR_M: f64 = 10.0;
/// Colour of pixels without a depth.
const NO_DEPTH: [u8; 3] = [198, 200, 205];

/// The map as one layer of cubes below the floor. `None` when the grid is not one that the recorder writes.
pub(super) fn voxels(grid: &fox::Grid) -> Option<fox::VoxelGrid> {
    let fox::Vector2 { x, y } = grid.cell_size?;
    if grid.cell_stride != CELL_BYTES
        || grid.row_stride != grid.column_count.checked_mul(CELL_BYTES)?
    {
        return None;
    }
    let rows = grid.data.len().checked_div(grid.row_stride as usize)?;
    let data: Vec<u8> = grid.data.as_chunks().0.iter().flat_map(cube).collect();
    let mut pose = grid.pose?;
    pose.position.as_mut()?.z -= x;
    Some(fox::VoxelGrid {
        timestamp: grid.timestamp,
        frame_id: grid.frame_id.clone(),
        pose: Some(pose),
        row_count: u32::try_from(rows).ok()?,
        column_count: grid.column_count,
        cell_size: Some(fox::Vector3 { x, y, z: x }),
        slice_stride: u32::try_from(grid.data.len()).ok()?,
        row_stride: grid.row_stride,
        cell_stride: grid.cell_stride,
        fields: grid.fields.clone(),
        data: data.into(),
    })
}

/// Red, green, blue, alpha and occupancy of a cell, with the colours of cubes.
fn cube([_, _, _, _, occupancy]: &[u8; CELL_BYTES as usize]) -> [u8; CELL_BYTES as usize] {
    let value = i8::from_le_bytes([*occupancy]);
    let share = f64::from(value.clamp(0, 100)) / 100.0;
    let [red, green, blue, alpha] =
        if value < 0 { UNKNOWN } else { [mixed(0, share), mixed(1, share), mixed(2, share), 255] };
    [red, green, blue, alpha, *occupancy]
}

fn mixed(channel: usize, share: f64) -> u8 {
    let [free, occupied] = [FREE, OCCUPIED].map(|color| f64::from(color[channel]));
    (free + (occupied - free) * share).round() as u8
}

/// A circle around the robot with a line in the direction of its heading.
pub(super) fn robot(t_map_base: &Pose3, height_m: f64) -> Vec<Point3<f64>> {
    let circle = (0..36).map(|step| {
        let (sin, cos) = (f64::from(step) * 10.0_f64.to_radians()).sin_cos();
        Point3::new(MARK_M * cos, MARK_M * sin, height_m)
    });
    let heading =
        (0..=12).map(|step| Point3::new(HEADING_M * f64::from(step) / 12.0, 0.0, height_m));
    circle.chain(heading).map(|point| t_map_base * point).collect()
}

/// The hits of a scan in the frame of the scanner, metres.
pub(super) fn hits(scan: &fox::LaserScan) -> Vec<Point3<f64>> {
    let steps = scan.ranges.len().saturating_sub(1).max(1) as f64;
    let step = (scan.end_angle - scan.start_angle) / steps;
    let hits = scan.ranges.iter().enumerate().filter(|(_, range)| range.is_finite());
    hits.map(|(beam, range)| {
        let (sin, cos) = (scan.start_angle + beam as f64 * step).sin_cos();
        Point3::new(range * cos, range * sin, 0.0)
    })
    .collect()
}

/// The points of a path with points between them, at a height above the map, metres.
pub(super) fn along(path: &fox::PosesInFrame, height_m: f64) -> Vec<Point3<f64>> {
    let corners: Vec<Point3<f64>> = path
        .poses
        .iter()
        .filter_map(|pose| pose.position)
        .map(|at| Point3::new(at.x, at.y, height_m))
        .collect();
    let mut points: Vec<Point3<f64>> = corners.last().copied().into_iter().collect();
    for (from, to) in corners.iter().zip(corners.iter().skip(1)) {
        // A path of the planner is some metres long; a corrupt one must not fill the memory.
        let most = MAX_POINTS.saturating_sub(points.len()) as f64;
        let steps = ((to - from).norm() / SPACING_M).ceil().min(most) as u32;
        points
            .extend((0..steps).map(|step| from + (to - from) * f64::from(step) / f64::from(steps)));
    }
    points
}

/// Points of one colour in the frame `map`.
pub(super) fn points(
    timestamp: Option<fox::Timestamp>,
    points: &[Point3<f64>],
    color: [u8; 4],
) -> fox::PointCloud {
    let mut data = Vec::with_capacity(16 * points.len());
    for point in points {
        for along in point.coords.iter() {
            data.extend((*along as f32).to_le_bytes());
        }
        data.extend(color);
    }
    fox::PointCloud {
        timestamp,
        frame_id: "map".to_owned(),
        pose: Some(messages::pose(&Pose3::identity())),
        point_stride: 16,
        fields: vec![
            messages::field("x", 0, NumericType::Float32),
            messages::field("y", 4, NumericType::Float32),
            messages::field("z", 8, NumericType::Float32),
            messages::field("red", 12, NumericType::Uint8),
            messages::field("green", 13, NumericType::Uint8),
            messages::field("blue", 14, NumericType::Uint8),
            messages::field("alpha", 15, NumericType::Uint8),
        ],
        data: data.into(),
    }
}

/// A depth image in viridis: near is yellow, far is violet, and grey is no depth. `None` when it is not one that the recorder
/// writes.
pub(super) fn colored(depth: &fox::RawImage) -> Option<fox::CompressedImage> {
    let pixels = depth.data.as_chunks::<2>().0;
    let width = depth.width as usize;
    let height = depth.height as usize;
    if depth.encoding != "16UC1" || width.checked_mul(height) != Some(pixels.len()) {
        return None;
    }
    let rgb: Vec<u8> = pixels.iter().flat_map(|mm| color(u16::from_le_bytes(*mm))).collect();
    let png = super::super::ticks::png(&rgb, width, height, image::ExtendedColorType::Rgb8).ok()?;
    Some(fox::CompressedImage {
        timestamp: depth.timestamp,
        frame_id: depth.frame_id.clone(),
        data: png.into(),
        format: "png".to_owned(),
    })
}

fn color(depth_mm: u16) -> [u8; 3] {
    if depth_mm == 0 {
        return NO_DEPTH;
    }
    let share = (f64::from(depth_mm) / 1000.0 / NEAR_M).ln() / (FAR_M / NEAR_M).ln();
    colorous::VIRIDIS.eval_continuous(1.0 - share.clamp(0.0, 1.0)).as_array()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_hits_of_a_scan_become_points() {
        let scan = fox::LaserScan {
            start_angle: 0.0,
            end_angle: std::f64::consts::PI,
            ranges: vec![1.0, f64::INFINITY, 2.0, f64::NAN, 3.0],
            ..fox::LaserScan::default()
        };
        let found = hits(&scan);
        let expected = [[1.0, 0.0], [0.0, 2.0], [-3.0, 0.0]];
        assert_eq!(found.len(), 3);
        for (point, [x, y]) in found.iter().zip(expected) {
            assert!((point.x - x).abs() < 1e-9 && (point.y - y).abs() < 1e-9, "{point}");
        }
    }

    #[test]
    fn near_is_yellow_far_is_violet_and_nothing_is_grey() {
        assert_eq!([color(300), color(10_000), color(0)], [[253, 231, 37], [68, 1, 84], NO_DEPTH]);
    }

    #[test]
    fn a_depth_image_of_another_size_is_not_drawn() {
        let depth = fox::RawImage {
            width: 2,
            height: 2,
            encoding: "16UC1".to_owned(),
            data: vec![0; 6].into(),
            ..fox::RawImage::default()
        };
        assert!(colored(&depth).is_none());
        let whole = fox::RawImage { data: vec![0; 8].into(), ..depth };
        let png = image::load_from_memory(&colored(&whole).unwrap().data).unwrap().into_rgb8();
        assert!(png.pixels().all(|pixel| pixel.0 == NO_DEPTH) && png.dimensions() == (2, 2));
    }

    #[test]
    fn free_is_light_occupied_is_dark_and_unknown_is_not_drawn() {
        let unknown = u8::from_le_bytes((-1_i8).to_le_bytes());
        assert_eq!(cube(&[1, 2, 3, 255, 0]), [252, 252, 250, 255, 0]);
        assert_eq!(cube(&[1, 2, 3, 255, 100]), [52, 58, 70, 255, 100]);
        assert_eq!(cube(&[128, 128, 128, 40, unknown])[3], 0);
    }

    #[test]
    fn a_grid_with_other_cells_is_not_drawn() {
        let grid = fox::Grid {
            pose: Some(messages::pose(&Pose3::identity())),
            cell_size: Some(fox::Vector2 { x: 0.05, y: 0.05 }),
            column_count: 2,
            row_stride: 10,
            cell_stride: 5,
            data: vec![0; 30].into(),
            ..fox::Grid::default()
        };
        let voxels_of_grid = voxels(&grid).unwrap();
        assert_eq!((voxels_of_grid.row_count, voxels_of_grid.slice_stride), (3, 30));
        assert!(voxels(&fox::Grid { cell_stride: 4, ..grid.clone() }).is_none());
        assert!(voxels(&fox::Grid { row_stride: 0, column_count: 0, ..grid }).is_none());
    }

    #[test]
    fn a_path_has_a_point_every_few_centimetres() {
        let at =
            |x| fox::Pose { position: Some(fox::Vector3 { x, y: 0.0, z: 0.0 }), orientation: None };
        let path = fox::PosesInFrame { poses: vec![at(0.0), at(1.0)], ..Default::default() };
        assert_eq!(along(&path, 0.1).len(), 21);
        assert!(along(&fox::PosesInFrame::default(), 0.0).is_empty());
    }
}
